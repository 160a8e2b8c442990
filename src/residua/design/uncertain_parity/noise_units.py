"""Units of primary residuals and thresholds, from fault-free data."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

#: Variances below this fraction of the largest, in units of each residual's own spread, are raised to it.
_FLOOR = 1e-8


def whitening(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return ``M`` with ``M' covariance M = I``, nearly singular directions held back; applied as ``e @ M``."""
    spread = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    spread = np.where(spread > 0, spread, spread[spread > 0].min(initial=np.inf) if spread.any() else 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(spread, spread))
    return vectors / np.sqrt(np.maximum(values, _FLOOR * values[-1])) / spread[:, None]


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
    return whitening(covariance), False


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
