"""Test of Page and Hinkley: cumulative deviations of the residual from its own running mean."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from residua.decide.checks import is_number
from residua.decide.cusum import CUSUM, PageChain
from residua.decide.run_lengths import NEARLY, AlarmCycle, alarm_cycle, nodes_of, settled
from residua.decide.stream_settings import StreamSettings
from residua.decide.stream_test import StreamTest
from residua.decide.test import ResidualTest
from residua.errors import SettingError
from residua.number_kinds import POSITIVE, NumberKind
from residua.visible import echo

#: A sum grows to this multiple of its threshold at most, so that an alarm ends soon after its fault.
_FULL = 2.0
#: Samples of which each has a variance of its own in the integral equation, and after which it counts as one.
_EACH, _LAST = 64, 4096


@dataclass(frozen=True, eq=False, kw_only=True)
class PageHinkleyTest(StreamTest):
    """Fitted test of Page and Hinkley."""

    NUMBER_KINDS: ClassVar[Mapping[str, NumberKind]] = {**StreamTest.NUMBER_KINDS, "drift": POSITIVE}

    drift: float

    def first_sums(self, plants: int) -> NDArray[np.float64]:
        """Return sums on both sides, the mean, the number of samples, and whether there is an alarm: zeros."""
        return np.zeros((plants, 3 * len(self.center) + 2))

    def statistic(
        self, sums: NDArray[np.float64], e: NDArray[np.float64], seen: NDArray[np.bool_]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the largest sum; the end of an alarm restarts the sums and the mean."""
        k = e.shape[2]
        values, full = np.empty(seen.shape), _FULL * self.threshold
        now, mean, count, alarmed = sums[:, : 2 * k], sums[:, 2 * k : 3 * k], sums[:, -2], sums[:, -1] > 0
        for t in range(e.shape[1]):
            here = seen[:, t]
            counting = here & ~alarmed  # the mean stands still in an alarm, or it would take the fault for normal
            count = count + counting
            mean = np.where(counting[:, None], mean + (e[:, t] - mean) / np.maximum(count, 1.0)[:, None], mean)
            off = e[:, t] - mean
            new = np.minimum(np.maximum(now + np.hstack([off, -off]) - self.drift, 0.0), full)
            values[:, t] = value = new.max(axis=1)
            alarmed = alarmed | (here & (value > self.threshold))
            over = alarmed & here & (value <= self.release)
            now = np.where(over[:, None], 0.0, np.where(here[:, None], new, now))
            mean, count = np.where(over[:, None], 0.0, mean), np.where(over, 0.0, count)
            alarmed = alarmed & ~over
        return values, np.hstack([now, mean, count[:, None], alarmed[:, None].astype(float)])

    @property
    def title(self) -> str:
        """Name of the statistic."""
        return f"largest cumulative deviation from the mean so far (drift allowed {self.drift:g})"

    @property
    def samples(self) -> int:
        """Number of samples in which a change of twice the allowed drift reaches the threshold."""
        return max(1, int(np.ceil(min(self.threshold / self.drift, 1e9))))

    @property
    def least_seen(self) -> float:
        """Change of the mean that the allowed drift cancels."""
        return self.drift


@dataclass(frozen=True)
class PageHinkley(StreamSettings):
    r"""Alarm when the residual leaves its running mean, whatever that is.

    .. math:: m_k = \frac1k \sum_{i=1}^k e_i, \qquad U^\pm_k = \sum_{i=1}^{k} (\pm (e_i - m_i) - \delta), \qquad
              U^\pm_k - \min_{i \le k} U^\pm_i > h

    with each whitened residual :math:`e`, on both sides. A :class:`~residua.decide.CUSUM` measures from the mean of
    fault-free data; this test from the mean of the stream itself since its start, so that a constant offset that the
    fit has not seen (another operating point, a sensor's bias) raises no alarm, and few fault-free samples suffice. The
    price: a fault that is there from the first sample is not seen, and one that comes soon after it is seen late; the
    slower it grows, the more of it the mean takes up. In an alarm the mean stands still. An alarm is over when the
    statistic is at or below half the threshold; mean and sums then start again.

    Parameters
    ----------
    drift : float
        :math:`\delta`: the drift that is allowed, in standard deviations a sample: half of the change to be seen.
    mean_time_between_false_alarms : float, optional
        In samples, from a start or the end of an alarm to the next false alarm, on average. The threshold follows
        from it by integral equation.
    false_alarm_rate : float, optional
        Where no time is given: the fraction of fault-free samples in alarm, by the same equations; at most 0.02, since
        sooner after a start the mean is not known well enough for an alarm to end as it should. When omitted, one that
        the log of a fit can support; see :class:`residua.decide.NormThreshold`.
    threshold : float, optional
        h, where it is to be neither.
    source : {"auto", "design", "data", "quantile"}
        Where the threshold is from after a fit; see :class:`residua.decide.CUSUM`.
    treatment : {"auto", "none"}
        Whether a fit makes a coloured residual white, by an autoregression, and heavy tails Gaussian, by normal scores.

    See Also
    --------
    residua.decide.CUSUM : With a known mean of the fault-free residual: also detects faults present from the start.
    residua.decide.SPRT : With the rate of misses designed as well.

    Notes
    -----
    White Gaussian samples of any mean less their running mean are independent, with a known variance,

    .. math:: e_k - m_k = \sqrt{1 - 1/k}\; w_k, \qquad w_k \sim N(0, 1) \text{ independent}

    so that the run length of either side is that of a Markov chain whose steps grow to unit variance, by integral
    equation. Both sides of all residuals are counted as independent ones.

    Assumes: the fault-free residual is stationary but for its mean from one start to the next; where the threshold is
    designed, white and Gaussian too, once whitened.

    References
    ----------
    Page (1954), Biometrika 41; Hinkley (1971), Biometrika 58(3); Brown, Durbin and Evans (1975), Journal of the Royal
    Statistical Society B 37(2), for the independence of these deviations.

    Examples
    --------
    >>> import residua as rs
    >>> test = rs.decide.PageHinkley(drift=0.5, mean_time_between_false_alarms=500)
    >>> h = test.designed(1)
    >>> round(h, 2), round(test.run_length(h, 1))
    (5.02, 500)
    """

    kind: ClassVar[str] = "page-hinkley"
    makes: ClassVar[type[ResidualTest]] = PageHinkleyTest
    falls_to: ClassVar[float] = 0.5
    largest_fraction: ClassVar[float] = 0.02
    NUMBER_KINDS: ClassVar[Mapping[str, NumberKind]] = {**StreamSettings.NUMBER_KINDS, "drift": POSITIVE}

    drift: float = 0.5

    def __post_init__(self) -> None:
        """Check the settings."""
        super().__post_init__()
        if not (is_number(self.drift) and self.drift > 0):
            raise SettingError(
                f"drift must be a positive number of standard deviations, got {echo(self.drift)}: half of the change "
                "to be seen"
            )
        object.__setattr__(self, "drift", float(self.drift))

    def run_length(self, threshold: float, dimension: int) -> float:
        """Return the mean number of samples to a false alarm from a start."""
        return _run_length(self.drift, float(threshold), 2 * dimension)

    def delay(self, threshold: float, dimension: int, *, shift: float) -> float:
        """Return the mean number of samples to an alarm, after a step of one residual by so many deviations.

        From sums at zero, with the mean known as well as after a long time without a fault.
        """
        return CUSUM(shift=2 * self.drift, form="page").delay(threshold, dimension, shift=shift)

    def cycle(self, threshold: float, dimension: int) -> AlarmCycle:
        """Return the mean lengths of quiet and of false alarms."""
        lasting = alarm_cycle(PageChain(self.drift), threshold, self.falls_to * threshold).lasting
        return AlarmCycle(self.run_length(threshold, dimension), lasting)

    @property
    def harmless_offset(self) -> float:
        """One standard deviation, since the mean of the stream itself counts."""
        return 1.0

    def test(self, **parts: Any) -> PageHinkleyTest:
        """Build the fitted test."""
        return PageHinkleyTest(**parts, drift=self.drift)


@lru_cache(maxsize=256)
def _run_length(drift: float, threshold: float, sides: int) -> float:
    r"""Return the mean number of samples until one of several sides exceeds its threshold, from a start without a mean.

    .. math:: L = \sum_{k \ge 0} S_k^{2m}, \qquad S_k = P(\text{one side has not exceeded it by sample } k)

    of m residuals, forwards by the equation of step k, with its deviation :math:`\sqrt{1 - 1/k}`, and as an exponential
    beyond the samples after which it counts as one.
    """
    what = f"a threshold of {threshold:.6g}"
    return settled(lambda factor: _summed(drift, threshold, sides, factor), what, NEARLY)


def _summed(drift: float, threshold: float, sides: int, factor: float) -> float:
    nodes, weights = nodes_of(threshold, 0.7, factor)  # the smallest deviation of a step that may go up
    values = np.concatenate([[0.0], nodes])
    now, total = np.zeros(len(values)), 2.0  # before the first sample, and after it: it is its own mean
    now[0] = 1.0
    edges = [*range(2, _EACH), *np.unique(np.geomspace(_EACH, _LAST, 60).astype(int)).tolist()]
    for start, stop in pairwise(edges):
        steps = _steps(drift, values, nodes, weights, np.sqrt(1 - 2 / (start + stop - 1)))
        for _ in range(stop - start):
            now = now @ steps
            total += max(float(now.sum()), 0.0) ** sides
    left = float(now.sum())
    if left**sides <= np.finfo(float).eps * total:
        return total
    steady = np.eye(len(values)) - _steps(drift, values, nodes, weights, 1.0)
    rate = left / float(now @ np.linalg.solve(steady, np.ones(len(values))))
    return total + left**sides * (1 / -np.expm1(sides * np.log1p(-rate)) - 1)


def _steps(
    drift: float, values: NDArray[np.float64], nodes: NDArray[np.float64], weights: NDArray[np.float64], size: float
) -> NDArray[np.float64]:
    """Return the transition weights of the sums on the grid, for steps of a deviation."""
    from scipy.special import ndtr

    z = (nodes[None, :] - values[:, None] + drift) / size
    density = np.exp(-(z**2) / 2) / (np.sqrt(2 * np.pi) * size)
    return np.column_stack([ndtr((drift - values) / size), density * weights])


__all__ = ["PageHinkley", "PageHinkleyTest"]
