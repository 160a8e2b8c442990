"""Impulse responses of stable sampled systems, with a bound on everything that is cut off."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from residua.errors import AccuracyError, ModelError
from residua.linear.balancing import state_units
from residua.linear.observability import is_stable_mode
from residua.linear.spectrum import describe_modes
from residua.linear.state_space import StateSpace

Matrix = NDArray[np.float64]
#: Terms of a block; the powers of ``A`` within it are computed once.
_BLOCK = 256


@dataclass(frozen=True, eq=False)
class StableSystem:
    """A checked, stable, sampled system in balanced units of its states.

    Attributes
    ----------
    A, B, C, D : ndarray
    units : ndarray, shape (n,)
        ``x = units * x_balanced``.
    radius : float
        Spectral radius of ``A``.
    """

    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix
    units: NDArray[np.float64]
    radius: float


def stable_system(system: StateSpace, what: str = "the peak norm") -> StableSystem:
    """Return the matrices of a stable sampled system in balanced states, or say why there are none."""
    if not isinstance(system, StateSpace):
        raise ModelError(f"{what} takes a StateSpace, got {type(system).__name__}")
    if not system.is_discrete:
        raise ModelError(
            f"{what} is that of a sampled system, and this one is continuous: sample it first, "
            "system.discretize(dt); the bound then holds at the sample instants, for inputs that are held"
        )
    system = system.explicit()
    T = state_units(system.A, system.B, system.C, system.D)
    A, B, C = system.A / T[:, None] * T, system.B / T[:, None], system.C * T
    poles = np.linalg.eigvals(A).astype(complex) if len(A) else np.zeros(0, complex)
    stable = is_stable_mode(poles, system.dt)
    if not stable.all():
        raise ModelError(
            f"{what} is infinite: the system has the unstable pole {describe_modes(poles[~stable][:1])} "
            "(a pole that inputs or outputs do not reach counts too: leave it out of the model)"
        )
    return StableSystem(A, B, C, system.D, T, float(np.abs(poles).max(initial=0.0)))


@dataclass(frozen=True, eq=False)
class TailBound:
    r"""A norm in which ``A`` contracts, so that a geometric series bounds what is cut off.

    With :math:`P = L L^T` of a Lyapunov equation, :math:`\|L^T A L^{-T}\|_2 = s < 1` is computed, and

    .. math:: \sum_{j \ge 0} \|C A^j X\|_2 \le \|C L^{-T}\|_2 \, \|L^T X\|_2 / (1 - s)

    for every ``X``. The bound holds for whatever ``P`` the equation gave: only ``s`` has to be less than one.

    Where no equation gave one, ``L`` is the identity, ``contraction`` the norm of a power of ``A``, and ``output`` has
    the sum of the norms of those before it in it.
    """

    L: Matrix
    contraction: float
    output: float

    def beyond(self, X: Matrix) -> float:
        """Return the bound for the terms ``C X, C A X, C A^2 X, ...``."""
        return self.output * _largest(self.L.T @ X) / (1 - self.contraction)


def _largest(M: Matrix) -> float:
    return float(np.linalg.norm(M, 2)) if M.size else 0.0


def tail_bound(system: StableSystem) -> TailBound:
    """Return the bound, from the Lyapunov equation of ``A`` sped up by half of its stability margin, or from powers.

    The latter where the equation is not solved to enough digits: where poles are near to each other, and slow.
    """
    n = len(system.A)
    if not n:
        return TailBound(np.zeros((0, 0)), 0.0, 0.0)
    L = _contracting(system.A, 0.5 * (1 + system.radius))
    if L is not None:
        contraction = _largest(scipy.linalg.solve_triangular(L, (L.T @ system.A).T, lower=True))
        if contraction < 1:
            return TailBound(L, contraction, _largest(scipy.linalg.solve_triangular(L, system.C.T, lower=True)))
    return _by_powers(system)


def _contracting(A: Matrix, fast: float) -> Matrix | None:
    """Return a Cholesky factor of ``P = (A / fast)' P (A / fast) + I``, by doubling, which keeps ``P`` positive."""
    P, power = np.eye(len(A)), A / fast
    for _ in range(70):
        step = power.T @ P @ power
        P = P + step
        if not np.isfinite(P).all() or np.linalg.norm(step) <= 1e-15 * np.linalg.norm(P):
            break
        power = power @ power
    try:
        return np.asarray(np.linalg.cholesky(P), dtype=float)
    except np.linalg.LinAlgError:
        return None


def _by_powers(system: StableSystem) -> TailBound:
    r"""Bound by :math:`\sum_j |A^j| \le \sum_{j < N} |A^j| / (1 - |A^N|)`, ``N`` a power of two."""
    power, total, n = system.A, 1.0, len(system.A)
    for _ in range(60):
        size = _largest(power)
        if size < 0.5:
            return TailBound(np.eye(n), size, _largest(system.C) * total)
        total *= 1 + size  # the terms from N to 2 N - 1 are those before times A^N
        power = power @ power
        if not (np.isfinite(power).all() and np.isfinite(total)):
            break
    raise AccuracyError(
        f"no norm was found in which the system contracts (spectral radius {system.radius:.12g}): "
        "its poles are too near to the stability boundary, or too badly conditioned, for double precision"
    )


def impulse_blocks(system: StableSystem, *, most: int) -> Iterator[tuple[Matrix, float]]:
    """Yield blocks of terms ``h_k``, shape (terms, p, m), each with a bound on the norms of all terms after it.

    The first block is the direct term ``D``; ``most`` terms are yielded at most, rounded up to a block.
    """
    p, m = system.D.shape
    n = len(system.A)
    bound = tail_bound(system)
    X = system.B
    yield system.D[None], bound.beyond(X)
    if not n:
        return
    rows, power = system.C, system.A
    while len(rows) < _BLOCK * p:
        rows, power = np.vstack([rows, rows @ power]), power @ power
    for _ in range(0, most, _BLOCK):
        X_next = power @ X
        yield (rows @ X).reshape(-1, p, m), bound.beyond(X_next)
        X = X_next
