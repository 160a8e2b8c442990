"""What a Spark stream costs, keyed by shard and keyed by plant, and by sizes of shards and of micro-batches.

``python benchmarks/cluster_shards.py --out docs/data`` writes ``cluster_keys.csv``, ``cluster_sizes.csv`` and what
follows from these, ``cluster_hundred_million.csv``. The stream is on one machine, ``local-cluster`` with two workers of
one core; its source are Parquet files of packed rows, made here, a file for each micro-batch. Seconds are medians over
whole micro-batches (``triggerExecution`` of Spark's progress), the first of each run, in which processes start, left
out. Core-seconds are those that all processes of Spark and Python took meanwhile, which other work on the machine
changes little; those of one process are the least of three.
"""

from __future__ import annotations

import argparse
import csv
import os
import shutil
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import residua as rs
from residua.cluster import PackedRows, Shard, packed_table

SCHEMA = "plant BIGINT, start BIGINT, samples BIGINT, `values` ARRAY<DOUBLE>"
#: As many shards as this put nearly every plant in a shard of its own.
BY_PLANT = (1 << 31) - 1
#: Channels of the monitor.
CHANNELS = 3
#: Seconds between two looks at a running query.
LOOK = 0.05


class Run(NamedTuple):
    """What the micro-batches of a stream took, the first one left out, and how many events there were."""

    seconds: list[float]
    core_seconds: list[float]
    events: int


def monitor() -> rs.Monitor:
    """Return a monitor with four states, one input and two outputs."""
    A = np.diag([0.9, 0.8, 0.7, 0.6]) + np.diag([0.1, 0.1, 0.1], 1)
    plant = rs.Plant(A, np.ones((4, 1)) * 0.1, np.array([[1.0, 0, 1, 0], [0, 1.0, 0, 1]]), dt=1.0)
    plant = plant.with_sensor_faults().with_noise(process=1e-4, measurement=1e-2)
    return rs.Monitor(rs.design.kalman_filter(plant), test=rs.decide.NormThreshold(threshold=6.0, persistence=3))


def write_files(folder: Path, watched: rs.Monitor, plants: int, samples: int, files: int) -> None:
    """Write so many files, in each so many samples of every plant in one row; one plant in a hundred fails."""
    import pyarrow.parquet as pq

    folder.mkdir()
    rng = np.random.default_rng(0)
    for k in range(files):
        y = rng.standard_normal((plants, samples, 2)) * 0.1
        if k >= files // 2:
            y[::100, :, 0] += 3.0
        u = np.zeros((samples, 1))
        table = packed_table(watched, {p: (u, y[p]) for p in range(plants)}, samples=samples, start=k * samples)
        pq.write_table(table, folder / f"{k:03d}.parquet")


def session(memory: str = "2g") -> Any:
    from pyspark.sql import SparkSession

    os.environ |= {"SPARK_LOCAL_IP": "127.0.0.1", "SPARK_LOCAL_HOSTNAME": "localhost", "PYSPARK_PYTHON": sys.executable}
    settings = {
        "spark.ui.enabled": "false",
        "spark.driver.host": "127.0.0.1",
        "spark.driver.bindAddress": "127.0.0.1",
        "spark.executor.memory": memory,
        "spark.sql.shuffle.partitions": "2",
        "spark.sql.streaming.numRecentProgressUpdates": "1000",
    }
    builder = SparkSession.builder.master(f"local-cluster[2,1,{3 * 1024}]").appName("cluster_shards")  # pyright: ignore
    for name, value in settings.items():
        builder = builder.config(name, value)
    return builder.getOrCreate()


def core_seconds() -> float:
    """Return the seconds of a core that all processes took that this one has started, ended ones included."""
    parents, spent = {}, {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                fields = (entry / "stat").read_text().rpartition(")")[2].split()
            except OSError:  # it has ended
                continue
            parents[int(entry.name)], spent[int(entry.name)] = int(fields[1]), sum(map(int, fields[11:15]))
    own, more = set(), {os.getpid()}
    while more:
        more = {process for process, parent in parents.items() if parent in more}
        own |= more
    return sum(spent[process] for process in own) / os.sysconf("SC_CLK_TCK")


def watched_to_its_end(query: Any) -> dict[int, float]:
    """Wait for the end of a query, and return the core-seconds spent at the end of each micro-batch."""
    spent: dict[int, float] = {}
    while query.isActive:
        last = query.lastProgress
        if last is not None and last["numInputRows"]:
            spent.setdefault(last["batchId"], core_seconds())
        time.sleep(LOOK)
    query.awaitTermination()
    return spent


def to_its_end(writer: Any, tries: int = 5) -> tuple[list[Any], dict[int, float]]:
    """Run a query until it has done all, and return its progress, and core-seconds by micro-batch.

    Spark gives a Python process ten seconds to start, too few on a busy machine: the query is started again then.
    """
    for left in reversed(range(tries)):
        query = writer.start()
        try:
            spent = watched_to_its_end(query)
        except Exception as error:
            if not left or "failed to connect back" not in str(error):
                raise
        else:
            return [one for one in query.recentProgress if one["numInputRows"]], spent
    raise AssertionError


def stream(spark: Any, folder: Path, watched: rs.Monitor, shards: int) -> Run:
    """Run a stream over the files, one in a micro-batch."""
    from residua.cluster.spark import diagnose_stream

    with tempfile.TemporaryDirectory() as kept:
        frame = spark.readStream.schema(SCHEMA).option("maxFilesPerTrigger", 1).parquet(str(folder))
        writer = diagnose_stream(frame, watched, shards).writeStream.format("parquet").option("path", f"{kept}/out")
        done, spent = to_its_end(writer.option("checkpointLocation", f"{kept}/state").trigger(availableNow=True))
        events = spark.read.parquet(f"{kept}/out").where("kind != 'aside'").count()
    seconds = [one["durationMs"]["triggerExecution"] / 1e3 for one in done]
    pairs = [(spent[one["batchId"] - 1], spent[one["batchId"]]) for one in done[1:-1]]  # after the last one all ends
    made = Run(seconds[1:], [after - before for before, after in pairs], events)
    print(shards, *made, flush=True)
    return made


def keys(spark: Any, plants: int, samples: int, files: int, shards: int) -> list[dict[str, Any]]:
    """Return what a micro-batch takes keyed by shard and keyed by plant, in turn in the same session, twice."""
    watched, rows = monitor(), []
    with tempfile.TemporaryDirectory() as folder:
        write_files(Path(folder) / "in", watched, plants, samples, files)
        runs: dict[str, list[Run]] = {"shard": [], "plant": []}
        for _ in range(2):
            for key, number in (("shard", shards), ("plant", BY_PLANT)):
                runs[key].append(stream(spark, Path(folder) / "in", watched, number))
    assert len({run.events for both in runs.values() for run in both}) == 1
    times = {key: [one for run in both for one in run.seconds] for key, both in runs.items()}
    for key, number in (("shard", shards), ("plant", plants)):
        middle = float(np.median(times[key]))
        rows.append(
            {
                "key": key,
                "states": number,
                "plants": plants,
                "samples of each in a micro-batch": samples,
                "seconds": f"{middle:.2f}",
                "core-seconds": f"{float(np.median([one for run in runs[key] for one in run.core_seconds])):.2f}",
                "plants in a second": f"{plants / middle:.0f}",
                "times as fast": f"{float(np.median(times['plant'])) / middle:.1f}",
            }
        )
    return rows


def alone(watched: rs.Monitor, plants: int, samples: int) -> dict[str, float]:
    """Return seconds of one process for a shard of so many plants: restored, run, and as bytes; and these bytes."""
    rng = np.random.default_rng(0)
    u, y = np.zeros((samples, 1)), rng.standard_normal((plants, samples, 2)) * 0.1
    table = packed_table(watched, {p: (u, y[p]) for p in range(plants)})
    shard = Shard(watched)
    rows = PackedRows.of_arrow(table)
    shard.take(rows)
    best = {"restore": np.inf, "run": np.inf, "snapshot": np.inf}
    content = shard.to_bytes()
    for _ in range(3):
        start = time.process_time()
        again = Shard(watched).restored(content)
        best["restore"] = min(best["restore"], time.process_time() - start)
        later = PackedRows(rows.plants, rows.start + samples, rows.samples, rows.values, rows.offsets, rows.complete)
        start = time.process_time()
        again.take(later)
        best["run"] = min(best["run"], time.process_time() - start)
        start = time.process_time()
        again.to_bytes()
        best["snapshot"] = min(best["snapshot"], time.process_time() - start)
    return best | {"bytes": len(content) / plants}


def sizes(spark: Any, cases: list[tuple[int, int, int]], files: int) -> list[dict[str, Any]]:
    """Return what micro-batches take for (plants, plants in a shard, samples of each)."""
    watched, rows = monitor(), []
    made: dict[tuple[int, int], Path] = {}
    with tempfile.TemporaryDirectory() as folder:
        for plants, in_shard, samples in cases:
            source = made.setdefault((plants, samples), Path(folder) / f"{plants} {samples}")
            if not source.exists():
                write_files(source, watched, plants, samples, files)
            run, one = stream(spark, source, watched, max(1, plants // in_shard)), alone(watched, in_shard, samples)
            middle = float(np.median(run.seconds))
            rows.append(
                {
                    "plants": plants,
                    "plants in a shard": in_shard,
                    "samples of each": samples,
                    "seconds of a micro-batch": f"{middle:.2f}",
                    "core-seconds of it": f"{float(np.median(run.core_seconds)):.2f}",
                    "plant-samples in a second": f"{plants * samples / middle:.0f}",
                    "bytes of a plant": f"{one['bytes']:.0f}",
                    "microseconds of a plant: restore": f"{one['restore'] / in_shard * 1e6:.2f}",
                    "run": f"{one['run'] / in_shard * 1e6:.2f}",
                    "snapshot": f"{one['snapshot'] / in_shard * 1e6:.2f}",
                }
            )
    return rows


def hundred_million(rows: list[dict[str, Any]], plants: int = 10**8, seconds: int = 60) -> list[dict[str, Any]]:
    """Return what many plants would need, a sample a second each, from the measured sizes.

    The cost of a plant is the slope between the smallest and the largest stream with the same shards and samples: what
    a micro-batch costs whatever its size does not count. A sample beyond ten costs what it costs from ten to a hundred.
    """
    same = [row for row in rows if int(row["plants in a shard"]) == 1000 and int(row["samples of each"]) == 10]
    small, large = (pick(same, key=lambda row: int(row["plants"])) for pick in (min, max))
    spent = "core-seconds of it"
    slope = (float(large[spent]) - float(small[spent])) / (int(large["plants"]) - int(small["plants"]))
    few = [row for row in rows if row["plants"] == small["plants"] and int(row["plants in a shard"]) == 1000]
    costs = {int(row["samples of each"]): float(row[spent]) / int(row["plants"]) for row in few}
    a_plant = slope + (costs[100] - costs[10]) / 90 * (seconds - 10)
    size = float(large["bytes of a plant"])
    shard = 10_000
    return [
        {"of": "plants", "value": f"{plants:,}"},
        {"of": "seconds between micro-batches", "value": f"{seconds}"},
        {"of": "microseconds of a core for a plant in a micro-batch", "value": f"{a_plant * 1e6:.0f}"},
        {"of": "cores, all of them busy", "value": f"{np.ceil(plants * a_plant / seconds):.0f}"},
        {"of": f"shards of {shard:,} plants", "value": f"{plants // shard:,}"},
        {"of": "bytes of a plant", "value": f"{size:.0f}"},
        {"of": "megabytes of a shard", "value": f"{size * shard / 1e6:.1f}"},
        {"of": "gigabytes of state", "value": f"{size * plants / 1e9:.0f}"},
        {"of": "megabytes of state written in a second", "value": f"{size * plants / seconds / 1e6:.0f}"},
        {"of": "megabytes of samples that come in a second", "value": f"{plants * CHANNELS * 8 / 1e6:.0f}"},
    ]


def write_csv(path: Path, rows: list[dict[str, Any]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        table.writeheader()
        table.writerows(rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/data"))
    parser.add_argument("--plants", type=int, default=20_000, help="of the larger comparison of keys")
    parser.add_argument("--most", type=int, default=100_000, help="plants of the largest stream")
    parser.add_argument("--files", type=int, default=6, help="micro-batches of a stream, three or more")
    parser.add_argument("--only", choices=["keys", "sizes"])
    given = parser.parse_args()
    if shutil.which("java") is None:
        parser.exit(1, "Spark needs Java\n")
    spark = session()
    most, few = given.most, given.most // 10
    if given.only != "sizes":
        made = [row for plants in (given.plants // 10, given.plants) for row in keys(spark, plants, 10, given.files, 8)]
        write_csv(given.out / "cluster_keys.csv", made)
    if given.only != "keys":
        cases = [(few, size, 10) for size in (10, 100, 1000, few // 2)] + [(few, 1000, n) for n in (1, 100)]
        cases += [(most, size, 10) for size in (1000, 10_000, most // 2)]
        made = sizes(spark, cases, given.files)
        write_csv(given.out / "cluster_sizes.csv", made)
        write_csv(given.out / "cluster_hundred_million.csv", hundred_million(made))
    spark.stop()


if __name__ == "__main__":
    main()
