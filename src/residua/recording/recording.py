"""Recordings: inputs and outputs of a plant over time, from files and data frames, matched by name."""

from __future__ import annotations

import gzip
import io
import zlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.errors import DataError, FileFormatError, missing_extra
from residua.files import check_input, read_bytes
from residua.plant import Plant
from residua.recording.array_files import matrix_columns, table_from_arrays
from residua.recording.assembly import Recording, Times, assembled
from residua.recording.columns import ReadOptions
from residua.recording.csv_table import CsvTable, is_text, open_csv
from residua.recording.dates import seconds_from_text
from residua.recording.mat_files import read_mat
from residua.recording.missing import Marks, Tally
from residua.recording.npz_files import read_npz
from residua.recording.parquet_files import read_parquet
from residua.recording.time_axis import seconds_from_dates
from residua.recording.unpacked import too_large, unpacked_limit
from residua.visible import echo


def read_recording(
    path: str | Path,
    plant: Plant | None = None,
    *,
    time: str | None = None,
    dt: float | None = None,
    columns: Mapping[str, str] | Sequence[str] | None = None,
    variable: str | None = None,
    tolerance: float | None = None,
    fill_gaps: bool = False,
    dayfirst: bool | None = None,
    time_format: str | None = None,
    decimal: str = ".",
    transpose: bool = False,
    missing: Sequence[str | float] | str = (),
) -> Recording:
    """Read a recording: text (CSV; also with semicolons, tabs or blanks), Parquet, .mat or .npz.

    Columns are matched to the plant's inputs and outputs by name. Where no column has that name, one that differs in
    case, blanks or a unit alone is taken, such as ``H1 [cm]`` for ``h1``, and ``notes`` say so. A .mat or .npz file may
    hold one array per channel, the matrices ``u`` and ``y``, or one matrix with a column per channel, inputs first.
    Text without a header has its columns named by ``columns``.

    Text may be packed by gzip (``.csv.gz``), in UTF-8, UTF-16 with its mark, or Latin-1. Files of Excel are not read:
    save the sheet as CSV. Nothing in a file is executed; Python objects in .npz are refused. A .mat file is read in a
    process of its own, which a damaged one may end without ending this one. The arrays of a packed file may have up to
    2 GiB, or as many bytes as ``RESIDUA_MAX_UNPACKED`` in the environment.

    Empty cells become NaN. So do the marks in :data:`residua.recording.missing.MARKS`, in any case: those of data bases
    (``NULL``, ``N/A``), spreadsheets (``#VALUE!``), PI (``Bad Input``, ``I/O Timeout``, ``No Data``), AVEVA Historian
    (``(null)``), Ignition and OPC UA (``Bad_Stale``), and ``-`` or ``????``. ``notes`` count them by mark and column.

    Parameters
    ----------
    path : str or Path
        The ending of the name tells the format: .parquet, .mat or .npz; any other file is read as text.
    plant : Plant, optional
        Whose channels are wanted. Without one, every column with numbers is taken as an output, and ``notes`` name
        the columns of text.
    time : str, optional
        The time column; recognised by its name (``time``, ``t``, ``timestamp``, ``datetime``) when omitted. Seconds,
        or dates.
    dt : float, optional
        Step in seconds; a sampled plant's own step when omitted. A time column that is only recognised by its name is
        not used if it says otherwise, is irregular or cannot be read, and ``notes`` say so; one named by ``time`` must
        agree. With ``fill_gaps`` the step of the grid.
    columns : mapping or sequence of str, optional
        ``{channel: column}`` where names differ; or, for a matrix in a .mat or .npz file and for text without a header,
        the names of its columns in order.
    variable : str, optional
        Which matrix of a .mat or .npz file to read.
    tolerance : float, optional
        Largest difference of one time step from the usual one, as a fraction of it (0.01 when omitted). With
        ``fill_gaps`` the largest distance of a time from its point of the grid (0.1), below 0.5.
    fill_gaps : bool
        Put the rows on a grid of equal steps: every point without a row is a row of missing values, and times within
        the tolerance move to their point. ``notes`` say how many rows were inserted, the longest gap, and how many
        shared a point. Over missing values a monitor decides nothing (:class:`residua.Monitor`).
    dayfirst : bool, optional
        Whether 3/4/2026 is a day in April (True) or in March. When omitted the dates tell by a number over 12, and an
        error asks where none does; dots (3.4.2026) are read with the day first.
    time_format : str, optional
        How times are written, as :meth:`datetime.datetime.strptime` has it, such as ``"%d-%b-%Y %H:%M:%S"``. ISO 8601
        and dates of three numbers need none.
    decimal : {".", ","}
        Decimal mark of text. A comma in a number is never interpreted by guess.
    transpose : bool
        Time runs along the rows of the file's matrices, or of text without a header, not down.
    missing : sequence of str or float
        Further marks of missing values, such as ``["out", -9999]``.

    Returns
    -------
    Recording

    Raises
    ------
    DataError
        If a column is missing (the message has the ``columns`` to give), a cell is not a number (with its line), times
        are missing, repeated, backwards or irregular (with the row and both steps), or stand on no grid, the step is
        not the plant's, or there are no data.
    SettingError
        If ``decimal`` or ``tolerance`` is none.
    FileFormatError
        If there is no such file, it cannot be read, or its content does not match its ending.
    MissingExtraError
        If reading Parquet needs pyarrow and it is not installed.
    """
    path = Path(path)
    check_input(path, "recording")
    check_kind(path)
    options = ReadOptions(
        plant, time, dt, columns, variable, tolerance, fill_gaps, dayfirst, time_format, decimal, transpose, missing
    )
    read = _READERS.get(path.suffix.lower())
    return _from_text(path, options) if read is None else _from_arrays(read(path, options), options, path.name)


def recording_from_frame(
    frame: Any,
    plant: Plant | None = None,
    *,
    time: str | None = None,
    dt: float | None = None,
    columns: Mapping[str, str] | None = None,
    tolerance: float | None = None,
    fill_gaps: bool = False,
    dayfirst: bool | None = None,
    time_format: str | None = None,
    missing: Sequence[str | float] | str = (),
    source: str = "data frame",
) -> Recording:
    """Make a recording from a data frame (pandas, polars and others that narwhals knows).

    Parameters
    ----------
    frame : data frame
        Its columns are matched by name. A pandas index of dates serves as time when no column does.
    plant : Plant, optional
    time, dt, columns, tolerance, fill_gaps, dayfirst, time_format, missing
        As in :func:`read_recording`.
    source : str
        Name of it.

    Returns
    -------
    Recording

    Raises
    ------
    DataError
        As in :func:`read_recording`.
    MissingExtraError
        If narwhals is not installed.
    """
    try:
        import narwhals
    except ImportError as error:
        raise missing_extra("narwhals", "frames") from error
    try:
        data = narwhals.from_native(frame, eager_only=True)
    except TypeError as error:
        raise DataError(f"expected a data frame, got {type(frame).__name__}") from error
    table = {str(name): np.asarray(data[name].to_numpy()) for name in data.columns}
    index = getattr(frame, "index", None)
    if getattr(getattr(index, "dtype", None), "kind", "") == "M":
        table.setdefault("time", np.asarray(index))
    options = ReadOptions(plant, time, dt, columns, None, tolerance, fill_gaps, dayfirst, time_format, missing=missing)
    return _from_arrays(table, options, source)


#: Readers of the columns of files that are not text, by the ending of the name.
_READERS: dict[str, Callable[[Path, ReadOptions], dict[str, NDArray]]] = {
    ".parquet": read_parquet,
    ".mat": lambda path, options: table_from_arrays(read_mat(path), options, path.name),
    ".npz": lambda path, options: table_from_arrays(read_npz(path), options, path.name),
}
#: Remedies for a file that is not a recording, by the ending of its name.
_OTHERS = {
    **dict.fromkeys(
        (".xlsx", ".xls", ".xlsm", ".xlsb", ".ods"), "a spreadsheet: save the sheet as CSV (UTF-8), and give that"
    ),
    ".json": "not a recording; a monitor is saved as .json",
    ".toml": "not a recording; a plant is saved as .toml",
}


def check_kind(path: Path) -> None:
    """Raise if the ending of a name belongs to a file that is not a recording."""
    if path.suffix.lower() in _OTHERS:
        raise FileFormatError(f"{path.name}: this is {_OTHERS[path.suffix.lower()]}")


def _from_text(path: Path, options: ReadOptions) -> Recording:
    """Read a table of text, unpacked if it is compressed by gzip."""
    content = read_bytes(path, "recording")
    if content.startswith(b"\x1f\x8b"):
        inner = Path(path.stem).suffix.lower()
        if inner in _READERS or inner in _OTHERS:
            raise FileFormatError(f"{path.name}: only text is read packed: unpack it first (gunzip {path.name})")
        limit = unpacked_limit()
        try:
            with gzip.GzipFile(fileobj=io.BytesIO(content)) as file:
                content = file.read(limit + 1)
        except (OSError, EOFError, zlib.error) as error:
            raise FileFormatError(f"{path.name}: not a readable .gz file: {echo(str(error))}") from error
        if len(content) > limit:
            raise too_large(path.name, limit)
    table = open_csv(content, path.name, decimal=options.decimal)
    if not table.headed:
        return _from_headless(table, options, path.name)
    if options.matrix_names is not None:
        raise DataError("columns must be a mapping {channel: column} here: the file has a header")
    if options.transpose:
        raise DataError(f"{path.name}: transpose is for matrices and text without a header: this file has one")
    found, tally = options.matched(table.names, path.name), Tally()
    clock = found.clock
    numeric = clock and options.time_format is None and reads_as_number(table, clock, options.marks)
    together = [clock] if clock and numeric and not options.gets_round_times else []
    wanted = list(dict.fromkeys([*found.columns.values(), *together]))
    data = table.numbers(wanted, options.marks, tally, optional=options.takes_all)

    def times() -> Times:
        assert clock is not None
        if numeric:
            return (data if clock in data else table.numbers([clock], options.marks, Tally()))[clock], ""
        what = f"{table.source}: column {echo(clock)}"
        return seconds_from_text(*table.texts(clock), what, dayfirst=options.dayfirst, time_format=options.time_format)

    return assembled(data, found, times, options, path.name, tally, first_row=table.above + 1)


def _from_headless(table: CsvTable, options: ReadOptions, source: str) -> Recording:
    """Read text without a header as a matrix, with columns named by the caller."""
    if options.matrix_names is None and options.plant is not None:
        raise DataError(
            f"{source}: the first line must name the columns, it holds {echo(table.first_line, 60)}; of a file without "
            f"a header name its {len(table.names)} columns in order, columns=[...]"
        )
    shown: Sequence[str] = [f"line {name}" if options.transpose else f"column{name}" for name in table.names]
    if options.matrix_names is not None and not options.transpose:
        shown = options.matrix_names
    tally = Tally(dict(zip(table.names, shown, strict=False)))
    block = np.column_stack(list(table.numbers(table.names, options.marks, tally).values()))
    block = block.T if options.transpose else block
    columns = matrix_columns(block, "column", (), options.matrix_names, source)
    recording = _from_arrays(columns, options, source, first_row=table.above + 1)
    named = "named as asked" if options.matrix_names is not None else f"called column1 to column{block.shape[1]}"
    header = f"no header: every line is data, the columns are {named}"
    return replace(recording, notes=(header, *tally.notes, *recording.notes))


def reads_as_number(table: CsvTable, name: str, marks: Marks) -> bool:
    """Tell whether the first cell of a column is a number, or missing."""
    cell = table.first(name)
    if cell in marks:
        return True
    try:
        float(cell.replace(",", "."))
    except ValueError:
        return False
    return True


def _from_arrays(table: dict[str, NDArray], options: ReadOptions, source: str, first_row: int = 0) -> Recording:
    """Make a recording from named columns that are arrays already."""
    found, tally, data = options.matched(list(table), source), Tally(), {}
    for name in dict.fromkeys(found.columns.values()):
        values = _as_numbers(table[name], name, options.marks, tally)
        if isinstance(values, str):
            if not options.takes_all or not is_text(map(str, table[name]), options.marks):
                raise DataError(f"{source}: column {echo(name)}{values}")
            continue
        data[name] = values

    def times() -> Times:
        assert found.clock is not None
        values, what = table[found.clock], f"{source}: column {echo(found.clock)}"
        if values.dtype.kind == "M":
            if np.isnat(values).any():
                raise DataError(f"{what}: the time in row {first_row + int(np.isnat(values).argmax())} is missing")
            return seconds_from_dates(values.astype("datetime64[ns]"))
        if values.dtype.kind in "OUT" and len(values) and isinstance(values[0], str):
            rows = range(first_row, first_row + len(values))
            texts = [str(value) for value in values]
            return seconds_from_text(texts, rows, what, dayfirst=options.dayfirst, time_format=options.time_format)
        seconds = _as_numbers(values, "", options.marks, Tally())
        if isinstance(seconds, str):
            raise DataError(f"{what}{seconds}")
        return seconds, ""

    return assembled(data, found, times, options, source, tally, first_row=first_row)


def _as_numbers(values: NDArray, name: str, marks: Marks, tally: Tally) -> NDArray[np.float64] | str:
    """Return a column of numbers, its marks of missing values counted, or the problem with it, for a message."""
    if values.dtype.kind in "fiub":
        return np.asarray(values, dtype=float)
    if values.dtype.kind not in "OUT":
        return f": expected numbers, got values of type {values.dtype}"
    out, found = np.full(len(values), np.nan), Counter[str]()
    for i, value in enumerate(values):
        try:
            out[i] = np.nan if value is None else float(value)
        except (TypeError, ValueError, OverflowError):
            if str(value) not in marks:
                advice = f"; if that stands for a missing value, give missing=[{echo(value, 40)}]"
                return f", row {i}: expected a number, got {echo(value)}{advice * isinstance(value, str)}"
            found[str(value)] += 1
    for mark, count in found.items():
        tally.add(mark, name, count)
    return out
