"""Spark on two worker processes gives the alarms of one process, after restarts, resharding and killed workers too."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("pyspark", reason="PySpark is not installed (make test-cluster)")

import pyarrow as pa
import pyarrow.parquet as pq

from cluster_examples import PLANTS, SAMPLES, expected, in_order, monitor, part
from residua.cluster import EVENT_COLUMNS, Shard, packed_table, shard_of
from residua.cluster.spark import diagnose_batch, diagnose_stream, resharded, shard_states
from residua.errors import DataError, FileFormatError

SCHEMA = "plant BIGINT, start BIGINT, samples BIGINT, `values` ARRAY<DOUBLE>"
#: Where the recordings are cut into files.
CUTS = (0, 50, 64, SAMPLES)
#: When the first file says that it was written; each further one a second later.
WRITTEN = 1_700_000_000
#: Generations from a Python worker up to its executor.
EXECUTOR = 2


def write(folder: Path, *numbers: int, extra: pa.Table | None = None) -> None:
    """Write files of packed rows, each with a stretch of time of all plants."""
    folder.mkdir(exist_ok=True)
    for number in numbers:
        start, stop = CUTS[number : number + 2]
        table = packed_table(monitor(), part(start, stop), samples=9, start=start)
        rows = np.random.default_rng(number).permutation(len(table))
        table = table.take(rows)
        path = folder / f"{number}.parquet"
        pq.write_table(table if extra is None else pa.concat_tables([table, extra]), path)
        # Spark takes files by the time of their last change, and two that are written at once may have the same.
        os.utime(path, (WRITTEN + number, WRITTEN + number))


def bad_rows() -> pa.Table:
    """Return a record of an unknown plant, of another width, and one without a plant."""
    values = [[0.0] * 3, [0.0], [0.0] * 3]
    columns = {"plant": [999, 100, None], "start": [0, 0, 0], "samples": [1, 1, 1], "values": values}
    return pa.table(columns, schema=packed_table(monitor(), part(0, 1)).schema)


def events(rows: list[Any]) -> list[tuple[Any, ...]]:
    """Return the events among rows, as they are compared."""
    names = ("plant", "sample", "kind", "onset", "raised", "ended")
    made = [(*(row[n] for n in names), tuple(row.names), tuple(row.scores)) for row in rows if row.kind != "aside"]
    return in_order(made)


def causes(rows: list[Any]) -> list[str]:
    return sorted(row.cause for row in rows if row.kind == "aside")


def to_its_end(writer: Any, tries: int = 5) -> None:
    """Run a query until it has done all.

    Spark gives a Python process ten seconds to start before the first micro-batch, too few on a busy machine:
    the query is started again then.
    """
    for left in reversed(range(tries)):
        try:
            writer.start().awaitTermination()
        except Exception as error:
            if not left or "failed to connect back" not in str(error):
                raise
        else:
            return


def run_stream(
    spark: Any,
    source: Path,
    out: Path,
    shards: int,
    watched: Any = None,
    after: Any = None,
    **more: Any,
) -> None:
    """Run a stream over the files that are there and not done yet, a file in a micro-batch."""
    frame = spark.readStream.schema(SCHEMA).option("maxFilesPerTrigger", 1).parquet(str(source))
    made = diagnose_stream(frame, watched or monitor(), shards, **more)
    if after is not None:
        made = made.mapInPandas(after, made.schema)
    writer = made.writeStream.format("parquet").option("path", str(out)).option("checkpointLocation", f"{out}.state")
    to_its_end(writer.trigger(availableNow=True))


def test_a_batch_gives_the_events_of_one_process(spark: Any, tmp_path: Path) -> None:
    """Whatever the number of partitions; what cannot be a record is put aside, and the job goes on."""
    write(tmp_path / "in", 0, 1, 2, extra=bad_rows())
    frame = spark.read.schema(SCHEMA).parquet(str(tmp_path / "in"))
    known = range(100, 100 + PLANTS)
    for partitions in (1, 3):
        made = diagnose_batch(frame, monitor(), partitions, plants=known)
        assert made.columns == list(EVENT_COLUMNS)
        rows = made.collect()
        assert events(rows) == expected()
        assert causes(rows) == sorted(["unknown plant", "width", "incomplete"] * 3)


def test_a_batch_survives_a_killed_worker(spark: Any, tmp_path: Path, ends_worker: Any, ended: Any) -> None:
    """Nothing is lost and nothing doubled."""
    write(tmp_path / "in", 0, 1, 2)
    end = ends_worker(EXECUTOR)

    def after(parts: Iterator[Any]) -> Iterator[Any]:
        for one in parts:
            end()
            yield one

    made = diagnose_batch(spark.read.schema(SCHEMA).parquet(str(tmp_path / "in")), monitor(), 3)
    made.mapInPandas(after, made.schema).write.parquet(str(tmp_path / "out"))
    assert ended()
    assert events(spark.read.parquet(str(tmp_path / "out")).collect()) == expected()


def test_a_stream_gives_the_events_of_one_process(spark: Any, tmp_path: Path) -> None:
    """After a restart from its checkpoint, and with another number of shards, too."""
    source, out = tmp_path / "in", tmp_path / "out"
    write(source, 0, extra=bad_rows())
    run_stream(spark, source, out, 3, plants=range(100, 100 + PLANTS))
    write(source, 1)
    run_stream(spark, source, out, 3, checkpoint=f"{out}.state")
    states = shard_states(spark, f"{out}.state")
    kept = {row.shard: Shard(monitor(), shards=3).restored(row.content).ids for row in states.collect()}
    assert sorted(kept) == [0, 1, 2]
    assert all(shard_of(plant, 3) == shard for shard, ids in kept.items() for plant in ids)  # Spark's hash is ours
    write(tmp_path / "in more", 2)
    more = tmp_path / "out more"
    run_stream(spark, tmp_path / "in more", more, 5, states=resharded(states, monitor(), 3, 5))
    rows = [row for folder in (out, more) for row in spark.read.parquet(str(folder)).collect()]
    assert causes(rows) == ["incomplete", "unknown plant", "width"]
    assert events(rows) == expected()
    # the checkpoint of another monitor, or of another number of shards
    write(source, 2)
    of_another = "of another monitor, or of other thresholds"
    for watched, shards, said in ((monitor(5.0), 3, of_another), (monitor(), 4, "one of 3 shards")):
        with pytest.raises(FileFormatError, match=said):
            run_stream(spark, source, out, shards, watched, checkpoint=f"{out}.state")
    with pytest.raises(Exception, match=of_another):
        run_stream(spark, source, out, 3, monitor(5.0))
    run_stream(spark, source, out, 3)  # nothing was done to it: it goes on
    assert events(spark.read.parquet(str(out)).collect()) == expected()


def test_a_stream_survives_a_killed_worker(spark: Any, tmp_path: Path, ends_worker: Any, ended: Any) -> None:
    """The executor ends while events are on their way out of its shards, in a later micro-batch than the first."""
    source, out, end = tmp_path / "in", tmp_path / "out", ends_worker(EXECUTOR)
    write(source, 0, 1, 2)

    def after(parts: Iterator[Any]) -> Iterator[Any]:
        for one in parts:
            if (one["sample"] >= CUTS[1]).any():
                end()
            yield one

    run_stream(spark, source, out, 6, after=after)
    assert ended()
    assert events(spark.read.parquet(str(out)).collect()) == expected()


def test_a_frame_with_other_columns_is_refused(spark: Any) -> None:
    with pytest.raises(DataError, match="lacks start"):
        diagnose_batch(spark.createDataFrame([], "plant STRING, samples INT, `values` ARRAY<DOUBLE>"), monitor())
    wrong = "plant STRING, start INT, samples INT, `values` ARRAY<FLOAT>"
    with pytest.raises(DataError, match="'values' must be array<double>, got 'array<float>'"):
        diagnose_batch(spark.createDataFrame([], wrong), monitor())
