"""Settings of sequential tests, and their thresholds: designed by integral equation, or from data."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, ClassVar, Literal, Self, get_args

import numpy as np
from numpy.typing import NDArray

from residua.decide.checks import check_rate, is_number, rate_aimed_at
from residua.decide.confident_thresholds import check_source, promise_by
from residua.decide.dependence import correlation_times
from residua.decide.exceedance_tail import scale_of
from residua.decide.false_alarms import Observed
from residua.decide.fault_free import FaultFree, check_enough, held_apart
from residua.decide.run_lengths import LONGEST, AlarmCycle, threshold_of
from residua.decide.stream_test import StreamTest, plain
from residua.decide.test import Block, FaultFreeRun, TestSettings, Watched
from residua.decide.treatment import Treated, treated
from residua.decide.whitening import moving_directions, whitening_matrix
from residua.design import ResidualGenerator
from residua.errors import DataError, SettingError
from residua.number_kinds import POSITIVE, PROBABILITY, NumberKind
from residua.tolerances import LEAKAGE, SIGNAL_ROUNDING
from residua.visible import echo
from residua.words import counted, number

Source = Literal["auto", "design", "data", "quantile", "tail", "conformal"]
Treatment = Literal["auto", "none"]
#: Those that take the threshold from the data, whatever the design says.
_OF_DATA = ("data", "quantile", "tail", "conformal")

#: Probability that white noise looks as coloured, below which it is taken to be coloured.
_COLOURED = 0.01
#: False alarms that are expected where a design is compared with the data, the rarest last: as many as data can show;
#: and the samples between them, at least: of shorter times designs that are approximate are too far off.
_EXPECTED = {200.0: 100.0, 50.0: 40.0, 20.0: 40.0}
#: Deviations of their number by which the data contradict the design.
_CONTRADICTION = 3.0
#: Probability that as many false alarms come by chance, below which they contradict the threshold of a design.
_BY_CHANCE = 0.001
#: Deviations of the time in alarm by which it does.
_LONG = 4.0
#: Alarms that show how long they last, and the fractions in alarm among which a threshold is sought that has so many.
_LEAST_RAISED, _MOST_SHARE, _SHARES = 30, 0.2, 12
#: Stretches of time, each of which is judged by a fit to the others.
_FOLDS = 4
#: How much more often false alarms come for a mean from few samples, where it is said.
_NOTABLE = 1.02
#: Standard deviations by which the ends of a stretch of time may be off its mean.
_ENDS = 3.0
#: Windows over which the sums of a residual have the same covariance if it is white.
_WINDOWS = (2, 8, 32)


@dataclass(frozen=True)
class StreamSettings(TestSettings):
    """Settings shared by all sequential tests, such as :class:`residua.decide.CUSUM`."""

    NUMBER_KINDS: ClassVar[Mapping[str, NumberKind]] = {
        "threshold": POSITIVE,
        "false_alarm_rate": PROBABILITY,
        "mean_time_between_false_alarms": POSITIVE,
    }
    #: The level at which an alarm ends, as a part of the threshold.
    falls_to: ClassVar[float] = 0.0
    #: How a threshold is designed.
    origin: ClassVar[str] = "by integral equation"
    #: The largest fraction of samples in alarm for which the design holds.
    largest_fraction: ClassVar[float] = 1.0
    #: Uncertain part of a fit that makes false alarms more frequent.
    uncertain: ClassVar[str] = "the mean"

    mean_time_between_false_alarms: float | None = None
    false_alarm_rate: float | None = None
    threshold: float | None = None
    source: str = "auto"
    treatment: str = "auto"

    def __post_init__(self) -> None:
        """Check the settings."""
        check_rate(self.false_alarm_rate)
        time = self.mean_time_between_false_alarms
        if time is not None:
            if not (is_number(time) and 1 < time <= LONGEST):
                raise SettingError(
                    f"mean_time_between_false_alarms must be a number of samples above 1, at most {LONGEST:g}, "
                    f"got {echo(time)}"
                )
            object.__setattr__(self, "mean_time_between_false_alarms", float(time))
        if self.threshold is not None and not (is_number(self.threshold) and self.threshold > 0):
            raise SettingError(f"threshold must be a positive number, got {echo(self.threshold)}")
        check_source(self.source, get_args(Source))
        if self.treatment not in get_args(Treatment):
            raise SettingError(f"treatment must be one of {', '.join(get_args(Treatment))}, got {echo(self.treatment)}")
        if self.threshold is not None and self.source in _OF_DATA[1:]:
            raise SettingError(
                f"threshold={self.threshold:g} and source={self.source!r} cannot be combined: leave one out"
            )
        by_design = time is None and self.threshold is None and self.source not in _OF_DATA
        rate = self.false_alarm_rate
        if by_design and rate is not None and rate > self.largest_fraction:
            raise SettingError(
                f"{type(self).__name__} is designed for at most {self.largest_fraction:g} of samples in alarm, got "
                f"false_alarm_rate={rate:g}: beyond, alarms come so soon after one another that each "
                "changes the next; give less, or mean_time_between_false_alarms="
            )
        object.__setattr__(self, "false_alarm_rate", None if rate is None else float(rate))

    # ------------------------------------------------------------- of each kind of test

    @abstractmethod
    def run_length(self, threshold: float, dimension: int) -> float:
        """Return the mean number of samples to a false alarm from a start, of white residuals with unit covariance."""

    @abstractmethod
    def cycle(self, threshold: float, dimension: int) -> AlarmCycle:
        """Return the mean lengths of quiet and of false alarms."""

    @abstractmethod
    def test(self, **parts: Any) -> StreamTest:
        """Build the fitted test."""

    @property
    @abstractmethod
    def harmless_offset(self) -> float:
        """Error of the mean, in standard deviations, that hardly changes the rate of alarms."""

    @property
    def uninterrupted(self) -> StreamSettings:
        """Settings with as many alarms as this test has without restarts; nearly always these themselves."""
        return self

    @property
    def counted_samples(self) -> int:
        """Number of samples in every statistic; 1 if it begins with the first."""
        return 1

    def for_parts(self, parts: Mapping[str, Any], watched: Watched) -> Self:
        """Return the settings completed for a generator and its whitening; as a rule these themselves."""
        return self

    def hurry(self, threshold: float, dimension: int, samples: int) -> float:
        """Return the factor on the rate of false alarms if the mean comes from so many samples, on average.

        1 where that is not known.
        """
        return 1.0

    def promise(self, threshold: float, dimension: int) -> tuple[str, float | None]:
        """Describe a threshold by its false alarms, and return the time between them where it is known."""
        time = self.run_length(threshold, dimension)
        return f"a false alarm each {number(time)} samples on average", time

    # -------------------------------------------------------------------------- thresholds

    def designed(self, dimension: int, rate: float | None = None, *, samples: int | None = None) -> float:
        """Return the threshold for the wanted time between false alarms, or for a fraction of samples in alarm.

        ``rate`` is another fraction than that of the settings.
        ``samples`` are those that the mean is from, which makes false alarms more frequent; known exactly when omitted.
        """
        guess = 3.0 + 0.5 * dimension**0.5
        time = self.mean_time_between_false_alarms

        def solved(more: float) -> float:
            if time is not None and rate is None:
                return threshold_of(lambda h: self.run_length(h, dimension), more * time, guess)
            wanted = more / (rate_aimed_at(self.false_alarm_rate) if rate is None else rate)
            return threshold_of(lambda h: 1 / self.cycle(h, dimension).fraction, wanted, guess)

        known = solved(1.0)
        more = 1.0 if samples is None else self.hurry(known, dimension, samples)
        return known if more == 1.0 else solved(more)

    def from_model(self, watched: Watched) -> StreamTest | None:
        """Return the test that needs no data, if the plant's noise leaves the residual white; else ``None``."""
        covariance = watched.generator.covariance_of_sums(1)
        if covariance is None or self.source in _OF_DATA:
            return None
        if not is_white(watched.generator):
            return None
        parts = plain(np.zeros(len(covariance)), whitening_matrix(covariance))
        mine = self.for_parts(parts, watched)
        return mine._by_design(parts, moving_directions(covariance), None, "noise model of the plant", None)

    def fitted(self, watched: Watched, run: FaultFreeRun, rate: float) -> StreamTest:
        """Return the test fitted to fault-free data, for a rate of false alarms.

        Mean, covariance and, where the residual is coloured, an autoregression are from the data. The threshold is
        that of the design, for white Gaussian residuals, if these data do not contradict it: if as many alarms as the
        design says are raised on them by lower thresholds. Where they do, the threshold is from the data.
        """
        data = FaultFree(run.residuals, run.usable, 1, run.seams)
        count = int(run.usable.sum())
        check_enough(count, run.residuals.shape[1], self.counted_samples)
        self._check_mean(count, data.moving)
        if data.spread <= SIGNAL_ROUNDING * run.signal_size():
            raise DataError(
                "these residuals hold no noise: no time between false alarms can be designed; set threshold=, or use "
                "NormThreshold, whose threshold is then the level of rounding"
            )
        other = None if rate == self.asked(watched) else rate
        made = self._whitened(data)
        parts, k, notes = made.parts, made.moving, made.notes
        mine, origin = self.for_parts(parts, watched), f"moments of {count} fault-free samples"
        if self.threshold is not None or self.source == "design":
            return mine._by_design(parts, k, other, "; ".join([origin, *notes]), count)
        if self.source == "conformal":
            return mine._by_later_half(data, rate)
        stretches, values, seen = mine._cross_fitted(data)
        against = (
            f"source={self.source!r}" if self.source in _OF_DATA else mine._contradiction(values, seen, stretches, k)
        )
        if not against:
            said = "the data do not contradict the design" if against == "" else "too few samples to contradict it"
            made = mine._by_design(parts, k, other, "; ".join([origin, *notes, said]), count)
            against = mine._too_many(made.threshold, values, seen, stretches, k)
            if not against:
                return made
        blank = mine.test(**parts, threshold=np.inf, release=0.0, basis="")
        if other is None and self.mean_time_between_false_alarms is not None:
            rate = mine._share_for(self.mean_time_between_false_alarms, values, seen, stretches, rate)
        return mine._by_data(blank, values, seen, stretches, rate, [against, *notes])

    def _check_mean(self, count: int, k: int) -> None:
        """Raise if the test would detect the error of the mean alone."""
        offset, most = (k / count) ** 0.5, self.harmless_offset
        if offset > most:
            raise DataError(
                f"{count} fault-free samples leave the mean of {counted(k, 'residual')} uncertain by {number(offset)} "
                f"standard deviations, which {type(self).__name__} would take for a change: give at least "
                f"{int(np.ceil(k / most**2))} samples, or use NormThreshold, which can be fitted to fewer"
            )

    def _cross_fitted(self, data: FaultFree) -> tuple[list[slice], NDArray[np.float64], NDArray[np.bool_]]:
        """Return stretches of time, the statistic of each by a fit to the others, and a mask of its samples.

        The data of a fit of mean, covariance and memory look quieter than other data.
        """
        values, seen = np.full(len(data.usable), np.nan), np.zeros(len(data.usable), dtype=bool)
        counted = np.cumsum(data.usable)
        edges = np.searchsorted(counted, np.arange(_FOLDS + 1) * counted[-1] / _FOLDS, side="left").tolist()
        edges[0], edges[-1] = 0, len(counted)
        cuts = sorted({*edges, *(part.start for part in data.parts)})
        stretches = [slice(a, b) for a, b in pairwise(cuts)]
        for start, stop in pairwise(edges):
            others = data.usable.copy()
            others[start:stop] = False
            parts = self._whitened(replace(data, usable=others)).parts
            blank = self.test(**parts, threshold=np.inf, release=0.0, basis="")
            for part in stretches:
                if start <= part.start < stop:
                    block = Block(data.residuals[None, part], data.usable[None, part])
                    tested = blank.run(blank.start(1), block)[1]
                    values[part], seen[part] = tested.statistic[0], tested.usable[0]
        return stretches, values, seen

    def _by_later_half(self, data: FaultFree, rate: float) -> StreamTest:
        """Return the test whitened by the first half of the data, with a threshold from the second."""
        first, _, second = held_apart(data)
        treatment = self._whitened(replace(data, usable=first))
        notes = treatment.notes
        blank = self.test(**treatment.parts, threshold=np.inf, release=0.0, basis="")
        values, seen = np.full(len(second), np.nan), np.zeros(len(second), dtype=bool)
        start = int(second.argmax())
        stretches = [slice(max(part.start, start), part.stop) for part in data.parts if part.stop > start]
        for part in stretches:
            tested = blank.run(blank.start(1), Block(data.residuals[None, part], data.usable[None, part]))[1]
            values[part], seen[part] = tested.statistic[0], tested.usable[0]
        halves = "made white by the first half of the data, the threshold of the second"
        return self._by_data(blank, values, seen, stretches, rate, [halves, *notes])

    def _whitened(self, data: FaultFree) -> Treated:
        """Fit the treatment that makes the residual white and Gaussian."""
        return treated(data, self.treatment, self.harmless_offset)

    def _by_design(
        self, parts: Mapping[str, Any], k: int, rate: float | None, origin: str, samples: int | None
    ) -> StreamTest:
        """Return the test with the threshold of the design for k independent residuals, or the one that is set."""
        if self.threshold is not None:
            threshold, basis = self.threshold, "threshold given"
        else:
            threshold, basis = self.designed(k, rate, samples=samples), f"designed {self.origin}"
        text, time = self.promise(threshold, k)
        more = 1.0 if samples is None or self.threshold is not None else self.hurry(threshold, k, samples)
        if more > _NOTABLE:
            text += f" with {self.uncertain} known ({100 * (more - 1):.0f} % more often with it from {samples} samples)"
        basis += f": {text}, if the residual is white and Gaussian"
        release = self.falls_to * threshold
        return self.test(**parts, threshold=threshold, release=release, basis=f"{basis}; {origin}", mean_time=time)

    def _contradiction(
        self, values: NDArray[np.float64], seen: NDArray[np.bool_], parts: Sequence[slice], dimension: int
    ) -> str | None:
        """Describe a contradiction between the design and the number of false alarms seen; empty without one.

        ``None`` where there are too few samples to see any.
        """
        count, like, said = int(seen.sum()), self.uninterrupted, None
        for expected, apart in _EXPECTED.items():
            if count < apart * expected:
                continue
            said, guess = "", 3.0 + 0.5 * dimension**0.5
            level = threshold_of(lambda h: like.run_length(h, dimension), count / expected, guess)
            cycle = like.cycle(level, dimension)
            mean = count / (cycle.quiet + cycle.lasting)
            levels = np.concatenate([_levels(values[part][seen[part]], self.falls_to) for part in parts])
            raised = int(np.sum((levels[1:] > level) & (levels[:-1] <= level)))
            if abs(raised - mean) > _CONTRADICTION * np.sqrt(mean) + 1:
                return (
                    f"the data contradict the design for white Gaussian residuals: {raised} alarms at a threshold of "
                    f"{level:.3g}, {mean:.0f} expected"
                )
        return said

    def _too_many(
        self,
        threshold: float,
        values: NDArray[np.float64],
        seen: NDArray[np.bool_],
        parts: Sequence[slice],
        dimension: int,
    ) -> str:
        """Describe an excess of false alarms over the design that chance does not explain; empty without one.

        Or longer ones. Lower thresholds say nothing of values that are rare, and then far beyond the others.
        """
        from scipy.special import pdtrc

        cycle = self.uninterrupted.cycle(threshold, dimension)
        mean = int(seen.sum()) / (cycle.quiet + cycle.lasting)
        levels = np.concatenate([_levels(values[part][seen[part]], self.falls_to) for part in parts])
        raised = int(np.sum((levels[1:] > threshold) & (levels[:-1] <= threshold)))
        if raised and pdtrc(raised - 1, mean) < _BY_CHANCE:
            return (
                f"the data contradict the design for white Gaussian residuals: {counted(raised, 'alarm')} at its "
                f"threshold of {threshold:.3g}, {mean:.2g} expected"
            )
        lasting, most = int(np.sum(levels > threshold)), mean + _LONG * (2 * mean) ** 0.5 + _LONG**2
        if lasting > cycle.lasting * most:  # of alarms as many as Poisson's, each as long as an exponential variable
            return (
                f"the data contradict the design for white Gaussian residuals: {counted(lasting, 'sample')} in alarm "
                f"at its threshold of {threshold:.3g}, {number(mean * cycle.lasting, 2)} expected"
            )
        return ""

    def _share_for(
        self,
        time: float,
        values: NDArray[np.float64],
        seen: NDArray[np.bool_],
        parts: Sequence[slice],
        designed: float,
    ) -> float:
        """Return the fraction in alarm for a time between alarms, with alarms as long as in these data."""
        levels = [_levels(values[part][seen[part]], self.falls_to) for part in parts]
        level = np.concatenate(levels)
        for share in np.geomspace(max(designed, 1 / len(level)), max(designed, _MOST_SHARE), _SHARES):
            height = float(np.quantile(level, 1 - share))
            raised = sum(int(np.sum((one[1:] > height) & (one[:-1] <= height))) for one in levels)
            if raised >= _LEAST_RAISED:
                lasting = float(np.mean(level > height)) * len(level) / raised
                return lasting / (time + lasting)
        return designed

    def _by_data(
        self,
        blank: StreamTest,
        values: NDArray[np.float64],
        seen: NDArray[np.bool_],
        parts: Sequence[slice],
        rate: float,
        notes: Sequence[str],
    ) -> StreamTest:
        """Return the test with a threshold from the data, and the promised rate."""
        k = len(blank.center)
        levels, blocks, begins, first = [], [], [], 0
        squares = np.where(seen, values**2 - np.mean(values[seen] ** 2), 0.0)[:, None]
        length = int(np.ceil(2 * correlation_times(squares, parts)[0]))
        for part in parts:
            mine = values[part][seen[part]]
            levels.append(np.maximum(_levels(mine, self.falls_to), 0.0))  # a ratio may be below one: no alarm
            number_of = np.arange(len(mine)) // length
            blocks.append(first + number_of)
            begins.append(np.arange(len(mine)) == 0)
            first += int(number_of.max(initial=-1)) + 1
        level = np.concatenate(levels)
        everywhere = np.ones(len(level), dtype=bool)
        found = Observed(level, level, everywhere, np.concatenate(blocks), np.concatenate(begins),
                         scale_of(level, float(k)), 1, 1, level, level)  # fmt: skip
        promise = promise_by("auto" if self.source == "data" else self.source, found, rate)
        basis = f"fitted to {len(level)} fault-free samples, {promise}; {'; '.join(notes)}"
        threshold = max(float(promise.threshold), float(np.finfo(float).tiny))
        return replace(
            blank, threshold=threshold, release=self.falls_to * threshold, basis=basis, promised=float(promise.promised)
        )

    # ----------------------------------------------- interface to the rest of a monitor

    def asked(self, watched: Watched, rows: int = 0) -> float:
        """Return the fraction of fault-free samples in alarm for the wanted time between alarms."""
        if self.mean_time_between_false_alarms is None:
            return super().asked(watched, rows)
        covariance = watched.generator.covariance_of_sums(1)
        n = watched.generator.n_residuals
        k = n if covariance is None else moving_directions(covariance)
        W = np.eye(n) if covariance is None else whitening_matrix(covariance)
        mine = self.for_parts(plain(np.zeros(n), W), watched)
        return mine.cycle(mine.designed(k), k).fraction

    def check(self, watched: Watched) -> None:
        """Raise if parts have to be tested separately."""
        if watched.parts is not None:
            raise SettingError(
                f"{type(self).__name__} tests the residual as a whole, and an isolation by codes asks which part "
                "fired: take NormThreshold, or isolate by direction"
            )

    @property
    def remedy(self) -> str:
        """Remedy for a missing threshold."""
        if self.source in _OF_DATA:
            return super().remedy
        return f"{super().remedy}, or give the plant noise (with_noise) that leaves the residual white"


def is_white(generator: ResidualGenerator) -> bool:
    """Tell whether the plant's noise leaves the residual white: sums over any window have the same covariance."""
    covariance = generator.covariance_of_sums(1)
    if covariance is None:
        return False
    sums = [generator.covariance_of_sums(window) for window in _WINDOWS]
    limit = LEAKAGE * float(np.abs(covariance).max(initial=0.0))
    return all(one is not None and np.abs(one - covariance).max() <= limit for one in sums)


def _levels(values: NDArray[np.float64], falls_to: float) -> NDArray[np.float64]:
    r"""Return for every sample the threshold below which it is in alarm.

    .. math:: a_t = \max(s_t, \min(a_{t-1}, s_t / \gamma))

    where an alarm ends with the statistic :math:`s` at or below :math:`\gamma` times the threshold.
    """
    if falls_to >= 1:
        return values
    out, level = values.tolist(), 0.0
    for t, value in enumerate(out):
        ceiling = value / falls_to if falls_to else (np.inf if value > 0 else 0.0)
        out[t] = level = max(value, min(level, ceiling))
    return np.array(out)


__all__ = ["StreamSettings", "is_white"]
