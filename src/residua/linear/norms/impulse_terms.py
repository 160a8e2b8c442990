"""Impulse responses of stable sampled systems, with a bound on everything that is cut off."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import suppress
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
    return in_balanced_states(system, what)


def in_balanced_states(system: StateSpace, what: str) -> StableSystem:
    """Return the matrices of a stable system in balanced states; norms depend on the units of inputs and outputs."""
    system = system.explicit()
    T = scaling(system.A, system.B, system.C, system.D, sampled=system.is_discrete).states
    A, B, C = system.A / T[:, None] * T, system.B / T[:, None], system.C * T
    poles = np.linalg.eigvals(A).astype(complex) if len(A) else np.zeros(0, complex)
    stable = is_stable_mode(poles, system.dt)
    if not stable.all():
        raise ModelError(
            f"{what} is infinite: the system has the unstable pole {describe_modes(poles[~stable][:1])} "
            "(a pole that inputs or outputs do not reach counts too: leave it out of the model)"
        )
    return StableSystem(A, B, C, system.D, T, float(np.abs(poles).max(initial=0.0)))


def doubled_sum(power: Matrix, W: Matrix) -> Matrix | None:
    """Return ``sum power^k W power'^k`` by squaring, which keeps it positive; ``None`` if it grows without end."""
    total = W
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(60):
            step = power @ total @ power.T
            total = total + step
            size, more = (math.sqrt(v.dot(v)) for v in (total.ravel(), step.ravel()))  # Frobenius norms, soon
            if not math.isfinite(size):
                return None
            if more <= 1e-16 * size:
                break
            power = power @ power
    return total


def _tail_bound(system: StableSystem) -> Callable[[Matrix], float]:
    r"""Return a function that bounds the sum of the norms of ``C X, C A X, C A^2 X, ...`` for every ``X``.

    With :math:`P = L L^T` of the Lyapunov equation of ``A`` sped up by a part of its stability margin,
    :math:`\|L^T A L^{-T}\|_2 = s < 1` is computed, and

    .. math:: \sum_{j \ge 0} \|C A^j X\|_2 \le \|C L^{-T}\|_2 \, \|L^T X\|_2 / (1 - s)

    holds for whatever ``P`` the equation gave: only ``s`` has to be less than one. Where it is not, as with poles that
    are near to each other, and slow, a triangular form bounds it.
    """
    n = len(system.A)
    if not n:
        return lambda X: 0.0
    for share in (0.5, 0.25):
        P = doubled_sum(system.A.T / (1 - share * (1 - system.radius)), np.eye(n))
        if P is None:
            continue
        with suppress(np.linalg.LinAlgError):
            L = np.linalg.cholesky(P)
            contraction = spectral_norm(scipy.linalg.solve_triangular(L, (L.T @ system.A).T, lower=True))
            output = spectral_norm(scipy.linalg.solve_triangular(L, system.C.T, lower=True))
            if contraction < 1:
                return lambda X, L=L, c=contraction, output=output: output * spectral_norm(L.T @ X) / (1 - c)
    return _by_triangle(system)


def _by_triangle(system: StableSystem) -> Callable[[Matrix], float]:
    r"""Return a bound by absolute values of a triangular form, for want of a norm in which ``A`` contracts.

    With the Schur form :math:`A = Q T Q^H` and :math:`N \ge |Q^H A Q|`, for every ``X``,

    .. math:: \sum_{j \ge 0} \|C A^j X\|_2 \le \sum_{ik} \bigl(|C Q| (I - N)^{-1} |Q^H X|\bigr)_{ik}

    ``N`` is ``|T|`` and what rounding of the form amounts to; its powers die out as those of ``A`` do, however near to
    each other the poles are.
    """
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
    weights = (1 + 1e-6) * seen.sum(axis=0) @ np.abs(inverse)
    return lambda X: float(weights @ np.abs(Q.conj().T @ X).sum(axis=1))


def impulse_blocks(system: StableSystem, *, most: int) -> Iterator[tuple[Matrix, float]]:
    """Yield blocks of terms ``h_k``, shape (terms, p, m), each with a bound on the norms of all terms after it.

    The first block is the direct term ``D``; ``most`` terms are yielded at most, rounded up to a block.
    """
    beyond = _tail_bound(system)
    yield system.D[None], beyond(system.B)
    if len(system.A):
        for H, X in response_blocks(system.A, system.B, system.C, most):
            yield H, beyond(X)


def response_blocks(A: Matrix, B: Matrix, C: Matrix, terms: int) -> Iterator[tuple[Matrix, Matrix]]:
    """Yield ``C A^k B`` from ``k = 0`` on in blocks of 256, and the ``A^k B`` that comes after each, for so many terms.

    By products with a high power of ``A``, where these agree with one step after the other over the first two blocks.
    Squares of a matrix that is far from normal are far off, though its steps are not: then by steps.
    """
    p, m = len(C), B.shape[1]
    if not (p and m and terms):
        return
    X, rows, power, stepped, jumps = B, C, A, [], False
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(-(-terms // _BLOCK)):
            if k == _COMPARED:
                while len(rows) < _BLOCK * p:
                    rows, power = np.vstack([rows, rows @ power]), power @ power
                again, missed = B, 0.0
                for H in stepped:
                    missed += float(np.abs((rows @ again).reshape(H.shape) - H).sum())
                    again = power @ again
                jumps = bool(missed <= _AGREED * sum(float(np.abs(H).sum()) for H in stepped))
            if jumps:
                H, X = (rows @ X).reshape(_BLOCK, p, m), power @ X
            else:
                states = np.empty((_BLOCK + 1, *B.shape))
                states[0] = X
                for i in range(_BLOCK):
                    np.matmul(A, states[i], out=states[i + 1])
                H, X = C @ states[:-1], states[-1].copy()
            if k < _COMPARED:
                stepped.append(H)
            yield H, X
