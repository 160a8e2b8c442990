"""Recordings read piece by piece: Parquet by batches of a row group, text by blocks of lines, .npz by memory map.

The result equals that of :func:`residua.read_recording`, bit for bit: a file, or a piece of one, that might read
otherwise raises :class:`NotServedError`, and is then read by that function, which reports any error.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from residua.recording import csv_arrow
from residua.recording.array_files import table_from_arrays
from residua.recording.columns import ReadOptions
from residua.recording.csv_table import open_csv
from residua.recording.missing import Marks, Tally
from residua.recording.npz_files import read_npz
from residua.recording.recording import check_kind, reads_as_number
from residua.recording.unpacked import unpacked_limit

#: Rows of a piece, about; bytes of a piece of text.
ROWS, BYTES = 65_536, 1 << 23
#: How far a file of text is read for its header.
_HEAD = 1 << 20
#: Times its own size that a file may unpack to, if that is over the limit: more is made to fill the disk.
_UNPACKED = 1000
_BOM = b"\xef\xbb\xbf"


class NotServedError(Exception):
    """A recording cannot be read piece by piece; the text gives the reason."""


@dataclass(frozen=True, eq=False)
class Piece:
    """Rows of a recording.

    Attributes
    ----------
    values : ndarray, shape (rows, channels)
        Inputs, then outputs.
    time : ndarray, shape (rows,), or None
        As it stands in the file: seconds, or dates as ``datetime64[ns]``.
    done : float
        The part of the file that is read, 0 to 1.
    """

    values: NDArray[np.float64]
    time: NDArray | None
    done: float


@dataclass(frozen=True, eq=False)
class Stream:
    """A recording that is read piece by piece.

    Attributes
    ----------
    path : Path
    columns : dict of str to str
        Of every channel.
    clock : str or None
        The time column.
    inputs : int
        Channels that are inputs: the first ones.
    first_row : int
        Number of the first row, for messages.
    reader : object
        Yields columns by their names, with the part of the file that is read.
    marks : Marks
    matched : tuple of str
        The note on channels whose columns have another name.
    tally : Tally
        The marks of missing values in the pieces so far.
    """

    path: Path
    columns: Mapping[str, str]
    clock: str | None
    inputs: int
    first_row: int
    reader: Any
    marks: Marks = field(default_factory=Marks)
    matched: tuple[str, ...] = ()
    tally: Tally = field(default_factory=Tally)

    @property
    def notes(self) -> tuple[str, ...]:
        """The notes of the recording, as far as it was read."""
        return (*self.matched, *self.tally.notes)

    def pieces(self) -> Iterator[Piece]:
        """Yield the recording in pieces, from its beginning.

        Raises
        ------
        NotServedError
            If a piece may differ from the result of :func:`residua.read_recording`.
        """
        self.tally.counts.clear()
        names = [*self.columns.values(), *([self.clock] if self.clock else [])]
        for columns, done in self.reader(list(dict.fromkeys(names))):
            values = np.column_stack(
                [
                    self.marks.numbers_removed(_numbers(columns[name]), name, self.tally)
                    for name in self.columns.values()
                ]
            )
            yield Piece(values, None if self.clock is None else _times(columns[self.clock]), done)


def open_stream(path: Path, options: ReadOptions) -> Stream:
    """Open a recording to be read piece by piece.

    Parameters
    ----------
    path : Path
    options : ReadOptions

    Raises
    ------
    NotServedError
        If it is read by :func:`residua.read_recording` only, or not at all.
    DataError
        If a column is missing, as that function says it.
    """
    if options.fill_gaps or options.gets_round_times or options.transpose or options.matrix_names is not None:
        raise NotServedError("it is put on a grid, transposed, has its columns named, or its times are not used")
    if options.time_format is not None or options.variable is not None:
        raise NotServedError("its times are in a format of their own, or one of its matrices was chosen")
    check_kind(path)
    suffix = path.suffix.lower()
    if suffix == ".parquet":
        return _parquet(path, options)
    if suffix == ".npz":
        return _npz(path, options)
    if suffix == ".mat":
        raise NotServedError(f"{suffix} files are read at once")
    return _text(path, options)


def _stream(path: Path, options: ReadOptions, names: list[str], first_row: int, reader: Any) -> Stream:
    found = options.matched(names, path.name)
    outputs = options.outputs or tuple(found.columns)
    columns = {name: found.columns[name] for name in (*options.inputs, *outputs)}
    if len(columns) != len(options.inputs) + len(outputs):
        raise NotServedError("a channel is input and output")
    return Stream(path, columns, found.clock, len(options.inputs), first_row, reader, options.marks, found.notes)


def _numbers(values: NDArray) -> NDArray[np.float64]:
    if values.dtype.kind not in "fiub":
        raise NotServedError(f"a column has values of type {values.dtype}")
    return np.asarray(values, dtype=np.float64)


def _times(values: NDArray) -> NDArray:
    if values.dtype.kind != "M":
        return _numbers(values)
    if np.isnat(values).any():
        raise NotServedError("a time is missing")
    return values.astype("datetime64[ns]")


# ------------------------------------------------------------------ Parquet


def _parquet(path: Path, options: ReadOptions) -> Stream:
    try:
        import pyarrow
        import pyarrow.parquet as parquet
    except ImportError as error:
        raise NotServedError("pyarrow is not installed") from error
    try:
        with parquet.ParquetFile(path) as file:
            schema, rows = file.schema_arrow, file.metadata.num_rows
            values = rows * len(schema.names)
    except Exception as error:  # whatever pyarrow says of a damaged file
        raise NotServedError(str(error)) from error

    if 8 * values > max(unpacked_limit(), _UNPACKED * path.stat().st_size):
        raise NotServedError("it unpacks to very much more than it is")

    def batches(names: list[str]) -> Iterator[tuple[dict[str, NDArray], float]]:
        done = 0
        try:
            with parquet.ParquetFile(path, pre_buffer=False) as file:
                for batch in file.iter_batches(batch_size=ROWS, columns=names, use_threads=False):
                    done += batch.num_rows
                    columns = {name: batch.column(name).to_numpy(zero_copy_only=False) for name in names}
                    yield columns, done / max(rows, 1)
        except Exception as error:
            raise NotServedError(str(error)) from error
        pyarrow.default_memory_pool().release_unused()
        if done != rows:
            raise NotServedError("it has fewer rows than it says")

    return _stream(path, options, list(schema.names), 0, batches)


# ------------------------------------------------------------------ text


def _text(path: Path, options: ReadOptions) -> Stream:
    with path.open("rb") as file:
        raw = file.read(_HEAD)
    whole = len(raw) < _HEAD
    if not whole and b"\n" not in raw:
        raise NotServedError("it has no line end near its beginning")
    raw = raw if whole else raw[: raw.rfind(b"\n") + 1]
    try:
        head = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise NotServedError("its header is not in UTF-8") from error
    if "\x00" in head or head.startswith("\ufeff"):
        raise NotServedError("its header is not plain text")
    table = open_csv(raw, path.name, decimal=options.decimal)
    if not table.headed or table.blanks:
        raise NotServedError("it has no header, or blanks between its cells")
    stream = _stream(path, options, list(table.names), table.above + 1, None)
    if stream.clock is not None and not reads_as_number(table, stream.clock, options.marks):
        raise NotServedError("its times are dates")
    size = path.stat().st_size

    def blocks(names: list[str]) -> Iterator[tuple[dict[str, NDArray], float]]:
        places = [table.names.index(name) for name in names]
        with path.open("rb") as file:
            for lines in _lines(file, table.above):
                body = csv_arrow.body_of(lines, len(table.names), table.delimiter, options.decimal)
                columns = None if body is None else body.numbers(places, options.marks)
                if body is None or columns is None:
                    raise NotServedError("a cell is not a number, or a line differs from the others")
                for name, place, values in zip(names, places, columns, strict=True):
                    if name != stream.clock and np.isnan(values).any():
                        body.count_marks(place, options.marks, name, stream.tally)
                yield dict(zip(names, columns, strict=True)), min(1.0, file.tell() / max(size, 1))

    return replace(stream, reader=blocks)


def _lines(file: IO[bytes], above: int) -> Iterator[bytes]:
    """Yield the lines below the first ones in blocks, ended by line feeds, without blank lines at the end."""
    if file.read(len(_BOM)) != _BOM:
        file.seek(0)
    rest, blank, first = b"", b"", True
    while True:
        more = file.read(BYTES)
        block = rest + more
        cut = block.rfind(b"\n") + 1 if more else len(block)
        if more and not cut:
            raise NotServedError("a line is too long")
        lines, rest = block[:cut], block[cut:]
        if b"\r" in lines:
            lines = lines.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
        if first:
            lines, first = lines.split(b"\n", above)[-1], False
        lines = blank + lines if blank else lines
        tail = lines[-1000:]  # the end of the text without trailing blanks
        last = len(lines) - len(tail) + len(tail.rstrip()) if tail.strip() else len(lines.rstrip())
        end = lines.find(b"\n", last) + 1 if last else 0
        if last:
            yield lines[: end or None]
        blank = lines[end:] if end or not last else b""
        if not more:
            return


# ------------------------------------------------------------------ .npz


def _npz(path: Path, options: ReadOptions) -> Stream:
    try:
        arrays = read_npz(path, mapped=True)
    except Exception as error:  # whatever a reader of damaged data ends with
        raise NotServedError(str(error)) from error
    table = table_from_arrays(arrays, options, path.name)
    stream = _stream(path, options, list(table), 0, None)
    names = [*stream.columns.values(), *([stream.clock] if stream.clock else [])]
    lengths = {len(table[name]) for name in names}
    if len(lengths) != 1:
        raise NotServedError("its columns differ in length")
    rows = lengths.pop()

    def slices(names: list[str]) -> Iterator[tuple[dict[str, NDArray], float]]:
        for start in range(0, rows, ROWS):
            stop = min(rows, start + ROWS)
            yield {name: np.array(table[name][start:stop]) for name in names}, stop / rows

    return replace(stream, reader=slices)
