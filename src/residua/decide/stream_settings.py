"""Settings of sequential tests, and their thresholds: designed by integral equation, or from data."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal, Self, get_args

import numpy as np
from numpy.typing import NDArray

from residua.decide.calibrate import (
    SETTLING,
    ResidualModel,
    calibrated,
    held_out,
    levels_of,
    simulated_worlds,
)
from residua.decide.checks import check_rate, is_number, rate_aimed_at
from residua.decide.confident_thresholds import check_source, promise_by
from residua.decide.dependence import correlation_times
from residua.decide.exceedance_tail import scale_of
from residua.decide.false_alarms import Observed
from residua.decide.fault_free import FaultFree, check_enough
from residua.decide.run_lengths import LONGEST, AlarmCycle, threshold_of
from residua.decide.stream_test import StreamTest, plain
from residua.decide.test import Block, FaultFreeRun, TestSettings, Watched
from residua.decide.treatment import fit_parts, treated
from residua.decide.whitening import moving_directions, whitening_matrix
from residua.design import ResidualGenerator
from residua.errors import DataError, SettingError
from residua.number_kinds import POSITIVE, PROBABILITY, NumberKind
from residua.tolerances import LEAKAGE, SIGNAL_ROUNDING, TINY
from residua.visible import echo
from residua.words import counted, number

Source = Literal["auto", "design", "data", "quantile"]
Treatment = Literal["auto", "none"]
#: Those that take the threshold from the data, whatever the design says.
_OF_DATA = ("data", "quantile")

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
    def counted_samples(self) -> int:
        """Number of samples in every statistic; 1 if it begins with the first."""
        return 1

    @property
    def settling(self) -> int:
        """Number of samples after which the statistic has forgotten its start."""
        return self.counted_samples

    def for_parts(self, parts: Mapping[str, Any], watched: Watched) -> Self:
        """Return the settings completed for a generator and its whitening; as a rule these themselves."""
        return self

    def promise(self, threshold: float, dimension: int) -> tuple[str, float | None]:
        """Describe a threshold by its false alarms, and return the time between them where it is known."""
        time = self.run_length(threshold, dimension)
        return f"a false alarm each {number(time)} samples on average", time

    # -------------------------------------------------------------------------- thresholds

    def designed(self, dimension: int, rate: float | None = None) -> float:
        """Return the threshold for the wanted time between false alarms, or for a fraction of samples in alarm.

        ``rate`` is another fraction than that of the settings.
        """
        guess = 3.0 + 0.5 * dimension**0.5
        time = self.mean_time_between_false_alarms
        if time is not None and rate is None:
            return threshold_of(lambda h: self.run_length(h, dimension), time, guess)
        wanted = 1 / (rate_aimed_at(self.false_alarm_rate) if rate is None else rate)
        return threshold_of(lambda h: 1 / self.cycle(h, dimension).fraction, wanted, guess)

    def from_model(self, watched: Watched) -> StreamTest | None:
        """Return the test that needs no data, if the plant's noise leaves the residual white; else ``None``."""
        covariance = watched.generator.covariance_of_sums(1)
        if covariance is None or self.source in _OF_DATA:
            return None
        if not is_white(watched.generator):
            return None
        parts = plain(np.zeros(len(covariance)), whitening_matrix(covariance))
        mine = self.for_parts(parts, watched)
        return mine._by_design(parts, moving_directions(covariance), None, "noise model of the plant")

    def fitted(self, watched: Watched, run: FaultFreeRun, rate: float) -> StreamTest:
        """Return the test fitted to fault-free data, for a rate of false alarms.

        Mean, covariance and, where the residual is coloured, an autoregression are from the data. The threshold is from
        worlds of the fitted model, each fitted anew (:mod:`residua.decide.calibrate`), unless it is to be designed for
        white Gaussian residuals.
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
        asked_otherwise = rate != self.asked(watched)
        made = treated(data, self.treatment, self.harmless_offset)
        mine = self.for_parts(made.parts, watched)
        if self.threshold is not None or self.source == "design":
            origin = "; ".join([f"moments of {count} fault-free samples", *made.notes])
            return mine._by_design(made.parts, made.moving, rate if asked_otherwise else None, origin)
        blank = mine.test(**made.parts, threshold=np.inf, release=0.0, basis="")
        levels = mine._held_out_levels(run)
        if self.source == "quantile":
            return mine._by_data(blank, levels, rate, made.notes)
        model = fit_parts([made], [range(run.residuals.shape[1])], run).model
        assert made.varies is not None  # as of any treatment that was fitted
        model = replace(model, covariance=np.diag(made.varies.astype(float)))
        time = None if asked_otherwise else self.mean_time_between_false_alarms
        worth = count / data.worth[0] / max(made.moving, 1)
        data_levels = np.concatenate(levels) if levels else np.zeros(0)
        found = calibrated(mine._world_levels(blank, model), data_levels, rate, count, worth=worth, time=time)
        return replace(
            blank,
            threshold=found.threshold,
            release=self.falls_to * found.threshold,
            basis="; ".join([str(found), *made.notes]),
            mean_time=found.time,
            promised=float(found.promised),
        )

    def _world_levels(self, blank: StreamTest, model: ResidualModel) -> NDArray[np.float64]:
        """Return the levels of new rows of simulated worlds."""
        settling = SETTLING + self.settling
        e = simulated_worlds(model, settling=settling).new
        for j, knots in enumerate(blank.knots if blank.scores.size else ()):
            e[..., j] = np.interp(e[..., j], knots, blank.scores)
        values, _ = blank.statistic(blank.first_sums(len(e)), e, np.ones(e.shape[:2], dtype=bool))
        return levels_of(values, self.falls_to)[:, settling:]

    def _check_mean(self, count: int, k: int) -> None:
        """Raise if the test would detect the error of the mean alone."""
        offset, most = (k / count) ** 0.5, self.harmless_offset
        if offset > most:
            raise DataError(
                f"{count} fault-free samples leave the mean of {counted(k, 'residual')} uncertain by {number(offset)} "
                f"standard deviations, which {type(self).__name__} would take for a change: give at least "
                f"{int(np.ceil(k / most**2))} samples, or use NormThreshold, which can be fitted to fewer"
            )

    def _held_out_levels(self, run: FaultFreeRun) -> list[NDArray[np.float64]]:
        """Return the levels of each stretch of time by a fit to the others; none if they are too few samples."""
        out = []
        for others, mine in held_out(run):
            try:
                parts = treated(
                    FaultFree(others.residuals, others.usable, 1, others.seams), self.treatment, self.harmless_offset
                ).parts
            except DataError:  # too few samples remain for a fit
                return []
            blank = self.test(**parts, threshold=np.inf, release=0.0, basis="")
            for part in FaultFree(mine.residuals, mine.usable, 1, mine.seams).parts:
                block = Block(mine.residuals[None, part], mine.usable[None, part])
                tested = blank.run(blank.start(1), block)[1]
                values = tested.statistic[0][tested.usable[0]]
                if len(values):
                    out.append(levels_of(values[None], self.falls_to)[0])
        return out

    def _by_design(self, parts: Mapping[str, Any], k: int, rate: float | None, origin: str) -> StreamTest:
        """Return the test with the threshold of the design for k independent residuals, or the one that is set."""
        if self.threshold is not None:
            threshold, basis = self.threshold, "threshold given"
        else:
            threshold, basis = self.designed(k, rate), f"designed {self.origin}"
        text, time = self.promise(threshold, k)
        basis += f": {text}, if the residual is white and Gaussian; {origin}"
        return self.test(**parts, threshold=threshold, release=self.falls_to * threshold, basis=basis, mean_time=time)

    def _by_data(
        self, blank: StreamTest, levels: Sequence[NDArray[np.float64]], rate: float, notes: Sequence[str]
    ) -> StreamTest:
        """Return the test with an order statistic of the data as its threshold, and the promised rate."""
        level, blocks, begins, first = np.concatenate(levels), [], [], 0
        length = int(np.ceil(2 * correlation_times((level - level.mean())[:, None], [slice(0, len(level))])[0]))
        for one in levels:
            number_of = np.arange(len(one)) // length
            blocks.append(first + number_of)
            begins.append(np.arange(len(one)) == 0)
            first += int(number_of.max(initial=-1)) + 1
        everywhere = np.ones(len(level), dtype=bool)
        found = Observed(level, level, everywhere, np.concatenate(blocks), np.concatenate(begins),
                         scale_of(level, float(len(blank.center))), 1, 1, level, level)  # fmt: skip
        promise = promise_by("quantile", found, rate)
        threshold = max(float(promise.threshold), TINY)
        return replace(
            blank,
            threshold=threshold,
            release=self.falls_to * threshold,
            basis="; ".join([f"fitted to {len(level)} fault-free samples, {promise}", *notes]),
            promised=float(promise.promised),
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


__all__ = ["StreamSettings", "is_white"]
