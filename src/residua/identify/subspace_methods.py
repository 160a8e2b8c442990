"""The subspace methods: states as combinations of the past, weighted by each method, and the model that they give."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from residua.errors import AccuracyError, DataError, DesignError
from residua.identify.hankel_factor import NOISE_FREE, HankelFactor, regress, triangle
from residua.identify.prediction import Innovations
from residua.linear.poles.riccati import filter_riccati
from residua.linear.poles.spectrum import spectral_radius
from residua.linear.subspaces.rank import range_basis

Matrix = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class StateMap:
    """Candidates for the states, the most telling first: an order takes as many of them as it says.

    Attributes
    ----------
    T : ndarray, shape (candidates, past rows x channels)
        The map from the past, in units of the factor, to states of unit mean square.
    singular_values : ndarray
        The weight of each candidate, by the method.
    past : int
        Rows of the past.
    observability : ndarray or None, shape (future rows x outputs, candidates)
        The effect of the states on the outputs to come, where the method finds the dynamics from it.
    """

    T: NDArray[np.float64]
    singular_values: NDArray[np.float64]
    past: int
    observability: NDArray[np.float64] | None = None


def state_map(method: str, factor: HankelFactor, past: int, *, feedthrough: bool) -> StateMap:
    r"""Return the states of a subspace method: the leading left singular vectors of its weighted projection.

    Three methods project the outputs to come on the past along the inputs to come,
    :math:`Y_f = \Theta_u U_f + \Theta_z Z_p + E_f`, and are consistent where the inputs do not depend on past outputs:

    - N4SID takes the oblique projection :math:`\Theta_z Z_p`, without weights;
    - MOESP takes :math:`\Theta_z Z_p \Pi`, with the inputs to come projected out. The left singular vectors are the
      extended observability matrix, whose shift gives :math:`A` and :math:`C`. The shift needs two rows of the future,
      and tells ``(past - 1) outputs`` states apart at most;
    - CVA takes :math:`(Y_f \Pi Y_f^T)^{-1/2} \Theta_z Z_p \Pi`, whose singular values are the canonical correlations
      of past and future. No unit of an output changes them.

    PBSID takes the predictor instead, :math:`\Gamma K_p z`. It is consistent in closed loop too, where something moves
    the inputs that does not follow from the past, and there is no feedthrough or a delay in the loop.

    References
    ----------
    Van Overschee and De Moor (1994), N4SID, Automatica 30(1); Van Overschee and De Moor (1995), A unifying theorem
    for three subspace system identification algorithms, Automatica 31(12); Verhaegen (1994), Identification of the
    deterministic part of MIMO state space models, Automatica 30(1); Larimore (1990), Canonical variate analysis in
    identification, filtering and adaptive control, 29th CDC; Chiuso (2007), The role of vector autoregressive modeling
    in predictor-based subspace identification, Automatica 43(6), section 4.
    """
    z = factor.R[:, factor.signals(range(past))]
    if method == "pbsid":
        weighted = _predicted_outputs(factor, z, past, feedthrough=feedthrough)
    else:
        later = range(past, factor.length)
        given, y = factor.R[:, [0, *factor.inputs(*later)]], factor.R[:, factor.outputs(*later)]
        weighted = regress(y, np.hstack([given, z]))[0][:, given.shape[1] :]
        z = z if method == "n4sid" else regress(z, given)[1]
        if method == "cva":
            # outputs to come without noise depend on one another
            V, decision = range_basis(regress(y, given)[1].T)
            weighted = V.T / decision.singular_values[: decision.rank, None] @ weighted
    U, decision = range_basis(weighted @ z.T)
    size = np.linalg.norm(U.T @ weighted @ z.T, axis=1) / np.sqrt(factor.windows)
    T = U.T @ weighted / size[:, None]
    if method != "moesp":
        return StateMap(T, decision.singular_values, past)
    # the shift drops a row: a state beyond the rows that are left would get poles that no data say
    most = min(len(size), (past - 1) * factor.n_outputs)
    return StateMap(T[:most], decision.singular_values[:most], past, U[:, :most] * size[:most])


def _predicted_outputs(factor: HankelFactor, z: NDArray, past: int, *, feedthrough: bool) -> NDArray[np.float64]:
    r"""Return the map of PBSID from the past to the predicted outputs, in units of the innovations.

    The outputs are regressed on the past, :math:`y_k = \sum_{i=1}^p \Xi_i z_{k-i} (+ D u_k) + e_k`, with
    :math:`z = [u; y]`. The coefficients are the Markov parameters of the predictor,
    :math:`\Xi_i = C (A - KC)^{i-1} [B - KD, K]`. Shifted below one another they take the past to the predicted outputs.
    The rest after ``p`` rows is :math:`(A - KC)^p`.
    """
    fixed = [0, *(factor.inputs(past) if feedthrough else [])]
    coefficients, residual = regress(factor.R[:, factor.outputs(past)], np.hstack([factor.R[:, fixed], z]))
    _, s, Vt = np.linalg.svd(residual / np.sqrt(factor.windows), full_matrices=False)
    markov = (Vt.T / np.maximum(s, NOISE_FREE)) @ Vt @ coefficients[:, len(fixed) :]
    n, p = factor.n_channels, factor.n_outputs
    rows = np.zeros((past * p, past * n))
    for j in range(past):
        # row j: z at time t of the window is past - t rows back, and j more once j rows have passed
        rows[j * p : (j + 1) * p, j * n :] = markov[:, : (past - j) * n]
    return rows


def realise(factor: HankelFactor, states: StateMap, order: int, *, feedthrough: bool) -> Innovations:
    """Return the model of an order: outputs by states and inputs, then the next states by these and the innovations.

    Where the gain of that regression leaves the predictor unstable, the gain is that of the Riccati equation for the
    covariances of both residuals.

    Raises
    ------
    DataError
        If no stable predictor has these covariances.
    """
    R, now, m, p = factor.R, states.past, factor.n_inputs, factor.n_outputs
    T, one, u, y = states.T[:order], R[:, [0]], R[:, factor.inputs(now)], R[:, factor.outputs(now)]
    x0, x1 = R[:, factor.signals(range(now))] @ T.T, R[:, factor.signals(range(1, now + 1))] @ T.T
    A = C = None
    if states.observability is not None:
        G = states.observability[:, :order]
        A, C = np.asarray(np.linalg.lstsq(G[:-p], G[p:], rcond=None)[0], dtype=float), G[:p]
    given = np.hstack([one, *([u] if feedthrough else []), *([x0] if C is None else [])])
    fit, e = regress(y if C is None else y - x0 @ C.T, given)
    D = fit[:, 1 : 1 + m] if feedthrough else np.zeros((p, m))
    C = fit[:, fit.shape[1] - order :] if C is None else C
    e = np.where(np.linalg.norm(e, axis=0) > NOISE_FREE * np.sqrt(factor.windows), e, 0.0)
    step, left = regress(x1 if A is None else x1 - x0 @ A.T, np.hstack([one, u, *([x0] if A is None else []), e]))
    B, K = step[:, 1 : 1 + m], step[:, -p:]
    A = step[:, 1 + m : 1 + m + order] if A is None else A
    samples = max(factor.windows - order - 1 - (m if feedthrough else 0), 1)
    V = e.T @ e / samples
    K, note = _stable_gain(A, C, K, left.T @ left / samples, V)
    return Innovations(A, B, C, D, K, step[:, 0], fit[:, 0], V, T, now, note)


def resampled(
    factor: HankelFactor, states: StateMap, order: int, method: str, *, feedthrough: bool
) -> list[Innovations]:
    """Return the models of the data without each of their parts in turn, in the coordinates of the whole.

    Their spread is that of the estimate (the jackknife), however the noise is correlated within a part. The states are
    looked for again each time: with those of the whole the spread would be too small. A part without which there
    is no stable model of this order has none: the list is then shorter than the parts.
    """
    models = []
    now = factor.R[:, factor.signals(range(states.past))]
    for left_out in range(len(factor.parts)):
        rest = [one for k, one in enumerate(factor.parts) if k != left_out]
        windows = round(factor.windows * len(rest) / len(factor.parts))
        one = replace(factor, R=triangle(np.vstack(rest)), parts=(), windows=windows)
        candidates = state_map(method, one, states.past, feedthrough=feedthrough)
        if len(candidates.T) < order:
            continue
        try:
            model = realise(one, candidates, order, feedthrough=feedthrough)
        except DataError:  # no stable predictor: counted by who asks
            continue
        # the same states in other coordinates: S takes their own to those of the whole, for the rows of all data
        S = regress(now @ states.T[:order].T, now @ candidates.T[:order].T)[0]
        back = np.linalg.pinv(S)
        models.append(
            replace(
                model,
                A=S @ model.A @ back,
                B=S @ model.B,
                C=model.C @ back,
                K=S @ model.K,
                state_constant=S @ model.state_constant,
                states=S @ model.states,
            )
        )
    return models


def _stable_gain(A: Matrix, C: Matrix, K: Matrix, W: Matrix, V: Matrix) -> tuple[Matrix, str]:
    """Return the gain of a stable predictor, with a note if it is not the one that was estimated."""
    radius = float(spectral_radius(A - K @ C))
    if radius < 1:
        return K, ""
    n, cross = len(A), K @ V
    joint = np.block([[K @ cross.T + W, cross], [cross.T, V]]) + NOISE_FREE**2 * np.eye(n + len(V))
    size = np.sqrt(np.diag(joint))
    values, vectors = np.linalg.eigh(joint / np.outer(size, size))  # rounding leaves some of them negative
    joint = np.outer(size, size) * ((vectors * np.maximum(values, 0.0)) @ vectors.T)
    try:
        solution = filter_riccati(A, C, joint[:n, :n], joint[n:, n:], joint[:n, n:], dt=1.0)
    except (DesignError, AccuracyError) as error:
        raise DataError(
            f"no stable predictor of order {len(A)} fits the data ({error}): choose another order, or method"
        ) from error
    note = (
        f"the estimated gain left the predictor unstable (a pole of size {radius:.4g}): it is replaced by that of the "
        "Riccati equation for the same covariances"
    )
    return np.asarray(solution.gain), note
