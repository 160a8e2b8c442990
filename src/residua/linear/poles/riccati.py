"""The stabilising solution of the filter Riccati equation: the solvers, and the solution with its residual checked."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from residua import arrays
from residua.errors import AccuracyError, DesignError, ModelError
from residua.linear.poles.spectrum import describe_modes
from residua.linear.poles.stability import is_stable_mode
from residua.linear.subspaces.observability import detectability, pair, staircase
from residua.linear.systems.scaling import power_near, scaling
from residua.tolerances import RESIDUE, above_rounding

Matrix = NDArray[np.float64]
#: Largest relative residual of an equation that counts as solved.
_RESIDUAL_LIMIT = 1e-6
#: From so many states on doubling is several times faster than the QZ algorithm.
_STATES = 32
#: Doublings, after which 2^60 steps of the filter are covered: no filter that works needs more.
_MOST = 60
#: Relative residual beyond which the QZ algorithm is asked as well: it leaves as much itself at 200 states.
_RESIDUAL = 50_000 * float(np.finfo(float).eps)
#: Condition of the measurement noise, by which is divided, and of the covariance up to which two ways to the solution
#: agree to many digits. Beyond, as where a mode is hardly seen, what comes out is decided by one of them alone.
_CONDITION = 1e6
#: What is in the way of a solution, and what helps.
_HARDLY = (
    "a mode near the stability boundary is hardly seen by the outputs, or hardly disturbed; add a sensor, or process "
    "noise on it"
)


@dataclass(frozen=True, eq=False)
class RiccatiSolution:
    """A steady-state Kalman filter.

    Attributes
    ----------
    covariance : ndarray, shape (n, n)
        ``P``, of the estimation error (of the prediction, in sampled time).
    gain : ndarray, shape (n, p)
        ``K``: ``(P C' + S) R^-1``, or ``(A P C' + S) (C P C' + R)^-1`` in sampled time.
    innovation_covariance : ndarray, shape (p, p)
        ``C P C' + R`` in sampled time, the intensity ``R`` in continuous time.
    poles : ndarray of complex, shape (n,)
        Of ``A - K C``; all stable.
    residual : float
        Norm of the equation's residual relative to the sum of the norms of its terms, in balanced units.
    """

    covariance: Matrix
    gain: Matrix
    innovation_covariance: Matrix
    poles: NDArray[np.complex128]
    residual: float


def filter_riccati(
    A: ArrayLike,
    C: ArrayLike,
    Q: ArrayLike,
    R: ArrayLike,
    S: ArrayLike | None = None,
    *,
    dt: float = 0,
) -> RiccatiSolution:
    r"""Solve the algebraic Riccati equation of the steady-state Kalman filter.

    .. math:: A P + P A^T + Q - (P C^T + S) R^{-1} (P C^T + S)^T = 0

    in continuous time, and in sampled time, for the predictor,

    .. math:: P = A P A^T + Q - (A P C^T + S)(C P C^T + R)^{-1}(A P C^T + S)^T.

    The solution returned is the stabilising one: its poles are stable and its residual is small, or an error is raised.

    Assumes
        ``(A, C)`` detectable; every mode on the stability boundary disturbed by process noise; ``R`` positive definite.

    Parameters
    ----------
    A : array_like, shape (n, n)
    C : array_like, shape (p, n)
    Q : array_like, shape (n, n)
        Process noise: covariance for each step, or intensity.
    R : array_like, shape (p, p)
        Measurement noise, in the squared units of ``y``.
    S : array_like, shape (n, p), optional
        Cross-covariance of process and measurement noise; zero when omitted.
    dt : float
        0 for continuous time, otherwise the sample step in seconds.

    Returns
    -------
    RiccatiSolution

    Raises
    ------
    ModelError
        If a matrix is malformed or ``[[Q, S], [S', R]]`` is not a covariance.
    DesignError
        If one of the assumptions fails; the message names the outputs or the modes.
    AccuracyError
        If the solution fails its own check.

    References
    ----------
    Anderson and Moore, Optimal Filtering, 1979, section 4.4.

    Examples
    --------
    >>> filter_riccati([[0.0]], [[1.0]], [[4.0]], [[1.0]]).gain
    array([[2.]])
    """
    dt = arrays.sample_step(dt)
    A, C = pair(A, C)
    p, n = C.shape
    if p == 0:
        raise DesignError("a Kalman filter needs at least one output")
    S = np.zeros((n, p)) if S is None else arrays.matrix(S, "S", (n, p))
    Q, R = _covariance(Q, "Q", n), _covariance(R, "R", p)
    if n == 0:
        return RiccatiSolution(np.zeros((0, 0)), np.zeros((0, p)), R, np.zeros(0, complex), 0.0)
    _check_solvable(A, C, Q, R, S, dt)
    T = scaling(A, np.zeros((n, 0)), C, np.zeros((p, 0)), sampled=dt > 0).states
    # Outputs in units of their noise: R becomes a correlation matrix, however C is scaled.
    Y = 1 / power_near(np.sqrt(np.diag(R)))
    # The size of the state follows from the noise; common units keep P near one.
    T = T * (float(power_near(np.sqrt(np.trace(Q / T[:, None] / T)))) or 1.0)
    A, C, Q = A / T[:, None] * T, Y[:, None] * C * T, Q / T[:, None] / T
    terms = A, C, Q, Y[:, None] * R * Y, S / T[:, None] * Y
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the outcome is checked here
            P = filter_covariance(*terms[:4], terms[4] if np.any(S) else None, dt=dt)
    except (np.linalg.LinAlgError, ValueError) as error:
        raise AccuracyError(f"the Riccati equation could not be solved ({error}): {_HARDLY}") from error
    P, K, innovation, residual = _refined(*terms, P, dt)
    poles = np.linalg.eigvals(A - K @ C).astype(complex)
    if not is_stable_mode(poles, dt).all() or not residual <= _RESIDUAL_LIMIT:
        raise AccuracyError(
            f"the Riccati equation was not solved: relative residual {residual:.3g} (limit {_RESIDUAL_LIMIT:.0e}), "
            f"poles {describe_modes(poles)}; scale the noise covariances nearer to one another"
        )
    # what rounding leaves of correlations that there are not, and of innovations that tell nothing of a state
    size = np.sqrt(np.abs(np.diag(P)))
    P = above_rounding(P, np.outer(size, size), RESIDUE)
    informative = ((A @ P if dt else P) @ C.T + terms[4]).any(axis=1, keepdims=True)
    K = np.where(informative, above_rounding(K, np.abs(K).max(axis=1, keepdims=True), RESIDUE), 0.0)
    return RiccatiSolution(T[:, None] * P * T, T[:, None] * K * Y, innovation / Y[:, None] / Y, poles, residual)


def _covariance(M: ArrayLike, name: str, n: int) -> Matrix:
    M = arrays.matrix(M, name, (n, n))
    if np.abs(M - M.T).max(initial=0.0) > 1e-8 * np.abs(M).max(initial=0.0):
        raise ModelError(f"{name} must be symmetric; it differs from its transpose by {np.abs(M - M.T).max():.3g}")
    return (M + M.T) / 2


def _correlation(M: Matrix) -> tuple[Matrix, Matrix]:
    """Scale a covariance to unit diagonal, which makes its definiteness independent of units."""
    d = np.sqrt(np.maximum(np.diag(M), 0.0))
    d = np.where(d > 0, d, 1.0)
    return M / d[:, None] / d, d


def _check_solvable(A: Matrix, C: Matrix, Q: Matrix, R: Matrix, S: Matrix, dt: float) -> None:
    """Raise unless the stabilising solution exists; name what stands in its way."""
    joint, _ = _correlation(np.block([[Q, S], [S.T, R]]))
    lowest = float(np.linalg.eigvalsh(joint)[0])
    if lowest < -1e-9 * max(1.0, float(np.abs(joint).max())):
        raise ModelError(
            f"[[Q, S], [S', R]] is not a covariance: its correlation matrix has the eigenvalue {lowest:.3g}"
        )
    values, vectors = np.linalg.eigh(_correlation(R)[0])
    rank = int(np.count_nonzero(values > 1e-13 * values[-1]))
    if rank < len(R):
        raise DesignError(
            f"R is singular: rank {rank} of {len(R)}, no noise in the direction of output number "
            f"{int(np.argmax(np.abs(vectors[:, 0]))) + 1}; give every output measurement noise"
        )
    answer = detectability(A, C, dt=dt)
    if not answer:
        raise DesignError(
            f"not detectable: mode {describe_modes(answer.unstable_modes)} is not seen by any output; "
            "add a sensor that sees it"
        )
    # After the measured part of the process noise is taken out, Q - S R^-1 S' drives A - S R^-1 C.
    gain = np.linalg.solve(R, S.T).T
    rest, scale = _correlation(Q - gain @ S.T)
    values, vectors = np.linalg.eigh(rest)
    root = np.sqrt(np.where(values > 1e-12, values, 0.0)) * vectors * scale[:, None]
    modes, near = staircase((A - gain @ C).T, root.T).hidden_modes
    boundary = modes[np.abs(np.abs(modes) - 1 if dt else modes.real) <= near]
    if boundary.size:
        raise DesignError(
            f"mode {describe_modes(boundary)} on the stability boundary is not disturbed by process noise, "
            "so no steady filter is stable; add process noise on it"
        )


def _gain(A: Matrix, C: Matrix, Q: Matrix, R: Matrix, S: Matrix, P: Matrix, dt: float) -> tuple[Matrix, Matrix, float]:
    """Return gain, innovation covariance and relative residual of a candidate ``P``."""
    innovation, cross = (C @ P @ C.T + R, A @ P @ C.T + S) if dt else (R, P @ C.T + S)
    try:
        K: Matrix = np.asarray(np.linalg.solve(innovation, cross.T).T, dtype=np.float64)
    except np.linalg.LinAlgError as error:  # a mode that is hardly seen, as a random walk, hides the noise of outputs
        raise AccuracyError(
            f"the measurement noise is rounding of what the outputs cannot foretell: {_HARDLY}"
        ) from error
    terms = [Q, -K @ cross.T, *((A @ P @ A.T, -P) if dt else (A @ P + P @ A.T,))]
    size = sum(float(np.linalg.norm(M)) for M in terms)
    return K, innovation, float(np.linalg.norm(sum(terms))) / size if size else 0.0


def _refined(
    A: Matrix, C: Matrix, Q: Matrix, R: Matrix, S: Matrix, P: Matrix, dt: float
) -> tuple[Matrix, Matrix, Matrix, float]:
    """Return covariance, gain, innovation covariance and residual after Newton steps that help (Kleinman, Hewer)."""
    K, innovation, residual = _gain(A, C, Q, R, S, P, dt)
    solver = scipy.linalg.solve_discrete_lyapunov if dt else scipy.linalg.solve_continuous_lyapunov
    for _ in range(3):
        if residual <= 1e-12 or not is_stable_mode(np.linalg.eigvals(A - K @ C), dt).all():
            break
        W = Q - K @ S.T - S @ K.T + K @ R @ K.T
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                better = solver(A - K @ C, W if dt else -W)
            found = _gain(A, C, Q, R, S, (better + better.T) / 2, dt)
        except (np.linalg.LinAlgError, ValueError, AccuracyError):
            break
        if not found[2] < residual:
            break
        P, (K, innovation, residual) = (better + better.T) / 2, found
    return P, K, innovation, residual


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
    F, G = (A - S @ through[:, :n]).T, _symmetric(C.T @ through[:, :n])
    H = _symmetric(Q - S @ through[:, n:])
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
                N = _symmetric(2 * rate * scipy.linalg.lu_solve(W, G_left.T, trans=1))
                P = _symmetric(2 * rate * scipy.linalg.lu_solve(W, H_left.T))
            for _ in range(_MOST):
                W = scipy.linalg.lu_solve(scipy.linalg.lu_factor(one + N @ P), np.hstack([M, N]))
                N, P, M = _symmetric(N + M @ W[:, n:] @ M.T), _symmetric(P + M.T @ (P @ W[:, :n])), M @ W[:, :n]
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


def _symmetric(M: Matrix) -> Matrix:
    return (M + M.T) / 2
