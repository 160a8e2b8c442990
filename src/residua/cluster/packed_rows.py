"""Packed rows, the input of a cluster: some consecutive samples of one plant in each."""

from __future__ import annotations

import zlib
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.decide.checks import check_samples
from residua.design.core.signals import stack_signals
from residua.errors import DataError, SettingError, missing_extra
from residua.monitor import Monitor
from residua.visible import echo, listed

#: Whole numbers below it are exact as floats.
EXACT = 1 << 53
#: The columns of a packed row.
COLUMNS = ("plant", "start", "samples", "values")


@dataclass(frozen=True, eq=False)
class PackedRows:
    """Packed rows as arrays.

    Attributes
    ----------
    plants : list
        Whose samples they are: whole numbers, or texts; ``None`` where nothing is said.
    start : ndarray of int, shape (rows,)
        The number of the first sample in the row. A plant counts its samples on a regular grid, its first one as 0.
    samples : ndarray of int, shape (rows,)
        How many there are.
    values : ndarray, shape (numbers,)
        Of all rows: sample after sample, in each the inputs, then the outputs, in plant units; NaN where missing.
    offsets : ndarray of int, shape (rows + 1,)
        Where in ``values`` each row begins.
    complete : ndarray of bool, shape (rows,)
        Where no column is null.
    """

    plants: list[Any]
    start: NDArray[np.int64]
    samples: NDArray[np.int64]
    values: NDArray[np.float64]
    offsets: NDArray[np.int64]
    complete: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.plants)

    def of(self, row: int) -> NDArray[np.float64]:
        """Return the numbers of a row."""
        return self.values[self.offsets[row] : self.offsets[row + 1]]

    @staticmethod
    def joined(parts: Sequence[PackedRows]) -> PackedRows:
        """Return rows concatenated."""
        if len(parts) == 1:
            return parts[0]
        sizes = np.concatenate([[0], *(np.diff(part.offsets) for part in parts)]).astype(np.int64)
        return PackedRows(
            [plant for part in parts for plant in part.plants],
            np.concatenate([np.zeros(0, dtype=np.int64), *(part.start for part in parts)]),
            np.concatenate([np.zeros(0, dtype=np.int64), *(part.samples for part in parts)]),
            np.concatenate([np.zeros(0), *(part.values[part.offsets[0] : part.offsets[-1]] for part in parts)]),
            np.cumsum(sizes),
            np.concatenate([np.zeros(0, dtype=bool), *(part.complete for part in parts)]),
        )

    @staticmethod
    def of_columns(columns: Mapping[str, Any]) -> PackedRows:
        """Return the rows of a data frame of pandas, or of a mapping from names of columns to arrays.

        ``values`` is a column of arrays, or an array of (rows, numbers).

        Raises
        ------
        DataError
            If a column is missing, or ``values`` came as texts, which Dask makes of arrays.
        """
        _check_columns(list(columns))
        if any(isinstance(one, str) for one in columns["values"]):
            raise DataError(
                "the column values holds texts in place of arrays of numbers; Dask makes them unless told not to: "
                'dask.config.set({"dataframe.convert-string": False})'
            )
        plants = [_plain(one) for one in columns["plant"]]
        start, has_start = _whole(columns["start"])
        samples, has_samples = _whole(columns["samples"])
        there = [one is not None and np.ndim(one) == 1 for one in columns["values"]]
        lists = [
            np.asarray(one, dtype=np.float64) if has else np.zeros(0)
            for one, has in zip(columns["values"], there, strict=True)
        ]
        offsets = np.cumsum([0, *map(len, lists)], dtype=np.int64)
        named = np.array([one is not None for one in plants], dtype=bool)
        values = np.concatenate([np.zeros(0), *lists])
        return PackedRows(
            plants, start, samples, values, offsets, named & has_start & has_samples & np.array(there, bool)
        )

    @staticmethod
    def of_arrow(table: Any) -> PackedRows:
        """Return the rows of a table or a record batch of Arrow, without copying numbers that are contiguous."""
        _check_columns(table.schema.names)
        columns = [table.column(table.schema.get_field_index(name)) for name in COLUMNS]
        plant, start, samples, values = (
            one.combine_chunks() if hasattr(one, "combine_chunks") else one for one in columns
        )
        complete = np.ones(len(plant), dtype=bool)
        for one in (plant, start, samples, values):
            if one.null_count:
                complete &= one.is_valid().to_numpy(zero_copy_only=False)
        numbers = values.values.cast("double").to_numpy(zero_copy_only=False)
        offsets = values.offsets.to_numpy().astype(np.int64)
        first, count = (one.fill_null(0).cast("int64").to_numpy() for one in (start, samples))
        return PackedRows(plant.to_pylist(), first, count, numbers, offsets, complete)


def _check_columns(names: Sequence[str]) -> None:
    missing = [name for name in COLUMNS if name not in names]
    if missing:
        raise DataError(f"packed rows have the columns {listed(COLUMNS)}; missing here: {listed(missing)}")


def _plain(plant: Any) -> Any:
    """Return an id as a number or text of Python, ``None`` if it is missing."""
    if isinstance(plant, (int, np.integer)) and not isinstance(plant, bool):
        return int(plant)
    if isinstance(plant, (float, np.floating)) and plant == np.floor(plant) and abs(plant) < EXACT:
        return int(plant)  # a column of whole numbers in which some are missing
    return str(plant) if isinstance(plant, str) else None


def _whole(column: Any) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return whole numbers, 0 for missing ones, and their mask."""
    array = np.asarray(column)
    if array.dtype.kind in "iu":
        return array.astype(np.int64), np.ones(len(array), dtype=bool)
    numbers = np.array([np.nan if one is None else one for one in column], dtype=np.float64)
    there = np.isfinite(numbers) & (numbers == np.floor(numbers)) & (np.abs(numbers) < 2.0**63)
    return np.where(there, numbers, 0).astype(np.int64), there


def shard_of(plant: Hashable, shards: int) -> int:
    """Return the number of the shard of a plant: the CRC-32 of its id, written as text, modulo the number of shards.

    The same on every machine and in every run, and the same as ``pmod(crc32(cast(plant AS STRING)), shards)`` in Spark.

    Parameters
    ----------
    plant : int or str
    shards : int

    Examples
    --------
    >>> from residua.cluster import shard_of
    >>> [shard_of(plant, 4) for plant in ("north", "south", 17)]
    [2, 0, 2]
    """
    return zlib.crc32(str(plant).encode()) % checked_shards(shards)


def checked_shards(shards: Any) -> int:
    """Return a number of shards, from 1 to 2^31 - 1."""
    check_samples(shards, "shards")
    if shards >= 1 << 31:
        raise SettingError(f"shards must be below 2^31, got {shards}")
    return int(shards)


def packed_table(
    monitor: Monitor,
    recordings: Mapping[Any, tuple[ArrayLike | None, ArrayLike]],
    *,
    samples: int = 1000,
    start: int | Mapping[Any, int] = 0,
) -> Any:
    """Return recordings as a table of Arrow of packed rows, for Spark, Ray, Dask and Parquet files.

    Parameters
    ----------
    monitor : Monitor
        Whose plant has the channels.
    recordings : mapping of int or str to (u, y)
        Of each plant, by its id: inputs (time, inputs), or ``None``, and outputs (time, outputs), in plant units.
    samples : int
        In a row, at most.
    start : int, or mapping of the ids to int
        The number of the first sample.

    Returns
    -------
    pyarrow.Table

    Raises
    ------
    DataError
        If a recording does not fit the plant.

    Examples
    --------
    >>> import numpy as np
    >>> import residua as rs
    >>> from residua.cluster import packed_table
    >>> plant = rs.Plant([[0.9]], [[0.1]], [[1.0]], dt=1, inputs=["valve"], outputs=["level"])
    >>> monitor = rs.Monitor(rs.design.kalman_filter(plant.with_noise(process=1e-4, measurement=1)))
    >>> table = packed_table(monitor, {"north": (np.ones((5, 1)), np.zeros((5, 1)))}, samples=3)
    >>> table.select(["plant", "start", "samples"]).to_pydict()
    {'plant': ['north', 'north'], 'start': [0, 3], 'samples': [3, 2]}
    """
    pa = pyarrow()
    check_samples(samples, "samples")
    ids = list(recordings)
    if not (all(type(one) is int for one in ids) or all(type(one) is str for one in ids)):
        raise DataError(f"the ids of plants must be all whole numbers, or all texts: {echo(ids)}")
    columns: dict[str, list[Any]] = {name: [] for name in COLUMNS}
    for plant, (u, y) in recordings.items():
        data = stack_signals(monitor.design.plant, u, y)
        if data.ndim != 2:
            raise DataError(f"the recording of {echo(plant)} must be (time, channels), got shape {data.shape}")
        number = start[plant] if isinstance(start, Mapping) else start
        for at in range(0, len(data), samples):
            part = data[at : at + samples]
            for name, value in zip(COLUMNS, (plant, number + at, len(part), part.ravel()), strict=True):
                columns[name].append(value)
    id_type = pa.string() if ids and type(ids[0]) is str else pa.int64()
    types = (id_type, pa.int64(), pa.int64(), pa.list_(pa.float64()))
    return pa.table({name: pa.array(columns[name], kind) for name, kind in zip(COLUMNS, types, strict=True)})


def pyarrow() -> Any:
    """Return the package of Arrow.

    Raises
    ------
    MissingExtraError
        If it is not installed.
    """
    try:
        import pyarrow as pa  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise missing_extra("pyarrow", "parquet") from error
    return pa


__all__ = ["COLUMNS", "EXACT", "PackedRows", "checked_shards", "packed_table", "pyarrow", "shard_of"]
