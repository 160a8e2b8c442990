"""Reading Parquet files, by pyarrow."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from residua.errors import DataError, FileFormatError, ResiduaError, missing_extra
from residua.recording.columns import ReadOptions
from residua.recording.unpacked import too_large, unpacked_limit
from residua.visible import echo


def read_parquet(path: Path, options: ReadOptions) -> dict[str, NDArray]:
    """Return the columns of a Parquet file that channels and times are read from.

    Raises
    ------
    FileFormatError
        If it is none, or damaged, or its columns unpack to more than they may.
    MissingExtraError
        If pyarrow is not installed.
    """
    if options.matrix_names is not None:
        raise DataError("columns must be a mapping {channel: column} here: the file has named columns")
    limit = unpacked_limit()
    try:
        import pyarrow.parquet as parquet
    except ImportError as error:
        raise missing_extra("pyarrow", "parquet") from error
    try:
        with parquet.ParquetFile(path) as file:
            found = options.matched(list(file.schema_arrow.names), path.name)
            names = list(dict.fromkeys([*found.columns.values(), *filter(None, [found.clock])]))
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
