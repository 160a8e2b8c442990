"""Tests that remember beside the norm of the residual, on recordings that others made.

Run it with the folder of the data::

    .venv/bin/python benchmarks/change_detection.py --data FOLDER

It writes ``docs/data/change_detection.csv``.

Three tanks: the Kalman filter of the given plant. Mean, covariance and threshold are from the first half of the
fault-free recording, for a fraction of 0.1 % in alarm; the second half shows what is in alarm there. So that all tests
are compared at the same rate, the threshold is then moved until just 0.1 % of that second half are in alarm, and the
twelve faults are run: the fraction of their samples in alarm from the onset on, and the seconds to the first alarm.
"""

from __future__ import annotations

import argparse
import copy
import csv
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import scipy.io

import residua as rs
from residua.decide import CUSUM, EWMA, GLR, ChiSquared, NormThreshold, TestSettings
from residua.library import three_tank

OUTPUT = Path(__file__).resolve().parent.parent / "docs" / "data" / "change_detection.csv"
RATE, ONSET = 0.001, 200

TESTS: dict[str, Callable[[], TestSettings]] = {
    "norm": lambda: NormThreshold(persistence=1),
    "norm, sums over 50": lambda: NormThreshold(window=50, persistence=1),
    "chi-squared over 50": lambda: ChiSquared(window=50),
    "EWMA, weight 0.1": lambda: EWMA(weight=0.1),
    "EWMA, weight 0.02": lambda: EWMA(weight=0.02),
    "CUSUM, Crosier, shift 1": lambda: CUSUM(shift=1.0),
    "CUSUM, Page, shift 0.5": lambda: CUSUM(shift=0.5, form="page"),
    "GLR, window 100": lambda: GLR(window=100),
}


def at_rate(monitor: rs.Monitor, share: Callable[[rs.Monitor], float], rate: float) -> rs.Monitor:
    """Return the monitor with the smallest threshold, to a thousandth, that leaves a share in alarm within a rate."""
    low, high = 1e-3, 1e3
    for _ in range(24):
        middle = float(np.sqrt(low * high))
        low, high = (low, middle) if share(_scaled(monitor, middle)) <= rate else (middle, high)
        if high / low < 1.001:
            break
    moved = _scaled(monitor, high)
    if share(moved) > rate:
        raise RuntimeError(f"no threshold leaves {rate:g} in alarm")
    return moved


def _scaled(monitor: rs.Monitor, factor: float) -> rs.Monitor:
    """Return a monitor with its threshold, and the level at which an alarm ends, times a factor."""
    test = monitor.norm_test
    changes = {"threshold": test.threshold * factor}
    if hasattr(test, "release") and not isinstance(test.release, int):
        changes["release"] = test.release * factor
    other = copy.deepcopy(monitor)
    other._test, other._spec = replace(test, **changes), None  # no fit gives just this threshold
    return other


def tanks(folder: Path) -> list[list[str]]:
    """Return a row for each test on the three tanks."""
    normal = scipy.io.loadmat(folder / "train_5ch.mat")["normal"]
    faulty = scipy.io.loadmat(folder / "test_5ch.mat")
    half = len(normal) // 2
    rows = [["test", "in alarm, second half, as fitted", "detected", *(f"{k}" for k in range(1, 13)), "median delay"]]
    flt = rs.design.kalman_filter(three_tank(dt=1.0))
    for name, make in TESTS.items():
        monitor = rs.Monitor(flt, test=make(), isolate=None)
        monitor.fit(normal[:half, :2], normal[:half, 2:], false_alarm_rate=RATE, held_out=0)

        def share(one: rs.Monitor) -> float:
            return float(one.run(normal[half:, :2], normal[half:, 2:]).alarm.mean())  # pyright: ignore

        fitted, monitor = share(monitor), at_rate(monitor, share, RATE)
        detected, delays = [], []
        for number in range(1, 13):
            data = faulty[f"fault{number:02d}"]
            alarm = monitor.run(data[:, :2], data[:, 2:]).alarm[ONSET:]  # pyright: ignore
            detected.append(float(alarm.mean()))
            delays.append(int(alarm.argmax()) if alarm.any() else len(alarm))
        shown = [f"{one:.2f} ({delay})" for one, delay in zip(detected, delays, strict=True)]
        rows.append([name, f"{fitted:.4f}", f"{np.mean(detected):.3f}", *shown, f"{np.median(delays):.0f}"])
        print(*rows[-1], sep="  ", flush=True)
    return rows


def main(arguments: Sequence[str] | None = None) -> None:
    """Write the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    folder = parser.parse_args(arguments).data
    with OUTPUT.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(tanks(folder / "three_tank_dts200"))


if __name__ == "__main__":
    main()
