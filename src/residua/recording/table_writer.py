"""Writing named columns to files."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from residua.errors import DataError, FileFormatError, missing_extra
from residua.files import replacing
from residua.visible import echo

#: Rows that are written at once; of a Parquet file as one group.
_ROWS = 1 << 16


def check_table(path: str | Path) -> None:
    """Raise :class:`DataError` unless residuals can be written under such a name."""
    if Path(path).suffix.lower() not in (".csv", ".parquet"):
        raise DataError(f"{path}: residuals are written as .csv or .parquet, by the ending of the name")


def write_table(path: str | Path, columns: Mapping[str, Iterable[float] | NDArray]) -> Path:
    """Write named columns to a .csv or .parquet file.

    Numbers in CSV come back to the last bit; NaN is an empty cell, true and false are 1 and 0. The file
    appears whole or not at all.

    Parameters
    ----------
    path : str or Path
        The ending of the name tells the format.
    columns : mapping of str to array_like, shape (T,)

    Returns
    -------
    Path
        Where it was written.

    Raises
    ------
    FileFormatError
        If the ending is another one, or the folder does not exist or must not be written to.
    DataError
        If the columns differ in length.
    MissingExtraError
        If writing Parquet needs pyarrow and it is not installed.
    """
    path = Path(path)
    arrays = {name: np.asarray(column) for name, column in columns.items()}
    lengths = {name: len(column) for name, column in arrays.items()}
    if len(set(lengths.values())) > 1:
        raise DataError(f"the columns differ in length: {lengths}")
    suffix = path.suffix.lower()
    if suffix == ".csv":
        with replacing(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
            csv.writer(file, lineterminator="\n").writerow(arrays)
            for start in range(0, max(lengths.values(), default=0), _ROWS):
                parts = [_cells(column[start : start + _ROWS]) for column in arrays.values()]
                file.writelines(",".join(row) + "\n" for row in zip(*parts, strict=True))
    elif suffix == ".parquet":
        try:
            import pyarrow
            import pyarrow.parquet as parquet
        except ImportError as error:
            raise missing_extra("pyarrow", "parquet") from error
        with (
            replacing(path) as temporary,
            parquet.ParquetWriter(temporary, pyarrow.table({n: a[:0] for n, a in arrays.items()}).schema) as writer,
        ):
            for start in range(0, max(1, max(lengths.values(), default=0)), _ROWS):
                part = {name: array[start : start + _ROWS] for name, array in arrays.items()}
                writer.write_table(pyarrow.table(part))
    else:
        raise FileFormatError(f"{path.name}: tables are written as .csv or .parquet, not {echo(suffix)}")
    return path


def _cells(values: NDArray) -> list[str]:
    if values.dtype.kind == "b":
        return ["1" if value else "0" for value in values.tolist()]
    return ["" if value != value else repr(value) for value in values.tolist()]
