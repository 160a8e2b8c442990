"""What the page on the default test says of its tables is in them, and a part of each comes out again."""

from __future__ import annotations

import csv
import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import numpy as np

ROOT = Path(__file__).resolve().parent.parent


def rows(name: str) -> list[list[str]]:
    with (ROOT / "docs" / "data" / name).open(encoding="utf-8", newline="") as file:
        return list(csv.reader(file))[1:]


def script(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, ROOT / "benchmarks" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    made = importlib.util.module_from_spec(spec)
    sys.modules[name] = made  # dataclasses look their module up
    spec.loader.exec_module(made)
    return made


def test_false_alarms_come_as_often_as_promised() -> None:
    cells = {(row[0], int(row[1])): float(row[3]) for row in rows("default_test_rates.csv")}
    enough = [mean for (_, count), mean in cells.items() if count >= 1000]
    assert len(enough) == 21
    assert max(enough) < 2.5
    assert np.mean(enough) < 1.5
    assert sum(mean > 1.5 for mean in enough) <= 2


def test_a_cell_of_false_alarms_comes_out_again() -> None:
    made = script("default_test_rates")
    multiples = [made.of_residuals(made.RESIDUALS["white"], 1000, [0, 1000, fit])[0] for fit in range(2)]
    assert max(multiples) <= 3.2  # the largest of fifty is in the table


def test_lasting_faults_of_sensors_are_seen() -> None:
    table = rows("default_faults.csv")
    lasting = [row for row in table if row[2] == "sensor" and row[3] == "5" and float(row[10]) > 0.95]
    assert len(lasting) > 20
    assert np.mean([float(row[4]) >= 0.95 for row in lasting]) >= 0.95
    assert np.median([float(row[5]) for row in lasting]) <= 1.3 * np.median([float(row[11]) for row in lasting])
    seen = [row[6] == "yes" for row in table if float(row[4]) > 0]
    assert np.mean(seen) >= 0.9
    at_once, later = (np.mean([row[k] == "yes" for row in table if float(row[4]) > 0]) for k in (14, 15))
    assert at_once >= 0.6
    assert later >= 0.85
    assert min(float(row[7]) - float(row[4]) for row in table) >= -0.03  # suggest's best, against the Kalman default


def test_a_plant_of_the_table_comes_out_again() -> None:
    made = script("default_faults")
    again = [[str(value) for value in row] for row in made.table(["motor"], 0)]
    table = [row for row in rows("default_faults.csv") if row[0] == "motor"]
    assert [row[:4] for row in again] == [row[:4] for row in table]
    shares = np.array([[row[4], row[10]] for row in again], dtype=float)
    assert np.allclose(shares, np.array([[row[4], row[10]] for row in table], dtype=float), atol=0.02)
