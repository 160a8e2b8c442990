"""Measured residuals of an engine: learnt on one half of the samples, judged on the other.

Run it with the folder of the data::

    .venv/bin/python benchmarks/engine_halves.py --data FOLDER

It writes ``docs/data/engine_halves.csv``. The 307 fault-free samples are halved in two ways: the first half and the
second, and quarters in turn. A monitor is fitted to the one; so that all are compared at the same rate, its
threshold is then moved until 5.5 % of the other are in alarm: as many as have some residual over 1, which is what
the residuals are normalised to. The same is done with single samples: the largest residual against one threshold.
Each fault is learnt from the first half of its samples; the second half says which fraction is in alarm, from the
first whole window on, and of these how many are named right.
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from change_detection import at_rate
from engine_residuals import Recording, data_folder, read
from numpy.typing import NDArray

import residua as rs
from residua.decide import NormThreshold

OUTPUT = Path(__file__).resolve().parent.parent / "docs" / "data" / "engine_halves.csv"
RATE, WINDOWS = 0.055, (1, 10, 20, 40)
Parts = list[NDArray[np.float64]]
Faults = dict[str, NDArray[np.float64]]


def halves(healthy: NDArray[np.float64]) -> Iterator[tuple[str, Parts, Parts]]:
    """Yield the ways to halve the fault-free samples."""
    first, second, third, fourth = np.array_split(healthy, 4)
    yield "first half", [np.vstack([first, second])], [np.vstack([third, fourth])]
    yield "quarters in turn", [first, third], [second, fourth]


def rows(recording: Recording) -> Iterator[list[str]]:
    """Yield the header, then a row for each way and test."""
    faults = list(recording.faulty)
    yield ["fitted to", "test", "other half in alarm, as fitted", *faults, *(f"{fault}, named" for fault in faults)]
    known = {fault: samples[: len(samples) // 2] for fault, samples in recording.faulty.items()}
    new = {fault: samples[len(samples) // 2 :] for fault, samples in recording.faulty.items()}
    for name, fitted, judged in halves(recording.healthy):
        largest = np.abs(np.vstack(judged)).max(axis=1)
        threshold = np.quantile(largest, 1 - RATE)
        yield [
            *(name, "single samples", f"{(largest > 1).mean():.3f}"),
            *(f"{(np.abs(samples).max(axis=1) > threshold).mean():.3f}" for samples in new.values()),
            *("" for _ in faults),
        ]
        for window in WINDOWS:
            yield [name, f"sums over {window}", *judgement(fitted, judged, known, new, window)]


def judgement(fitted: Parts, judged: Parts, known: Faults, new: Faults, window: int) -> Iterator[str]:
    """Yield the figures of one test."""
    count = judged[0].shape[1]
    test = NormThreshold(window=window, persistence=1, false_alarm_rate=RATE)
    monitor = rs.Monitor(rs.identify.given_residuals(count), test=test)
    monitor.fit([(None, part) for part in fitted], held_out=0)

    def share(one: rs.Monitor) -> float:
        return float(np.mean(np.concatenate([one.run(None, part).alarm[max(window, 2) - 1 :] for part in judged])))

    yield f"{share(monitor):.3f}"
    monitor = at_rate(monitor, share, RATE)
    for fault, samples in known.items():
        try:
            monitor.learn_fault(fault, None, samples, interval=(0.0, np.inf))
        except rs.errors.DataError as error:
            print(f"{fault} not learnt: {error}")
    diagnoses = {fault: monitor.run(None, samples) for fault, samples in new.items()}
    yield from (f"{diagnosis.alarm[max(window, 2) - 1 :].mean():.3f}" for diagnosis in diagnoses.values())
    for fault, diagnosis in diagnoses.items():
        named = np.zeros(len(diagnosis.alarm), dtype=bool)
        for alarm in diagnosis.alarms:
            named[alarm.start : alarm.stop] |= alarm.named == ((fault,),)
        yield f"{named[diagnosis.alarm].mean() if diagnosis.alarm.any() else 0.0:.2f}"


def main(arguments: list[str] | None = None) -> int:
    """Write the table."""
    table = list(rows(read(data_folder(__doc__, arguments))))
    with OUTPUT.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(table)
    for line in table:
        print("  ".join(f"{cell:>8}" for cell in line))
    return 0


if __name__ == "__main__":
    sys.exit(main())
