"""A threshold on the norm of the residual."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from residua.decide.persistence import alarm_logic
from residua.decide.seams import parts_between
from residua.decide.whitening import residual_moments, whitening_matrix
from residua.decide.window import empty_window, moving_sum
from residua.errors import DataError, SettingError
from residua.visible import echo


@dataclass(frozen=True)
class NormThreshold:
    r"""Alarm while the norm of the whitened residual stays over a threshold.

    .. math:: J_k = \sqrt{\bar q_k^T \bar q_k} > J_{th}, \qquad
       \bar q_k = \frac{1}{\sqrt N} \sum_{i=0}^{N-1} \Sigma_N^{-1/2} (r_{k-i} - \bar r)

    with the covariance :math:`\Sigma_N` of the residual summed over ``N`` samples, divided by ``N``. With a
    window of one sample this is the norm of the whitened residual itself.

    Parameters
    ----------
    threshold : float, optional
        Fitted from fault-free data when omitted (:meth:`residua.Monitor.fit`), or, where the residual's
        covariance is known from the plant's noise, taken from the chi-squared distribution.
    persistence : int
        Samples in a row over the threshold that raise an alarm.
    release : int, optional
        Samples in a row below it that end the alarm; as many as ``persistence`` when omitted.
    window : int
        Samples ``N`` over which the residual is summed. A longer window sees smaller and slower faults, and
        sees large ones no more than that later.
    whiten : {"auto", "data", "model", "none"}
        Whose covariance :math:`\Sigma_N` is used: that of the fault-free data, that of the plant's noise
        model, or the identity. ``"auto"`` takes the data when fitted, else the model, else none.
    false_alarm_rate : float
        Fraction of fault-free samples in alarm that is aimed at, unless ``fit`` is told otherwise.

    References
    ----------
    Chen, Patton and Zhang (1996), eq. (24).
    """

    threshold: float | None = None
    persistence: int = 3
    release: int | None = None
    window: int = 1
    whiten: str = "auto"
    false_alarm_rate: float = 1e-4

    def __post_init__(self) -> None:
        """Check the settings."""
        if self.threshold is not None and not (is_number(self.threshold) and self.threshold > 0):
            raise SettingError(f"threshold must be a positive number, got {echo(self.threshold)}")
        for name in ("persistence", "window"):
            check_samples(getattr(self, name), name)
        if self.release is not None:
            check_samples(self.release, "release")
        if self.whiten not in ("auto", "data", "model", "none"):
            raise SettingError(f"whiten must be 'auto', 'data', 'model' or 'none', got {echo(self.whiten)}")
        check_rate(self.false_alarm_rate)
        for name in ("persistence", "release", "window"):  # plain numbers, whatever they came as
            value = getattr(self, name)
            object.__setattr__(self, name, None if value is None else int(value))
        for name in ("threshold", "false_alarm_rate"):
            value = getattr(self, name)
            object.__setattr__(self, name, None if value is None else float(value))


def is_number(value: object) -> bool:
    """Tell whether a setting is one finite number."""
    return isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool) and isfinite(value)


def check_samples(value: object, name: str, *, least: int = 1) -> None:
    """Raise unless a setting is a whole number of samples."""
    if not is_number(value) or int(value) != value or value < least:  # pyright: ignore
        raise SettingError(f"{name} must be a whole number of samples, at least {least}, got {echo(value)}")


def check_rate(rate: float) -> None:
    """Raise unless ``rate`` is a usable false alarm rate."""
    if not is_number(rate) or not 0 < rate < 1:
        raise SettingError(f"false_alarm_rate must lie between 0 and 1, got {echo(rate)}")


@dataclass(frozen=True, eq=False)
class NormTest:
    """A norm threshold with every number filled in: what runs.

    Attributes
    ----------
    center : ndarray, shape (k,)
        Fault-free mean.
    whitening : ndarray, shape (k, k)
    threshold : float
    persistence, release, window : int
    basis : str
        Where threshold and covariance come from, in words.
    kind : {"norm", "peak"}
        What it was made of: :class:`NormThreshold`, or :class:`residua.decide.PeakThreshold`, whose window is
        ``release``.
    """

    center: NDArray[np.float64]
    whitening: NDArray[np.float64]
    threshold: float
    persistence: int
    release: int
    window: int
    basis: str
    kind: str = "norm"

    @property
    def band(self) -> NDArray[np.float64]:
        """How far each residual alone, averaged over the window, can be from its mean below threshold."""
        inverse = np.linalg.pinv(self.whitening)
        return self.threshold * np.sqrt(np.sum(inverse**2, axis=0) / self.window)


def norm_test_from_model(settings: NormThreshold, covariance: NDArray | None, n_residuals: int) -> NormTest | None:
    """Return the test that needs no data, or ``None`` when data are needed."""
    use_model = settings.whiten in ("auto", "model") and covariance is not None
    whitening = whitening_matrix(covariance) if use_model and covariance is not None else np.eye(n_residuals)
    if settings.threshold is not None:
        threshold, basis = settings.threshold, "threshold given"
    elif use_model:
        from scipy.special import chdtri  # slow to import, and needed only here

        threshold = float(np.sqrt(chdtri(n_residuals, settings.false_alarm_rate)))
        basis = f"chi-squared distribution at {settings.false_alarm_rate:g} per sample, noise model of the plant"
    else:
        return None
    release = settings.release or settings.persistence
    return NormTest(np.zeros(n_residuals), whitening, threshold, settings.persistence, release, settings.window, basis)


def fit_norm_test(
    settings: NormThreshold,
    residuals: NDArray[np.float64],
    usable: NDArray[np.bool_],
    *,
    false_alarm_rate: float,
    covariance: NDArray | None,
    signal_size: float,
    seams: Sequence[int] = (),
) -> NormTest:
    """Fit mean, covariance and threshold to fault-free residuals.

    The threshold is the smallest for which the fraction of usable samples in alarm, persistence and release
    included, is at most ``false_alarm_rate``. Where fewer than ten samples would be left in alarm, the data
    cannot tell: the threshold for ten is then extended by the exponential tail of the data.

    Parameters
    ----------
    settings : NormThreshold
    residuals : ndarray, shape (time, k)
    usable : ndarray of bool, shape (time,)
    false_alarm_rate : float
    covariance : ndarray or None
        From the plant's noise model, of sums over the window.
    signal_size : float
        Size of the signals that the residual is the difference of; residuals below 1e-12 of it are rounding.
    seams : sequence of int
        The first sample of each further recording, where there are several in a row.

    Returns
    -------
    NormTest
    """
    check_rate(false_alarm_rate)
    rows = residuals[usable]
    k = residuals.shape[1]
    check_enough(len(rows), k, settings.window)
    mean, spread = residual_moments(rows)
    if settings.window > 1:
        _, spread = residual_moments(_sums(residuals - mean, usable, settings.window, seams)[usable])
    source = covariance if settings.whiten == "model" and covariance is not None else spread
    rounding = 1e-12 * signal_size
    noise_free = bool(np.sqrt(np.trace(spread)) <= rounding)
    if settings.whiten == "none" or noise_free:
        whitening = np.eye(k)
    else:
        whitening = whitening_matrix(source)
    release = settings.release or settings.persistence
    test = NormTest(mean, whitening, np.inf, settings.persistence, release, settings.window, "")
    if settings.threshold is not None:
        return replace(test, threshold=settings.threshold, basis="threshold given, mean and covariance fitted")
    statistic = np.linalg.norm(_sums((residuals - mean) @ whitening, usable, settings.window, seams), axis=1)
    fitted, basis = fitted_threshold(statistic, usable, test, false_alarm_rate, seams=seams)
    if noise_free:
        fitted, basis = above_rounding(fitted, rounding, basis)
    return replace(test, threshold=float(fitted), basis=basis)


def above_rounding(threshold: float, rounding: float, basis: str) -> tuple[float, str]:
    """Return a threshold fitted to data without noise, raised to the rounding of the signals, and its basis."""
    told = f"{basis}; no noise in these data: the threshold is at rounding level"
    return max(threshold, rounding, np.finfo(float).tiny), told


def check_enough(samples: int, k: int, window: int) -> None:
    """Raise unless there are enough usable samples to fit the threshold of ``k`` residuals."""
    least = max(10 * k, 30, 10 * window)
    if samples < least:
        raise DataError(
            f"{samples} usable samples are too few to fit {k} residuals with a window of {window}: give at "
            f"least {least} fault-free samples after the filter has settled"
        )


def fitted_threshold(
    statistic: NDArray,
    usable: NDArray[np.bool_],
    test: NormTest,
    false_alarm_rate: float,
    *,
    least: int = 10,
    seams: Sequence[int] = (),
) -> tuple[float, str]:
    """Return the smallest threshold with at most a rate of false alarms on fault-free samples, and its basis in words.

    Where fewer than ``least`` samples would be left in alarm, that for so many is extended by the tail of the data.
    """
    count = int(usable.sum())
    seen_rate = max(false_alarm_rate, min(0.2, least / count))
    fitted = _smallest_threshold(statistic, usable, test, seen_rate, seams)
    basis = f"fitted to {count} fault-free samples, at most {false_alarm_rate:g} of them in alarm"
    if seen_rate > false_alarm_rate:
        decay = _tail_decay(statistic, usable, test.persistence, seams)
        extended = float(np.sqrt(fitted**2 + decay * np.log(seen_rate / false_alarm_rate)))
        fitted = max(extended, _smallest_threshold(statistic, usable, test, false_alarm_rate, seams))
        basis += f" (too few to see that: extended from a rate of {seen_rate:.2g} by the tail of the data)"
    return fitted, basis


def _sums(residuals: NDArray, usable: NDArray[np.bool_], window: int, seams: Sequence[int]) -> NDArray[np.float64]:
    """Return the sums over the window, divided by its square root."""
    counted = np.where(usable[:, None], residuals, 0.0)[None]
    empty = empty_window(1, window, residuals.shape[1])
    sums = [moving_sum(counted[:, part], empty)[0][0] for part in parts_between(len(usable), seams)]
    return np.concatenate(sums) / np.sqrt(window)


def _smallest_threshold(
    statistic: NDArray, usable: NDArray, test: NormTest, rate: float, seams: Sequence[int]
) -> float:
    """Return the smallest threshold that keeps the fraction of samples in alarm at ``rate`` (bisection)."""
    levels = np.unique(statistic[usable])
    zero, off = np.zeros(1, dtype=np.int64), np.zeros(1, dtype=bool)
    parts = parts_between(len(usable), seams)

    def fraction(threshold: float) -> float:
        over, count = (statistic > threshold)[None], 0
        for part in parts:
            there = usable[None, part]
            alarm, _, _ = alarm_logic(over[:, part], there, zero, zero, off, test.persistence, test.release)
            count += int((alarm & there).sum())
        return float(count / usable.sum())

    low, high = 0, len(levels) - 1  # no sample is over the highest level
    while low < high:
        middle = (low + high) // 2
        if fraction(levels[middle]) <= rate:
            high = middle
        else:
            low = middle + 1
    above = levels[low + 1] if low + 1 < len(levels) else levels[low] * (1 + 1e-6)
    return float(levels[low] + 0.5 * (above - levels[low]))


def _tail_decay(statistic: NDArray, usable: NDArray, persistence: int, seams: Sequence[int]) -> float:
    """Return the scale of the exponential tail of the squared statistic, persistence taken into account.

    An alarm needs the statistic over the threshold ``persistence`` times in a row, so the tail of the smallest
    of as many is what counts; that of a squared Gaussian norm is exponential.
    """
    pieces = [statistic[part][usable[part]] ** 2 for part in parts_between(len(usable), seams)]
    view = np.lib.stride_tricks.sliding_window_view
    lowest = [view(piece, persistence).min(axis=1) for piece in pieces if len(piece) >= persistence]
    if not lowest:
        return 0.0
    lowest = np.concatenate(lowest)
    level = float(np.quantile(lowest, 0.95))
    above = lowest[lowest > level]
    return float(np.mean(above - level)) if above.size else 0.0
