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


def filter_covariance(A: Matrix, C: Matrix, Q: Matrix, R: Matrix, S: Matrix | None = None, *, dt: float) -> Matrix:
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
    if len(A) >= _STATES and np.linalg.cond(R) < _CONDITION:
        P = _by_doubling(A, C, Q, R, np.zeros_like(C.T) if S is None else S, dt)
        if P is not None:
            return P
    solver = scipy.linalg.solve_discrete_are if dt else scipy.linalg.solve_continuous_are
    P = np.asarray(solver(A.T, C.T, Q, R, s=S), dtype=np.float64)
    return (P + P.T) / 2


def _by_doubling(A: Matrix, C: Matrix, Q: Matrix, R: Matrix, S: Matrix, dt: float) -> Matrix | None:
    """Return the solution, or ``None`` where it is not surely the one, or there is none at all."""
    through = np.linalg.solve(R, np.hstack([C, S.T]))
    n, one = len(A), np.eye(len(A))
    F, G = (A - S @ through[:, :n]).T, _even(C.T @ through[:, :n])
    H = _even(Q - S @ through[:, n:])
    M, N, P = F, G, H
    try:
        with np.errstate(all="ignore"):
            if not dt:  # the equation in sampled time with the same solution, by the Cayley transform
                # near the poles of the filter, in whatever units P is
                rate = np.sqrt((np.linalg.norm(F) ** 2 + np.linalg.norm(G) * np.linalg.norm(H)) / n)
                shifted = scipy.linalg.lu_factor(F - rate * one)
                G_left, H_left = scipy.linalg.lu_solve(shifted, G), scipy.linalg.lu_solve(shifted, H, trans=1)
                W = scipy.linalg.lu_factor(F.T - rate * one + H @ G_left)
                M = one + 2 * rate * scipy.linalg.lu_solve(W, one).T
                N = _even(2 * rate * scipy.linalg.lu_solve(W, G_left.T, trans=1))
                P = _even(2 * rate * scipy.linalg.lu_solve(W, H_left.T))
            for _ in range(_MOST):
                W = scipy.linalg.lu_solve(scipy.linalg.lu_factor(one + N @ P), np.hstack([M, N]))
                N, P, M = _even(N + M @ W[:, n:] @ M.T), _even(P + M.T @ (P @ W[:, :n])), M @ W[:, :n]
                if float(np.linalg.norm(M)) ** 2 < np.finfo(float).eps:  # of the start, which is squared next
                    break
            else:
                return None
            if dt:
                terms = [F.T @ P @ np.linalg.solve(one + G @ P, F), H, -P]
            else:
                terms = [F.T @ P, P @ F, H, -P @ G @ P]
            residual = float(np.linalg.norm(sum(terms))) / sum(float(np.linalg.norm(term)) for term in terms)
            sizes = np.linalg.eigvalsh(P)
            return P if residual <= _RESIDUAL and 0 < sizes[-1] < _CONDITION * sizes[0] else None
    except (np.linalg.LinAlgError, ValueError):  # a singular matrix on the way, or numbers that are not finite
        return None


def _even(M: Matrix) -> Matrix:
    return (M + M.T) / 2
