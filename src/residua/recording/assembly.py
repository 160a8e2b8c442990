"""A recording from columns: inputs, outputs, and a clock that is regular, put on a grid, or not used."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.errors import DataError
from residua.recording.columns import Matched, ReadOptions, settled_step
from residua.recording.levels import level_and_spread
from residua.recording.matching import named_columns
from residua.recording.missing import Tally
from residua.recording.time_axis import regular_step
from residua.recording.time_grid import Grid, put_on_grid
from residua.shown import Shown, notes, table
from residua.visible import echo, shortened, visible
from residua.words import counted, number

#: Head of the table of channels, channels that it prints at most, and characters of a name.
_HEADER, _SHOWN, _WIDEST = ("channel", "column", "mean", "std. dev.", "missing"), 20, 40
#: Times in seconds, and the moment that they count from, where they were dates.
Times = tuple[NDArray[np.float64], str]


@dataclass(frozen=True, eq=False, repr=False)
class Recording(Shown):
    """Inputs and outputs of a plant at equally spaced times, in plant units.

    Attributes
    ----------
    time : ndarray, shape (T,)
        Seconds.
    u : ndarray, shape (T, inputs)
    y : ndarray, shape (T, outputs)
        Missing values are NaN.
    dt : float
        Step in seconds.
    source : str
        The file that it came from.
    columns : dict of str to str
        Channel of the plant to the column that it was read from.
    n_missing : int
        Number of values (not samples) in ``u`` and ``y`` that are missing or not finite, those of rows that were
        inserted included.
    origin : str
        The moment that ``time`` counts from, where the recording had dates.
    n_inserted : int
        Number of samples that the file has no row for (``fill_gaps``).
    notes : tuple of str
        The changes at reading: columns of another name, those of text, marks of missing values, rows that were
        inserted or left out, and how far times were moved. A diagnosis has them among its own.
    """

    time: NDArray[np.float64]
    u: NDArray[np.float64]
    y: NDArray[np.float64]
    dt: float
    source: str
    columns: Mapping[str, str]
    n_missing: int
    origin: str = ""
    n_inserted: int = 0
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.time)

    def _rows(self) -> list[tuple[str, str, float, float, int]]:
        """Return channel, column, mean, standard deviation and missing values of each channel."""
        values = np.hstack([self.u, self.y])
        missing = np.count_nonzero(~np.isfinite(values), axis=0).tolist()
        figures = (part.tolist() for part in level_and_spread(values))
        return list(zip(self.columns, self.columns.values(), *figures, missing, strict=False))

    def _headline(self) -> str:
        return (
            f"{self.source}: {len(self)} samples, {self.dt:g} s apart, {self.u.shape[1]} inputs, "
            f"{self.y.shape[1]} outputs, {counted(self.n_missing, 'value')} missing"
        )

    def _parts(self) -> list[str]:
        return [table(_HEADER, self._rows()), notes(self.notes)]

    def __repr__(self) -> str:
        """Return a line on the recording and a short table of its channels."""
        rows = [[channel, column, *map(number, figures), str(gaps)] for channel, column, *figures, gaps in self._rows()]
        cells = [[shortened(visible(cell), _WIDEST) for cell in row] for row in (_HEADER, *rows[:_SHOWN])]
        widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
        lines = ["  ".join(map(str.ljust, row, widths)).rstrip() for row in cells]
        more = [f"and {len(rows) - _SHOWN} more channels"] if len(rows) > _SHOWN else []
        return "\n".join([visible(self._headline()), *lines, *more])


def assembled(
    data: Mapping[str, NDArray],
    found: Matched,
    times: Callable[[], Times],
    options: ReadOptions,
    source: str,
    tally: Tally,
    first_row: int,
) -> Recording:
    """Return the recording from columns.

    Parameters
    ----------
    data : mapping of str to ndarray
        The columns that are read, by their names.
    found : Matched
        The column of every channel; those that are not in ``data`` hold nothing but text.
    times : callable
        Reads the column of times, which is done only if it is used.
    options : ReadOptions
    source : str
        Name of the recording in messages.
    tally : Tally
        The marks of missing values.
    first_row : int
        Number of the first row, for messages.
    """
    chosen = {name: column for name, column in found.columns.items() if column in data}
    texts = [column for column in found.columns.values() if column not in data]
    if not chosen:
        raise DataError(f"{source}: no column holds numbers, there is text alone: {named_columns(texts)}")
    outputs = options.outputs or tuple(chosen)
    data = {column: options.marks.numbers_removed(data[column], column, tally) for column in chosen.values()}
    columns = {chosen[name]: data[chosen[name]] for name in (*options.inputs, *outputs)}
    lengths = {name: len(column) for name, column in columns.items()}
    rows = max(lengths.values(), default=0)
    time, origin, step, grid, notes = _settled(found.clock, times, options, source, first_row, rows)
    if time is not None and found.clock is not None:
        lengths[found.clock] = len(time)
    if min(lengths.values(), default=0) != max(lengths.values(), default=0):
        raise DataError(f"{source}: the columns differ in length: {echo(lengths)}")
    if rows == 0:
        raise DataError(f"{source}: there are no data rows")
    u, y = (
        np.column_stack([data[chosen[name]] for name in group]) if group else np.zeros((rows, 0))
        for group in (options.inputs, outputs)
    )
    dt = settled_step(step, options, source, texts)
    inserted = 0
    if grid is not None:
        notes += grid.notes(np.hstack([u, y]))
        time, u, y, inserted = grid.time, grid.filled(u), grid.filled(y), grid.inserted
    if time is None:
        time = np.arange(rows, dtype=np.float64) * dt
    n_missing = int((~np.isfinite(u)).sum() + (~np.isfinite(y)).sum())
    left_out = (f"columns of text, left out: {named_columns(texts)}",) if texts else ()
    notes = (*found.notes, *left_out, *tally.notes, *notes)
    return Recording(time, u, y, dt, source, dict(chosen), n_missing, origin, inserted, notes)


def _settled(
    clock: str | None, times: Callable[[], Times], options: ReadOptions, source: str, first_row: int, rows: int
) -> tuple[NDArray[np.float64] | None, str, float | None, Grid | None, tuple[str, ...]]:
    """Return times, their origin, step and grid, and notes.

    No times where there are none, or where they are not used because of ``dt``.
    """
    if clock is None:
        if options.fill_gaps:
            raise DataError(f"{source}: fill_gaps needs times, and there is no time column: name it by time=")
        return None, "", None, None, ()
    try:
        time, origin = times()
        time = np.asarray(time, dtype=np.float64)
        if len(time) < 2 or len(time) != rows:
            return time, origin, None, None, ()
        if options.fill_gaps:
            grid = put_on_grid(time, options.step, options.near, first_row, source)
            return time, origin, grid.step, grid, ()
        step = regular_step(time, options.near, first_row, source)
        if options.gets_round_times:
            settled_step(step, options, source)
        return time, origin, step, None, ()
    except DataError as error:
        if not options.gets_round_times:
            raise
        note = f"its time column {echo(clock)} was not used, rows are {options.dt:g} s apart as dt= says ({error})"
        return None, "", None, None, (note,)
