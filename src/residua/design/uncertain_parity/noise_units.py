"""Units of primary residuals and thresholds, from fault-free data."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from residua.linear.whitening import whitening_matrix


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


def threshold_of(statistic: NDArray[np.float64], rate: float, memory: int) -> float:
    """Return the level that a statistic exceeds on a fraction of the samples.

    Where fewer than ten independent stretches of ``memory`` samples would be over it, the level for ten is extended by
    the exponential tail of the square.
    """
    values = statistic[~np.isnan(statistic)] ** 2
    seen = min(0.2, max(rate, 10 * memory / len(values)))
    level = float(np.quantile(values, 1 - seen))
    if seen > rate:
        above = values[values > level]
        decay = float((above - level).mean()) if above.size else 0.0
        level = max(level + decay * np.log(seen / rate), float(values.max()) if rate * len(values) < 1 else 0.0)
    return float(np.sqrt(level))
