"""Monitors of models identified from fault-free recordings that others made: detection, names, false alarms.

``python benchmarks/identified_models.py --data FOLDER`` writes ``docs/data/identified_models.csv``. A monitor is the
Kalman filter of the identified plant, with one test for all sets: sums over 10 samples, 5 in a row, 1 % of samples in
alarm, or for the valve also what is asked for by default; nothing is chosen by a recording with a fault.
"""

from __future__ import annotations

import argparse
import csv
import itertools
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import scipy.io

import residua as rs
from residua.library import three_tank_fault

TABLE = Path(__file__).parents[1] / "docs/data/identified_models.csv"
TANK = ("Q1", "Q2"), ("h1", "h2", "h3")
#: Of false alarms, by default.
RATE = 1e-4
VALVE = (
    *("time", "inlet pressure", "outlet pressure", "temperature", "flow", "command", "position", "process value"),
    *("boiler flow", "boiler pressure", "boiler temperature"),
)


def monitor_of(plant: rs.Plant, data: np.ndarray, window: int, rate: float = 0.01) -> rs.Monitor:
    """Return the monitor of a plant, fitted to fault-free rows."""
    test = rs.decide.NormThreshold(window=window, persistence=5)
    m = len(plant.inputs)
    return rs.Monitor(rs.design.kalman_filter(plant), test=test).fit(data[:, :m], data[:, m:], false_alarm_rate=rate)


def three_tanks(folder: Path, plant: rs.Plant, model: str, window: int) -> list[str]:
    """Return detection, false alarms before the faults, and right names of the last alarms, for the twelve faults."""
    normal = scipy.io.loadmat(folder / "train_5ch.mat")["normal"]
    faulty = scipy.io.loadmat(folder / "test_5ch.mat")
    monitor = monitor_of(plant, normal, window)
    detected, false, right = [], [], 0
    for number in range(1, 13):
        data = faulty[f"fault{number:02d}"]
        diagnosis = monitor.run(data[:, :2], data[:, 2:])
        assert isinstance(diagnosis, rs.Diagnosis)
        detected.append(float(np.mean(diagnosis.alarm[200:])))
        false.append(float(np.mean(diagnosis.alarm[:200])))
        last = diagnosis.alarms[-1].candidates if diagnosis.alarms else ()
        right += bool(last) and last[0].name in three_tank_fault(number)
    shown = f"{np.mean(detected):.3f}", f"{np.mean(false):.4f}", f"{right} of 12"
    return ["three tanks", model, str(window), *shown]


def valve(
    folder: Path, window: int, rate: float, *, feedthrough: bool
) -> tuple[list[str], rs.identify.IdentificationReport]:
    """Return the false alarms of the second half of the hour, of a model and threshold from the first half."""
    data = scipy.io.loadmat(folder / "OneHourTestData_ExampleII.mat")["OneHourTestData_ExampleII"].T
    wanted = ("command", "inlet pressure", "outlet pressure"), ("position", "flow")
    columns = [VALVE.index(name) for names in wanted for name in names]
    first, second = np.split(data[:, columns], 2)
    model = rs.identify.subspace(first, inputs=wanted[0], outputs=wanted[1], dt=1.0, feedthrough=feedthrough)
    monitor = monitor_of(model.plant.with_sensor_faults(), first, window, rate)
    diagnosis = monitor.run(second[:, :3], second[:, 3:])
    assert isinstance(diagnosis, rs.Diagnosis)
    within = ", feedthrough" if feedthrough else ""
    kind = f"order {model.report.order}{within}, {rate:g} asked for"
    return ["control valve", kind, str(window), "-", f"{np.mean(diagnosis.alarm):.4f}", "-"], model.report


def rows_of(folder: Path) -> Sequence[list[str]]:
    """Return the table, printing the reports of the models as they come."""
    tanks = folder / "three_tank_dts200"
    normal = scipy.io.loadmat(tanks / "train_5ch.mat")["normal"]
    model = rs.identify.subspace(normal, inputs=TANK[0], outputs=TANK[1], dt=1.0)
    print(model.report)
    plant = model.plant.with_sensor_faults().with_actuator_faults()
    rows = [three_tanks(tanks, plant, f"identified, order {model.report.order}", window) for window in (10, 50)]
    for feedthrough, rate, window in itertools.product((False, True), (RATE, 0.01), (10, 50)):
        row, report = valve(folder / "damadics", window, rate, feedthrough=feedthrough)
        rows.append(row)
        print(report)
    return rows


def main() -> None:
    """Write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, required=True, help="folder of the recordings")
    rows = rows_of(parser.parse_args().data)
    with TABLE.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["recordings", "model", "window", "detected", "false alarms", "named"])
        writer.writerows(rows)
    print(TABLE.read_text(encoding="utf-8"))


if __name__ == "__main__":
    main()
