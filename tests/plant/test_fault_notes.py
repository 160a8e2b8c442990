"""Notes on faults: what they are, what to check, their unit; in plant files, in monitors, and on no computation."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import residua as rs
from residua.decide.sizes import fault_unit
from residua.errors import FileFormatError, ModelError
from residua.library import three_tank
from residua.plant import dumps_plant, loads_plant

NOTES = {"description": "A hole.", "check": 'the "drain" valve\nand the floor', "unit": "cm2"}


def tank() -> rs.Plant:
    plant = rs.Plant([[0.9]], [[0.1]], [[1.0]], dt=1, units={"y1": "cm"}).with_sensor_faults()
    return plant.with_faults({"leak": [-1.0]}, component="tank 1")


def test_notes_are_kept_by_every_step() -> None:
    plant = tank().with_fault_notes({"leak": NOTES})
    assert plant.fault_list[1] == rs.plant.Fault("leak", "component", "tank 1", **NOTES)
    assert plant.with_fault_notes({"leak": {"unit": "m2"}}).fault_list[1].check == NOTES["check"], "only what is given"
    assert loads_plant(dumps_plant(plant)).fault_list == plant.fault_list
    assert plant.without_faults("y1 sensor").fault_list == plant.fault_list[1:]
    assert tank().fault_list[1] == rs.plant.Fault("leak", "component", "tank 1")


def test_notes_go_through_a_monitor_file(tmp_path: Path) -> None:
    plant = tank().with_fault_notes({"leak": NOTES}).with_noise(process=1e-4, measurement=1e-2)
    rs.Monitor(rs.design.kalman_filter(plant)).save(tmp_path / "m.json")
    assert rs.Monitor.load(tmp_path / "m.json").generator.plant.fault_list == plant.fault_list
    plain = tank().with_noise(process=1e-4, measurement=1e-2)
    rs.Monitor(rs.design.kalman_filter(plain)).save(tmp_path / "p.json")
    assert rs.Monitor.load(tmp_path / "p.json").generator.plant.fault_list == plain.fault_list


def test_units_of_sizes() -> None:
    plant = tank()
    assert [fault_unit(plant, name) for name in plant.faults] == ["cm", ""]
    noted = plant.with_fault_notes({"leak": NOTES, "y1 sensor": {"unit": "mm"}})
    assert [fault_unit(noted, name) for name in plant.faults] == ["mm", "cm2"]


def test_notes_change_nothing_that_is_computed() -> None:
    plant = three_tank()
    bare = plant.with_fault_notes({name: dict.fromkeys(NOTES, "") for name in plant.faults})
    np.testing.assert_array_equal(rs.design.kalman_filter(plant).system.A, rs.design.kalman_filter(bare).system.A)


@pytest.mark.parametrize(
    ("notes", "what"),
    [
        ({"leek": NOTES}, "unknown fault notes: fault 'leek'"),
        ({"leak": {"cheque": "x"}}, "expected texts for description, check, unit"),
        ({"leak": {"unit": 2}}, "expected texts"),
    ],
)
def test_wrong_notes_are_refused(notes: dict, what: str) -> None:
    with pytest.raises(ModelError, match=what):
        tank().with_fault_notes(notes)


def test_a_file_with_a_wrong_note_names_the_entry() -> None:
    text = dumps_plant(tank())
    with pytest.raises(FileFormatError, match=r"faults\[1\].check: expected text"):
        loads_plant(text.replace('name = "leak"', 'name = "leak"\ncheck = 3'))
    with pytest.raises(FileFormatError, match=r"unknown entry 'chek' \(did you mean 'check'"):
        loads_plant(text.replace('name = "leak"', 'name = "leak"\nchek = "x"'))
