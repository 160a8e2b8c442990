"""Held-out part of fault-free recordings, and the alarms of the fitted test on it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from residua.decide.dependence import correlation_times
from residua.decide.fault_free import FaultFree
from residua.decide.test import Block, FaultFreeRun, ResidualTest
from residua.number_kinds import COUNT, INDEX, POSITIVE, PROBABILITY, NumberKind
from residua.records import Record
from residua.words import one_in

#: How sure an interval is: 2.5 % on either side.
CONFIDENCE = 0.95
#: Fewest samples that are held out, and in windows: with fewer nothing is.
LEAST, LEAST_WINDOWS = 30, 2
#: Times the rate aimed at beyond which recordings are no fault-free ones, or do not stay as they begin.
_FAR = 10.0
#: Fraction in alarm up to which it is said as one in so many, too.
_OFTEN = 0.1
#: Samples that a test is run over at a time: bounds memory.
_PIECE = 100_000


@dataclass(frozen=True)
class HeldOut(Record):
    """Alarms on fault-free samples that were used neither for the covariance nor for the threshold.

    Attributes
    ----------
    samples : int
        Held out and judged.
    alarmed : int
        Those in alarm.
    independent : float
        Independent samples that they are worth.
    asked : float
        Fraction in alarm that the fit aimed at.
    recording, sample : int
        Where the first alarm is: the number of the recording, from 1, and its sample; 0 without an alarm.
    """

    NUMBER_KINDS: ClassVar[Mapping[str, NumberKind]] = {
        "samples": COUNT,
        "alarmed": INDEX,
        "independent": POSITIVE,
        "asked": PROBABILITY,
        "recording": INDEX,
        "sample": INDEX,
    }

    samples: int
    alarmed: int
    independent: float
    asked: float
    recording: int = 0
    sample: int = 0

    @property
    def rate(self) -> float:
        """Fraction in alarm."""
        return self.alarmed / self.samples

    @property
    def interval(self) -> tuple[float, float]:
        r"""95 % confidence interval of the rate, from the number of independent samples.

        .. math:: B^{-1}_{0.025}(k, n - k + 1), \qquad B^{-1}_{0.975}(k + 1, n - k)

        with the quantiles of the beta distribution, ``n`` independent samples and ``k = n`` times the rate.

        References
        ----------
        Clopper and Pearson (1934), Biometrika 26(4), 404-413.

        Examples
        --------
        >>> from residua.decide.held_out import HeldOut
        >>> low, high = HeldOut(10, 0, 10.0, 0.01).interval
        >>> low, round(high, 4)
        (0.0, 0.3085)
        """
        from scipy.special import betaincinv  # slow to import, and needed only here

        n, k, side = self.independent, self.independent * self.rate, (1 - CONFIDENCE) / 2
        low = 0.0 if self.alarmed == 0 else float(betaincinv(k, n - k + 1, side))
        high = 1.0 if self.alarmed == self.samples else float(betaincinv(k + 1, n - k, 1 - side))
        return low, high

    @property
    def is_over(self) -> bool:
        """True if the rate exceeds its target, with 97.5 % confidence."""
        return self.interval[0] > self.asked

    @property
    def is_far_over(self) -> bool:
        """True if the rate exceeds ten times its target, with 97.5 % confidence."""
        return self.interval[0] > _FAR * self.asked

    def __str__(self) -> str:
        often = f" ({one_in(self.rate)})" if self.alarmed and self.rate <= _OFTEN else ""
        return f"{self.alarmed:,} of {self.samples:,} held-out samples in alarm{often}"


def held_out_rows(run: FaultFreeRun, share: float, window: int) -> NDArray[np.bool_] | None:
    """Return the last part of the usable samples of every recording; ``None`` if there are too few to hold any out.

    Parameters
    ----------
    run : FaultFreeRun
    share : float
        Of the usable samples of each recording.
    window : int
        Samples that the test sums. Thirty and two windows are the least to hold out.
    """
    held = np.zeros(len(run.usable), dtype=bool)
    least = max(LEAST, LEAST_WINDOWS * window)
    for part in FaultFree(run.residuals, run.usable, 1, run.seams).parts:
        rows = np.flatnonzero(run.usable[part])
        count = int(share * len(rows))
        if count >= least and len(rows) - count >= least:
            held[part.start + rows[-count] : part.stop] = True
    return held if held.any() else None


def alarms_held_out(test: ResidualTest, run: FaultFreeRun, held: NDArray[np.bool_], asked: float) -> HeldOut | None:
    """Run a fitted test over fault-free recordings, and count its alarms on the held-out samples.

    Those samples are judged whose whole window was held out. The samples are worth ``n / tau`` independent ones, with
    the correlation time of the squared statistic, or of being in alarm where that is longer.
    """
    judged, alarm, statistic, parts = [], [], [], FaultFree(run.residuals, run.usable, 1, run.seams).parts
    for part in parts:
        state = test.start(1)
        for start in range(part.start, part.stop, _PIECE):
            piece = slice(start, min(start + _PIECE, part.stop))
            signals = None if run.signals is None else run.signals[None, piece]
            block = Block(run.residuals[None, piece], run.usable[None, piece], start - part.start, signals=signals)
            state, tested = test.run(state, block)
            judged.append(tested.usable[0])
            alarm.append(tested.alarm[0])
            statistic.append(tested.statistic[0])
    usable, alarms, level = np.concatenate(judged), np.concatenate(alarm), np.concatenate(statistic)
    counted = usable & held
    for part in parts:
        counted[part] &= np.cumsum(held[part] & run.usable[part]) >= test.samples
    if not counted.any():
        return None
    columns = np.zeros((len(counted), 2))
    for j, value in enumerate((np.where(counted, level, 0.0) ** 2, alarms.astype(float))):
        columns[:, j] = np.where(counted, value - value[counted].mean(), 0.0)
    spans = [slice(part.start + int(rows[0]), part.start + int(rows[-1]) + 1) for part in parts
             if len(rows := np.flatnonzero(counted[part]))]  # fmt: skip
    samples, longest = int(counted.sum()), float(correlation_times(columns, spans).max())
    place = (0, 0)
    if (alarms & counted).any():
        first = int((alarms & counted).argmax())
        place = next((number, first - part.start) for number, part in enumerate(parts, 1) if first < part.stop)
    return HeldOut(samples, int((alarms & counted).sum()), max(1.0, samples / longest), asked, *place)


__all__ = ["HeldOut", "alarms_held_out", "held_out_rows"]
