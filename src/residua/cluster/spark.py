"""A monitor on Apache Spark: streams with their state in Spark's checkpoint, and batches; needs the extra ``spark``."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import Any

from residua.cluster.monitor_text import monitor_of_text, text_of_monitor
from residua.cluster.packed_rows import COLUMNS, PackedRows, checked_shards
from residua.cluster.shard import EVENT_COLUMNS, LONGEST_GAP, Shard, Taken
from residua.errors import DataError, missing_extra
from residua.monitor.monitor import Monitor
from residua.visible import echo, listed

_Base: Any = object
try:
    import pandas as pd  # pyright: ignore[reportMissingImports]
    from pyspark.errors import AnalysisException  # pyright: ignore[reportMissingImports]
    from pyspark.sql.streaming.stateful_processor import StatefulProcessor  # pyright: ignore[reportMissingImports]
except ImportError:
    pd: Any = None
    AnalysisException: Any = None
else:
    _Base = StatefulProcessor

#: State store of streams in Spark: the only one with values by name.
STATE_STORE = "org.apache.spark.sql.execution.streaming.state.RocksDBStateStoreProvider"
_STORE_SETTING = "spark.sql.streaming.stateStore.providerClass"
#: The value that a shard keeps, and its type.
_STATE, _STATE_TYPE = "residua", "content BINARY"
_STATES_TYPE = "shard INT, content BINARY"


def diagnose_stream(
    frame: Any,
    monitor: Monitor,
    shards: int,
    *,
    plants: Collection[Any] | None = None,
    longest_gap: int = LONGEST_GAP,
    states: Any = None,
    checkpoint: str | None = None,
) -> Any:
    """Return the events of alarms of a stream of packed rows, as a stream.

    Parameters
    ----------
    frame : pyspark.sql.DataFrame
        A stream with the columns of packed rows: ``plant`` (text or whole number), ``start``, ``samples`` (whole
        numbers) and ``values`` (array of doubles); see :class:`residua.cluster.PackedRows`.
    monitor : Monitor
        Fitted. It travels as its record in JSON.
    shards : int
        How many blobs of state there are; the same as long as a checkpoint is used.
    plants : collection of ids, optional
        Those that are known; records of others are put aside. When omitted, a plant begins with its first record.
    longest_gap : int
        Samples that did not come count as missing, as far as this; a record that is further ahead is put aside.
    states : pyspark.sql.DataFrame, optional
        With which a new checkpoint begins: :func:`shard_states` of another one, by :func:`resharded`.
    checkpoint : str, optional
        The folder that will be the ``checkpointLocation``: a state of another monitor in it is refused here and now.

    Returns
    -------
    pyspark.sql.DataFrame
        A stream with the columns of :data:`residua.cluster.EVENT_COLUMNS`: ``kind`` is ``raised``, ``ended``, or
        ``aside`` for a record that was put aside, with its ``cause`` and ``reason``.

    Raises
    ------
    DataError
        If the frame has other columns.
    NotFittedError
        If the monitor has no threshold.
    FileFormatError
        If the checkpoint is of another monitor, or of another number of shards.
    MissingExtraError
        If PySpark is not installed.

    Notes
    -----
    Within a micro-batch rows may come in any order; across micro-batches a row that comes after later ones of its plant
    is put aside as ``late``. The session is set to the state store that this needs, RocksDB.

    Without ``checkpoint=``, one of another monitor or number of shards stops the query with the first micro-batch that
    has a row for a state in it; that micro-batch is not applied, in no part.
    """
    _check_installed()
    text, whole = text_of_monitor(monitor), _check_columns(frame)
    shards = checked_shards(shards)
    frame.sparkSession.conf.set(_STORE_SETTING, STATE_STORE)
    # A record without a plant, which is put aside there, goes to the first shard.
    shard = f"CAST(coalesce(pmod(crc32(CAST(plant AS STRING)), {shards}), 0) AS INT) AS shard"
    # As text, for in pandas a column of whole numbers with an empty entry becomes floats, which are not exact.
    keyed = frame.selectExpr(shard, "CAST(plant AS STRING) AS plant", *(f"`{name}`" for name in COLUMNS[1:]))
    if checkpoint is not None:
        _check_checkpoint(frame.sparkSession, checkpoint, Shard(monitor, shards=shards))
    settings = {"shards": shards, "plants": None if plants is None else frozenset(plants), "longest_gap": longest_gap}
    processor = ShardProcessor(text, whole, settings)
    return keyed.groupBy("shard").transformWithStateInPandas(
        processor,
        outputStructType=_event_type(whole),
        outputMode="Append",
        timeMode="None",
        initialState=None if states is None else states.select("shard", "content").groupBy("shard"),
    )


class ShardProcessor(_Base):
    """Processor run by Spark for each shard with rows in a micro-batch: state in, rows through, state out."""

    def __init__(self, text: str, whole: bool, settings: dict[str, Any]) -> None:
        self._text, self._whole, self._settings = text, whole, settings
        self._state: Any = None

    def init(self, handle: Any) -> None:
        """Store the handle of the state."""
        self._state = handle.getValueState(_STATE, _STATE_TYPE)

    def _blank(self) -> Shard:
        return Shard(monitor_of_text(self._text), **self._settings)

    def handleInputRows(self, key: Any, rows: Iterator[Any], timerValues: Any) -> Iterator[Any]:
        """Process the rows of a shard, all of the micro-batch at once."""
        shard, kept = self._blank(), self._state.get() if self._state.exists() else None
        if kept is not None:
            shard = shard.restored(kept[0])
        taken = shard.take(PackedRows.joined([self._rows(part) for part in rows]))
        self._state.update((shard.to_bytes(),))
        if taken:
            yield pd.DataFrame(taken.columns(), dtype=object)

    def _rows(self, part: Any) -> PackedRows:
        columns = {name: part[name] for name in COLUMNS}
        if self._whole:
            columns["plant"] = [None if plant is None else int(plant) for plant in part["plant"]]
        return PackedRows.of_columns(columns)

    def handleInitialState(self, key: Any, initialState: Any, timerValues: Any) -> None:
        """Start with the states of another checkpoint, in one part or in several."""
        blank = self._blank()
        parts = [blank.restored(content) for content in initialState["content"]]
        if self._state.exists():
            parts.append(blank.restored(self._state.get()[0]))
        self._state.update((Shard.joined(parts).to_bytes(),))


def diagnose_batch(
    frame: Any,
    monitor: Monitor,
    partitions: int | None = None,
    *,
    plants: Collection[Any] | None = None,
    longest_gap: int = LONGEST_GAP,
) -> Any:
    """Return the events of alarms of a table of packed rows.

    The rows are brought together by plant (``repartition``), sorted (``sortWithinPartitions``) and run in a single pass
    (``mapInArrow``); only the plant at hand is remembered.

    Parameters
    ----------
    frame : pyspark.sql.DataFrame
        As of :func:`diagnose_stream`, but no stream.
    monitor : Monitor
    partitions : int, optional
        Over which the plants are divided; as many as Spark takes for a shuffle when omitted.
    plants, longest_gap
        As of :func:`diagnose_stream`.

    Returns
    -------
    pyspark.sql.DataFrame
        As of :func:`diagnose_stream`: the same events that the stream would give, in no order.

    Raises
    ------
    DataError, NotFittedError, MissingExtraError
        As of :func:`diagnose_stream`.
    """
    _check_installed()
    text, whole = text_of_monitor(monitor), _check_columns(frame)
    known = None if plants is None else frozenset(plants)
    number = () if partitions is None else (checked_shards(partitions),)

    def run(batches: Iterator[Any]) -> Iterator[Any]:
        shard = Shard(monitor_of_text(text), plants=known, longest_gap=longest_gap)
        for taken in run_sorted(shard, batches):
            if taken:
                yield from taken.arrow(whole).to_batches()

    together = frame.select(*COLUMNS).repartition(*number, "plant").sortWithinPartitions("plant", "start")
    return together.mapInArrow(run, _event_type(whole))


def run_sorted(shard: Shard, batches: Iterator[Any]) -> Iterator[Taken]:
    """Process batches of rows sorted by plant; a plant is removed when the next one begins."""
    for batch in batches:
        rows = PackedRows.of_arrow(batch)
        yield shard.take(rows)
        if len(rows):
            shard.keep({rows.plants[-1]})


def shard_states(spark: Any, checkpoint: str) -> Any:
    """Return the states in the checkpoint of a stream that has stopped, as a table of (shard, content).

    Parameters
    ----------
    spark : pyspark.sql.SparkSession
    checkpoint : str
        The folder that was the ``checkpointLocation``.

    Returns
    -------
    pyspark.sql.DataFrame
        To be written anywhere as a snapshot, or to go on with: ``diagnose_stream(..., states=...)``.
    """
    _check_installed()
    spark.conf.set(_STORE_SETTING, STATE_STORE)
    reader = spark.read.format("statestore").option("path", checkpoint).option("stateVarName", _STATE)
    return reader.load().selectExpr("key.shard AS shard", "value.content AS content")


def resharded(states: Any, monitor: Monitor, before: int, shards: int) -> Any:
    """Return the states of some shards as those of another number of them.

    Parameters
    ----------
    states : pyspark.sql.DataFrame
        As of :func:`shard_states`.
    monitor : Monitor
        With which they ran.
    before, shards : int
        How many shards they are of, and how many they shall be of.

    Returns
    -------
    pyspark.sql.DataFrame
        Of (shard, content): parts of the new states, several for a shard, which ``diagnose_stream(..., states=...)``
        puts together. They stay on the workers.
    """
    _check_installed()
    text, before, shards = text_of_monitor(monitor), checked_shards(before), checked_shards(shards)

    def run(parts: Iterator[Any]) -> Iterator[Any]:
        blank = Shard(monitor_of_text(text), shards=before)
        for part in parts:
            for content in part["content"]:
                split = blank.restored(content).split(shards)
                yield pd.DataFrame({"shard": list(split), "content": [one.to_bytes() for one in split.values()]})

    return states.mapInPandas(run, _STATES_TYPE)


def _check_checkpoint(spark: Any, checkpoint: str, blank: Shard) -> None:
    """Raise if a checkpoint with commits holds the state of other shards."""
    try:
        committed = not spark.read.text(f"{checkpoint}/commits").isEmpty()
    except AnalysisException as error:
        if error.getCondition() != "PATH_NOT_FOUND":
            raise
        return
    if committed:
        for row in shard_states(spark, checkpoint).limit(1).collect():
            blank.restored(row["content"])


def _event_type(whole: bool) -> str:
    types = EVENT_COLUMNS | ({"plant": "bigint"} if whole else {})
    return ", ".join(f"{name} {kind}" for name, kind in types.items())


def _check_installed() -> None:
    if _Base is object:
        raise missing_extra("pyspark", "spark")


def _check_columns(frame: Any) -> bool:
    """Raise unless a frame has packed rows; return whether the ids are whole numbers."""
    types = dict(frame.dtypes)
    missing = [name for name in COLUMNS if name not in types]
    if missing:
        raise DataError(f"packed rows have the columns {listed(COLUMNS)}; this frame lacks {listed(missing)}")
    allowed = {
        "plant": ("string", "bigint", "int", "smallint", "tinyint"),
        "start": ("bigint", "int", "smallint", "tinyint"),
        "samples": ("bigint", "int", "smallint", "tinyint"),
        "values": ("array<double>",),
    }
    for name, kinds in allowed.items():
        if types[name] not in kinds:
            raise DataError(f"the column {name!r} must be {' or '.join(kinds)}, got {echo(types[name])}")
    return types["plant"] != "string"


__all__ = ["STATE_STORE", "diagnose_batch", "diagnose_stream", "resharded", "shard_states"]
