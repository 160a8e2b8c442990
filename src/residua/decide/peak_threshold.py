"""The finite-horizon test: a fault is declared while the largest residual of a moving window is over a threshold."""

from __future__ import annotations

import reprlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import SupportsFloat

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.decide.norm_threshold import check_rate, check_samples, is_number
from residua.decide.row_norms import row_norms
from residua.errors import DataError, SettingError

#: Characters up to which an error repeats what was given.
_LONGEST = 80


@dataclass(frozen=True)
class PeakThreshold:
    r"""Alarm while the largest norm of the residual over a moving window is over a threshold.

    .. math:: \max_{N_0 \le k \le N} |r(k)|_2 > J_{th}

    at sample :math:`N`, over the last ``window`` samples :math:`N_0 = N - window + 1` to :math:`N`. The residual is
    neither centred nor whitened: a threshold that a design has certified is a bound of :math:`|r|_2` itself.

    Guaranteed: if :math:`|r(k)|_2 \le J_{th}` for every fault-free run, as a certified threshold promises for all
    disturbances :math:`|w(k)|_2 \le 1` and all plants of the uncertainty set, there is no false alarm, not one.

    A monitor runs it as the alarm logic of :class:`residua.decide.NormThreshold` with ``persistence=1`` and
    ``release=window``, which is the same test. One sample over the threshold raises the alarm, and it ends at the
    ``window``-th sample in a row that is not over it. So if any of the last ``window`` samples is over, the last
    such raised the alarm, and fewer than ``window`` not over have followed: it stands. If none is, either the last of
    them has ended it, or it never was raised. The maximum needs no memory of its own, and streamed samples give the
    same bits as a whole recording.

    Assumes that the filter has settled: a certified threshold holds from an initial error of zero, or once the
    transient of the start has decayed (``Monitor(settle=...)``). Samples that are not judged, because values are
    missing or the filter settles again, are no part of the window: it holds the last ``window`` judged samples and
    reaches further back in time over a gap. Meanwhile an alarm neither begins nor ends.

    Parameters
    ----------
    thresholds : float, mapping of str to float, or sequence of float, optional
        :math:`J_{th}` in the unit of the residual: one number for all members of a bank, or for a residual that is
        tested as a whole; by name of the member; or in the order of the members. A number is whatever ``float`` takes
        as one, a :class:`residua.design.CertifiedThreshold` as well: the outcome of
        :func:`residua.design.certified_thresholds` may be given as it is. When omitted, those that the design
        has certified (its ``thresholds``); without any, fitted to fault-free data (:meth:`residua.Monitor.fit`).
    window : int
        Samples of the window, the last one included.
    false_alarm_rate : float
        Fraction of fault-free samples in alarm that is aimed at where thresholds are fitted; given and certified
        thresholds are not changed by it.

    Raises
    ------
    SettingError
        If a threshold is not a positive number, or the window is not a positive number of samples.

    References
    ----------
    Robust l1 fault detection, eq. (49); the thresholds: eqs. (41)-(48).

    Examples
    --------
    >>> import numpy as np
    >>> import residua as rs
    >>> plant = rs.Plant([[0.9]], [[0.1]], [[1.0]], dt=1, inputs=["valve"], outputs=["level"]).with_sensor_faults()
    >>> observer = rs.design.detection_filter(plant, poles=[0.5])
    >>> monitor = rs.Monitor(observer, test=rs.decide.PeakThreshold(0.25, window=60))
    >>> y = np.ones((200, 1))
    >>> y[100] += 1.0
    >>> found = monitor.run(np.ones((200, 1)), y)
    >>> print([(alarm.raised, alarm.ended) for alarm in found.alarms])
    [(100.0, 161.0)]
    """

    thresholds: SupportsFloat | Mapping[str, SupportsFloat] | Sequence[SupportsFloat] | None = None
    window: int = 60
    false_alarm_rate: float = 1e-4

    def __post_init__(self) -> None:
        """Check the settings."""
        object.__setattr__(self, "thresholds", _checked(self.thresholds))
        check_samples(self.window, "window")
        check_rate(self.false_alarm_rate)
        object.__setattr__(self, "window", int(self.window))
        object.__setattr__(self, "false_alarm_rate", float(self.false_alarm_rate))

    def for_members(self, members: Sequence[str]) -> tuple[float, ...] | None:
        """Return the threshold of every member, or the one of a residual without members; ``None`` where none is given.

        Raises
        ------
        SettingError
            If they are not one for each.
        """
        given = self.thresholds
        if given is None:
            return None
        if not isinstance(given, (Mapping, Sequence)):
            return (float(given),) * max(1, len(members))
        if (not members and len(given) > 1) or (isinstance(given, Mapping) and not members):
            raise SettingError(
                "thresholds one by one are for the members of a bank that is read by code, isolate=Structured(); "
                "here the residual is tested as a whole: give one number (of a design with one member, float() of its)"
            )
        if isinstance(given, Mapping):
            missing, unknown = [m for m in members if m not in given], [m for m in given if m not in members]
            if missing or unknown:
                raise SettingError(
                    f"thresholds must name each member once: {', '.join(map(repr, members))}; "
                    + "; ".join(
                        f"{what} {', '.join(map(repr, names))}"
                        for what, names in (("missing", missing), ("unknown", unknown))
                        if names
                    )
                )
            return tuple(float(given[name]) for name in members)
        if len(given) != max(1, len(members)):
            raise SettingError(
                f"expected {len(members)} thresholds, one for each of {', '.join(map(repr, members))}, got {len(given)}"
            )
        return tuple(map(float, given))


def _checked(given: object) -> float | dict[str, float] | tuple[float, ...] | None:
    """Return thresholds as plain values."""
    if given is None:
        return None
    if isinstance(given, Mapping):
        found: float | dict[str, float] | tuple[float, ...] = {
            str(name): _positive(value, f"the threshold of {_short(name)}") for name, value in given.items()
        }
    elif isinstance(given, (Sequence, np.ndarray)) and not isinstance(given, str) and np.ndim(given) == 1:
        found = tuple(_positive(value, f"threshold {k + 1}") for k, value in enumerate(given))
    else:
        return _positive(given, "the threshold")
    if not found:
        raise SettingError("thresholds is empty: give one per member, one number for all, or leave it out")
    return found


def _positive(value: object, what: str) -> float:
    """Return a threshold as a number; what a design has certified is one."""
    one = isinstance(value, SupportsFloat) and not isinstance(value, (bool, np.bool_)) and np.size(value) == 1  # type: ignore[arg-type]
    number = float(value) if one else np.nan  # type: ignore[arg-type]
    if not (is_number(number) and number > 0):
        raise SettingError(f"{what} must be a positive finite number, got {_short(value)}")
    return number


def _short(value: object) -> str:
    """Return what was given, in a line."""
    text = " ".join(reprlib.repr(value).split())
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}... ({type(value).__name__})"


def peak_over_window(residuals: ArrayLike, window: int = 60) -> NDArray[np.float64]:
    r"""Return the largest norm of the residual over a moving window: what :class:`PeakThreshold` compares.

    .. math:: p(N) = \max_{N - window < k \le N} |r(k)|_2

    over the last ``window`` usable samples. A monitor with :class:`PeakThreshold` is in alarm at a sample if and only
    if this is over the threshold there, to the last bit, provided that the samples that it does not judge are NaN.
    The work does not grow with the window (van Herk's algorithm: the maxima from either end of blocks of one window).

    Parameters
    ----------
    residuals : array_like, shape (time, residuals) or (time,)
        NaN where a sample is not usable.
    window : int

    Returns
    -------
    ndarray, shape (time,)
        At a sample that is not usable that of the usable one before; NaN before the first of them.

    Raises
    ------
    DataError
        If the residuals are not one or two-dimensional.
    SettingError
        If the window is not a positive number of samples.

    References
    ----------
    Robust l1 fault detection, eq. (49); van Herk (1992), Pattern Recognition Letters 13(7), 517-521.

    Examples
    --------
    >>> from residua.decide import peak_over_window
    >>> peak_over_window([0.0, 3.0, float("nan"), -1.0, 2.0, 0.5], window=2)
    array([0., 3., 3., 3., 2., 2.])
    """
    check_samples(window, "window")
    rows = np.asarray(residuals, dtype=float)
    rows = rows[:, None] if rows.ndim == 1 else rows
    if rows.ndim != 2:
        raise DataError(f"residuals must be (time, residuals), got shape {rows.shape}")
    usable = ~np.isnan(rows).any(axis=1)
    peaks = _moving_maximum(row_norms(rows[usable]), int(window))
    seen = np.cumsum(usable)
    return np.concatenate([[np.nan], peaks])[seen]


def _moving_maximum(values: NDArray[np.float64], window: int) -> NDArray[np.float64]:
    """Return the largest of the last ``window`` values at each of them."""
    count = len(values)
    window = min(window, max(1, count))  # a longer one sees no more
    length = -(-(count + window - 1) // window) * window
    padded = np.full(length, -np.inf)
    padded[window - 1 : window - 1 + count] = values
    blocks = padded.reshape(-1, window)
    forwards = np.maximum.accumulate(blocks, axis=1).ravel()
    backwards = np.maximum.accumulate(blocks[:, ::-1], axis=1)[:, ::-1].ravel()
    return np.maximum(backwards[:count], forwards[window - 1 : window - 1 + count])


__all__ = ["PeakThreshold", "peak_over_window"]
