"""Time column of a recording: finding it, and checking that its steps are equal."""

from __future__ import annotations

import re
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from residua.errors import DataError

#: Largest difference of one step from the usual one, as a fraction of it, of times that count as regular.
REGULAR = 0.01

_EVEN = ", or, where the rows are evenly apart, give their step dt in seconds (--read dt=S)"

#: Names that a time column goes by, in any case, with or without ``[s]`` or ``[UTC]``.
TIME_NAME = re.compile(
    r"(time|t|time[ _]?stamp|date([ _/]?time)?)\s*([\[(]\s*(s|sec|seconds|utc|gmt|local)\s*[\])])?", re.IGNORECASE
)


def find_time(names: Iterable[str], channels: Iterable[str]) -> str | None:
    """Return the name of the time column, ``None`` if there is none; a channel of the plant never is.

    A column of dates counts where no other name is one of times.
    """
    taken = set(channels)
    found = [name for name in names if name not in taken and TIME_NAME.fullmatch(name)]
    return min(found, key=lambda name: name.lower().startswith("date") and "time" not in name.lower(), default=None)


def seconds_from_dates(dates: NDArray) -> tuple[NDArray[np.float64], str]:
    """Return ``datetime64`` values as seconds since the first one, and that one as text."""
    if len(dates) == 0:
        return np.zeros(0), ""
    return seconds_since(dates, dates[0]), str(np.datetime_as_string(dates[0], unit="auto"))


def seconds_since(dates: NDArray, first: np.datetime64) -> NDArray[np.float64]:
    """Return ``datetime64`` values as seconds since one of them."""
    return np.asarray((dates - first) / np.timedelta64(1, "ns"), dtype=float) / 1e9


def regular_step(time: NDArray[np.float64], tolerance: float, first_row: int, source: str) -> float:
    """Return the step of the times, or raise with the row at which they are not equally spaced.

    Parameters
    ----------
    time : ndarray, shape (T,), T >= 2
    tolerance : float
        Largest difference of one step from the median step, as a fraction of it.
    first_row : int
        Number of the row that ``time[0]`` is from, for messages.
    source : str
    """
    bad = np.flatnonzero(~np.isfinite(time))
    if len(bad):
        raise DataError(
            f"{source}: the time in row {first_row + bad[0]} is missing or not finite; take the row out{_EVEN}"
        )
    steps = np.diff(time)
    usual = float(np.median(steps))
    wrong = np.flatnonzero(steps <= 0)
    if len(wrong):
        k = int(wrong[0])
        what = "repeats" if steps[k] == 0 else "goes backwards"
        raise DataError(
            f"{source}: time {what} in row {first_row + k + 1}: {time[k + 1]:.10g} s after {time[k]:.10g} s "
            f"(usual step {usual:g} s); put the rows in order{_EVEN}"
        )
    # Times far from zero are rounded; their steps cannot be more regular than that.
    rounding = 4 * np.finfo(float).eps * float(np.abs(time).max())
    wrong = np.flatnonzero(np.abs(steps - usual) > tolerance * usual + rounding)
    if len(wrong):
        k = int(wrong[0])
        raise DataError(
            f"{source}: time is irregular: the step to row {first_row + k + 1} is {steps[k]:.6g} s, the usual one "
            f"{usual:.6g} s ({len(wrong)} of {len(steps)} steps differ by more than {tolerance:.2g} of it); "
            "fill_gaps=True of read_recording and recording_from_frame puts the rows on a grid and leaves gaps in it"
        )
    return float((time[-1] - time[0]) / len(steps))
