"""Thresholds from data with a confidence statement: order statistics."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from residua.decide.dependence import effective_exceedances
from residua.decide.exceedance_tail import HIGHEST, past, quantile
from residua.decide.false_alarms import CONFIDENCE, ENOUGH, Observed, Promise, lasting_blocks, promise_of
from residua.errors import SettingError
from residua.tolerances import ROUNDING, SAME
from residua.visible import echo
from residua.words import number, one_in

#: Where a threshold is from.
Source = Literal["auto", "quantile"]
#: Samples that are worth that part of as many independent ones are taken for independent ones in words.
_ALL = 0.98


def check_source(source: object, among: tuple[str, ...] = get_args(Source)) -> None:
    """Raise unless ``source`` is known."""
    if source not in among:
        raise SettingError(f"source must be one of {', '.join(among)}, got {echo(source)}")


def least_rate(samples: float) -> float:
    r"""Return the smallest rate that independent samples can promise with 95 % confidence: none of them over a level.

    .. math:: 1 - 0.05^{1/n}

    References
    ----------
    Wilks (1941), Annals of Mathematical Statistics 12(1), 91-96.

    Examples
    --------
    >>> round(least_rate(8000), 6)
    0.000374
    """
    return float(-np.expm1(np.log1p(-CONFIDENCE) / samples))


def samples_for(rate: float) -> int:
    """Return the number of independent samples that can promise a rate with 95 % confidence.

    Examples
    --------
    >>> samples_for(1e-4)
    29956
    """
    return int(np.ceil(np.log1p(-CONFIDENCE) / np.log1p(-rate) * (1 - ROUNDING)))


@dataclass(frozen=True)
class StatedPromise(Promise):
    """A threshold, the rate that the data promise, and its basis.

    Attributes
    ----------
    samples : int
        Those of the data that count.
    worth : float
        The number of independent ones that they are worth.
    """

    samples: int = 0
    worth: float = 0.0

    @property
    def holds(self) -> bool:
        """True if the data promise the rate."""
        return self.promised <= self.asked * (1 + SAME)

    def __str__(self) -> str:
        sure = f"with 95 % confidence at most {one_in(self.promised)} on other data like these"
        if self.holds:
            return f"an order statistic, {sure}"
        least, share = least_rate(self.worth), self.worth / self.samples
        independent = "" if share >= _ALL else f" (worth {number(self.worth)} independent ones)"
        many = int(np.ceil(samples_for(self.asked) / (1.0 if share >= _ALL else share) * (1 - ROUNDING)))
        return (
            f"the largest of them, {sure}: with {self.samples} samples{independent} no fewer than {one_in(least)} can "
            f"be promised at 95 %; {one_in(self.asked)} takes {'' if share >= _ALL else 'about '}{many} samples"
        )


def promise_by(source: str, seen: Observed, asked: float) -> Promise:
    r"""Return the threshold for a rate by one of the sources, with the rate that can be promised.

    ``"auto"``
        :func:`residua.decide.false_alarms.promise_of`.
    ``"quantile"``
        Whatever the distribution: the smallest order statistic of which fewer samples are in alarm than were asked for,
        with 95 % confidence. With :math:`j` of :math:`n` independent samples over it the rate is, at worst, distributed
        as :math:`B(j + 1, n - j)`.
    Samples that are in alarm together count as one: ``n`` and ``j`` are divided by the mean number of those over a high
    level in a stretch of time.

    References
    ----------
    Wilks (1941), Annals of Mathematical Statistics 12(1), 91-96.
    """
    if source == "auto":
        return promise_of(seen, asked)
    levels, own = np.sort(seen.levels[seen.counted]), np.sort(seen.own[seen.counted])
    together = _together(seen, asked)
    worth = max(len(levels) / together, 1.0)
    over = _quantile_exceedances(len(levels), together, asked)
    level = max(_over(levels, over), _over(own, over))
    expected = (over / together + 1) / (worth + 1)
    return StatedPromise(level, asked, expected, _bound(over, len(levels), together), "", len(levels), worth)


def _over(ordered: NDArray[np.float64], over: int) -> float:
    """Return the order statistic exceeded by so many samples, as a threshold."""
    return past(float(ordered[len(ordered) - 1 - over]))


def _bound(over: int, samples: int, together: float) -> float:
    """Return the upper 95 % confidence limit of a rate, given so many samples over a level."""
    from scipy.special import betaincinv

    worth, clusters = max(samples / together, 1.0), over / together
    return float(betaincinv(clusters + 1, max(worth - clusters, SAME), CONFIDENCE))


def _quantile_exceedances(samples: int, together: float, asked: float) -> int:
    """Return the most samples over a level that still promise a rate with 95 % confidence; 0 if none do."""
    low, high = 0, min(int(asked * samples) + 1, samples - 1)
    while low < high:  # the bound grows with them
        middle = (low + high + 1) // 2
        low, high = (middle, high) if _bound(middle, samples, together) <= asked else (low, middle - 1)
    return low


def _together(seen: Observed, asked: float) -> float:
    """Return the number of samples over a high level that are worth one independent one."""
    levels = seen.levels[seen.counted]
    n, ordered = len(levels), np.sort(levels)
    for rate in np.geomspace(max(asked, min(ENOUGH / n, HIGHEST)), max(asked, HIGHEST), 6):
        blocks = lasting_blocks(seen, float(rate))
        over = blocks[levels > quantile(ordered, float(rate))]
        worth = effective_exceedances(np.bincount(over).astype(float)) if len(over) else 0.0
        if worth >= ENOUGH or rate >= HIGHEST:
            break
    return len(over) / worth if worth else float(n)


__all__ = ["Source", "StatedPromise", "check_source", "least_rate", "promise_by", "samples_for"]
