"""Rows at irregular times, put on a grid: missing rows become gaps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.errors import DataError

#: Largest distance of a time from its point of the grid, as a fraction of the step, unless the caller says otherwise.
NEAR = 0.1
#: Largest fraction of rows that may fall on the point of another: beyond, the step is not that of the rows.
_SHARED = 0.05
#: Grids of fewer points are always made; longer ones up to so many points for each row.
_POINTS, _POINTS_PER_ROW = 1_000_000, 20
#: Relative difference between the step that was asked for and that of the times that is let pass.
STEP_TOLERANCE = 1e-3


@dataclass(frozen=True, eq=False)
class Grid:
    """Equally spaced times, and the row at each of them.

    Attributes
    ----------
    time : ndarray, shape (points,)
    step : float
    rows : ndarray of int
        The rows that are kept, in order.
    places : ndarray of int
        The point of the grid that each of them stands at.
    dropped : ndarray of int, shape (n, 2)
        Rows that are not kept, each with the row that stands at its point.
    offset : float
        Largest distance of a kept row from its point, as a fraction of the step.
    """

    time: NDArray[np.float64]
    step: float
    rows: NDArray[np.int64]
    places: NDArray[np.int64]
    dropped: NDArray[np.int64]
    offset: float

    @property
    def inserted(self) -> int:
        """Number of points without a row."""
        return len(self.time) - len(self.rows)

    def filled(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return values, one row each, on the grid; NaN for missing rows."""
        out = np.full((len(self.time), *values.shape[1:]), np.nan)
        out[self.places] = values[self.rows]
        return out

    def notes(self, values: NDArray[np.float64]) -> tuple[str, ...]:
        """Describe the changes to the rows with these values; empty if they were regular."""
        out = []
        if self.inserted:
            gaps = np.diff(self.places)
            longest = int(gaps.argmax())
            many = int((gaps > 1).sum())
            out.append(
                f"{self.inserted} rows inserted as missing, in {many} gap{'s' * (many != 1)}: "
                f"{self.inserted / len(self.time):.2g} of the grid; the longest is {gaps[longest] * self.step:g} s "
                f"from {self.time[self.places[longest]]:g} s on"
            )
        if len(self.dropped):
            one, other = (np.nan_to_num(values[self.dropped[:, i]]) for i in (0, 1))
            differ = int((one != other).any(axis=1).sum())
            out.append(
                f"{len(self.dropped)} rows at the time of another left out, the nearest kept "
                f"({differ} of them with other values)"
            )
        if self.offset > 1e-6:
            out.append(f"times up to {self.offset:.2g} of a step off it")
        return (f"put on a grid of {self.step:g} s: {'; '.join(out)}",) if out else ()


def put_on_grid(time: NDArray[np.float64], step: float | None, tolerance: float, first_row: int, source: str) -> Grid:
    """Return the grid of the times, within a tolerance.

    Parameters
    ----------
    time : ndarray, shape (T,), T >= 2
    step : float, optional
        Of the grid, where it is known; the median of the steps when omitted. Times that drift against it by no more
        than 1e-3 of it have a grid of their own step.
    tolerance : float
        Largest distance of a time from its point of the grid, as a fraction of the step.
    first_row : int
        Number of the row that ``time[0]`` is from, for messages.
    source : str
    """
    bad = np.flatnonzero(~np.isfinite(time))
    if len(bad):
        raise DataError(f"{source}: the time in row {first_row + bad[0]} is missing or not finite")
    steps = np.diff(time)
    back = np.flatnonzero(steps < 0)
    if len(back):
        k = int(back[0])
        raise DataError(
            f"{source}: time goes backwards in row {first_row + k + 1}: {time[k + 1]:.10g} s after {time[k]:.10g} s"
        )
    if not np.any(steps > 0):
        raise DataError(f"{source}: every row has the same time, {time[0]:.10g} s")
    usual = float(np.median(steps[steps > 0]))
    if step is not None and abs(usual - step) > max(2 * tolerance, STEP_TOLERANCE) * step:
        raise DataError(
            f"{source}: the times are usually {usual:g} s apart, and a grid of {step:g} s was asked for (dt=, or the "
            "step of the plant): resample the recording, or discretize the plant at its step"
        )
    asked = usual if step is None else step
    # far more points than there are rows, as after a wrong date
    points = (time[-1] - time[0]) / asked
    if points > max(_POINTS, _POINTS_PER_ROW * len(time)):
        longest = int(steps.argmax())
        raise DataError(
            f"{source}: {len(time)} rows would need a grid of {points:.6g} points of {asked:g} s; the longest gap, "
            f"before row {first_row + longest + 1}, is {steps[longest]:g} s: is that time right? If "
            "so, cut the recording there: fit takes several"
        )
    fit = _fitted(time, asked, tolerance)
    if step is not None and abs(fit.step - step) > STEP_TOLERANCE * step:
        raise DataError(
            f"{source}: the times are {fit.step:.8g} s apart on average, and a grid of {step:g} s was asked for (dt=, "
            f"or the step of the plant): they drift by more than {STEP_TOLERANCE:g} of it"
        )
    away = int((fit.off > tolerance).sum())
    if away:
        k = int(fit.off.argmax())
        raise DataError(
            f"{source}: the times stand on no grid of {fit.step:.6g} s: {away} of {len(time)} rows are more than "
            f"{tolerance:.2g} of a step from the nearest point, the worst, row {first_row + k}, {fit.off[k]:.2g} of "
            "one; give the step by dt=, allow more by tolerance= (below 0.5), or resample the recording"
        )
    places, off, step = fit.places, fit.off, fit.step
    points, total = int(places[-1]) + 1, len(places)
    order = np.lexsort((off, places))  # of each point the nearest row comes first, and is kept
    rows = order[np.concatenate([[True], np.diff(places[order]) > 0])]
    keeper = rows[np.searchsorted(places[rows], places)]
    dropped = np.flatnonzero(keeper != np.arange(total))
    if len(dropped) > max(1.0, _SHARED * total):
        k = int(dropped[0])
        raise DataError(
            f"{source}: {len(dropped)} of {total} rows fall on a point of the grid of {step:g} s that has another row "
            f"already, the first is row {first_row + k}: if the rows come faster than their times tell, leave the "
            "times out, with dt= and without fill_gaps"
        )
    time = np.asarray(fit.start + step * np.arange(points), dtype=np.float64)
    twice = np.column_stack([dropped, keeper[dropped]])
    return Grid(time, step, rows, places[rows], twice, float(off[rows].max(initial=0.0)))


@dataclass(frozen=True, eq=False)
class _Fit:
    """Start and step of a grid, the nearest point of every time, and its distance, as a fraction of the step."""

    start: float
    step: float
    places: NDArray[np.int64]
    off: NDArray[np.float64]


def _fitted(time: NDArray[np.float64], step: float, tolerance: float) -> _Fit:
    """Return the grid with the given step, if the times fit it; else the one of least squares.

    Where they stand on neither, the one with fewer times off it.
    """
    since = time - time[0]
    simple = _with_start(time, since, step, np.rint(since / step))
    if simple.off.max() <= tolerance:
        return simple
    steps = np.diff(time)
    counts = np.rint(steps / step)
    short = (counts > 0) & (counts <= 3)  # the step of the rows themselves; a long gap multiplies its error
    if short.any():
        step = float(steps[short].sum() / counts[short].sum())
    places = np.concatenate([[0.0], np.cumsum(np.rint(steps / step))])
    for _ in range(10):
        start, step = _line(places, since)
        after = np.rint((since - start) / step)
        if np.array_equal(after, places):
            break
        places = after
    best = _with_start(time, since, step, places - places[0])
    return min(simple, best, key=lambda fit: int((fit.off > tolerance).sum()))


def _with_start(time: NDArray[np.float64], since: NDArray[np.float64], step: float, places: NDArray) -> _Fit:
    """Return the grid of a step whose start suits most times: the first, if they fit it up to rounding."""
    rounding = 8 * np.finfo(float).eps * (float(np.abs(time).max()) + since[-1])
    errors = since - step * places
    start = 0.0 if np.abs(errors).max() <= rounding else float(np.median(errors))
    off = np.abs(errors - start)
    return _Fit(float(time[0] + start), step, places.astype(np.int64), np.where(off <= rounding, 0.0, off) / step)


def _line(places: NDArray[np.float64], since: NDArray[np.float64]) -> tuple[float, float]:
    """Return start and step of the grid that best fits the times of these places."""
    middle = places.mean()
    away = places - middle
    step = float(away @ since / (away @ away))
    return float(since.mean() - step * middle), step
