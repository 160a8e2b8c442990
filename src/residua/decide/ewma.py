"""An exponentially weighted moving average of the residual, of one or of many."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from residua.decide.checks import is_number
from residua.decide.compiled import CompiledTest
from residua.decide.row_norms import row_norms
from residua.decide.run_lengths import AlarmCycle, alarm_cycle, mean_run_length
from residua.decide.stream_settings import StreamSettings
from residua.decide.stream_test import StreamTest
from residua.decide.test import ResidualTest
from residua.decide.vector_run_lengths import LengthChain, shifted_run_length
from residua.errors import SettingError
from residua.number_kinds import PART, NumberKind
from residua.visible import echo


@dataclass(frozen=True, eq=False, kw_only=True)
class EWMATest(StreamTest):
    """Fitted exponentially weighted moving average."""

    NUMBER_KINDS: ClassVar[Mapping[str, NumberKind]] = {**StreamTest.NUMBER_KINDS, "weight": PART}

    weight: float

    def first_sums(self, plants: int) -> NDArray[np.float64]:
        """Return the average before the first sample: zero."""
        return np.zeros((plants, len(self.center)))

    def statistic(
        self, sums: NDArray[np.float64], e: NDArray[np.float64], seen: NDArray[np.bool_]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the length of the average in its own standard deviations."""
        z, old, new = sums, 1 - self.weight, self.weight * e
        averages = np.empty_like(e)
        for k in range(e.shape[1]):
            z = np.where(seen[:, k, None], old * z + new[:, k], z)
            averages[:, k] = z
        return row_norms(averages) / _deviation(self.weight), z

    @property
    def compiled(self) -> CompiledTest | None:
        """Equivalent for the fused loop."""
        if type(self) is not EWMATest:
            return None
        return self.compiled_as("ewma", weight=self.weight, deviation=_deviation(self.weight))

    @property
    def title(self) -> str:
        """Name of the statistic."""
        return f"exponentially weighted moving average (weight {self.weight:g})"

    @property
    def samples(self) -> int:
        """Number of samples that make up most of the average."""
        return int(np.ceil(2 / self.weight - 1))

    @property
    def least_seen(self) -> float:
        """Mean whose average equals the threshold."""
        return self.threshold * _deviation(self.weight)


@dataclass(frozen=True)
class EWMA(StreamSettings):
    r"""Alarm where an exponentially weighted moving average of the residual is too far from zero.

    .. math:: z_k = (1 - \lambda) z_{k-1} + \lambda e_k, \qquad J_k = \sqrt{\frac{2 - \lambda}{\lambda}}\, |z_k| > h

    with the whitened residual :math:`e`; of several residuals this is the multivariate EWMA. It sees small lasting
    changes, and large ones nearly as soon as a test of single samples does. An alarm is over when :math:`J` is at or
    below half the threshold.

    Parameters
    ----------
    weight : float
        :math:`\lambda`, above 0 and at most 1: the smaller, the smaller the changes that it sees best: 0.1 for about
        one standard deviation.
    mean_time_between_false_alarms : float, optional
        In samples, from a start at zero to the alarm, on average. The threshold follows from it by integral equation.
    false_alarm_rate : float, optional
        Where no time is given: the fraction of fault-free samples in alarm, by the same equations. When omitted, one
        that the log of a fit can support; see :class:`residua.decide.NormThreshold`.
    threshold : float, optional
        h, where it is to be neither.
    source : {"auto", "design", "data", "quantile"}
        Where the threshold is from after a fit; see :class:`residua.decide.CUSUM`.
    treatment : {"auto", "none"}
        Whether a fit makes a coloured residual white, by an autoregression, and heavy tails Gaussian, by normal scores.

    See Also
    --------
    residua.decide.CUSUM : Nearly the fastest for a change of a known size.
    residua.decide.NormThreshold : Single samples, or sums over a window.

    Notes
    -----
    Assumes: the fault-free residual is stationary; where the threshold is designed, white and Gaussian too, once
    whitened.

    References
    ----------
    Lucas and Saccucci (1990), Technometrics 32(1); Lowry, Woodall, Champ and Rigdon (1992), Technometrics 34(1).

    Examples
    --------
    >>> import numpy as np
    >>> import residua as rs
    >>> plant = rs.Plant([[0.9]], [[0.1]], [[1.0]], dt=1, inputs=["valve"], outputs=["level"])
    >>> plant = plant.with_sensor_faults().with_noise(process=1e-4, measurement=1e-2)
    >>> test = rs.decide.EWMA(weight=0.1, mean_time_between_false_alarms=500)
    >>> monitor = rs.Monitor(rs.design.kalman_filter(plant), test=test)
    >>> round(monitor.norm_test.threshold, 3)
    2.814
    >>> round(test.run_length(2.814, 1), 1), round(test.delay(2.814, 1, shift=1.0), 1)
    (499.6, 10.3)
    """

    kind: ClassVar[str] = "ewma"
    makes: ClassVar[type[ResidualTest]] = EWMATest
    falls_to: ClassVar[float] = 0.5
    NUMBER_KINDS: ClassVar[Mapping[str, NumberKind]] = {**StreamSettings.NUMBER_KINDS, "weight": PART}

    weight: float = 0.1

    def __post_init__(self) -> None:
        """Check the settings."""
        super().__post_init__()
        if not (is_number(self.weight) and 0 < self.weight <= 1):
            raise SettingError(f"weight must lie above 0 and be at most 1, got {echo(self.weight)}")
        object.__setattr__(self, "weight", float(self.weight))

    def run_length(self, threshold: float, dimension: int) -> float:
        """Return the mean number of samples to a false alarm from a start at zero."""
        return mean_run_length(self._chain(dimension), threshold * _deviation(self.weight))

    def delay(self, threshold: float, dimension: int, *, shift: float) -> float:
        """Return the mean number of samples to an alarm from a start at zero, after a step of so many deviations."""
        return shifted_run_length(self._chain(dimension), threshold * _deviation(self.weight), shift)

    def cycle(self, threshold: float, dimension: int) -> AlarmCycle:
        """Return the mean lengths of quiet and of false alarms."""
        level = threshold * _deviation(self.weight)
        return alarm_cycle(self._chain(dimension), level, self.falls_to * level)

    @property
    def harmless_offset(self) -> float:
        """Two fifths of the deviation of the average."""
        return 0.4 * _deviation(self.weight)

    @property
    def settling(self) -> int:
        """Six times the samples in the average."""
        return int(np.ceil(6 / self.weight))

    def test(self, **parts: Any) -> EWMATest:
        """Build the fitted test."""
        return EWMATest(**parts, weight=self.weight)

    def _chain(self, dimension: int) -> LengthChain:
        return LengthChain(dimension, kept=(1 - self.weight) / self.weight, gain=self.weight)


def _deviation(weight: float) -> float:
    """Return the steady-state standard deviation of the average."""
    return float(np.sqrt(weight / (2 - weight)))


__all__ = ["EWMA", "EWMATest"]
