"""PBSID: the states from the predictor, which a controller that feeds outputs back does not bias."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from residua.identify.hankel_factor import HankelFactor, regress
from residua.identify.horizon import NOISE_FREE
from residua.identify.state_map import StateMap, states_of


def pbsid(factor: HankelFactor, past: int, future: int, *, feedthrough: bool) -> StateMap:
    r"""Return the states of predictor-based subspace identification.

    The outputs are regressed on the past, :math:`y_k = \sum_{i=1}^p \Xi_i z_{k-i} (+ D u_k) + e_k`, with
    :math:`z = [u; y]`. The coefficients are the Markov parameters of the predictor,
    :math:`\Xi_i = C (A - KC)^{i-1} [B - KD, K]`; shifted below one another they take the past to the predicted
    outputs, :math:`\Gamma K_p z`, whose leading singular vectors, with outputs weighted by the innovations, are the
    states. What is cut off after ``p`` rows is :math:`(A - KC)^p`.

    Consistent in closed loop too, where something moves the inputs that the past does not say, and there is no
    feedthrough or a delay in the loop.

    References
    ----------
    Chiuso (2007), The role of vector autoregressive modeling in predictor-based subspace identification, Automatica
    43(6), section 4.
    """
    now = past
    fixed = [0, *(factor.inputs(now) if feedthrough else [])]
    z = factor.R[:, factor.signals(range(past))]
    fit = regress(factor.R[:, factor.outputs(now)], np.hstack([factor.R[:, fixed], z]))
    coefficients = fit.coefficients[:, len(fixed) :]
    weight = _inverse_root(fit.residual / np.sqrt(factor.windows))
    n, p = factor.n_channels, factor.n_outputs
    rows = np.zeros((future * p, past * n))
    for j in range(min(future, past)):
        # row j: z at time t of the window is past - t rows back, and j more once j rows have passed
        rows[j * p : (j + 1) * p, j * n :] = weight @ coefficients[:, : (past - j) * n]
    states, _ = states_of(rows, z, factor.windows, past)
    return replace(states, observability=None)


def _inverse_root(residual: NDArray) -> NDArray[np.float64]:
    """Return the inverse root of the covariance of residuals, none counted as smaller than what is no noise."""
    _, s, Vt = np.linalg.svd(residual, full_matrices=False)
    return (Vt.T / np.maximum(s, NOISE_FREE)) @ Vt
