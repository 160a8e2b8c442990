"""Units of primary residuals from fault-free data."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from residua.linear.subspaces.whitening import whitening_matrix


def fitted_scale(
    e: NDArray[np.float64], weights: NDArray[np.float64], signals: NDArray[np.float64], now: NDArray[np.float64]
) -> tuple[NDArray[np.float64], bool]:
    """Return the units that make primary residuals white, and whether these data hold no noise at all.

    ``weights`` are the largest gains from each signal to each residual: residuals below 1e-12 of what they are the
    difference of are rounding, and keep their units.
    """
    terms = weights @ np.abs(signals.reshape(-1, signals.shape[-1])).max(axis=0)
    covariance = e.T @ e / len(e)
    if np.all(np.sqrt(np.diag(covariance)) <= 1e-12 * terms):
        return now, True
    return whitening_matrix(covariance), False
