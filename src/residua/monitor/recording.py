"""Recordings: inputs and outputs of a plant over time, from files and data frames, matched by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.errors import DataError, FileFormatError, missing_extra
from residua.files import check_input, read_bytes
from residua.monitor.array_files import table_from_arrays
from residua.monitor.csv_table import MISSING, CsvTable, open_csv
from residua.monitor.mat_files import read_mat
from residua.monitor.matching import ReadOptions, settled_step
from residua.monitor.npz_files import read_npz
from residua.monitor.parquet_files import read_parquet
from residua.monitor.table_writer import write_table
from residua.monitor.time_axis import regular_step, seconds_from_dates, seconds_from_text
from residua.plant import Plant
from residua.visible import echo

__all__ = ["Recording", "read_recording", "recording_from_frame", "write_table"]


@dataclass(frozen=True, eq=False)
class Recording:
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
        Number of values (not samples) in ``u`` and ``y`` that are missing or not finite.
    origin : str
        The moment that ``time`` counts from, where the recording had dates.
    """

    time: NDArray[np.float64]
    u: NDArray[np.float64]
    y: NDArray[np.float64]
    dt: float
    source: str
    columns: Mapping[str, str]
    n_missing: int
    origin: str = ""

    def __len__(self) -> int:
        return len(self.time)


def read_recording(
    path: str | Path,
    plant: Plant | None = None,
    *,
    time: str | None = None,
    dt: float | None = None,
    columns: Mapping[str, str] | Sequence[str] | None = None,
    variable: str | None = None,
    tolerance: float = 0.01,
) -> Recording:
    """Read a recording: CSV (also with semicolons or tabs), Parquet, .mat or .npz.

    Columns are matched to the plant's inputs and outputs by name. A .mat or .npz file may hold one array per
    channel, the matrices ``u`` and ``y``, or one matrix with a column per channel, inputs first. Nothing in
    a file is executed; Python objects in .npz are refused. A .mat file is read in a process of its own, which a damaged
    one may end without ending this one; of any packed file the arrays may have up to 2 GiB, or as many bytes as
    ``RESIDUA_MAX_UNPACKED`` in the environment says. Empty cells, ``nan`` and spreadsheet errors such
    as ``#VALUE!`` become NaN and are counted.

    Parameters
    ----------
    path : str or Path
        The ending of the name tells the format.
    plant : Plant, optional
        Whose channels are wanted. Without one, every column is taken as an output.
    time : str, optional
        The time column; found by its name (``time``, ``t``, ``timestamp``, ``datetime``) when omitted. Seconds,
        or dates in ISO 8601.
    dt : float, optional
        Step in seconds for recordings without times; a sampled plant's own step when omitted.
    columns : mapping or sequence of str, optional
        ``{channel: column}`` where names differ; or, for a matrix in a .mat or .npz file, the names of its
        columns in order.
    variable : str, optional
        Which matrix of a .mat or .npz file to read.
    tolerance : float
        Largest difference of one time step from the usual one, as a fraction of it.

    Returns
    -------
    Recording

    Raises
    ------
    DataError
        If a column is missing (the message says what is there), a cell is no number (with its line), times
        are missing, repeated, backwards or irregular (with the row and both steps), the step is not the
        plant's, or there are no data.
    FileFormatError
        If there is no such file, it cannot be read, or it is not what its ending says.
    MissingExtraError
        If reading Parquet needs pyarrow and it is not installed.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in _READERS:
        raise FileFormatError(f"{path.name}: unknown format {echo(suffix)}; known: {', '.join(sorted(_READERS))}")
    check_input(path, "a recording")
    options = ReadOptions(plant, time, dt, columns, variable, tolerance)
    return _READERS[suffix](path, options)


def recording_from_frame(
    frame: Any,
    plant: Plant | None = None,
    *,
    time: str | None = None,
    dt: float | None = None,
    columns: Mapping[str, str] | None = None,
    tolerance: float = 0.01,
    source: str = "data frame",
) -> Recording:
    """Make a recording of a data frame (pandas, polars and whatever else narwhals knows).

    Parameters
    ----------
    frame : data frame
        Its columns are matched by name. A pandas index of dates serves as time when no column does.
    plant : Plant, optional
    time, dt, columns, tolerance
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
    options = ReadOptions(plant, time, dt, columns, None, tolerance)
    return _from_arrays(table, options, source)


def _from_csv(path: Path, options: ReadOptions) -> Recording:
    if options.matrix_names is not None:
        raise DataError("columns must be a mapping {channel: column} here: the file has a header")
    table = open_csv(read_bytes(path, "a recording"), path.name)
    chosen, clock = options.matched(table.names, path.name)
    numeric = list(dict.fromkeys(chosen.values()))
    dates = clock is not None and not _reads_as_number(table, clock)
    if clock is not None and not dates and clock not in numeric:
        numeric.append(clock)
    data: dict[str, NDArray] = dict(table.numbers(numeric))
    origin = ""
    if clock is not None and dates:
        cells, rows = table.texts(clock)
        data[clock], origin = seconds_from_text(cells, rows, f"{path.name}: column {echo(clock)}")
    return _assembled(data, chosen, clock, options, path.name, origin, first_row=2)


def _reads_as_number(table: CsvTable, name: str) -> bool:
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
        table = table_from_arrays(
            read(path),
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
    ".tsv": _from_csv,
    ".txt": _from_csv,
    ".parquet": _from_parquet,
    ".mat": _from_named_arrays(read_mat),
    ".npz": _from_named_arrays(read_npz),
}


def _from_arrays(table: dict[str, NDArray], options: ReadOptions, source: str) -> Recording:
    """Make a recording of named columns that are arrays already."""
    chosen, clock = options.matched(list(table), source)
    data: dict[str, NDArray] = {}
    origin = ""
    for name in dict.fromkeys(chosen.values()):
        data[name] = _as_numbers(table[name], f"{source}: column {echo(name)}")
    if clock is not None:
        values = table[clock]
        if values.dtype.kind == "M":
            if np.isnat(values).any():
                raise DataError(f"{source}: the time in row {int(np.isnat(values).argmax())} is missing")
            data[clock], origin = seconds_from_dates(values.astype("datetime64[ns]"))
        elif values.dtype.kind in "OUT" and len(values) and isinstance(values[0], str):
            cells = [str(value) for value in values]
            data[clock], origin = seconds_from_text(cells, range(len(cells)), f"{source}: column {echo(clock)}")
        else:
            data[clock] = _as_numbers(values, f"{source}: column {echo(clock)}")
    return _assembled(data, chosen, clock, options, source, origin, first_row=0)


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


def _assembled(
    data: Mapping[str, NDArray],
    chosen: Mapping[str, str],
    clock: str | None,
    options: ReadOptions,
    source: str,
    origin: str,
    first_row: int,
) -> Recording:
    lengths = {name: len(column) for name, column in data.items()}
    steps = max(lengths.values(), default=0)
    if min(lengths.values(), default=0) != steps:
        raise DataError(f"{source}: the columns differ in length: {echo(lengths)}")
    if steps == 0:
        raise DataError(f"{source}: there are no data rows")
    outputs = options.outputs or tuple(chosen)
    u, y = (
        np.column_stack([data[chosen[name]] for name in group]) if group else np.zeros((steps, 0))
        for group in (options.inputs, outputs)
    )
    found = None
    if clock is not None and steps > 1:
        found = regular_step(np.asarray(data[clock]), options.tolerance, first_row, source)
    dt = settled_step(found, options, source)
    time = np.arange(steps, dtype=np.float64) * dt if clock is None else np.asarray(data[clock], dtype=np.float64)
    n_missing = int((~np.isfinite(u)).sum() + (~np.isfinite(y)).sum())
    return Recording(time, u, y, dt, source, dict(chosen), n_missing, origin)
