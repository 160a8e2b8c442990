"""Recordings for identification: the wanted channels, cut where a value is missing, read block by block."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.arrays import names as checked_names, runs, unique
from residua.errors import DataError, ModelError, SettingError
from residua.recording.matching import required_columns, spelling_notes
from residua.recording.recording import Recording, read_recording, recording_from_frame
from residua.recording.time_axis import REGULAR
from residua.visible import echo, listed
from residua.words import counted, listing, number as number_text

#: Rows that are read at a time, so that a recording on disk is never in memory as a whole.
BLOCK = 65_536
#: Largest difference of the steps of two recordings, as a fraction.
_SAME_STEP = REGULAR / 10

#: What is said of arrays without a step.
UNTIMED = "no step was given: the samples are taken to be 1 s apart (dt=)"

Names = Sequence[str] | str | None


@dataclass(frozen=True, eq=False)
class Segment:
    """Rows without a missing value, one after the other.

    Attributes
    ----------
    u, y : ndarray, shape (time, columns)
        The arrays of the recording, all rows of it: nothing is copied.
    columns : tuple of int
        The columns of ``u``, then of ``y``, that are the inputs, then the outputs.
    start, stop : int
        The rows of this segment.
    recording : int
        The number of its recording, from 0.
    delays : tuple of int
        For each channel, how many rows before the others it is read.
    differenced : tuple of bool
        For each channel, true if it is read as the change from the row before.
    """

    u: NDArray
    y: NDArray
    columns: tuple[int, ...]
    start: int
    stop: int
    recording: int
    delays: tuple[int, ...] = ()
    differenced: tuple[bool, ...] = ()

    def __len__(self) -> int:
        return self.stop - self.start

    def rows(self, start: int, stop: int) -> NDArray[np.float64]:
        """Return rows of the segment, counted from its start: inputs, then outputs, in their own units."""
        before, changing = max(self.delays, default=0), np.flatnonzero(self.differenced)
        first, last = self.start + start - before - bool(len(changing)), self.start + stop
        block = np.hstack([self.u[first:last], self.y[first:last]]) if self.u.shape[1] else self.y[first:last]
        if self.columns != tuple(range(block.shape[1])):
            block = block[:, list(self.columns)]
        block = np.asarray(block, dtype=float)
        if before:
            block = np.column_stack([block[before - d : len(block) - d, i] for i, d in enumerate(self.delays)])
        if not len(changing):
            return block
        out = block[1:].copy()
        out[:, changing] -= block[:-1, changing]
        return out

    def blocks(self) -> Iterator[tuple[int, NDArray[np.float64]]]:
        """Yield the rows some at a time, with the first one's number in the segment."""
        for start in range(0, len(self), BLOCK):
            yield start, self.rows(start, min(start + BLOCK, len(self)))

    def cut(self, start: int, stop: int) -> Segment:
        """Return a part of it, counted from its start."""
        return replace(self, start=self.start + start, stop=self.start + stop)


@dataclass(frozen=True, eq=False)
class Gathered:
    """The recordings that a model is identified from.

    Attributes
    ----------
    inputs, outputs : tuple of str
    dt : float
        Step in seconds.
    segments : tuple of Segment
        Nothing is interpolated between them.
    sources : tuple of str
        Name of each recording.
    samples : tuple of int
        Rows of each recording, those with missing values included.
    notes : tuple of str
    timed : bool
        True where the recordings have a step of their own.
    """

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    dt: float
    segments: tuple[Segment, ...]
    sources: tuple[str, ...]
    samples: tuple[int, ...]
    notes: tuple[str, ...] = ()
    timed: bool = True

    @property
    def channels(self) -> tuple[str, ...]:
        """Inputs, then outputs."""
        return self.inputs + self.outputs

    @property
    def n_samples(self) -> int:
        """Rows without a missing value."""
        return sum(len(one) for one in self.segments)

    def blocks(self) -> Iterator[tuple[Segment, int, NDArray[np.float64]]]:
        """Yield the segments block by block, each with the number of its first row in the segment."""
        for segment in self.segments:
            for start, block in segment.blocks():
                yield segment, start, block

    def data(self) -> list[NDArray[np.float64]]:
        """Return every segment whole: inputs, then outputs, in their own units; for methods that need it in memory."""
        return [segment.rows(0, len(segment)) for segment in self.segments]

    def whole(self) -> list[NDArray[np.float64]]:
        """Return every recording that has a complete row, with all its rows: inputs, then outputs; NaN is missing."""
        first = {one.recording: replace(one, start=0, stop=len(one.y), delays=()) for one in self.segments}
        return [one.rows(0, len(one)) for _, one in sorted(first.items())]

    def divided(self, held_out: float) -> tuple[Gathered, Gathered]:
        """Return the first part of each recording, and its last, which is the fraction ``held_out`` of its rows.

        Raises
        ------
        SettingError
            If that is no fraction from 0 to below 1.
        DataError
            If the first part is empty.
        """
        if not (isinstance(held_out, (int, float, np.integer, np.floating)) and 0 <= held_out < 1):
            raise SettingError(f"held_out must be a fraction from 0 to below 1, got {echo(held_out)}")
        first, last = [], []
        for segment in self.segments:
            border = int(np.ceil((1 - held_out) * self.samples[segment.recording])) - segment.start
            border = min(max(border, 0), len(segment))
            first += [segment.cut(0, border)] if border else []
            last += [segment.cut(border, len(segment))] if border < len(segment) else []
        if not first:
            raise DataError("nothing is left to identify from: hold out less")
        return self.with_segments(first), self.with_segments(last)

    def shortened(self, rows: int, least: int = 1) -> Gathered:
        """Return about so many rows: the first ones of every segment, of each as large a part, and ``least`` of them.

        Where that is far too much of many short segments, evenly spaced ones of those that have ``least`` rows.
        """
        if self.n_samples <= rows:
            return self
        share = rows / self.n_samples
        parts = [one.cut(0, min(len(one), max(int(np.ceil(share * len(one))), least))) for one in self.segments]
        if sum(map(len, parts)) > 2 * rows:
            parts = [one for one in parts if len(one) >= least] or parts
            parts = parts[:: max(sum(map(len, parts)) // rows, 1)]
        return self.with_segments(parts)

    def delayed(self, delays: Mapping[str, int]) -> Gathered:
        """Return the same with some inputs read so many rows earlier than the outputs.

        Raises
        ------
        SettingError
            If a delay is of no input, or no whole number of rows.
        """
        if not isinstance(delays, Mapping):
            raise SettingError(f"delays must be a mapping of inputs to rows, got {echo(delays)}")
        for name in delays:
            if name not in self.inputs:
                raise SettingError(f"delays: {echo(name)} is no input; there are {listed(self.inputs) or 'none'}")
        rows_of = tuple(checked_count(delays.get(name, 0), f"delays: {echo(name)}") for name in self.channels)
        if not any(rows_of):
            return self
        late = max(rows_of)
        parts = [replace(one, start=one.start + late, delays=rows_of) for one in self.segments if len(one) > late]
        return self.with_segments(parts)

    def of_channels(self, kept: Sequence[str], differenced: Collection[str] = ()) -> Gathered:
        """Return some of the channels, of which some are read as their changes from row to row.

        The first row of a segment has no change, and is left out then.
        """
        wanted = [i for i, name in enumerate(self.channels) if name in kept]
        m = len(self.inputs)
        changing = tuple(self.channels[i] in differenced for i in wanted) if differenced else ()
        segments = [
            replace(
                one,
                columns=tuple(one.columns[i] for i in wanted),
                start=one.start + bool(changing),
                delays=tuple(one.delays[i] for i in wanted) if one.delays else (),
                differenced=changing,
            )
            for one in self.segments
            if len(one) > bool(changing)
        ]
        return replace(
            self,
            inputs=tuple(self.channels[i] for i in wanted if i < m),
            outputs=tuple(self.channels[i] for i in wanted if i >= m),
            segments=tuple(segments),
        )

    def with_segments(self, segments: Sequence[Segment]) -> Gathered:
        """Return the same with other segments."""
        return replace(self, segments=tuple(segments))


def checked_count(value: object, name: str, least: int = 0, instead: str = "") -> int:
    """Return a whole number, or raise with the text that could stand ``instead`` of one."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        other = f", or {instead}" if instead else ""
        raise SettingError(f"{name} must be a whole number, at least {least}{other}, got {echo(value)}")
    return int(value)


def gather(
    recordings: Any,
    y: ArrayLike | None = None,
    *,
    inputs: Names = None,
    outputs: Names = None,
    dt: float | None = None,
) -> Gathered:
    """Return recordings as segments of the wanted channels.

    Parameters
    ----------
    recordings : Recording, data frame, path, array, pair (u, y), or a list of these
        An array alone has the inputs in its first columns, then the outputs; with ``y`` it has the inputs only
        (``None`` for none).
    y : array_like, shape (time, outputs), optional
    inputs, outputs : sequence of str, optional
        The channels by name. Of a recording or a data frame the outputs are all columns that are no inputs, when
        omitted; ``notes`` name those that are left out, for they hold text, never change, or have no value. Of arrays
        the names are ``u1..`` and ``y1..`` when omitted.
    dt : float, optional
        Step in seconds; that of the recordings when omitted, 1 s of arrays.

    Raises
    ------
    DataError
        If a channel is missing, a recording is empty, the steps differ, or no row is complete.
    SettingError
        If a channel is named twice, or ``dt`` is none.
    """
    if dt is not None and not (isinstance(dt, (int, float, np.number)) and np.isfinite(dt) and dt > 0):
        raise SettingError(f"dt must be a positive step in seconds, got {echo(dt)}")
    wanted = []
    for channels, what in ((inputs, "inputs"), (outputs, "outputs")):
        named = None if channels is None else (channels,) if isinstance(channels, str) else tuple(channels)
        if not all(isinstance(one, str) and one for one in named or ()):
            raise SettingError(f"{what} must be names, got {echo(channels)}")
        wanted.append(named)
    if y is not None or _is_pair(recordings):
        several = [recordings if y is None else (recordings, y)]
    else:
        listed_ones = recordings if isinstance(recordings, (list, tuple)) else [recordings]
        several = [one if _is_pair(one) else (one, None) for one in listed_ones]
    if not several:
        raise DataError("the list of recordings is empty")
    tables = [_table(pair, wanted[0], wanted[1], dt, number) for number, pair in enumerate(several)]
    tables, notes = _without_still(tables) if outputs is None and y is None else (tables, ())
    first = tables[0]
    if not first.outputs:
        raise DataError("there are no outputs: name them, outputs=[...]")
    for number, one in enumerate(tables, 1):
        if (one.inputs, one.outputs) != (first.inputs, first.outputs):
            raise DataError(
                f"recording {number} has the channels {listed(one.inputs + one.outputs)}, the first one "
                f"{listed(first.inputs + first.outputs)}: name those to use, inputs=[...], outputs=[...]"
            )
    steps = [one.dt for one in tables if one.dt is not None]
    step = dt if dt is not None and steps else [*steps, 1.0][0]
    for number, one in enumerate(tables, 1):
        if one.dt is not None and abs(one.dt - step) > _SAME_STEP * step:
            raise DataError(f"recording {number} ({one.source}) has a step of {one.dt:g} s, expected {step:g} s")
        if not len(one.rows):
            raise DataError(f"recording {number} ({one.source}) is empty")
    segments = [one.rows.cut(start, stop) for one in tables for start, stop in _complete_runs(one.rows)]
    if not segments:
        raise DataError(f"no row is complete: {_emptiest(tables)}")
    samples = tuple(len(one.rows) for one in tables)
    missing = sum(samples) - sum(map(len, segments))
    notes = (*(() if steps else (UNTIMED,)), *notes)
    if missing:
        notes += (
            f"{counted(missing, 'row')} of {sum(samples)} with a missing value left out, which cuts the data into "
            f"{counted(len(segments), 'segment')}",
        )
    notes += tuple(dict.fromkeys(f"{one.source}: {note}" for one in tables for note in one.notes))
    sources = tuple(one.source for one in tables)
    return Gathered(first.inputs, first.outputs, float(step), tuple(segments), sources, samples, notes, bool(steps))


def _is_pair(one: Any) -> bool:
    return isinstance(one, tuple) and len(one) == 2 and (one[0] is None or np.ndim(one[0]) > 0)


@dataclass(frozen=True, eq=False)
class _Table:
    """One recording: all its rows, complete or not, and their channels."""

    rows: Segment
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    dt: float | None
    source: str
    notes: tuple[str, ...] = ()
    named: bool = False


def _table(
    pair: tuple[Any, Any],
    inputs: tuple[str, ...] | None,
    outputs: tuple[str, ...] | None,
    dt: float | None,
    number: int,
) -> _Table:
    (one, y), source = pair, f"recording {number + 1}"
    if y is not None or isinstance(one, np.ndarray):
        return _table_of_arrays(one, y, inputs, outputs, dt, number)
    if isinstance(one, (str, Path)):
        one = read_recording(one, dt=dt)
    elif hasattr(one, "columns") and not isinstance(one, Recording):
        one = recording_from_frame(one, dt=dt, source=source)
    if not isinstance(one, Recording):
        raise DataError(
            f"{source}: expected a recording, a data frame, a path or arrays (u, y), got {type(one).__name__}"
        )
    channels, source = tuple(one.columns), one.source or source
    chosen_inputs = channels[: one.u.shape[1]] if inputs is None else inputs
    advice = "give inputs and outputs the names of columns"
    found = required_columns((*chosen_inputs, *(outputs or ())), channels, source, advice=advice)
    chosen_outputs = tuple(name for name in channels if name not in found.values()) if outputs is None else outputs
    found |= {name: name for name in chosen_outputs if name not in found}
    _check_once(chosen_inputs, chosen_outputs)
    columns = tuple(channels.index(found[name]) for name in chosen_inputs + chosen_outputs)
    rows = Segment(one.u, one.y, columns, 0, len(one.y), number)
    notes = (*one.notes, *spelling_notes(found))
    return _Table(rows, chosen_inputs, chosen_outputs, one.dt, source, notes, named=True)


def _without_still(tables: list[_Table]) -> tuple[list[_Table], tuple[str, ...]]:
    """Return recordings without the outputs that never change in any of them, or have no value, and a note on these.

    Nobody has named them: all columns were taken, as far as they are no inputs. Columns of arrays stay.
    """
    first = tables[0]
    m = len(first.inputs)
    if not all(one.named and one.outputs == first.outputs for one in tables):
        return tables, ()
    low = high = np.full(m + len(first.outputs), np.nan)
    for one in tables:
        for _, block in one.rows.blocks():
            known = np.where(np.isfinite(block), block, np.nan)
            low, high = np.fmin(low, np.fmin.reduce(known)), np.fmax(high, np.fmax.reduce(known))
    still = {k: low[m + k] for k in range(len(first.outputs)) if not low[m + k] < high[m + k]}
    if not still or len(still) == len(first.outputs):
        return tables, ()
    kept = [k for k in range(len(first.outputs)) if k not in still]
    left = [
        replace(
            one,
            outputs=tuple(one.outputs[k] for k in kept),
            rows=replace(one.rows, columns=one.rows.columns[:m] + tuple(one.rows.columns[m + k] for k in kept)),
        )
        for one in tables
    ]
    values = {first.outputs[k]: "no value" if np.isnan(value) else number_text(value) for k, value in still.items()}
    named = listing(f"{echo(name)} ({value})" for name, value in values.items())
    return left, (f"columns that never change, left out: {named}",)


def _table_of_arrays(
    u: Any, y: Any, inputs: tuple[str, ...] | None, outputs: tuple[str, ...] | None, dt: float | None, number: int
) -> _Table:
    source = f"recording {number + 1}"
    if y is None:
        whole = _two_dimensional(u, source)
        m = len(inputs or ())
        if whole.shape[1] < m + len(outputs or ()):
            raise DataError(
                f"{source} has {counted(whole.shape[1], 'column')}, and {m} inputs and {len(outputs or ())} outputs "
                "are named: inputs first, then outputs"
            )
        u, y = whole[:, :m], whole[:, m:]
    y = _two_dimensional(y, f"{source}: y")
    u = np.zeros((len(y), 0)) if u is None else _two_dimensional(u, f"{source}: u")
    if len(u) != len(y):
        raise DataError(f"{source}: u has {len(u)} rows, y has {len(y)}")
    try:
        input_names = checked_names(inputs, u.shape[1], "u", "inputs")
        output_names = checked_names(outputs, y.shape[1], "y", "outputs")
    except ModelError as error:
        raise DataError(f"{source}: {error}") from error
    _check_once(input_names, output_names)
    rows = Segment(u, y, tuple(range(u.shape[1] + y.shape[1])), 0, len(y), number)
    return _Table(rows, input_names, output_names, dt, source)


def _two_dimensional(data: Any, what: str) -> NDArray:
    array = data if isinstance(data, np.ndarray) else np.asarray(data)
    if array.dtype.kind not in "fiub":
        raise DataError(f"{what}: expected numbers, got values of type {array.dtype}")
    if array.ndim == 1:
        array = array[:, None]
    if array.ndim != 2:
        raise DataError(f"{what} has the shape {array.shape}: expected (time, channels)")
    return array


def _check_once(inputs: tuple[str, ...], outputs: tuple[str, ...]) -> None:
    twice = sorted(set(inputs) & set(outputs))
    if twice:
        raise SettingError(
            f"{listed(twice)} cannot be an input and an output: leave {'it' if len(twice) == 1 else 'them'} out of one"
        )
    try:
        unique(inputs + outputs, "inputs and outputs")
    except ModelError as error:
        raise SettingError(str(error)) from error


def _complete_runs(rows: Segment) -> list[tuple[int, int]]:
    """Return the runs of rows without a missing value, as (start, stop)."""
    out: list[tuple[int, int]] = []
    for start, block in rows.blocks():
        for first, last in (runs(np.asarray(np.isfinite(block).all(axis=1))) + start).tolist():
            if out and out[-1][1] == first:
                out[-1] = (out[-1][0], last)
            else:
                out.append((first, last))
    return out


def _emptiest(tables: Sequence[_Table]) -> str:
    """Name the channel with the most missing values."""
    gaps = [(~np.isfinite(block)).sum(axis=0) for one in tables for _, block in one.rows.blocks()]
    absent = np.sum(gaps, axis=0)
    worst, total = int(np.argmax(absent)), sum(len(one.rows) for one in tables)
    channel = (tables[0].inputs + tables[0].outputs)[worst]
    return f"{channel!r} is missing in {int(absent[worst])} of {total} rows; leave it out, or other channels"
