"""Recordings larger than memory: time and peak memory of ``residua run`` on CSV and Parquet, beside bare reading.

Run ``python benchmarks/large_recordings.py [rows of CSV] [rows of Parquet]``; the issue asks for a CSV file of 1e6 rows
in twice ``pyarrow.csv`` plus ``Monitor.run``, and for 1e7 rows of Parquet in 300 MB. Medians of interleaved rounds.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

import residua as rs

ROUNDS = 3
#: Runs a command and prints its wall time and the peaks of its memory: all of it, and without what is mapped of files.
_WATCH = """
import json, os, subprocess, sys, time
began = time.perf_counter()
child = subprocess.Popen(sys.argv[1:], stdout=subprocess.DEVNULL)
most = own = 0
while child.poll() is None:
    try:
        lines = dict(line.split(":", 1) for line in open(f"/proc/{child.pid}/status"))
        most = max(most, int(lines["VmHWM"].split()[0]))
        own = max(own, int(lines["RssAnon"].split()[0]))
    except (OSError, KeyError, ValueError):
        pass
    time.sleep(0.005)
print(json.dumps([time.perf_counter() - began, most / 1024, own / 1024, child.returncode]))
"""


def plant() -> rs.Plant:
    """Return a plant with 4 states, 2 inputs and 3 outputs, sampled."""
    rng = np.random.default_rng(3)
    A = np.diag([0.9, 0.8, 0.7, 0.6]) + 0.05 * rng.standard_normal((4, 4))
    made = rs.Plant(A, rng.standard_normal((4, 2)), rng.standard_normal((3, 4)), dt=0.1, inputs=["u1", "u2"])
    return made.with_sensor_faults().with_noise(process=1e-2, measurement=1e-2)


def rows(count: int, start: int, made: rs.Plant, alarm: int) -> dict[str, np.ndarray]:
    """Return rows of a recording, with noise for every channel, and a fault from one sample on."""
    rng = np.random.default_rng(start + 1)
    y = 0.02 * rng.standard_normal((count, 3))
    y[max(0, alarm - start) :, 0] += 30.0
    at = np.arange(start, start + count)
    return {"time": at * 0.1, "u1": np.zeros(count), "u2": np.zeros(count)} | dict(zip(made.outputs, y.T, strict=True))


def write(folder: Path, made: rs.Plant, csv_rows: int, parquet_rows: int) -> tuple[Path, Path]:
    """Write both files, the second one piece by piece."""
    table = folder / "table.csv"
    pyarrow.csv.write_csv(pa.table(rows(csv_rows, 0, made, csv_rows // 2)), table)
    large, writer = folder / "large.parquet", None
    for start in range(0, parquet_rows, 1_000_000):
        count = min(1_000_000, parquet_rows - start)
        part = pa.table(rows(count, start, made, parquet_rows // 3))
        writer = writer or pyarrow.parquet.ParquetWriter(large, part.schema)
        writer.write_table(part)
    assert writer is not None
    writer.close()
    return table, large


def watched(*arguments: str) -> list[float]:
    """Return wall time in seconds, peak memory and peak of its own memory in MB, of the command line."""
    command = [sys.executable, "-m", "residua", *arguments]
    told = subprocess.run([sys.executable, "-c", _WATCH, *command], capture_output=True, text=True, check=True)
    out = json.loads(told.stdout)
    assert out[3] in (0, 1), told.stderr
    return out[:3]


def timed(work: object) -> float:
    began = time.perf_counter()
    work()  # pyright: ignore
    return time.perf_counter() - began


def timed_run(monitor: rs.Monitor, path: Path, made: rs.Plant) -> float:
    """Return the seconds of a run over a recording in memory."""
    recording = rs.read_recording(path, made)
    return timed(lambda: monitor.run(recording))


def main() -> None:
    csv_rows, parquet_rows = (int(float(one)) for one in (sys.argv[1:3] if len(sys.argv) > 2 else ("1e6", "1e7")))
    made = plant()
    monitor = rs.Monitor(rs.design.kalman_filter(made))
    with tempfile.TemporaryDirectory(dir=os.environ.get("TMPDIR")) as name:
        folder = Path(name)
        table, large = write(folder, made, csv_rows, parquet_rows)
        saved = folder / "monitor.json"
        monitor.save(saved)
        times: dict[str, list[float]] = {"pyarrow.csv": [], "Monitor.run": [], "residua run": [], "start": []}
        for _ in range(ROUNDS):
            times["pyarrow.csv"].append(timed(lambda: pyarrow.csv.read_csv(table)))
            times["Monitor.run"].append(timed_run(monitor, table, made))
            times["residua run"].append(watched("run", str(saved), str(table))[0])
            times["start"].append(watched("--version")[0])
        middle = {what: statistics.median(values) for what, values in times.items()}
        print(
            f"CSV, {csv_rows} rows, {table.stat().st_size / 1e6:.0f} MB:", {k: round(v, 2) for k, v in middle.items()}
        )
        share = (middle["residua run"] - middle["start"]) / (middle["pyarrow.csv"] + middle["Monitor.run"])
        print(f"  residua run: {share:.2f} times pyarrow.csv plus Monitor.run, without the start of the program")
        batches = timed(lambda: [None for _ in pyarrow.parquet.ParquetFile(large).iter_batches(65_536)])
        print(f"Parquet, {parquet_rows} rows: iter_batches {batches:.2f} s")
        outputs = {
            "nothing written": [],
            "residuals": ["--residuals", str(folder / "out.parquet")],
            "page": ["--report", str(folder / "out.html")],
        }
        for what, options in outputs.items():
            wall, most, own = watched("run", str(saved), str(large), *options)
            print(f"  {what}: {wall:.1f} s, peak {most:.0f} MB, of its own {own:.0f} MB")


if __name__ == "__main__":
    main()
