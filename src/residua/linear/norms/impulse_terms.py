"""Impulse responses of stable sampled systems, with a bound on everything that is cut off."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from residua.errors import AccuracyError, ModelError
from residua.linear.poles.spectrum import describe_modes
from residua.linear.poles.stability import is_stable_mode
from residua.linear.subspaces.rank import spectral_norm
from residua.linear.systems.scaling import scaling
from residua.linear.systems.state_space import StateSpace

Matrix = NDArray[np.float64]
#: Terms of a block.
_BLOCK = 256
#: Blocks over which products with powers are compared with single steps, and how far they may be apart, relative to the
#: sum of their terms.
_COMPARED, _AGREED = 2, 1e-12


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
    T = scaling(system.A, system.B, system.C, system.D, sampled=True).states
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
    """

    L: Matrix
    contraction: float
    output: float

    def beyond(self, X: Matrix) -> float:
        """Return the bound for the terms ``C X, C A X, C A^2 X, ...``."""
        return self.output * spectral_norm(self.L.T @ X) / (1 - self.contraction)


@dataclass(frozen=True, eq=False)
class TriangularTailBound:
    r"""A bound by absolute values of a triangular form, for want of a norm in which ``A`` contracts.

    With the Schur form :math:`A = Q T Q^H` and :math:`N \ge |Q^H A Q|`, for every ``X``,

    .. math:: \sum_{j \ge 0} \|C A^j X\|_2 \le \sum_{ik} \bigl(|C Q| (I - N)^{-1} |Q^H X|\bigr)_{ik}

    ``N`` is ``|T|`` and what rounding of the form amounts to; its powers die out as those of ``A`` do, however near to
    each other the poles are.
    """

    Q: NDArray[np.complex128]
    weights: NDArray[np.float64]

    def beyond(self, X: Matrix) -> float:
        """Return the bound for the terms ``C X, C A X, C A^2 X, ...``."""
        return float(self.weights @ np.abs(self.Q.conj().T @ X).sum(axis=1))


def tail_bound(system: StableSystem) -> TailBound | TriangularTailBound:
    """Return the bound, from the Lyapunov equation of ``A`` sped up by half of its stability margin, or by triangles.

    The latter where the equation is not solved to enough digits: where poles are near to each other, and slow.
    """
    n = len(system.A)
    if not n:
        return TailBound(np.zeros((0, 0)), 0.0, 0.0)
    L = _contracting(system.A, 0.5 * (1 + system.radius))
    if L is not None:
        contraction = spectral_norm(scipy.linalg.solve_triangular(L, (L.T @ system.A).T, lower=True))
        if contraction < 1:
            return TailBound(L, contraction, spectral_norm(scipy.linalg.solve_triangular(L, system.C.T, lower=True)))
    return _by_triangle(system)


def _contracting(A: Matrix, fast: float) -> Matrix | None:
    """Return a Cholesky factor of ``P = (A / fast)' P (A / fast) + I``, by doubling, which keeps ``P`` positive."""
    P, power = np.eye(len(A)), A / fast
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(70):
            step = power.T @ P @ power
            P = P + step
            if not np.isfinite(P).all() or np.linalg.norm(step) <= 1e-15 * np.linalg.norm(P):
                break
            power = power @ power
    if not np.isfinite(P).all():
        return None
    try:
        return np.asarray(np.linalg.cholesky(P), dtype=float)
    except np.linalg.LinAlgError:
        return None


def _by_triangle(system: StableSystem) -> TriangularTailBound:
    n, eps = len(system.A), np.finfo(float).eps
    T, Q = scipy.linalg.schur(system.A, output="complex")
    N = np.abs(np.triu(T)) + 10 * n * eps * np.linalg.norm(system.A)
    inverse = np.linalg.solve(np.eye(n) - N, np.eye(n)) if np.abs(np.diagonal(T)).max() < 1 else np.full((n, n), np.nan)
    x = inverse.sum(axis=1)
    # a positive x with x > N x proves that the powers of N die out
    if not (np.isfinite(x).all() and (x > 0).all() and (x - N @ x > 0.5).all()):
        raise AccuracyError(
            f"no norm was found in which the system contracts (spectral radius {system.radius:.12g}): "
            "its poles are too near to the stability boundary, or too badly conditioned, for double precision"
        )
    seen = np.abs(system.C @ Q) + 10 * n * eps * np.abs(system.C).sum(axis=1, keepdims=True)
    return TriangularTailBound(Q, (1 + 1e-6) * seen.sum(axis=0) @ np.abs(inverse))


def impulse_blocks(system: StableSystem, *, most: int) -> Iterator[tuple[Matrix, float]]:
    """Yield blocks of terms ``h_k``, shape (terms, p, m), each with a bound on the norms of all terms after it.

    The first block is the direct term ``D``; ``most`` terms are yielded at most, rounded up to a block.
    """
    bound = tail_bound(system)
    yield system.D[None], bound.beyond(system.B)
    if len(system.A):
        for H, X in response_blocks(system.A, system.B, system.C, most):
            yield H, bound.beyond(X)


def response_blocks(A: Matrix, B: Matrix, C: Matrix, terms: int) -> Iterator[tuple[Matrix, Matrix]]:
    """Yield ``C A^k B`` from ``k = 0`` on in blocks of 256, and the ``A^k B`` that comes after each, for so many terms.

    By products with a high power of ``A``, where these agree with one step after the other over the first two blocks.
    Squares of a matrix that is far from normal are far off, though its steps are not: then by steps.
    """
    p, m = len(C), B.shape[1]
    if not (p and m and terms):
        return
    X, stepped = B, []
    jumps: _Jumps | None = None
    for k in range(-(-terms // _BLOCK)):
        if k == _COMPARED:
            jumps = _Jumps(A, C)
            jumps = jumps if jumps.agree(B, stepped) else None
        H, X = _stepped(A, X, C) if jumps is None else (jumps.rows_times(X), jumps.times_power(X))
        if k < _COMPARED:
            stepped.append(H)
        yield H, X


def _stepped(A: Matrix, X: Matrix, C: Matrix) -> tuple[Matrix, Matrix]:
    """Return a block of terms by one step after the other, and the state after it."""
    states = np.empty((_BLOCK + 1, *X.shape))
    states[0] = X
    for k in range(_BLOCK):
        np.matmul(A, states[k], out=states[k + 1])
    return C @ states[:-1], states[-1].copy()


class _Jumps:
    """``C A^k`` for a block of ``k``, and the power of ``A`` that leads to the next, by squaring."""

    def __init__(self, A: Matrix, C: Matrix) -> None:
        rows, power = C, A
        with np.errstate(over="ignore", invalid="ignore"):
            while len(rows) < _BLOCK * len(C):
                rows, power = np.vstack([rows, rows @ power]), power @ power
        self._rows, self._power, self._outputs = rows, power, len(C)

    def rows_times(self, X: Matrix) -> Matrix:
        """Return a block of terms from a state on."""
        with np.errstate(over="ignore", invalid="ignore"):
            return (self._rows @ X).reshape(_BLOCK, self._outputs, X.shape[1])

    def times_power(self, X: Matrix) -> Matrix:
        """Return the state after a block."""
        with np.errstate(over="ignore", invalid="ignore"):
            return self._power @ X

    def agree(self, X: Matrix, blocks: list[Matrix]) -> bool:
        """Tell whether blocks that were made by steps from a state on come out again."""
        missed = size = 0.0
        for H in blocks:
            missed, size = missed + float(np.abs(self.rows_times(X) - H).sum()), size + float(np.abs(H).sum())
            X = self.times_power(X)
        return bool(missed <= _AGREED * size)
