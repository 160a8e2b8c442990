"""Reading Parquet files, by pyarrow."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from residua.errors import FileFormatError, ResiduaError, missing_extra
from residua.recording.unpacked import too_large, unpacked_limit
from residua.visible import echo


def read_parquet(path: Path, wanted: Callable[[list[str]], list[str]]) -> dict[str, NDArray]:
    """Return columns of a Parquet file.

    Parameters
    ----------
    path : Path
    wanted : callable
        From the names of all columns to those that are read.

    Raises
    ------
    FileFormatError
        If it is none, or damaged, or its columns unpack to more than they may.
    MissingExtraError
        If pyarrow is not installed.
    """
    limit = unpacked_limit()
    try:
        import pyarrow.parquet as parquet
    except ImportError as error:
        raise missing_extra("pyarrow", "parquet") from error
    try:
        with parquet.ParquetFile(path) as file:
            names = wanted(list(file.schema_arrow.names))
            about = file.metadata
            packed = sum(about.row_group(k).total_byte_size for k in range(about.num_row_groups))
            if max(packed, about.num_rows * 8 * len(names)) > limit:  # a run of equal values takes no room
                raise too_large(path.name, limit)
            content = file.read(columns=names)
            return {name: np.asarray(content[name].to_numpy()) for name in names}
    except ResiduaError:
        raise
    except Exception as error:  # pyarrow's errors, and those of names and numbers that are none
        raise FileFormatError(
            f"{path.name}: not a readable Parquet file: {type(error).__name__}: {echo(str(error))}"
        ) from error
