"""Recordings: inputs and outputs of a plant over time, from files and data frames, matched by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.errors import DataError, FileFormatError, missing_extra
from residua.files import check_input, read_bytes
from residua.plant import Plant
from residua.recording.array_files import table_from_arrays
from residua.recording.assembly import Clock, Recording, Times, assembled
from residua.recording.columns import ReadOptions
from residua.recording.csv_table import MISSING, CsvTable, open_csv
from residua.recording.dates import seconds_from_text
from residua.recording.mat_files import read_mat
from residua.recording.npz_files import read_npz
from residua.recording.parquet_files import read_parquet
from residua.recording.time_axis import seconds_from_dates
from residua.visible import echo

__all__ = ["Recording", "read_recording", "recording_from_frame"]


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
) -> Recording:
    """Read a recording: text (CSV; also with semicolons, tabs or blanks), Parquet, .mat or .npz.

    Columns are matched to the plant's inputs and outputs by name. A .mat or .npz file may hold one array per
    channel, the matrices ``u`` and ``y``, or one matrix with a column per channel, inputs first. Text without a
    header has its columns named by ``columns``. Nothing in a file is executed; Python objects in .npz are refused. A
    .mat file is read in a process of its own, which a damaged one may end without ending this one; of any packed file
    the arrays may have up to 2 GiB, or as many bytes as ``RESIDUA_MAX_UNPACKED`` in the environment says. Empty cells,
    ``nan`` and spreadsheet errors such as ``#VALUE!`` become NaN and are counted.

    Parameters
    ----------
    path : str or Path
        The ending of the name tells the format: .csv, .tsv, .txt or .dat for text.
    plant : Plant, optional
        Whose channels are wanted. Without one, every column is taken as an output.
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
        What stands before the decimals in text. A comma in a number is never guessed at.
    transpose : bool
        Time runs along the rows of the file's matrices, or of text without a header, not down.

    Returns
    -------
    Recording

    Raises
    ------
    DataError
        If a column is missing (the message says what is there), a cell is no number (with its line), times
        are missing, repeated, backwards or irregular (with the row and both steps), or stand on no grid, the step is
        not the plant's, or there are no data.
    SettingError
        If ``decimal`` or ``tolerance`` is none.
    FileFormatError
        If there is no such file, it cannot be read, or it is not what its ending says.
    MissingExtraError
        If reading Parquet needs pyarrow and it is not installed.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in _READERS:
        raise FileFormatError(f"{path.name}: unknown format {echo(suffix)}; known: {', '.join(sorted(_READERS))}")
    check_input(path, "recording")
    options = ReadOptions(
        plant, time, dt, columns, variable, tolerance, fill_gaps, dayfirst, time_format, decimal, transpose
    )
    return _READERS[suffix](path, options)


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
    source: str = "data frame",
) -> Recording:
    """Make a recording of a data frame (pandas, polars and whatever else narwhals knows).

    Parameters
    ----------
    frame : data frame
        Its columns are matched by name. A pandas index of dates serves as time when no column does.
    plant : Plant, optional
    time, dt, columns, tolerance, fill_gaps, dayfirst, time_format
        As in :func:`read_recording`.
    source : str
        What to call it.

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
    options = ReadOptions(plant, time, dt, columns, None, tolerance, fill_gaps, dayfirst, time_format)
    return _from_arrays(table, options, source)


def _from_csv(path: Path, options: ReadOptions) -> Recording:
    table = open_csv(read_bytes(path, "recording"), path.name, decimal=options.decimal)
    if not table.headed:
        return _from_headless(table, options, path.name)
    if options.matrix_names is not None:
        raise DataError("columns must be a mapping {channel: column} here: the file has a header")
    if options.transpose:
        raise DataError(f"{path.name}: transpose is for matrices and text without a header: this file has one")
    chosen, clock = options.matched(table.names, path.name)
    together = clock is not None and not options.gets_round_times and _has_numbers(table, clock, options)
    data = table.numbers(list(dict.fromkeys([*chosen.values(), *([clock] if clock and together else [])])))

    def times() -> Times:
        assert clock is not None
        return (data[clock], "") if clock in data else _times_of(table, clock, options)

    clock_ = None if clock is None else Clock(clock, times)
    return assembled(data, chosen, clock_, options, path.name, first_row=table.above + 1)


def _has_numbers(table: CsvTable, clock: str, options: ReadOptions) -> bool:
    """Whether times are numbers, by the first one and what the caller says."""
    return options.time_format is None and reads_as_number(table, clock)


def _times_of(table: CsvTable, name: str, options: ReadOptions) -> Times:
    """Return the times of a table of text in seconds, and the moment that they count from."""
    if _has_numbers(table, name, options):
        return table.numbers([name])[name], ""
    cells, rows = table.texts(name)
    what = f"{table.source}: column {echo(name)}"
    return seconds_from_text(cells, rows, what, dayfirst=options.dayfirst, time_format=options.time_format)


def _from_headless(table: CsvTable, options: ReadOptions, source: str) -> Recording:
    """Read text without a header as a matrix, whose columns the caller names."""
    if options.matrix_names is None and options.plant is not None:
        raise DataError(
            f"{source}: the first line must name the columns, it holds {echo(table.first_line, 60)}; of a file without "
            f"a header name its {len(table.names)} columns in order, columns=[...]"
        )
    block = np.column_stack(list(table.numbers(table.names).values()))
    block = block.T if options.transpose else block
    columns = table_from_arrays({"column": block}, (), (), variable="column", names=options.matrix_names, source=source)
    made = _from_arrays(columns, options, source, first_row=table.above + 1)
    named = "named as asked" if options.matrix_names is not None else f"called column1 to column{block.shape[1]}"
    return replace(made, notes=(f"no header: every line is data, the columns are {named}", *made.notes))


def reads_as_number(table: CsvTable, name: str) -> bool:
    """Whether the first cell of a column is a number, or missing."""
    cell = table.first(name)
    if cell.lower() in MISSING:
        return True
    try:
        float(cell.replace(",", "."))
    except ValueError:
        return False
    return True


def _from_parquet(path: Path, options: ReadOptions) -> Recording:
    if options.matrix_names is not None:
        raise DataError("columns must be a mapping {channel: column} here: the file has named columns")

    def wanted(names: list[str]) -> list[str]:
        chosen, clock = options.matched(names, path.name)
        return list(dict.fromkeys([*chosen.values(), *([clock] if clock else [])]))

    return _from_arrays(read_parquet(path, wanted), options, path.name)


def _from_named_arrays(read: Callable[[Path], dict[str, NDArray]]) -> Callable[[Path, ReadOptions], Recording]:
    def reader(path: Path, options: ReadOptions) -> Recording:
        renamed = options.columns if isinstance(options.columns, Mapping) else {}
        arrays = read(path)
        if options.transpose:
            arrays = {name: M.T if M.ndim == 2 else M for name, M in arrays.items()}
        table = table_from_arrays(
            arrays,
            [renamed.get(name, name) for name in options.inputs],
            [renamed.get(name, name) for name in options.outputs],
            variable=options.variable,
            names=options.matrix_names,
            source=path.name,
        )
        return _from_arrays(table, options, path.name)

    return reader


_READERS: dict[str, Callable[[Path, ReadOptions], Recording]] = {
    ".csv": _from_csv,
    ".dat": _from_csv,
    ".tsv": _from_csv,
    ".txt": _from_csv,
    ".parquet": _from_parquet,
    ".mat": _from_named_arrays(read_mat),
    ".npz": _from_named_arrays(read_npz),
}


def _from_arrays(table: dict[str, NDArray], options: ReadOptions, source: str, first_row: int = 0) -> Recording:
    """Make a recording of named columns that are arrays already."""
    chosen, clock = options.matched(list(table), source)
    data = {name: _as_numbers(table[name], f"{source}: column {echo(name)}") for name in dict.fromkeys(chosen.values())}
    clock_ = None
    if clock is not None:
        clock_ = Clock(clock, lambda: _times_from(table[clock], options, f"{source}: column {echo(clock)}", first_row))
    return assembled(data, chosen, clock_, options, source, first_row=first_row)


def _times_from(values: NDArray, options: ReadOptions, what: str, first_row: int) -> Times:
    """Return a column of times in seconds, and the moment that they count from."""
    if values.dtype.kind == "M":
        if np.isnat(values).any():
            raise DataError(f"{what}: the time in row {first_row + int(np.isnat(values).argmax())} is missing")
        return seconds_from_dates(values.astype("datetime64[ns]"))
    if values.dtype.kind in "OUT" and len(values) and isinstance(values[0], str):
        rows = range(first_row, first_row + len(values))
        texts = [str(value) for value in values]
        return seconds_from_text(texts, rows, what, dayfirst=options.dayfirst, time_format=options.time_format)
    return _as_numbers(values, what), ""


def _as_numbers(values: NDArray, what: str) -> NDArray[np.float64]:
    if values.dtype.kind in "fiub":
        return np.asarray(values, dtype=float)
    if values.dtype.kind == "O":
        out = np.empty(len(values))
        for i, value in enumerate(values):
            try:
                out[i] = np.nan if value is None else float(value)
            except (TypeError, ValueError, OverflowError):
                if str(value).strip().lower() not in MISSING and str(value) != "<NA>":
                    raise DataError(f"{what}, row {i}: expected a number, got {echo(value)}") from None
                out[i] = np.nan
        return out
    raise DataError(f"{what}: expected numbers, got values of type {values.dtype}")
