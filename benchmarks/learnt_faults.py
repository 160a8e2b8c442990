"""Tennessee Eastman: names of faults that were learnt from one recording each, on other recordings.

    .venv/bin/python benchmarks/learnt_faults.py --data FOLDER

FOLDER has ``d00.dat`` to ``d21_te.dat`` of the Braatz group; it writes ``docs/data/learnt_faults.csv``. Generators are
made from d00, their tests fitted to d00_te, both fault-free, at 1 % of samples in alarm, as in
``tennessee_eastman.py``. The faults 1, 2, 4, 5, 6, 7 and 14 are learnt from d01, d02, ..., each from its one recording
without its first 20 samples, and named on d01_te, d02_te, ..., from the row on where the fault begins: the share of
their samples in alarm that lie in alarms with the right name, with the name of another learnt fault, of a channel, or
with none. The last column is the share of the samples in alarm of the other faults, which nobody taught, that get the
name of a learnt one; of 3, 9 and 15, which hardly show, nothing is counted.
"""

from __future__ import annotations

import argparse
import csv
import os
from collections import Counter
from pathlib import Path
from typing import Any

from tennessee_eastman import HARD, RATE, START, diagnosed, recording

import residua as rs

OUTPUT = Path(__file__).resolve().parent.parent / "docs" / "data" / "learnt_faults.csv"
HEADER = ["monitor", "faults learnt", "right", "another learnt", "a channel", "unknown", "untaught, named as learnt"]
FAULTS = (1, 2, 4, 5, 6, 7, 14)
SETTLED = 20


def monitors(folder: Path) -> dict[str, rs.Monitor]:
    """Return the monitors, fitted."""
    train, normal = recording(folder, "d00"), recording(folder, "d00_te")
    designs: dict[str, Any] = {
        "PCA": rs.identify.principal_components(train),
        "CVA": rs.identify.canonical_variates(train),
        "parity relations of order 2": rs.identify.parity_from_data(train[:, :11], train[:, 11:], order=2),
    }
    return {
        name: rs.Monitor(made).fit(None, normal, false_alarm_rate=RATE, held_out=0) for name, made in designs.items()
    }


def taught(monitor: rs.Monitor, folder: Path) -> list[str]:
    """Teach a monitor the faults, and return why some were refused."""
    refused = []
    for fault in FAULTS:
        rows = recording(folder, f"d{fault:02d}")
        span = (SETTLED * monitor.generator.dt, len(rows) * monitor.generator.dt)
        try:
            monitor.learn_fault(f"fault {fault}", None, rows, interval=span)
        except rs.errors.DataError as error:
            refused.append(f"fault {fault}: {error}")
    return refused


def names(monitor: rs.Monitor, folder: Path, fault: int) -> Counter[str]:
    """Return the samples in alarm while a fault is there, by the name of their alarm; empty for none."""
    out: Counter[str] = Counter()
    for alarm in diagnosed(monitor, recording(folder, f"d{fault:02d}_te")).alarms:
        samples = alarm.stop - max(alarm.start, START)
        if samples > 0:
            out[alarm.candidates[0].name if alarm.candidates else ""] += samples
    return out


def rates(monitor: rs.Monitor, folder: Path) -> tuple[list[float], list[str]]:
    """Return the shares of the table: means over the faults; and the shares by fault, in words."""
    learnt = {f"fault {fault}" for fault in FAULTS}
    shares, mistaken, said = [], [], []
    for fault in (k for k in range(1, 22) if k not in HARD):
        seen = names(monitor, folder, fault)
        total, own = max(1, seen.total()), seen[f"fault {fault}"]
        other = sum(count for name, count in seen.items() if name in learnt) - own
        if fault in FAULTS:
            channel = seen.total() - own - other - seen[""]
            shares.append([own / total, other / total, channel / total, seen[""] / total])
            said.append(f"{fault}: {own / total:.2f}")
        else:
            mistaken.append(other / total)
    means = [sum(column) / len(shares) for column in zip(*shares, strict=True)]
    return [*means, sum(mistaken) / len(mistaken)], said


def main() -> None:
    """Write the table, and print the shares by fault, and the tables of learnt faults."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    default = Path(os.environ.get("RESIDUA_SHARED_DATA", OUTPUT.parents[3] / "shared" / "data")) / "tep"
    parser.add_argument("--data", type=Path, default=default, help="folder of the data")
    parser.add_argument("--output", type=Path, default=OUTPUT, help="table to write")
    options = parser.parse_args()
    table = [HEADER]
    for name, monitor in monitors(options.data).items():
        refused = taught(monitor, options.data)
        shares, said = rates(monitor, options.data)
        table.append([name, str(len(monitor.learnt_faults)), *(f"{value:.3f}" for value in shares)])
        print(*table[-1], "right by fault:", *said, flush=True)
        print(monitor.learnt_faults, *refused, sep="\n", flush=True)
    with options.output.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows(table)


if __name__ == "__main__":
    main()
