"""The covariance of a steady filter: the equation itself, solved; what its callers check is whether it may be used."""

from __future__ import annotations

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

Matrix = NDArray[np.float64]

#: From so many states on doubling is several times faster than the QZ algorithm.
_STATES = 32
#: Doublings, after which 2^60 steps of the filter are covered: no filter that works needs more.
_MOST = 60
#: Relative residual beyond which the QZ algorithm is asked as well: it leaves as much itself at 200 states.
_RESIDUAL = 50_000 * float(np.finfo(float).eps)
#: Condition of the measurement noise, by which is divided, and of the covariance up to which two ways to the solution
#: agree to many digits. Beyond, as where a mode is hardly seen, what comes out is decided by one of them alone.
_CONDITION = 1e6


def filter_covariance(
    A: Matrix, C: Matrix, Q: Matrix, R: Matrix, S: Matrix | None = None, *, dt: float, rough: bool = False
) -> Matrix:
    r"""Solve ``A P + P A' + Q = (P C' + S) R^-1 (P C' + S)'``, or its form in sampled time, for the stabilising ``P``.

    Small equations by the QZ algorithm; larger ones by doubling: with :math:`P_k` the covariance after :math:`2^k`
    steps from a known state,

    .. math::
        A_{k+1} = A_k W A_k, \quad G_{k+1} = G_k + A_k W G_k A_k^T, \quad
        P_{k+1} = P_k + A_k^T P_k W A_k, \qquad W = (I + G_k P_k)^{-1},

    for the transposed system, after a Cayley transform in continuous time. Where it does not forget the state that it
    starts from, leaves a residual, or the solution is ill-conditioned, the QZ algorithm decides.

    Parameters
    ----------
    A : ndarray, shape (n, n)
    C : ndarray, shape (p, n)
    Q : ndarray, shape (n, n)
    R : ndarray, shape (p, p)
    S : ndarray, shape (n, p), optional
    dt : float
    rough : bool
        Whether to return what doubling leaves, a start for other steps, where the QZ algorithm finds no solution.

    Returns
    -------
    ndarray, shape (n, n)

    Raises
    ------
    LinAlgError, ValueError
        Those of SciPy, where there is no solution.

    References
    ----------
    E. K.-W. Chu, H.-Y. Fan, W.-W. Lin, A structure-preserving doubling algorithm for continuous-time algebraic Riccati
    equations, Linear Algebra Appl. 396 (2005) 55-80.
    """
    cross = np.zeros_like(C.T) if S is None else S
    if len(A) >= _STATES and np.linalg.cond(R) < _CONDITION:
        P = _by_doubling(A, C, Q, R, cross, dt)
        if P is not None:
            return P
    solver = scipy.linalg.solve_discrete_are if dt else scipy.linalg.solve_continuous_are
    try:
        return np.asarray(solver(A.T, C.T, Q, R, s=S), dtype=np.float64)
    except np.linalg.LinAlgError:
        P = _by_doubling(A, C, Q, R, cross, dt, surely=False) if rough else None
        if P is None:
            raise
        return P


def _by_doubling(
    A: Matrix, C: Matrix, Q: Matrix, R: Matrix, S: Matrix, dt: float, *, surely: bool = True
) -> Matrix | None:
    """Return the solution, or ``None`` where it is not surely the one, or there is none at all."""
    through = np.linalg.solve(R, np.hstack([C, S.T]))
    n = len(A)
    F, G = (A - S @ through[:, :n]).T, _even(C.T @ through[:, :n])
    H = _even(Q - S @ through[:, n:])
    try:
        with np.errstate(all="ignore"):
            start = (F, G, H) if dt else _transformed(F, G, H)
            P = _doubled(*start)
            if P is None or not np.isfinite(P).all():
                return None
            if not surely:
                return P
            if not _residual(F, G, H, P, dt) <= _RESIDUAL:
                return None
            sizes = np.linalg.eigvalsh(P)
            return P if 0 < sizes[-1] < _CONDITION * sizes[0] else None
    except (np.linalg.LinAlgError, ValueError):  # a singular matrix on the way, or numbers that are not finite
        return None


def _transformed(F: Matrix, G: Matrix, H: Matrix) -> tuple[Matrix, Matrix, Matrix]:
    """Return the equation in sampled time with the same solution, by the Cayley transform."""
    one = np.eye(len(F))
    # near the poles of the filter, in whatever units P is
    rate = np.sqrt((np.linalg.norm(F) ** 2 + np.linalg.norm(G) * np.linalg.norm(H)) / len(F))
    shifted = scipy.linalg.lu_factor(F - rate * one)
    G_left, H_left = scipy.linalg.lu_solve(shifted, G), scipy.linalg.lu_solve(shifted, H, trans=1)
    W = scipy.linalg.lu_factor(F.T - rate * one + H @ G_left)
    A = one + 2 * rate * scipy.linalg.lu_solve(W, one).T
    return (
        A,
        _even(2 * rate * scipy.linalg.lu_solve(W, G_left.T, trans=1)),
        _even(2 * rate * scipy.linalg.lu_solve(W, H_left.T)),
    )


def _doubled(A: Matrix, G: Matrix, P: Matrix) -> Matrix | None:
    """Return the limit of the doublings, or ``None`` if the start is not forgotten."""
    n = len(A)
    for _ in range(_MOST):
        W = scipy.linalg.lu_solve(scipy.linalg.lu_factor(np.eye(n) + G @ P), np.hstack([A, G]))
        G, P, A = _even(G + A @ W[:, n:] @ A.T), _even(P + A.T @ (P @ W[:, :n])), A @ W[:, :n]
        if float(np.linalg.norm(A)) ** 2 < np.finfo(float).eps:  # of the start, which the next doubling would square
            return P
    return None


def _residual(F: Matrix, G: Matrix, H: Matrix, P: Matrix, dt: float) -> float:
    """Return the norm of the residual relative to the sum of the norms of its terms."""
    if dt:
        terms = [F.T @ P @ np.linalg.solve(np.eye(len(F)) + G @ P, F), H, -P]
    else:
        FP = F.T @ P
        terms = [FP + FP.T, H, -P @ G @ P]
    size = sum(float(np.linalg.norm(term)) for term in terms)
    return float(np.linalg.norm(sum(terms))) / size if size else 0.0


def _even(M: Matrix) -> Matrix:
    return (M + M.T) / 2
