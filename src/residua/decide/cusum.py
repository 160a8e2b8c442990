"""Cumulative sums of the residual: two-sided for each one, or of all as a vector."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from residua.decide.checks import is_number
from residua.decide.compiled import CompiledTest
from residua.decide.row_norms import row_norms
from residua.decide.run_lengths import AlarmCycle, Chain, alarm_cycle, mean_run_length, run_frequency
from residua.decide.stream_settings import StreamSettings
from residua.decide.stream_test import StreamTest
from residua.decide.test import ResidualTest
from residua.decide.vector_run_lengths import (
    LengthChain,
    delay_of_mc1,
    run_length_of_mc1,
    shifted_run_length,
)
from residua.errors import FileFormatError, SettingError
from residua.number_kinds import POSITIVE, NumberKind
from residua.visible import echo

Form = Literal["auto", "page", "crosier", "pignatiello-runger"]

#: A sum grows to this multiple of its threshold at most, so that an alarm ends soon after its fault.
_FULL = 2.0


@dataclass(frozen=True)
class PageChain(Chain):
    """A one-sided cumulative sum of white Gaussian samples, ``max(0, s + e - allowance)``.

    Attributes
    ----------
    allowance : float
    mean : float
        Of the samples, in deviations.
    """

    allowance: float
    mean: float = 0.0

    def density(self, now: NDArray[np.float64], then: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the density of the next sum."""
        return np.exp(-((then - now - self.mean + self.allowance) ** 2) / 2) / np.sqrt(2 * np.pi)

    def above(self, now: NDArray[np.float64], level: float) -> NDArray[np.float64]:
        """Return the probability that the next sum is above a level."""
        from scipy.special import ndtr

        return ndtr(now + self.mean - self.allowance - level)

    def at_zero(self, now: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the probability that the next sum is zero."""
        from scipy.special import ndtr

        return ndtr(self.allowance - self.mean - now)


@dataclass(frozen=True, eq=False, kw_only=True)
class CUSUMTest(StreamTest):
    """Fitted cumulative sums."""

    NUMBER_KINDS: ClassVar[Mapping[str, NumberKind]] = {**StreamTest.NUMBER_KINDS, "allowance": POSITIVE}

    sums_alarm: ClassVar[bool] = True

    allowance: float
    form: str

    def first_sums(self, plants: int) -> NDArray[np.float64]:
        """Return the sums before the first sample, and whether there is an alarm: zeros."""
        k = len(self.center)
        return np.zeros((plants, 1 + {"page": 2 * k, "crosier": k, "pignatiello-runger": k + 1}[self.form]))

    def statistic(
        self, sums: NDArray[np.float64], e: NDArray[np.float64], seen: NDArray[np.bool_]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the largest sum, or the length of the vector of sums; the end of an alarm restarts the sums."""
        step = {"page": self._page, "crosier": self._crosier, "pignatiello-runger": self._mc1}[self.form]
        if self.form == "page":
            e = np.concatenate([e, -e], axis=-1) - self.allowance
        values, everywhere = np.empty(seen.shape), bool(seen.all())
        now, alarmed = sums[:, :-1], sums[:, -1] > 0
        for k in range(e.shape[1]):
            new, value = step(now, e[:, k])
            values[:, k] = value
            here = True if everywhere else seen[:, k]
            alarmed = np.where(here, alarmed | (value > self.threshold), alarmed)
            if alarmed.any():
                over = alarmed & (value <= self.release) & here
                new, alarmed = np.where(over[:, None], 0.0, new), alarmed & ~over
            now = new if everywhere else np.where(seen[:, k, None], new, now)
        return values, np.hstack([now, alarmed[:, None].astype(float)])

    def _page(self, sums: NDArray, e: NDArray) -> tuple[NDArray, NDArray]:
        new = np.minimum(np.maximum(sums + e, 0.0), _FULL * self.threshold)
        return new, new.max(axis=1)

    def _crosier(self, sums: NDArray, e: NDArray) -> tuple[NDArray, NDArray]:
        new = sums + e
        length = row_norms(new)
        left = np.minimum(np.maximum(length - self.allowance, 0.0), _FULL * self.threshold)
        return new * np.divide(left, length, out=np.zeros_like(left), where=length > 0)[:, None], left

    def _mc1(self, sums: NDArray, e: NDArray) -> tuple[NDArray, NDArray]:
        count = sums[:, -1:] + 1
        total = sums[:, :-1] + e
        length = row_norms(total)
        left = np.maximum(length - self.allowance * count[:, 0], 0.0)
        full = _FULL * self.threshold
        if np.isfinite(full):
            most = full + self.allowance * count[:, 0]
            total = total * np.where(left > full, most / np.where(length > 0, length, 1.0), 1.0)[:, None]
            left = np.minimum(left, full)
        return np.where(left[:, None] > 0, np.hstack([total, count]), 0.0), left

    @property
    def compiled(self) -> CompiledTest | None:
        """Equivalent for the fused loop."""
        return self.compiled_as(self.form, allowance=self.allowance) if type(self) is CUSUMTest else None

    @property
    def title(self) -> str:
        """Name of the statistic."""
        name = {
            "page": "largest cumulative sum of one part",
            "crosier": "length of Crosier's cumulative sum",
            "pignatiello-runger": "length of Pignatiello and Runger's cumulative sum",
        }[self.form]
        return f"{name} (allowance {self.allowance:g})"

    @property
    def samples(self) -> int:
        """Number of samples in which a change of twice the allowance reaches the threshold."""
        return max(1, int(np.ceil(min(self.threshold / self.allowance, 1e9))))

    @property
    def least_seen(self) -> float:
        """Mean that the allowance cancels."""
        return self.allowance

    def check(self, watched: Any) -> None:
        """Raise if a test from a file is invalid."""
        super().check(watched)
        if self.form not in get_args(Form)[1:]:
            raise FileFormatError(f"fitted.form must be one of {', '.join(get_args(Form)[1:])}, got {echo(self.form)}")


@dataclass(frozen=True)
class CUSUM(StreamSettings):
    r"""Alarm when the residual has been off zero for longer than chance explains.

    .. math:: C^\pm_k = \max(0,\; C^\pm_{k-1} \pm e_k - \kappa) > h

    with the whitened residual :math:`e` and the allowance :math:`\kappa = \delta / 2` (``form="page"``, for each
    residual and either side); of several residuals by Crosier's vector of sums,

    .. math:: v_k = s_{k-1} + e_k, \qquad s_k = v_k \max(0,\; 1 - \kappa / |v_k|), \qquad |s_k| > h

    or Pignatiello and Runger's, :math:`\max(0,\; |\sum e| - \kappa n) > h` with the sum over the :math:`n` samples
    since it was last zero. For a change of the known size :math:`\delta` no test with as rare false alarms is faster
    (Moustakides 1986), whenever it comes. An alarm is over when the statistic is at or below half the threshold; the
    sums then start again from zero.

    Parameters
    ----------
    shift : float
        :math:`\delta`: the length of the change to be seen, in standard deviations of the residual.
    mean_time_between_false_alarms : float, optional
        In samples, from a start or the end of an alarm to the next false alarm, on average. The threshold follows
        from it by integral equation.
    false_alarm_rate : float, optional
        Where no time is given: the fraction of fault-free samples in alarm, by the same equations (of Pignatiello and
        Runger's sums about: an alarm is taken to end as its allowance takes it down). When omitted, one that the log of
        a fit can support; see :class:`residua.decide.NormThreshold`.
    threshold : float, optional
        h, instead of both.
    form : {"auto", "page", "crosier", "pignatiello-runger"}
        ``"auto"``: Page's of one residual, Crosier's of several. Page's is best for changes of one residual alone.
    source : {"auto", "design", "data", "quantile"}
        Where the threshold is from after a fit: worlds of the fitted model, each fitted anew; the design, for white
        Gaussian residuals; an order statistic of the data, so that the rate is at most ``false_alarm_rate`` with 95 %
        confidence. ``"data"`` waits for a fit where the noise model of the plant would give a threshold.
    treatment : {"auto", "none"}
        Whether a fit makes a coloured residual white, by an autoregression, and heavy tails Gaussian, by normal scores.

    See Also
    --------
    residua.decide.EWMA : Nearly as fast, for changes of any size.
    residua.decide.NormThreshold : Single samples, or sums over a window.

    Notes
    -----
    Assumes: the fault-free residual is stationary; where the threshold is designed, white and Gaussian too, once
    whitened. Of several residuals Page's sums are counted as independent ones.

    References
    ----------
    Page (1954), Biometrika 41; Crosier (1988), Technometrics 30(3); Pignatiello and Runger (1990), Journal of Quality
    Technology 22(3); Moustakides (1986), Annals of Statistics 14(4).

    Examples
    --------
    >>> import numpy as np
    >>> import residua as rs
    >>> plant = rs.Plant([[0.9]], [[0.1]], [[1.0]], dt=1, inputs=["valve"], outputs=["level"])
    >>> plant = plant.with_sensor_faults().with_noise(process=1e-4, measurement=1e-2)
    >>> test = rs.decide.CUSUM(shift=1.0, mean_time_between_false_alarms=500)
    >>> monitor = rs.Monitor(rs.design.kalman_filter(plant), test=test)
    >>> round(monitor.norm_test.threshold, 3)
    5.071
    >>> round(test.delay(5.071, 1, shift=1.0), 1)
    10.5
    """

    kind: ClassVar[str] = "cusum"
    makes: ClassVar[type[ResidualTest]] = CUSUMTest
    falls_to: ClassVar[float] = 0.5
    NUMBER_KINDS: ClassVar[Mapping[str, NumberKind]] = {**StreamSettings.NUMBER_KINDS, "shift": POSITIVE}

    shift: float = 1.0
    form: str = "auto"

    def __post_init__(self) -> None:
        """Check the settings."""
        super().__post_init__()
        if not (is_number(self.shift) and self.shift > 0):
            raise SettingError(
                f"shift must be a positive number of standard deviations, got {echo(self.shift)}: the change to be seen"
            )
        if self.form not in get_args(Form):
            raise SettingError(f"form must be one of {', '.join(get_args(Form))}, got {echo(self.form)}")
        object.__setattr__(self, "shift", float(self.shift))

    @property
    def allowance(self) -> float:
        """Half the shift."""
        return self.shift / 2

    def run_length(self, threshold: float, dimension: int) -> float:
        """Return the mean number of samples to a false alarm from a start at zero."""
        form = self._form(dimension)
        if form == "page":
            return mean_run_length(PageChain(self.allowance), threshold) / (2 * dimension)
        if form == "crosier":
            return mean_run_length(LengthChain(dimension, allowance=self.allowance), threshold)
        return run_length_of_mc1(self.allowance, dimension, threshold)

    def delay(self, threshold: float, dimension: int, *, shift: float) -> float:
        """Return the mean number of samples to an alarm from a start at zero, after a step of so many deviations.

        Of Page's sums of several residuals: of a step of one of them.
        """
        form = self._form(dimension)
        if form == "page":
            sides = [shift, -shift] + [0.0] * (2 * dimension - 2)
            return 1 / sum(run_frequency(PageChain(self.allowance, mean), threshold) for mean in sides)
        if form == "crosier":
            return shifted_run_length(LengthChain(dimension, allowance=self.allowance), threshold, shift)
        return delay_of_mc1(self.allowance, dimension, threshold, shift)

    def cycle(self, threshold: float, dimension: int) -> AlarmCycle:
        """Return the mean lengths of quiet and of false alarms."""
        form = self._form(dimension)
        if form == "pignatiello-runger":
            lasting = 1 + (1 - self.falls_to) * threshold / self.allowance
        else:
            chain = PageChain(self.allowance) if form == "page" else LengthChain(dimension, allowance=self.allowance)
            lasting = alarm_cycle(chain, threshold, self.falls_to * threshold).lasting
        return AlarmCycle(self.run_length(threshold, dimension), lasting)

    @property
    def harmless_offset(self) -> float:
        """A fifth of the allowance."""
        return self.allowance / 5

    def test(self, **parts: Any) -> CUSUMTest:
        """Build the fitted test."""
        return CUSUMTest(**parts, allowance=self.allowance, form=self._form(len(parts["center"])))

    def _form(self, dimension: int) -> str:
        if self.form != "auto":
            return self.form
        return "page" if dimension == 1 else "crosier"


__all__ = ["CUSUM", "CUSUMTest", "PageChain"]
