"""Fraction of samples over a level, with an extrapolated tail where data are few."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.decide.dependence import effective_exceedances
from residua.tolerances import DATA_ROUNDING

#: Independent exceedances from which a tail is extended.
_ENOUGH = 30.0
#: The rate from which it is extended, at most.
HIGHEST = 0.25
#: Exceedances that the prior of the tail is worth: one as heavy as that of the scale.
_PRIOR = 3.0
#: Values come in steps where a high one is there so many times on average.
_TIED = 4
#: The largest distance between them is the step, as deviations to several sides are close to one another; but that of
#: so many from the rest, which may be by chance.
_ALONE = 2
#: Multiples of it are spread evenly over the unit interval, however many there are.
_GOLDEN = (np.sqrt(5) - 1) / 2


@dataclass(frozen=True)
class Scale:
    r"""Scale on which the tail of a statistic is nearly straight: that of scaled chi-squared.

    Where its square is :math:`a \chi^2_\nu`, the depth :math:`-\ln P(J > h)` is exponentially distributed over any
    level; of other data, nearly so in the tail.

    Attributes
    ----------
    a, nu : float
    """

    a: float
    nu: float

    def depth(self, level: NDArray[np.float64] | float) -> NDArray[np.float64]:
        """Return minus the logarithm of the probability that the statistic exceeds a level."""
        from scipy.special import gammaincc, gammaln

        x, half = np.maximum(np.asarray(level, dtype=float), 0.0) ** 2 / (2 * self.a), self.nu / 2
        tail = gammaincc(half, x)
        far = tail < 1e-280
        x_far = np.where(far, x, 1.0)
        beyond = x_far - (half - 1) * np.log(x_far) + gammaln(half)
        return np.where(far, beyond, -np.log(np.where(far, 1.0, tail)))

    def level(self, depth: float) -> float:
        """Return the level of a depth (bisection)."""
        low, high = 0.0, float(np.sqrt(2 * self.a * (self.nu + 2 * depth + 40)))
        for _ in range(200):
            middle = (low + high) / 2
            low, high = (middle, high) if float(self.depth(middle)) < depth else (low, middle)
            if high - low <= 1e-14 * high:
                break
        return high


def scale_of(statistic: NDArray[np.float64], degrees: float) -> Scale:
    """Return the scaled chi-squared distribution with the mean and variance of the squares."""
    squares = statistic**2
    mean, variance = float(squares.mean()), float(squares.var())
    if not mean > 0:
        return Scale(np.finfo(float).tiny, 1.0)
    nu = degrees if variance <= 0 else min(degrees, 2 * mean**2 / variance)
    return Scale(mean / nu, nu)


@dataclass(frozen=True, eq=False)
class Tail:
    """Fraction of samples over any level, as far as fault-free data show it.

    Attributes
    ----------
    values : ndarray
        Sorted.
    scale : Scale or None
        Without one, values are depths already.
    start : float
        The level from which on the tail is extended: exponentially, in depth.
    rate : float
        The fraction of samples over it.
    slope : float
        How much faster the fraction falls than the scale says.
    worth : float
        Independent exceedances of the start.
    variance : float
        Relative variance of the rate.
    """

    values: NDArray[np.float64]
    scale: Scale | None
    start: float
    rate: float
    slope: float
    worth: float
    variance: float

    def level(self, rate: float) -> float:
        """Return the level exceeded by a fraction of the samples."""
        if rate >= self.rate:
            return quantile(self.values, rate)
        depth = float(depths(self.scale, self.start)) + np.log(self.rate / rate) / self.slope
        return float(depth) if self.scale is None else self.scale.level(float(depth))

    def fraction(self, level: float) -> float:
        """Return the fraction of samples over a level."""
        if level <= self.start:
            n = len(self.values)
            return float(n - np.searchsorted(self.values, level, side="right")) / n
        beyond = float(depths(self.scale, level) - depths(self.scale, self.start))
        return self.rate * float(np.exp(-self.slope * beyond))

    def spread(self, rate: float) -> float:
        """Return the standard deviation of the logarithm of a rate that is read or extended."""
        beyond = max(0.0, float(np.log(self.rate / rate)))
        return float(np.sqrt(self.variance + beyond**2 / self.worth))


def tail_of(
    values: NDArray[np.float64],
    blocks: NDArray[np.int64],
    scale: Scale | None,
    rate: float,
    *,
    highest: float = HIGHEST,
) -> Tail:
    """Return the tail of values, for use at a rate: from there on, or from the level with enough exceedances."""
    ordered = np.sort(values)
    n, number = len(ordered), int(blocks.max(initial=0)) + 1
    start, worth = ordered[-1], 0.0
    for candidate in np.geomspace(rate, max(rate, highest), 24 if rate < highest else 1):
        level = quantile(ordered, float(candidate))
        own = effective_exceedances(np.bincount(blocks[values > level], minlength=number).astype(float))
        if own > worth:
            start, worth = level, own
        if own >= _ENOUGH:
            break
    over = values[values > start]
    worth = max(worth, 1.0)
    variance = max(1 / worth - 1 / number, 1 / n) * number / max(number - 1, 1)
    beyond = float(np.mean(depths(scale, over) - depths(scale, start))) if len(over) else 0.0
    return Tail(ordered, scale, float(start), max(len(over), 1) / n, slope_of(worth, beyond), worth, variance)


def slope_of(worth: float, beyond: Any) -> Any:
    """Return the slope of a tail from the mean of the depths beyond its start."""
    return (worth + _PRIOR) / (worth * beyond + _PRIOR)


def depths(scale: Scale | None, level: NDArray[np.float64] | float) -> NDArray[np.float64]:
    """Return depths of levels; without a scale they are depths already."""
    return np.asarray(level, dtype=float) if scale is None else scale.depth(level)


def quantile(ordered: NDArray[np.float64], rate: float) -> float:
    """Return a level, between two samples, exceeded by at most a fraction of all; beyond all equal ones."""
    n = len(ordered)
    above = int(np.floor(rate * n + 1e-9))
    low = ordered[n - 1 - above] if above < n else ordered[0]
    if not np.isfinite(low):
        return float(ordered[n - above] if above else low)
    beyond = past(float(low))
    further = int(np.searchsorted(ordered, beyond, side="right"))
    return max(float(low + 0.5 * (ordered[further] - low)), beyond) if further < n else beyond


def past(value: float) -> float:
    """Return a level that a value does not exceed, in whatever order of operations it is recomputed."""
    return value + DATA_ROUNDING * abs(value)


def without_steps(values: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    r"""Return values as before their rounding to steps, and half a step; unrounded ones unchanged.

    Readings of few digits come in steps, which no smooth tail goes through. Here those that are equal are spread evenly
    over the step, a run of them together, as noise may be slow. Of :math:`\hat x` that is within half a step
    :math:`\Delta` of :math:`x`, no more is over :math:`h + \Delta/2` than of :math:`x` is over :math:`h`.
    """
    finite = values[np.isfinite(values)]
    ordered = np.sort(finite)
    below = int(np.searchsorted(ordered, quantile(ordered, 0.5))) - 1 if len(ordered) else 0
    top = ordered[below:]  # the upper half, with the one under it
    gaps = np.diff(top)
    if not len(gaps) or _TIED * np.count_nonzero(gaps > DATA_ROUNDING * np.abs(top[1:])) > len(gaps):
        return values, 0.0
    step = float(gaps[: len(gaps) - _ALONE].max(initial=0.0))
    changes = np.concatenate([[False], np.abs(np.diff(values)) > DATA_ROUNDING * np.abs(values[1:])])
    place = (np.cumsum(changes) + 0.5) * _GOLDEN % 1 - 0.5
    return values + step * place, step / 2


__all__ = ["HIGHEST", "Scale", "Tail", "depths", "past", "quantile", "scale_of", "slope_of", "tail_of", "without_steps"]
