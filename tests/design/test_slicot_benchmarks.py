"""Six small systems of the SLICOT benchmarks, every function: it holds, or it is refused with the reason."""

from __future__ import annotations

import dataclasses
import importlib
import sys
import time
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import residua as rs
from effort import cases

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
SMALL = ("BD01_1_02", "BD01_1_03", "BD01_2_02", "BD02_1_01", "BD02_1_08", "BD02_1_12")
FUNCTIONS = (
    "luenberger_observer",
    "reduced_order_observer",
    "unknown_input_observer",
    "descriptor_observer",
    "perfect_observer",
    "perfect_observer, least order",
    "fault_estimator, actuators",
    "fault_estimator, a sensor",
    "sensor_fault_bank, generalized",
    "sensor_fault_bank, dedicated",
    "actuator_fault_bank, generalized",
    "actuator_fault_bank, dedicated",
    "structured_bank",
    "decoupled_residual",
    "kalman_filter",
    "detection_filter",
    "robust_detection_filter",
)


def load(name: str) -> ModuleType:
    sys.path.insert(0, str(BENCHMARKS))
    try:
        return importlib.import_module(name)
    finally:
        sys.path.remove(str(BENCHMARKS))


@pytest.fixture(scope="module")
def table() -> ModuleType:
    return load("observer_table")


@pytest.fixture(scope="module")
def checks() -> ModuleType:
    return load("observer_checks")


@pytest.fixture
def folder(shared_data: Path) -> Path:
    return shared_data / "slicot_benchmarks"


def test_all_functions_are_in_the_table(table: ModuleType) -> None:
    assert tuple(table.FUNCTIONS) == FUNCTIONS


@pytest.mark.parametrize("function", FUNCTIONS)
@pytest.mark.parametrize("name", cases(SMALL, 3))
def test_it_holds_or_is_refused(name: str, function: str, table: ModuleType, folder: Path) -> None:
    for task in table.all_tasks(folder, [name], [function]):
        outcome = table.attempt(task, folder)
        assert outcome.outcome in ("ok", "refused"), outcome
        if outcome.outcome == "refused":
            assert len(outcome.reason) > 40


@pytest.mark.parametrize("name", ["BD01_1_02", "BD02_1_01"])
def test_an_unobservable_mode_is_a_pole_of_the_reduced_observer(name: str, table: ModuleType, folder: Path) -> None:
    """A product that is rounding made it look observable: the gain was 1e16, the pole anywhere."""
    plant = table.plant_for("plain", folder, name)
    for function in (rs.design.reduced_order_observer, rs.design.descriptor_observer):
        observer = function(plant)
        np.testing.assert_allclose(observer.evidence.fixed_poles, [-0.5], atol=1e-9)
        np.testing.assert_allclose(observer.poles, [-0.5], atol=1e-9)


def test_the_checks_find_what_is_wrong(checks: ModuleType, table: ModuleType, folder: Path) -> None:
    plant = table.plant_for("disturbed", folder, "BD01_1_03")
    asked = checks.Asked(margin=0.2)
    good = rs.design.unknown_input_observer(plant, margin=0.2)
    assert checks.check(good, plant, asked).identity < 1e-9
    rng = np.random.default_rng(0)
    for name in "FTKHM":
        matrix = getattr(good, name)
        bad = dataclasses.replace(good, **{name: matrix * (1 + 1e-4 * rng.standard_normal(matrix.shape))})
        with pytest.raises(checks.CheckError):
            checks.check(bad, plant, asked)
    with pytest.raises(checks.CheckError, match="not stable"):
        checks._spectrum([good.F + 10 * np.eye(good.order)], asked, np.zeros(0), 0.0)
    assert checks.check(good, plant, checks.Asked(margin=100.0)).pole > 0.1
    assert checks.check(good, plant, checks.Asked(poles=(-50.0,))).pole > 0.1


def test_the_checks_find_a_wrong_code(checks: ModuleType, table: ModuleType, folder: Path) -> None:
    plant = table.plant_for("faults", folder, "BD01_1_03")
    bank = rs.design.sensor_fault_bank(plant)
    checks.check(bank, plant, checks.Asked())
    turned = bank.structure.copy()
    turned[0, -1] = ~turned[0, -1]
    with pytest.raises(checks.CheckError):
        checks.check(dataclasses.replace(bank, structure=turned), plant, checks.Asked())
    silent = bank.structure.copy()
    silent[:] = True
    with pytest.raises(checks.CheckError, match="does not answer"):
        checks.check(dataclasses.replace(bank, structure=silent), plant, checks.Asked())


def test_the_checks_find_a_wrong_estimate(checks: ModuleType, table: ModuleType, folder: Path) -> None:
    plant = table.plant_for("faults", folder, "BD01_1_03")
    made = rs.design.fault_estimator(plant, faults=[plant.faults[0]])
    checks.check(made, plant, checks.Asked())
    with pytest.raises(checks.CheckError, match="unit gain"):
        checks.check(
            dataclasses.replace(made, lag={name: 2 * lag for name, lag in made.lag.items()}), plant, checks.Asked()
        )


def test_what_takes_too_long_is_ended(table: ModuleType, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def endless(plant: rs.Plant) -> None:
        time.sleep(60)

    monkeypatch.setattr(table, "LIMIT", 0.01)
    monkeypatch.setitem(table.FUNCTIONS, "luenberger_observer", table.Function("endless", "plain", endless))
    task = table.Task("BD01_1_09", "luenberger_observer", "poles")
    (outcome,) = table.run_all([task], folder)
    assert outcome.outcome == "third"
    assert "took over" in outcome.reason


def test_another_error_is_a_third_outcome(table: ModuleType, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(plant: rs.Plant) -> None:
        raise ZeroDivisionError("by accident")

    function = table.Function("broken", "plain", broken)
    monkeypatch.setitem(table.FUNCTIONS, "luenberger_observer", function)
    outcome = table.attempt(table.Task("BD01_1_03", "luenberger_observer", "default"), folder)
    assert outcome.outcome == "third"
    assert "by accident" in outcome.reason


def test_the_tables_tell_every_refusal(table: ModuleType, folder: Path, tmp_path: Path) -> None:
    tasks = table.all_tasks(folder, ["BD01_1_02", "BD02_1_01"], ["luenberger_observer", "kalman_filter"])
    outcomes = [table.attempt(task, folder) for task in tasks]
    table.write_tables(outcomes, folder, tmp_path)
    everything = (tmp_path / "observers_on_benchmarks_all.csv").read_text(encoding="utf-8").splitlines()
    assert len(everything) == 1 + len(tasks)
    reasons = (tmp_path / "observers_on_benchmarks_reasons.csv").read_text(encoding="utf-8")
    for outcome in outcomes:
        assert outcome.outcome == "ok" or outcome.reason[:40] in reasons
