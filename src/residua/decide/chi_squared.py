"""The sum of squares of the last residuals, whose distribution is known exactly."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from residua.decide.checks import check_samples, rate_aimed_at
from residua.decide.compiled import CompiledTest
from residua.decide.recent_samples import Sums, over_recent
from residua.decide.row_norms import row_squares
from residua.decide.run_lengths import AlarmCycle
from residua.decide.stream_settings import StreamSettings
from residua.decide.stream_test import StreamTest
from residua.decide.test import ResidualTest
from residua.errors import SettingError
from residua.number_kinds import WINDOW, NumberKind
from residua.words import one_in


@dataclass(frozen=True, eq=False, kw_only=True)
class ChiSquaredTest(StreamTest):
    """Fitted sum of squares."""

    NUMBER_KINDS: ClassVar[Mapping[str, NumberKind]] = {**StreamTest.NUMBER_KINDS, "window": WINDOW}

    window: int

    def first_sums(self, plants: int) -> NDArray[np.float64]:
        """Return the squares before the first sample: zero."""
        return np.zeros((plants, self.window - 1, 1))

    def statistic(
        self, sums: NDArray[np.float64], e: NDArray[np.float64], seen: NDArray[np.bool_]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the root of the sum of squares over the window."""
        return over_recent(sums, row_squares(e)[..., None], seen, _root_of_last)

    @property
    def compiled(self) -> CompiledTest | None:
        """Equivalent for the fused loop."""
        return self.compiled_as("chi-squared", window=self.window) if type(self) is ChiSquaredTest else None

    @property
    def title(self) -> str:
        """Name of the statistic."""
        return f"root of the sum of squares over {self.window} samples" if self.window > 1 else "length"

    @property
    def samples(self) -> int:
        """Length of the window."""
        return self.window

    @property
    def least_seen(self) -> float:
        """Mean whose sum of squares equals the threshold without noise."""
        return self.threshold / np.sqrt(self.window)


@dataclass(frozen=True)
class ChiSquared(StreamSettings):
    r"""Alarm while the sum of squares of the last residuals is too large.

    .. math:: J_k^2 = \sum_{i=0}^{N-1} |e_{k-i}|^2 \sim \chi^2(m N), \qquad J_k > h

    with ``m`` whitened residuals :math:`e`. It sees changes of the mean in any direction and of the size of the noise;
    changes of the mean that last are seen sooner by the norm of the sum (:class:`residua.decide.NormThreshold`).

    Parameters
    ----------
    window : int
        N, in samples.
    false_alarm_rate : float, optional
        The fraction of fault-free samples in alarm; the threshold follows from it exactly. When omitted, one that the
        log of a fit can support; see :class:`residua.decide.NormThreshold`.
    mean_time_between_false_alarms : float, optional
        In samples, for a window of one sample, where it is the inverse of that fraction.
    threshold : float, optional
        h, where it is to be neither.
    source : {"auto", "design", "data", "quantile"}
        Where the threshold is from after a fit; see :class:`residua.decide.CUSUM`.
    treatment : {"auto", "none"}
        Whether a fit makes a coloured residual white, by an autoregression, and heavy tails Gaussian, by normal scores.

    See Also
    --------
    residua.decide.NormThreshold : The norm of the sum over a window.
    residua.decide.GLR : The largest of such norms, over all windows up to a length.

    Notes
    -----
    Assumes: the fault-free residual is stationary; where the threshold is designed, white and Gaussian too, once
    whitened.

    References
    ----------
    Willsky (1976), Automatica 12(6), 601-611, section 5 (the weighted sum-squared residual).

    Examples
    --------
    >>> import residua as rs
    >>> round(rs.decide.ChiSquared(false_alarm_rate=0.01).designed(2) ** 2, 6)
    9.21034
    """

    kind: ClassVar[str] = "chi-squared"
    makes: ClassVar[type[ResidualTest]] = ChiSquaredTest
    falls_to: ClassVar[float] = 1.0
    origin: ClassVar[str] = "by the chi-squared distribution"
    NUMBER_KINDS: ClassVar[Mapping[str, NumberKind]] = {**StreamSettings.NUMBER_KINDS, "window": WINDOW}

    window: int = 1

    def __post_init__(self) -> None:
        """Check the settings."""
        super().__post_init__()
        check_samples(self.window, "window")
        object.__setattr__(self, "window", int(self.window))
        if self.mean_time_between_false_alarms is not None and self.window > 1:
            raise SettingError(
                "of a sum of squares over several samples the fraction in alarm is known exactly, the time between "
                "alarms is not: give false_alarm_rate instead of mean_time_between_false_alarms, or window=1"
            )

    def designed(self, dimension: int, rate: float | None = None) -> float:
        """Return the threshold for a fraction of samples in alarm."""
        from scipy.special import chdtri

        time = self.mean_time_between_false_alarms
        if rate is None:
            rate = rate_aimed_at(self.false_alarm_rate) if time is None else 1 / time
        return float(np.sqrt(chdtri(dimension * self.window, rate)))

    def run_length(self, threshold: float, dimension: int) -> float:
        """Return the mean number of samples to a false alarm, of single samples."""
        if self.window > 1:
            raise SettingError(
                "of a sum of squares over several samples the fraction in alarm is known (fraction), the time between "
                "alarms is not: window=1"
            )
        return 1 / self.fraction(threshold, dimension)

    def fraction(self, threshold: float, dimension: int) -> float:
        """Return the fraction of samples over a threshold."""
        from scipy.special import chdtrc

        return float(chdtrc(dimension * self.window, threshold**2))

    def power(self, threshold: float, dimension: int, *, shift: float) -> float:
        """Return the probability that a full window is over the threshold, after a step of so many deviations."""
        from scipy.special import chndtr

        return float(1 - chndtr(threshold**2, dimension * self.window, self.window * shift**2))

    def cycle(self, threshold: float, dimension: int) -> AlarmCycle:
        """Return the mean lengths of quiet and of false alarms, for single samples."""
        share = self.fraction(threshold, dimension)
        return AlarmCycle(1 / share, 1 / (1 - share))

    @property
    def counted_samples(self) -> int:
        """Length of the window."""
        return self.window

    @property
    def harmless_offset(self) -> float:
        """Half a standard deviation, since its square counts."""
        return 0.5

    def test(self, **parts: Any) -> ChiSquaredTest:
        """Build the fitted test."""
        return ChiSquaredTest(**parts, window=self.window)

    def promise(self, threshold: float, dimension: int) -> tuple[str, float | None]:
        """Describe a threshold by its false alarms, and return the time between them where it is known."""
        share = self.fraction(threshold, dimension)
        text = f"{one_in(share)} samples in alarm"
        return text, (1 / share if self.window == 1 else None)


def _root_of_last(sums: Sums) -> NDArray[np.float64]:
    """Return the root of the longest sum."""
    total = None
    for one in sums:
        total = one
    assert total is not None  # a window has at least one sample
    return np.sqrt(total[..., 0])


__all__ = ["ChiSquared", "ChiSquaredTest"]
