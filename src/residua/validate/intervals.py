"""Confidence intervals of figures over runs: shares, rates of events, means."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.decide.checks import check_probability
from residua.words import number

#: How sure an interval is where nothing else is asked for.
CONFIDENCE = 0.95
#: Resamples of a bootstrap.
_RESAMPLES = 1000


@dataclass(frozen=True)
class Estimate:
    """A figure with its confidence interval.

    Attributes
    ----------
    value : float
        NaN where there is none.
    low, high : float
        Ends of the interval; infinite where the data bound it on one side only.
    """

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        if np.isnan(self.value) and np.isnan(self.low):
            return "–"
        if np.isinf(self.low):
            return number(self.value)
        return f"{_short(self.value)} ({_short(self.low)} to {_short(self.high)})"

    def __contains__(self, value: float) -> bool:
        return bool(self.low <= value <= self.high)


def _short(value: float) -> str:
    """Return a number with three digits, or as many as distinguish it from a share of one; thousands with commas."""
    if 999.5 <= abs(value) < 1e7:
        return f"{float(f'{value:.3g}'):,.0f}".replace("-", "−")
    return next((text for text in (number(value, digits) for digits in range(3, 10)) if text != "1" or value == 1), "1")


#: A figure that nothing is known of.
UNKNOWN = Estimate(float("nan"), float("nan"), float("nan"))


def wilson(count: float, of: float, confidence: float = CONFIDENCE) -> Estimate:
    r"""Return a share of independent trials with its Wilson score interval.

    .. math:: \frac{\hat p + \frac{z^2}{2n} \pm z \sqrt{\frac{\hat p (1 - \hat p)}{n} + \frac{z^2}{4 n^2}}}{1 + z^2/n}

    Parameters
    ----------
    count : float
        Trials that came out so.
    of : float
        Trials ``n``; not whole where correlated ones are counted as fewer independent ones.
    confidence : float

    Returns
    -------
    Estimate
        With no trial, NaN within 0 and 1.

    References
    ----------
    Wilson (1927), Journal of the American Statistical Association 22, 209-212.

    Examples
    --------
    >>> from residua.validate.intervals import wilson
    >>> print(wilson(90, 100))
    0.9 (0.826 to 0.945)
    """
    from scipy.special import ndtri  # slow to import, and needed only here

    check_probability(confidence, "confidence")
    if not of > 0:
        return Estimate(float("nan"), 0.0, 1.0)
    p, z = count / of, float(ndtri((1 + confidence) / 2))
    middle, half = p + z**2 / (2 * of), z * np.sqrt(p * (1 - p) / of + z**2 / (4 * of**2))
    low, high = (middle - half) / (1 + z**2 / of), (middle + half) / (1 + z**2 / of)
    return Estimate(p, 0.0 if count == 0 else float(low), 1.0 if count == of else float(high))


def clustered_share(
    counts: NDArray[np.integer], of: NDArray[np.integer], least: float, confidence: float = CONFIDENCE
) -> Estimate:
    r"""Return a share of samples that are correlated within a run, runs being independent.

    The Wilson interval for :math:`n / D` samples, with the design effect :math:`D` of the ratio: the variance over runs
    of :math:`c_i - \hat p n_i`, over that of independent samples. It is never taken for less than ``least``, the
    samples that one statistic is made of, which stands alone where no sample counts.

    Parameters
    ----------
    counts, of : ndarray of int, shape (runs,)
    least : float
    confidence : float

    References
    ----------
    Kish (1965), Survey sampling, section 8.2 (design effect of clusters).
    """
    total, n = float(counts.sum()), float(of.sum())
    if not n:
        return wilson(0, 0, confidence)
    p, runs = total / n, len(counts)
    effect = max(1.0, float(least))
    if runs > 1 and 0 < p < 1:
        left = counts - p * of
        effect = max(effect, float(runs / (runs - 1) * np.sum(left**2) / (n * p * (1 - p))))
    return wilson(total / effect, n / effect, confidence)


def events_apart(count: int, time: float, confidence: float = CONFIDENCE) -> Estimate:
    r"""Return the mean time between events that come independently, with its exact Poisson interval.

    .. math:: \frac{2T}{\chi^2_{1-\alpha/2}(2k + 2)} \le \frac{T}{\lambda T} \le \frac{2T}{\chi^2_{\alpha/2}(2k)}

    Without an event the value and the upper end are infinite.

    References
    ----------
    Garwood (1936), Biometrika 28, 437-442.
    """
    from scipy.special import gammaincinv  # slow to import, and needed only here

    check_probability(confidence, "confidence")
    side = (1 - confidence) / 2
    most = float(gammaincinv(count + 1, 1 - side))
    fewest = float(gammaincinv(count, side)) if count else 0.0
    if not time > 0:
        return UNKNOWN
    return Estimate(time / count if count else np.inf, time / most, time / fewest if count else np.inf)


def bootstrap(
    values: NDArray[np.float64],
    statistic: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    seed: int,
    confidence: float = CONFIDENCE,
) -> Estimate:
    """Return a statistic of independent rows with its percentile bootstrap interval.

    Parameters
    ----------
    values : ndarray, shape (n,) or (n, k)
    statistic : callable
        From arrays of (resamples, n, ...) to numbers of (resamples,).
    seed : int
    confidence : float

    References
    ----------
    Efron and Tibshirani (1993), An introduction to the bootstrap, section 13.3.
    """
    check_probability(confidence, "confidence")
    side = (1 - confidence) / 2
    if not len(values):
        return UNKNOWN
    rng, drawn = np.random.default_rng(seed), []
    at_once = max(1, 1_000_000 // len(values))
    for start in range(0, _RESAMPLES, at_once):
        rows = rng.integers(0, len(values), (min(at_once, _RESAMPLES - start), len(values)))
        drawn.append(statistic(values[rows]))
    low, high = np.quantile(np.concatenate(drawn), [side, 1 - side])
    return Estimate(float(statistic(values[None])[0]), float(low), float(high))
