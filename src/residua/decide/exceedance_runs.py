"""Fraction of samples in alarm from runs above and below the threshold, if alarms are too rare to count."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from residua.decide.exceedance_tail import Tail, depths, slope_of
from residua.tolerances import TINY

#: Runs over a level from which on their course is known, and runs of a length from which on their number is.
_KNOWN, _COUNTED = 20, 16


@dataclass(frozen=True, eq=False)
class RunModel:
    r"""Model of alarms by runs of the statistic above and below the threshold.

    Runs of ``p`` samples over the threshold begin at a rate :math:`\nu_1`, and a fraction :math:`B` of the samples is
    the last of ``p`` over it; likewise :math:`\nu_0` and :math:`C` for ``q`` samples under it. Then the fraction in
    alarm is

    .. math:: R = \frac{T_0}{T_0 + T_1}, \qquad T_1 = \frac{1 - B}{\nu_1}, \qquad T_0 = \frac{1 - C}{\nu_0}

    with the mean times until an alarm is raised and ended (exact where samples are independent, and for ``p = q = 1``
    always). Runs that are too long to be seen often go on as often as shorter ones do. Over the highest level that
    enough runs are seen over, the course of runs is kept, and their number falls with that of the samples over the
    threshold.

    Attributes
    ----------
    statistic : ndarray, shape (n,)
    counted, begins : ndarray of bool, shape (n,)
    groups : ndarray of int, shape (n,)
        Stretches of time that are left out in turn to see how well the fraction is known.
    tail : Tail
        Of the statistic.
    persistence, release : int

    References
    ----------
    Feller (1968), An introduction to probability theory, volume 1, section XIII.7 (mean times until runs).
    """

    statistic: NDArray[np.float64]
    counted: NDArray[np.bool_]
    begins: NDArray[np.bool_]
    groups: NDArray[np.int64]
    tail: Tail
    persistence: int
    release: int

    @classmethod
    def of(
        cls,
        statistic: NDArray[np.float64],
        counted: NDArray[np.bool_],
        begins: NDArray[np.bool_],
        groups: NDArray[np.int64],
        tail: Tail,
        persistence: int,
        release: int,
    ) -> RunModel:
        """Return the model of a statistic."""
        return cls(statistic, counted, begins, groups, tail, persistence, release)

    @property
    def worth(self) -> float:
        """Degrees of freedom of the spread, plus one."""
        return min(self.tail.worth, float(self.groups.max(initial=0)) + 1)

    def level(self, rate: float) -> float:
        """Return the threshold of a rate (bisection)."""
        low, high = float(self.tail.values[0]), float(self.tail.level(rate / self.release / 2))
        for _ in range(48):
            middle = (low + high) / 2
            low, high = (middle, high) if self.fraction(middle) > rate else (low, middle)
        return high

    def fraction(self, level: float) -> float:
        """Return the fraction of samples in alarm with a threshold."""
        return float(self._fractions(level, whole=True)[0])

    def seen(self, rate: float) -> float:
        """Return the fraction in alarm at the level where the extended tail begins, or this rate."""
        return max(rate, self.fraction(self.tail.start))

    def spread(self, level: float) -> float:
        """Return the jackknife standard deviation of the logarithm of that fraction, over stretches of time.

        With that of the fraction of samples over the threshold besides: a few stretches show too little of it.
        """
        logarithms = np.log(self._fractions(level, whole=False))
        count = len(logarithms)
        if count < 2:
            return np.inf
        by_turns = float(np.sqrt((count - 1) / count * np.sum((logarithms - logarithms.mean()) ** 2)))
        return float(np.hypot(by_turns, self.tail.spread(max(self.tail.fraction(level), TINY))))

    @cached_property
    def limit(self) -> float:
        """Highest level exceeded by enough runs."""
        before, now = self.statistic[:-1], self.statistic[1:]
        rises = (before < now) & ~self.begins[1:] & self.counted[1:]
        low, high = np.sort(before[rises]), np.sort(now[rises])
        levels = high[::-1]
        runs = np.searchsorted(low, levels, side="left") - np.searchsorted(high, levels, side="left")
        enough = np.flatnonzero(runs >= _KNOWN)
        return float(np.nextafter(levels[enough[0]], -np.inf)) if len(enough) else float(np.median(self.tail.values))

    def _fractions(self, level: float, *, whole: bool) -> NDArray[np.float64]:
        """Return the fraction from all data, and from all but each stretch of time."""
        at = min(level, self.limit)
        course = self._course(at, whole)
        B, raised, C, ended = course.B, course.raised, course.C, course.ended
        if level > at:
            factor = self._over(level, whole) / np.maximum(course.seen, 1)
            B, raised = B * factor, raised * factor
        time_up = np.maximum(1 - B, TINY) / np.maximum(raised, TINY)
        time_down = np.maximum(1 - C, TINY) / np.maximum(ended, TINY)
        return time_down / (time_down + time_up)

    @cached_property
    def _number(self) -> int:
        """Number of stretches of time."""
        return int(self.groups.max(initial=0)) + 1

    @cached_property
    def _counted_groups(self) -> NDArray[np.int64]:
        return self.groups[self.counted]

    @cached_property
    def _counted_values(self) -> NDArray[np.float64]:
        return self.statistic[self.counted]

    @cached_property
    def _sorted(self) -> NDArray[np.float64]:
        return np.sort(self.statistic)

    @cached_property
    def _courses(self) -> dict[tuple[int, bool], _Course]:
        return {}

    @cached_property
    def _beyond(self) -> dict[bool, tuple[NDArray[np.float64], NDArray[np.float64], float]]:
        return {}

    def _left(self, values: NDArray, whole: bool) -> NDArray[np.float64]:
        """Return the sum of values over all stretches of time, or over all but each."""
        total = values.sum(axis=0, keepdims=True).astype(float)
        return total if whole else total - values

    def _by_stretches(self, values: NDArray[np.float64], whole: bool) -> NDArray[np.float64]:
        return self._left(np.bincount(self._counted_groups, values, minlength=self._number)[:, None], whole)[:, 0]

    def _course(self, at: float, whole: bool) -> _Course:
        """Return the runs at a level, cached between two values of the statistic."""
        key = int(np.searchsorted(self._sorted, at, side="right")), whole
        if key not in self._courses:
            over = self.statistic > at
            up, down = self._counts(over, self.persistence, whole), self._counts(~over, self.release, whole)
            samples = up.sum(axis=1)
            runs = *_runs(up, samples, self.persistence), *_runs(down, samples, self.release)
            self._courses[key] = _Course(*runs, samples - up[:, 0])
        return self._courses[key]

    def _counts(self, which: NDArray[np.bool_], longest: int, whole: bool) -> NDArray[np.float64]:
        """Return the number of samples with a run of 0, 1, ..., ``longest``, and more, up to them."""
        run = np.minimum(_run_lengths(which, self.begins)[self.counted], longest + 1)
        table = np.bincount(self._counted_groups * (longest + 2) + run, minlength=self._number * (longest + 2))
        return self._left(table.reshape(self._number, longest + 2), whole)

    def _over(self, level: float, whole: bool) -> NDArray[np.float64]:
        """Return the number of samples over a level: beyond the start of the tail, the expected number."""
        values = self._counted_values
        if level <= self.tail.start:
            return self._by_stretches((values > level).astype(float), whole)
        if whole not in self._beyond:
            over = values > self.tail.start
            start = float(depths(self.tail.scale, self.tail.start))
            excess = np.zeros(len(values))
            excess[over] = depths(self.tail.scale, values[over]) - start
            count = self._by_stretches(over.astype(float), whole)
            slope = slope_of(self.tail.worth, self._by_stretches(excess, whole) / np.maximum(count, 1))
            self._beyond[whole] = count, slope, start
        count, slope, start = self._beyond[whole]
        return count * np.exp(-slope * (float(depths(self.tail.scale, level)) - start))


@dataclass(frozen=True, eq=False)
class _Course:
    """Runs above and below a level: the fractions of samples that end one, their frequencies, and samples over."""

    B: NDArray[np.float64]
    raised: NDArray[np.float64]
    C: NDArray[np.float64]
    ended: NDArray[np.float64]
    seen: NDArray[np.float64]


def _run_lengths(which: NDArray[np.bool_], begins: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return for each sample the length of the run of marked ones that it ends, within one recording."""
    index = np.arange(1, len(which) + 1)
    last = np.maximum.accumulate(np.where(which & ~begins, 0, np.where(which, index - 1, index)))
    return np.where(which, index - last, 0)


def _runs(
    counts: NDArray[np.float64], samples: NDArray[np.float64], length: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the fraction of samples that end a run of a length or more, and the frequency of such runs.

    ``counts``: how many samples have a run of 0, 1, ..., length, and more, up to them; a row for each set of data.
    """
    reached = counts[:, 1 : length + 1]  # how many runs reach a length
    longer = np.cumsum(counts[:, :0:-1], axis=1)[:, ::-1][:, :length]  # samples that end a run of a length or more
    enough = reached >= _COUNTED
    last = np.where(enough.all(axis=1), length, np.maximum(np.argmin(enough, axis=1), 1)) - 1
    rows = np.arange(len(counts))
    begun, ends = reached[rows, last], longer[rows, last]
    goes_on = (ends - begun + 0.5) / (ends + 1.0)  # never none and never all
    with np.errstate(invalid="ignore"):  # without the only group that counts nothing is known: no rate is promised
        begins = begun * goes_on ** (length - 1 - last) / samples
        fraction = np.where(last == length - 1, ends / samples, begins / (1 - goes_on))
    return fraction, begins


__all__ = ["RunModel"]
