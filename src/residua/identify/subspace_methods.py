"""The subspace methods: states as combinations of the past, which each method weights in its own way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.identify.hankel_factor import NOISE_FREE, HankelFactor, regress
from residua.linear.subspaces.rank import range_basis


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
