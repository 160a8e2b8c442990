"""Delays of detection, with runs that end before the fault is seen: the product-limit estimate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.tolerances import ROUNDING
from residua.validate.intervals import CONFIDENCE, Estimate, bootstrap


@dataclass(frozen=True, eq=False)
class Delays:
    r"""The distribution of the delay from onset to alarm, with runs that ended without an alarm as censored.

    .. math:: \hat S(t) = \prod_{t_i \le t} \left(1 - \frac{d_i}{n_i}\right)

    with :math:`d_i` detections at :math:`t_i` among the :math:`n_i` runs that were not yet detected nor ended.

    Attributes
    ----------
    time : ndarray
        Delays in seconds at which the estimate changes.
    undetected : ndarray
        :math:`\hat S` at each: the share of the runs that is not detected so far.
    low, high : ndarray
        Its confidence interval at each, by Greenwood's variance of :math:`\ln(-\ln \hat S)`.
    detected : ndarray
        Delays of the runs that were detected, in seconds.
    censored : int
        Runs without a detection.

    References
    ----------
    Kaplan and Meier (1958), Journal of the American Statistical Association 53, 457-481; Kalbfleisch and Prentice
    (1980), The statistical analysis of failure time data, section 1.3 (the interval).
    """

    time: NDArray[np.float64]
    undetected: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    detected: NDArray[np.float64]
    censored: int
    confidence: float = CONFIDENCE

    def quantile(self, share: float) -> Estimate:
        """Return the delay by which a share of the runs is detected, infinite if the runs do not show it.

        With the interval of Brookmeyer and Crowley (1982), Biometrics 38, 29-41.
        """
        left = 1 - share

        def first(curve: NDArray[np.float64]) -> float:
            reached = np.flatnonzero(curve <= left * (1 + ROUNDING))
            return float(self.time[reached[0]]) if reached.size else float("inf")

        return Estimate(first(self.undetected), first(self.low), first(self.high))

    def quantiles(self, shares: Sequence[float]) -> tuple[Estimate, ...]:
        """Return several of them."""
        return tuple(self.quantile(share) for share in shares)

    def mean(self, seed: int) -> Estimate:
        """Return the mean delay of the runs that were detected, with its bootstrap interval."""
        return bootstrap(self.detected, lambda drawn: drawn.mean(axis=1), seed, self.confidence)


def delays_of(delay: NDArray[np.float64], seen: NDArray[np.bool_], confidence: float = CONFIDENCE) -> Delays:
    """Return the distribution from the delay of each run, or its undetected length if not ``seen``."""
    from scipy.special import ndtri  # slow to import, and needed only here

    times, first = np.unique(delay[seen], return_inverse=True)
    events = np.bincount(first, minlength=len(times)).astype(float)
    at_risk = len(delay) - np.searchsorted(np.sort(delay), times, side="left").astype(float)
    survival = np.asarray(np.cumprod(1 - events / np.maximum(at_risk, 1)), dtype=np.float64)
    z = float(ndtri((1 + confidence) / 2))
    with np.errstate(divide="ignore", invalid="ignore"):
        variance = np.cumsum(events / (at_risk * (at_risk - events)))
        width = z * np.sqrt(variance) / np.log(survival)
        low, high = survival ** np.exp(-width), survival ** np.exp(width)
    over = survival <= 0  # nobody is left: as of no success in n trials (Clopper and Pearson)
    last = 1 - ((1 - confidence) / 2) ** (1 / max(len(delay), 1))
    low, high = np.where(over, 0.0, low), np.where(over, last, high)
    return Delays(
        times, survival, np.minimum(low, high), np.maximum(low, high), delay[seen], int((~seen).sum()), confidence
    )
