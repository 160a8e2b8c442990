"""Rows on the grid of the sample step from readings: a pure function from state and readings to state and rows.

A row is released when every channel of it has been stated and all rows before it are out; or ``wait`` seconds after
it should have been, by the times of later readings or by the clock, with NaN for missing values. Rows come out in
order, each once. The grid follows the plant's clock slowly, so that a step that is stated a little wrong does no harm.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.live.readings import Readings
from residua.tolerances import DATA_ROUNDING

#: The part of a reading's distance from the grid by which the grid moves.
FOLLOW = 1 / 32
#: Readings in a row that are older than the last row, from which on the clock has gone back.
BACK_AFTER = 10
#: Rows that may wait for one that is missing, whatever ``wait`` is.
MOST_PENDING = 10_000


@dataclass(frozen=True)
class SamplingSettings:
    """Settings for the conversion of readings to rows.

    Attributes
    ----------
    wait : float
        Seconds that a row waits for readings that are missing.
    max_age : float
        Seconds for which a channel that is not stated keeps its last value; 0: it is missing at once.
    longest_gap : int
        Rows of NaN that a gap becomes at most: more make no difference to a filter that restarts.
    """

    wait: float
    max_age: float
    longest_gap: int


@dataclass(frozen=True, slots=True)
class Slot:
    """A row that is incomplete, or waits for others.

    Attributes
    ----------
    time : float
        As the first reading stated it.
    values : tuple of float
        NaN where a channel has not been stated, or was stated to be missing.
    stated : int
        Bit ``c``: channel ``c`` has been stated.
    arrived : float
        When the first reading came, by the clock.
    """

    time: float
    values: tuple[float, ...]
    stated: int
    arrived: float


@dataclass(frozen=True, slots=True)
class SamplingState:
    """State of the sampling of one plant.

    Attributes
    ----------
    last, grid : float
        The time of the last row as it was stated, and on the grid; NaN before the first.
    dated : bool
        Whether times are dates.
    pending : tuple of (int, Slot)
        By the number of steps after the last row, in order.
    held, held_at : tuple of float
        The last value of each channel, and its time; empty where values are not held.
    late : int
        Readings in a row that were older than the last row.
    back : bool
        Whether the clock has gone back: readings are refused until their time is past the last row, by as many rows as
        let the filter start anew.
    """

    last: float = math.nan
    grid: float = math.nan
    dated: bool = False
    pending: tuple[tuple[int, Slot], ...] = ()
    held: tuple[float, ...] = ()
    held_at: tuple[float, ...] = ()
    late: int = 0
    back: bool = False

    def to_record(self) -> list[Any]:
        """Return the state as plain values for JSON, with NaN as such."""
        slots = [[number, slot.time, slot.values, slot.stated] for number, slot in self.pending]
        return [self.last, self.grid, self.dated, slots, self.held, self.held_at, self.late, self.back]

    @staticmethod
    def from_record(content: list[Any], arrived: float) -> SamplingState:
        """Return the state of a record; pending readings count as having arrived at ``arrived``."""
        last, grid, dated, slots, held, held_at, late, back = content
        pending = tuple((number, Slot(time, tuple(values), stated, arrived)) for number, time, values, stated in slots)
        return SamplingState(last, grid, dated, pending, tuple(held), tuple(held_at), late, back)


@dataclass(frozen=True, slots=True)
class Rows:
    """Rows that were released.

    Attributes
    ----------
    times : ndarray, shape (rows,)
        As stated; of a row that nothing was said of, that of the grid.
    values : ndarray, shape (rows, channels)
    """

    times: NDArray[np.float64]
    values: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Remark:
    """A remark to be counted, or reported.

    Attributes
    ----------
    kind : str
        ``repeat``: said before; ``conflict``: another value for a time that was said; ``late``: for a row that is out;
        ``refused``: while the clock is back; ``clock``: it has gone back; ``gap``: rows without any reading.
    time : float
    count : int
    """

    kind: str
    time: float
    count: int = 1


#: Returns the row that is out for a time, NaN for missing values; ``None`` where it is not kept.
Known = Callable[[float], Sequence[float] | None]


def sample(
    state: SamplingState, readings: Readings, dt: float, settings: SamplingSettings, known: Known
) -> tuple[SamplingState, list[Rows], list[Remark]]:
    """Take readings of one plant, and release the rows that are complete or overdue.

    Parameters
    ----------
    state : SamplingState
    readings : Readings
    dt : float
        Seconds between rows.
    settings : SamplingSettings
    known : callable
        Looks up rows that are out, for readings that come again.

    Returns
    -------
    state : SamplingState
    rows : list of Rows
        In order.
    remarks : list of Remark
    """
    quick = _next_rows(state, readings, dt, settings)
    if quick is not None:
        return quick
    grid = _Grid(state, dt, settings)
    for k, time in enumerate(np.asarray(readings.times).tolist()):
        grid.put(time, readings, k, known)
        grid.release(readings.arrived)
    return grid.state, grid.rows, grid.remarks


def due(
    state: SamplingState, dt: float, settings: SamplingSettings, now: float
) -> tuple[SamplingState, list[Rows], list[Remark]]:
    """Release the rows that have waited long enough by the clock; ``now`` infinite: all of them."""
    grid = _Grid(state, dt, settings)
    grid.release(now)
    return grid.state, grid.rows, grid.remarks


def _next_rows(
    state: SamplingState, readings: Readings, dt: float, settings: SamplingSettings
) -> tuple[SamplingState, list[Rows], list[Remark]] | None:
    """Return rows that are complete, each one step after the previous one; else ``None``."""
    if state.pending or state.back or readings.stated is not None or settings.max_age > 0:
        return None
    times = np.asarray(readings.times, dtype=np.float64)
    grid = _followed(float(times[0]) - dt if state.grid != state.grid else state.grid, times, dt)
    if grid is None:
        return None
    dated = state.dated if state.grid == state.grid else readings.dated
    return SamplingState(float(times[-1]), grid, dated), [Rows(times, readings.values)], []


def _followed(grid: float, times: NDArray[np.float64], dt: float) -> float | None:
    """Return the grid for times one step apart each; ``None`` if one is off by half a step."""
    if len(times) > 1:
        steps = np.full(len(times), dt)
        steps[0] = grid + dt
        expected = np.add.accumulate(steps)
        if (expected == times).all():  # the sum goes from left to right, as the loop does: the same grid
            return float(expected[-1])
    half = 0.5 * dt
    for time in times.tolist():
        expected = grid + dt
        off = time - expected
        if off >= half or off <= -half:
            return None
        grid = expected + FOLLOW * off
    return grid


class _Grid:
    """The grid of a plant: slots are filled by readings, and released as rows."""

    def __init__(self, state: SamplingState, dt: float, settings: SamplingSettings) -> None:
        self.state, self._dt, self._settings = state, dt, settings
        self.rows: list[Rows] = []
        self.remarks: list[Remark] = []

    def put(self, time: float, readings: Readings, k: int, known: Known) -> None:
        """Put one reading into its slot."""
        state, dt, values = self.state, self._dt, readings.values[k]
        if math.isnan(state.grid):
            self.state = state = replace(state, grid=time - dt, last=time - dt, dated=readings.dated)
        number = round((time - state.grid) / dt)
        if state.back and number <= self._settings.longest_gap:  # later rows are another stretch: the filter restarts
            self.remarks.append(Remark("refused", time))
            return
        channels = range(len(values)) if readings.stated is None else readings.stated
        stated = [(c, float(values[c])) for c in channels]
        if number <= 0:
            self._put_late(time, stated, known(time), readings.past)
            return
        if state.late or state.back:
            state = replace(state, late=0, back=False)
        place = bisect_left(state.pending, number, key=lambda one: one[0])
        there = place < len(state.pending) and state.pending[place][0] == number
        slot = state.pending[place][1] if there else Slot(time, (math.nan,) * len(values), 0, readings.arrived)
        filled, bits, clash = list(slot.values), slot.stated, False
        for c, value in stated:
            if not bits >> c & 1:
                filled[c], bits = value, bits | 1 << c
            elif not _same(filled[c], value):
                clash = True
        if bits == slot.stated:
            self.remarks.append(Remark("conflict" if clash else "repeat", time))
        else:
            new = (number, Slot(slot.time, tuple(filled), bits, slot.arrived))
            state = replace(state, pending=(*state.pending[:place], new, *state.pending[place + there :]))
        self.state = state

    def _put_late(self, time: float, stated: list[tuple[int, float]], row: Sequence[float] | None, past: bool) -> None:
        """Remark on a reading for a released row: a repeat, a conflict, late, or of a clock that was set back."""
        kind = "late"
        if row is not None:
            if all(_same(row[c], value) for c, value in stated):
                self.remarks.append(Remark("repeat", time))
                return
            kind = "conflict" if any(row[c] == row[c] for c, _ in stated) else "late"
        self.remarks.append(Remark(kind, time))
        if past:
            return
        late = self.state.late + 1
        if late < BACK_AFTER:
            self.state = replace(self.state, late=late)
            return
        self.remarks.append(Remark("clock", time))
        self.state = replace(self.state, late=0, back=True)

    def release(self, now: float) -> None:
        """Release rows from the front for as long as they are complete or overdue."""
        pending, settings, dt, k = self.state.pending, self._settings, self._dt, 0
        if not pending:
            return
        out = _Releasing(self.state, dt, settings)
        spoken = _spoken_of(pending) if settings.max_age > 0 else 0
        last = pending[-1][1].time
        while k < len(pending):
            number, slot = pending[k]
            full = (1 << len(slot.values)) - 1
            if k and settings.max_age > 0:
                spoken = _spoken_of(pending[k:])
            overdue = now - slot.arrived >= settings.wait or len(pending) - k > MOST_PENDING
            newest = math.inf if overdue else last
            gap = number - out.step - 1
            if gap:
                gone = gap if spoken == full or newest == math.inf else _steps(newest - settings.wait - out.grid, dt)
                if gone < 1:
                    break
                self.remarks.append(Remark("gap", out.grid + dt, min(gap, gone)))
                out.skip(min(gap, gone), len(slot.values))
                if gone < gap:
                    break
            if slot.stated != full and newest < out.grid + dt + settings.wait and spoken != full:
                break
            out.take(slot)
            k += 1
        self.state, rows = out.finished(pending[k:])
        self.rows += rows


class _Releasing:
    """Rows in the course of their release, and the state after each."""

    def __init__(self, state: SamplingState, dt: float, settings: SamplingSettings) -> None:
        self.state, self.dt, self.settings = state, dt, settings
        self.last, self.grid = state.last, state.grid
        self.held, self.held_at = np.array(state.held), np.array(state.held_at)
        self.step = 0
        self.times: list[float] = []
        self.values: list[NDArray[np.float64]] = []

    def skip(self, rows: int, width: int) -> None:
        """Release rows without readings; not all of them in a long gap."""
        empty = 0
        for j in range(1, rows + 1):
            moment = self.grid + j * self.dt
            values = self._held(moment, width)
            empty += bool(np.isnan(values).all())
            if empty > self.settings.longest_gap:
                break
            self.times.append(moment)
            self.values.append(values)
        self.step += rows
        self.grid += rows * self.dt
        self.last = self.grid

    def take(self, slot: Slot) -> None:
        """Release the row of a slot."""
        expected, width = self.grid + self.dt, len(slot.values)
        values = np.array(slot.values)
        if self.settings.max_age > 0:
            held = self._held(slot.time, width)
            stated = [bool(slot.stated >> c & 1) for c in range(width)]
            self.held = np.where(stated, values, self.held if self.held.size else np.nan)
            self.held_at = np.where(stated, slot.time, self.held_at if self.held_at.size else np.nan)
            values = np.where(stated, values, held)
        self.times.append(slot.time)
        self.values.append(values)
        self.step += 1
        self.grid, self.last = expected + FOLLOW * (slot.time - expected), slot.time

    def _held(self, moment: float, width: int) -> NDArray[np.float64]:
        """Return the last value of each channel that is not too old at a time."""
        if self.settings.max_age <= 0 or not self.held.size:
            return np.full(width, np.nan)
        return np.where(moment - self.held_at <= self.settings.max_age, self.held, np.nan)

    def finished(self, pending: Sequence[tuple[int, Slot]]) -> tuple[SamplingState, list[Rows]]:
        """Return the next state, and the rows."""
        if not self.times:
            return self.state, []
        moved = tuple((number - self.step, slot) for number, slot in pending)
        held, held_at = tuple(self.held.tolist()), tuple(self.held_at.tolist())
        after = replace(self.state, last=self.last, grid=self.grid, pending=moved, held=held, held_at=held_at)
        return after, [Rows(np.array(self.times), np.array(self.values, dtype=np.float64))]


def _steps(seconds: float, dt: float) -> int:
    """Return the number of whole steps in a time; one that is short by a rounding error counts."""
    return math.floor(seconds / dt + DATA_ROUNDING)


def _spoken_of(pending: Sequence[tuple[int, Slot]]) -> int:
    """Return the channels stated in the slots, as bits: no earlier reading of these will come."""
    bits = 0
    for _, slot in pending:
        bits |= slot.stated
    return bits


def _same(a: float, b: float) -> bool:
    return a == b or (a != a and b != b)


__all__ = [
    "BACK_AFTER",
    "FOLLOW",
    "Known",
    "Remark",
    "Rows",
    "SamplingSettings",
    "SamplingState",
    "Slot",
    "due",
    "sample",
]
