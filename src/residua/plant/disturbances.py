"""Disturbance matrices: rank factors, from parameter perturbations, from steady states."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.arrays import matrix
from residua.errors import DataError, ModelError
from residua.linear.subspaces.rank import DEFAULT_RTOL, RankDecision, decide_rank, equilibrated


def factor_disturbance(E: ArrayLike, *, rtol: float = DEFAULT_RTOL) -> tuple[NDArray, RankDecision]:
    r"""Factor a disturbance matrix into full column rank: :math:`E d = E_1 (E_2 d)`.

    Parameters
    ----------
    E : array_like, shape (n, q)
    rtol : float
        Singular values below this fraction of the largest count as zero.

    Returns
    -------
    E1 : ndarray, shape (n, rank)
        ``U_r S_r`` of the singular value decomposition; its range is that of ``E``.
    decision : RankDecision
        The rank, with the singular values on both sides of the gap.

    References
    ----------
    Chen, Patton and Zhang (1996), section 2, below eq. (1).

    Examples
    --------
    >>> from residua.plant import factor_disturbance
    >>> E1, decision = factor_disturbance([[1.0, 2.0], [2.0, 4.0]])
    >>> E1.shape, decision.rank
    ((2, 1), 1)
    """
    M = matrix(np.atleast_2d(np.asarray(E)), "disturbance matrix", (None, None))
    if not M.size:
        return M[:, :0], RankDecision(0, np.zeros(0), 0.0)
    U, s, _ = np.linalg.svd(M, full_matrices=False)
    tolerance = rtol * float(s[0])
    decision = RankDecision(int(np.count_nonzero(s > tolerance)), s, tolerance)
    if decision.rank < M.shape[1]:  # small singular values may be nothing but units
        other = decide_rank(equilibrated(M), rtol=rtol)
        decision = other if other.rank > decision.rank else decision
    return U[:, : decision.rank] * s[: decision.rank], decision


def disturbance_from_perturbations(
    A_parts: Sequence[ArrayLike] = (), B_parts: Sequence[ArrayLike] = ()
) -> NDArray[np.float64]:
    r"""Return the disturbance matrix of parameter perturbations.

    With :math:`\Delta A = \sum a_i A_i` and :math:`\Delta B = \sum b_i B_i`,
    :math:`\Delta A x + \Delta B u = [A_1 \cdots A_N\; B_1 \cdots B_N]\, d` with
    :math:`d = [a_1 x; \dots; b_N u]`. Also serves for matrices that depend on parameters: pass the
    derivatives :math:`\partial A / \partial \alpha_i` and :math:`\partial B / \partial \alpha_i`.

    Parameters
    ----------
    A_parts : sequence of array_like, shape (n, n)
    B_parts : sequence of array_like, shape (n, inputs)

    Returns
    -------
    ndarray, shape (n, total columns)
        Usually far from full column rank; :meth:`residua.Plant.with_disturbances` factors it.

    References
    ----------
    Chen, Patton and Zhang (1996), section 2.

    Examples
    --------
    >>> from residua.plant import disturbance_from_perturbations
    >>> disturbance_from_perturbations([[[1, 0], [0, 0]]], [[[0], [2]]])
    array([[1., 0., 0.],
           [0., 0., 2.]])
    """
    parts = [*A_parts, *B_parts]
    if not parts:
        raise ModelError("give at least one perturbation matrix")
    blocks = [matrix(np.atleast_2d(np.asarray(part)), "perturbation", (None, None)) for part in parts]
    rows = {block.shape[0] for block in blocks}
    if len(rows) > 1:
        raise ModelError(f"all perturbation matrices need one row per state; got row counts {sorted(rows)}")
    return np.hstack(blocks)


def disturbance_from_parameters(
    matrices: Callable[[NDArray], tuple[ArrayLike, ArrayLike]],
    nominal: ArrayLike,
    *,
    relative_step: float = 1e-6,
) -> NDArray[np.float64]:
    r"""Return the disturbance matrix of a plant whose matrices depend on parameters.

    :math:`E = [\partial A/\partial\alpha_1\; \partial B/\partial\alpha_1 \mid \cdots]` at the nominal
    parameters, by central differences.

    Parameters
    ----------
    matrices : callable
        ``matrices(alpha) -> (A, B)``.
    nominal : array_like, shape (g,)
    relative_step : float
        Step of the difference, relative to each parameter (absolute where a parameter is zero).

    Returns
    -------
    ndarray, shape (n, g * (n + inputs))

    References
    ----------
    Chen, Patton and Zhang (1996), section 2, second example.

    Examples
    --------
    >>> from residua.plant import disturbance_from_parameters
    >>> E = disturbance_from_parameters(lambda a: ([[-a[0]]], [[a[0]]]), [2.0])
    >>> E.round(6)
    array([[-1.,  1.]])
    """
    alpha = np.atleast_1d(np.asarray(nominal, dtype=float))
    blocks = []
    for i in range(alpha.size):
        h = relative_step * (abs(alpha[i]) or 1.0)
        high, low = alpha.copy(), alpha.copy()
        high[i] += h
        low[i] -= h
        (A1, B1), (A0, B0) = matrices(high), matrices(low)
        blocks += [(np.asarray(A1, float) - A0) / (2 * h), (np.asarray(B1, float) - B0) / (2 * h)]
    return disturbance_from_perturbations(blocks)


def quadratic_terms(x: ArrayLike) -> NDArray[np.float64]:
    """Return all second-order monomials of the states: squares first, then ``x1 x2, x1 x3, x2 x3, ...``.

    Parameters
    ----------
    x : array_like, shape (..., n)

    Returns
    -------
    ndarray, shape (..., n (n + 1) / 2)

    References
    ----------
    Chen, Patton and Zhang (1996), below eq. (32).
    """
    x = np.asarray(x, dtype=float)
    pairs = [(i, j) for i, j in combinations_with_replacement(range(x.shape[-1]), 2) if i != j]
    cross = [x[..., i] * x[..., j] for i, j in pairs]
    return np.concatenate([x**2, np.stack(cross, axis=-1)] if cross else [x**2], axis=-1)


def disturbance_from_steady_states(
    A: ArrayLike,
    B: ArrayLike,
    states: ArrayLike,
    inputs: ArrayLike,
    *,
    terms: Callable[[NDArray], NDArray] = quadratic_terms,
    rtol: float = DEFAULT_RTOL,
) -> NDArray[np.float64]:
    r"""Estimate the directions of linearisation errors, from steady states of the real plant.

    Each steady state obeys :math:`A x^{(i)} + B u^{(i)} + E d(x^{(i)}) = 0`, so
    :math:`\hat E = (\Gamma^+ \Psi)^T` with rows :math:`d(x^{(i)})^T` in :math:`\Gamma` and
    :math:`-(A x^{(i)} + B u^{(i)})^T` in :math:`\Psi`.

    Parameters
    ----------
    A : array_like, shape (n, n)
    B : array_like, shape (n, inputs)
    states : array_like, shape (N, n)
        Steady states, as deviations from the operating point of the linear model.
    inputs : array_like, shape (N, inputs)
        The constant inputs that hold them.
    terms : callable
        The unmodelled terms ``d(x)``; all second-order monomials when omitted.
    rtol : float
        Tolerance of the rank test on the regressors.

    Returns
    -------
    ndarray, shape (n, terms)

    Raises
    ------
    DataError
        If there are too few steady states, or they do not excite every term.

    References
    ----------
    Chen, Patton and Zhang (1996), eq. (32) and the equations after it.
    """
    A_, B_ = np.asarray(A, dtype=float), np.asarray(B, dtype=float)
    x = np.atleast_2d(np.asarray(states, dtype=float))
    u = np.asarray(inputs, dtype=float).reshape(len(x), -1)
    if x.shape[1] != A_.shape[0] or u.shape[1] != B_.shape[1]:
        raise DataError(f"states must be (N, {A_.shape[0]}) and inputs (N, {B_.shape[1]})")
    if not (np.isfinite(x).all() and np.isfinite(u).all()):
        raise DataError("steady states and inputs must be finite")
    Gamma = terms(x)
    if len(x) < Gamma.shape[1]:
        raise DataError(f"{len(x)} steady states cannot determine {Gamma.shape[1]} terms: record more")
    scale = np.linalg.norm(Gamma, axis=0)
    if (scale == 0).any():
        raise DataError("one of the terms is zero in every steady state: vary the inputs more")
    s = np.linalg.svd(Gamma / scale, compute_uv=False)
    if s[-1] <= rtol * s[0]:
        raise DataError(
            f"the steady states do not excite every term (singular values {s[0]:.3g} ... {s[-1]:.3g}): "
            "vary the inputs more, or give fewer terms"
        )
    Psi = -(x @ A_.T + u @ B_.T)
    return (np.linalg.lstsq(Gamma / scale, Psi, rcond=None)[0] / scale[:, None]).T
