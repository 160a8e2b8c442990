"""Wald's sequential probability ratio test of each residual, two-sided and repeated."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from residua.decide.checks import is_number, rate_aimed_at
from residua.decide.run_lengths import (
    AlarmCycle,
    Chain,
    alarm_cycle,
    mean_run_length,
    nodes_of,
    run_frequency,
    settled,
)
from residua.decide.stream_settings import StreamSettings
from residua.decide.stream_test import StreamTest
from residua.decide.test import ResidualTest, Watched
from residua.decide.whitening import moving_directions
from residua.errors import FileFormatError, SettingError
from residua.number_kinds import ENTRY, POSITIVE, PROBABILITY, NumberKind
from residua.visible import echo
from residua.words import number

#: A ratio grows to this multiple of its threshold at most, so that an alarm ends soon after its fault.
_FULL = 2.0


@dataclass(frozen=True)
class Decisions:
    """Decisions of one sequential test from its start.

    Attributes
    ----------
    false_alarm_rate, miss_rate : float
        Wrong decisions, as parts of all: "fault" without one, and "no fault" with one of the size of the shift.
    samples, samples_with_fault : float
        The average sample numbers: to a decision without a fault, and with one.
    """

    false_alarm_rate: float
    miss_rate: float
    samples: float
    samples_with_fault: float


@dataclass(frozen=True)
class RatioChain(Chain):
    """Sum of one side over its lower bound, in deviations; zero is a restart, after a decision "no fault".

    Attributes
    ----------
    start : float
        Minus the lower bound: a start is as far over it.
    mean : float
        Of a step.
    """

    start: float
    mean: float

    def density(self, now: NDArray[np.float64], then: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the density of the next sum."""
        return np.exp(-((then - self._place(now)) ** 2) / 2) / np.sqrt(2 * np.pi)

    def above(self, now: NDArray[np.float64], level: float) -> NDArray[np.float64]:
        """Return the probability that the next sum is above a level."""
        from scipy.special import ndtr

        return ndtr(self._place(now) - level)

    def at_zero(self, now: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the probability that the next sum is below the bound, which leads to a restart."""
        from scipy.special import ndtr

        return ndtr(-self._place(now))

    def _place(self, now: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.where(now == 0, self.start, now) + self.mean


@dataclass(frozen=True, eq=False, kw_only=True)
class SPRTTest(StreamTest):
    """Fitted sequential tests."""

    NUMBER_KINDS: ClassVar[Mapping[str, NumberKind]] = {
        **StreamTest.NUMBER_KINDS, "shift": POSITIVE, "lower": ENTRY
    }  # fmt: skip

    shift: float
    lower: float

    def first_sums(self, plants: int) -> NDArray[np.float64]:
        """Return the ratios before the first sample, and whether there is an alarm: zeros."""
        return np.zeros((plants, 2 * len(self.center) + 1))

    def statistic(
        self, sums: NDArray[np.float64], e: NDArray[np.float64], seen: NDArray[np.bool_]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the largest log-likelihood ratio; "no fault" restarts one side, the end of an alarm all."""
        steps = self.shift * np.concatenate([e, -e], axis=-1) - self.shift**2 / 2
        values, full = np.empty(seen.shape), _FULL * self.threshold
        now, alarmed = sums[:, :-1], sums[:, -1] > 0
        for t in range(e.shape[1]):
            here = seen[:, t]
            new = np.minimum(now + steps[:, t], full)
            values[:, t] = value = new.max(axis=1)
            alarmed = alarmed | (here & (value > self.threshold))
            over = alarmed & here & (value <= self.release)
            new = np.where((new < self.lower) | over[:, None], 0.0, new)
            now, alarmed = np.where(here[:, None], new, now), alarmed & ~over
        return values, np.hstack([now, alarmed[:, None].astype(float)])

    @property
    def title(self) -> str:
        """Name of the statistic."""
        return f"largest likelihood ratio (logarithm; for a shift by {self.shift:g}, from zero again below "\
               f"{number(self.lower)}) of one part"  # fmt: skip

    @property
    def samples(self) -> int:
        """Number of samples in which a change of the shift reaches the threshold."""
        return max(1, int(np.ceil(min(2 * self.threshold / self.shift**2, 1e9))))

    @property
    def least_seen(self) -> float:
        """Half the shift: the ratio grows for any larger mean."""
        return self.shift / 2

    def check(self, watched: Any) -> None:
        """Raise if a test from a file is invalid."""
        super().check(watched)
        if not (self.shift > 0 and self.lower < 0):
            raise FileFormatError("fitted: shift must be positive and lower, where a test starts again, negative")


@dataclass(frozen=True)
class SPRT(StreamSettings):
    r"""Decide between "no fault" and "fault", repeatedly, with as few samples as both error rates allow.

    .. math:: \Lambda^\pm_k = \Lambda^\pm_{k-1} \pm \delta e_k - \delta^2 / 2, \qquad
              A = \ln\frac{1 - \beta}{\alpha}, \quad B = \ln\frac{\beta}{1 - \alpha}

    with each whitened residual :math:`e`, on both sides: a ratio above A raises the alarm, one below B decides "no
    fault" and starts again from zero, and between the bounds the test goes on. Of all tests with these rates of errors
    Wald's takes the fewest samples on average, where a fault is there from its start or never. An alarm is over when
    the largest ratio is at or below half of A; all ratios then start again.

    Parameters
    ----------
    false_alarm_rate : float, optional
        :math:`\alpha`, of each decision of each side of each residual, by Wald's bound: **not** a fraction of samples.
        The resulting time between false alarms is in ``basis`` and in :meth:`run_length`. When omitted, 1e-4,
        and a fit finds A for the fraction of samples in alarm that its log can support instead
        (:class:`residua.decide.NormThreshold`).
    miss_rate : float
        :math:`\beta`: the decisions "no fault" where the mean is off by the shift from a start on.
    shift : float
        :math:`\delta`, in standard deviations of the residual.
    mean_time_between_false_alarms : float, optional
        In samples, from a start: A then follows from it by integral equation instead, B stays.
    threshold : float, optional
        A, where it is to be neither.
    source : {"auto", "design", "data", "quantile"}
        Where the threshold is from after a fit; see :class:`residua.decide.CUSUM`.
    treatment : {"auto", "none"}
        Whether a fit makes a coloured residual white, by an autoregression, and heavy tails Gaussian, by normal scores.

    See Also
    --------
    residua.decide.CUSUM : For a fault that comes at any time: it starts again as soon as a sum is negative.

    Notes
    -----
    Wald's bounds are inequalities: ratios overshoot them. The error rates :math:`\alpha' \le \alpha / (1 - \beta)` and
    :math:`\beta' \le \beta / (1 - \alpha)`, and the average sample numbers, are by integral equation in
    :meth:`decisions`. A false alarm of one side comes each :math:`N_0 / \alpha'` samples, with :math:`N_0` samples to a
    decision; of :math:`m` residuals :math:`2 m` times as often: both sides of all residuals are counted as independent
    ones.

    Assumes: the fault-free residual is stationary; where the threshold is designed, white and Gaussian too, once
    whitened.

    References
    ----------
    Wald (1945), Annals of Mathematical Statistics 16(2), 117-186: the bounds of the ratio and the
    average sample numbers.

    Examples
    --------
    >>> import residua as rs
    >>> test = rs.decide.SPRT(false_alarm_rate=0.01, miss_rate=0.05)
    >>> round(test.designed(1), 6), round(test.lower, 6)
    (4.553877, -2.985682)
    >>> [round(n, 6) for n in test.wald_sample_numbers]
    [5.820573, 8.353798]
    >>> exact = test.decisions(test.designed(1))
    >>> round(exact.false_alarm_rate, 4), round(exact.miss_rate, 4), round(exact.samples, 2)
    (0.0057, 0.0281, 7.31)
    """

    kind: ClassVar[str] = "sprt"
    makes: ClassVar[type[ResidualTest]] = SPRTTest
    falls_to: ClassVar[float] = 0.5
    NUMBER_KINDS: ClassVar[Mapping[str, NumberKind]] = {
        **StreamSettings.NUMBER_KINDS, "miss_rate": PROBABILITY, "shift": POSITIVE
    }  # fmt: skip

    miss_rate: float = 0.05
    shift: float = 1.0

    def __post_init__(self) -> None:
        """Check the settings."""
        super().__post_init__()
        if not (is_number(self.miss_rate) and 0 < self.miss_rate < 1):
            raise SettingError(f"miss_rate must lie between 0 and 1, got {echo(self.miss_rate)}")
        if not (is_number(self.shift) and self.shift > 0):
            raise SettingError(
                f"shift must be a positive number of standard deviations, got {echo(self.shift)}: the change to be seen"
            )
        if self.wrong_alarms + self.miss_rate >= 1:
            raise SettingError(
                f"false_alarm_rate and miss_rate must be below 1 together, got {self.wrong_alarms:g} and "
                f"{self.miss_rate:g}: a coin does better"
            )
        object.__setattr__(self, "miss_rate", float(self.miss_rate))
        object.__setattr__(self, "shift", float(self.shift))

    @property
    def wrong_alarms(self) -> float:
        """The false alarms of each decision, by Wald's bound."""
        return rate_aimed_at(self.false_alarm_rate)

    @property
    def lower(self) -> float:
        """B, by Wald's bound."""
        return float(np.log(self.miss_rate / (1 - self.wrong_alarms)))

    @property
    def upper(self) -> float:
        """A, by Wald's bound."""
        return float(np.log((1 - self.miss_rate) / self.wrong_alarms))

    @property
    def wald_sample_numbers(self) -> tuple[float, float]:
        """The average sample numbers of one side without and with a fault, by Wald's approximation: no overshoot."""
        a, b, A, B = self.wrong_alarms, self.miss_rate, self.upper, self.lower
        half = self.shift**2 / 2
        return (a * A + (1 - a) * B) / -half, ((1 - b) * A + b * B) / half

    def decisions(self, threshold: float) -> Decisions:
        """Return the error rates and average sample numbers of one side by integral equation, with overshoot."""
        alarms, quiet = self._passage(threshold, -self.shift / 2)
        detections, faulty = self._passage(threshold, self.shift / 2)
        return Decisions(alarms, 1 - detections, quiet, faulty)

    def run_length(self, threshold: float, dimension: int) -> float:
        """Return the mean number of samples to a false alarm from a start."""
        return mean_run_length(self._chain(0.0), self._level(threshold)) / (2 * dimension)

    def delay(self, threshold: float, dimension: int, *, shift: float) -> float:
        """Return the mean number of samples to an alarm from a start, after a step of one residual."""
        sides = [shift, -shift] + [0.0] * (2 * dimension - 2)
        return 1 / sum(run_frequency(self._chain(mean), self._level(threshold)) for mean in sides)

    def cycle(self, threshold: float, dimension: int) -> AlarmCycle:
        """Return the mean lengths of quiet and of false alarms."""
        level, release = self._level(threshold), self._level(self.falls_to * threshold)
        lasting = alarm_cycle(self._chain(0.0), level, release).lasting
        return AlarmCycle(self.run_length(threshold, dimension), lasting)

    def designed(self, dimension: int, rate: float | None = None) -> float:
        """Return A: by Wald's bound, or for a wanted time between alarms, or a fraction of samples in alarm."""
        if self.mean_time_between_false_alarms is None and rate is None:
            return self.upper
        return super().designed(dimension, rate)

    def promise(self, threshold: float, dimension: int) -> tuple[str, float | None]:
        """Describe a threshold by its false alarms, and return the time between them."""
        exact, (text, time) = self.decisions(threshold), super().promise(threshold, dimension)
        return (
            f"{text}; of the decisions on each side of a residual {exact.false_alarm_rate:.2g} false alarms and, with "
            f"a fault of {self.shift:g} deviations, {exact.miss_rate:.2g} misses, after {exact.samples:.3g} and "
            f"{exact.samples_with_fault:.3g} samples on average"
        ), time

    def asked(self, watched: Watched, rows: int = 0) -> float:
        """Return the fraction of fault-free samples in alarm: by rows without a wish, else the design value."""
        if rows and self.mean_time_between_false_alarms is None and self.false_alarm_rate is None:
            return rate_aimed_at(None, rows)
        covariance = watched.generator.covariance_of_sums(1)
        k = watched.generator.n_residuals if covariance is None else moving_directions(covariance)
        return self.cycle(self.designed(k), k).fraction

    @property
    def harmless_offset(self) -> float:
        """A tenth of the shift."""
        return self.shift / 10

    def test(self, **parts: Any) -> SPRTTest:
        """Build the fitted test."""
        return SPRTTest(**parts, shift=self.shift, lower=self.lower)

    def _chain(self, mean: float) -> RatioChain:
        return RatioChain(-self.lower / self.shift, mean - self.shift / 2)

    def _level(self, ratio: float) -> float:
        return (ratio - self.lower) / self.shift

    def _passage(self, threshold: float, mean: float) -> tuple[float, float]:
        """Return the probability that a sum ends over the upper bound, and its mean number of samples."""
        chain, level = RatioChain(-self.lower / self.shift, mean), self._level(threshold)

        def solved(factor: float) -> tuple[float, float]:
            nodes, weights = nodes_of(level, chain.width, factor)
            now = np.concatenate([[0.0], nodes])  # a start, and sums between the bounds
            inside = np.column_stack([np.zeros(len(now)), chain.density(now[:, None], nodes[None, :]) * weights])
            ends = np.linalg.solve(
                np.eye(len(now)) - inside, np.column_stack([chain.above(now, level), np.ones(len(now))])
            )
            return float(ends[0, 0]), float(ends[0, 1])

        what = f"a bound of {threshold:.6g}"
        return settled(lambda factor: solved(factor)[0], what), settled(lambda factor: solved(factor)[1], what)


__all__ = ["SPRT", "Decisions", "RatioChain", "SPRTTest"]
