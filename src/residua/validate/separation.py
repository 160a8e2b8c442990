"""Separation of runs with a fault from runs without by the statistic: the curve over all thresholds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.validate.intervals import CONFIDENCE, Estimate, wilson

#: Points of a curve that are kept.
_POINTS = 201


@dataclass(frozen=True, eq=False)
class Roc:
    """Detections against false alarms for every threshold on the statistic (receiver operating characteristic).

    A run counts as detected where the largest statistic from the onset on is over the threshold, and as a false alarm
    where that is so for the same run without the fault, over the same samples.

    Attributes
    ----------
    threshold : ndarray
        Falling.
    false_alarms, detections : ndarray
        Shares of the runs over each threshold.
    area : Estimate
        Area under the curve, the probability that a run with the fault has the larger statistic of two; with its
        confidence interval. 0.5: the statistic says nothing.
    set_threshold : float
        The threshold of the monitor.
    """

    threshold: NDArray[np.float64]
    false_alarms: NDArray[np.float64]
    detections: NDArray[np.float64]
    area: Estimate
    set_threshold: float


def roc_of(
    peak: NDArray[np.float64],
    quiet: NDArray[np.float64],
    threshold: float,
    confidence: float = CONFIDENCE,
) -> Roc:
    """Return the curve from the largest statistics of runs with and without a fault.

    The interval of the area is that of DeLong, DeLong and Clarke-Pearson (1988), Biometrics 44, 837-845.
    """
    from scipy.special import ndtri  # slow to import, and needed only here

    levels = np.unique(np.concatenate([peak, quiet, [np.inf]]))[::-1]
    levels = levels[levels > -np.inf]
    if len(levels) > _POINTS:
        levels = levels[np.unique(np.linspace(0, len(levels) - 1, _POINTS).astype(int))]
    over = [np.asarray((levels[:, None] < values[None]).mean(axis=1)) for values in (quiet, peak)]
    # of each run, the share of those of the other kind that it is over, ties counting half; runs with and without the
    # fault share their noise, which makes the true spread of the area no larger than this one
    ahead, behind = _shares_below(peak, quiet), _shares_below(quiet, peak)
    spread = float(np.sqrt((ahead.var() + behind.var()) / len(peak)))
    value, half = float(ahead.mean()), float(ndtri((1 + confidence) / 2)) * spread
    area = Estimate(value, max(0.0, value - half), min(1.0, value + half))
    if not spread:  # all or nothing: as of trials that came out alike
        area = wilson(value * len(peak), len(peak), confidence)
    return Roc(levels, over[0], over[1], area, threshold)


def _shares_below(values: NDArray[np.float64], others: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return for each value the share of the others below it, ties counting half."""
    low, high = (np.searchsorted(np.sort(others), values, side=side) for side in ("left", "right"))
    return (low + high) / (2 * len(others))
