"""Scenarios: what they refuse, and what files say."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import residua as rs
from residua import validate as v
from residua.errors import FileFormatError, SettingError
from residua.validate.scenario import cases_of


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: v.Scenario("leak", v.step(at=1), size=0.0), "a size of 0 is no fault"),
        (lambda: v.Scenario("leak", v.step(at=1), size=[0.1, 0.0]), "a size of 0 is no fault"),
        (lambda: v.Scenario("leak", v.step(at=1), size=np.nan), "finite"),
        (lambda: v.Scenario("leak", v.step(at=1), size=[]), "finite"),
        (lambda: v.Scenario("leak", v.step(at=1), size="big"), "finite"),  # pyright: ignore
        (lambda: v.Scenario("leak", "step"), "shape must be one of"),  # pyright: ignore
        (lambda: v.Scenario("valve actuator", v.loss_of_effectiveness(at=1), size=1.5), "over 0 and up to 1"),
        (lambda: v.Scenario("a sensor", v.stuck_at(at=1), size=2.0), "stuck channel has no size"),
    ],
)
def test_what_no_scenario_can_be(make, message: str) -> None:
    with pytest.raises(SettingError, match=message):
        make()


@pytest.mark.parametrize(
    ("scenario", "message"),
    [
        (v.Scenario("rust", v.step(at=1)), "no fault 'rust'; known: a sensor, b sensor, valve actuator, leak"),
        (v.Scenario("leak", v.step(at=50)), "onset at 50 s is after the last sample of a run at 49.5 s"),
        (v.Scenario("leak", v.step(at=(10, 50))), "after the last sample"),
        (
            v.Scenario("leak", v.stuck_at(at=1)),
            "'leak' is a component fault; only the signal of one sensor",
        ),
        (v.Scenario("leak", v.loss_of_effectiveness(at=1), size=0.5), "component fault"),
    ],
)
def test_what_does_not_go_with_the_plant(plant: rs.Plant, scenario: v.Scenario, message: str) -> None:
    with pytest.raises(SettingError, match=message):
        cases_of(scenario, plant, 100, plant.dt)


def test_every_size_is_a_case(plant: rs.Plant) -> None:
    scenarios = [v.Scenario("leak", v.step(at=1), size=[0.1, -0.2]), v.Scenario("a sensor", v.stuck_at(at=1, value=3))]
    cases = cases_of(scenarios, plant, 100, plant.dt)
    assert [(case.fault, case.size, case.scenario) for case in cases] == [
        ("leak", 0.1, 0),
        ("leak", -0.2, 0),
        ("a sensor", 1.0, 1),
    ]


def test_scenarios_from_a_file(tmp_path: Path) -> None:
    path = tmp_path / "faults.toml"
    path.write_text(
        '[[scenario]]\nfault = "leak"\nshape = "ramp"\nslope = 0.01\nat = 600\nsize = [0.02, 0.05]\n'
        '[[scenario]]\nfault = "a sensor"\nshape = "stuck_at"\nat = [100, 200]\n',
        encoding="utf-8",
    )
    assert v.load_scenarios(path) == (
        v.Scenario("leak", v.ramp(slope=0.01, at=600), size=[0.02, 0.05]),
        v.Scenario("a sensor", v.stuck_at(at=(100, 200))),
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[[scenario]\n", "is not TOML"),
        ("a = 1\n", r"expected tables \[\[scenario\]\]"),
        ('[[scenario]]\nshape = "step"\nat = 1\n', "'fault' must be a name"),
        ('[[scenario]]\nfault = "leak"\nshape = "jump"\nat = 1\n', "'shape' must be one of step, ramp"),
        ('[[scenario]]\nfault = "leak"\nshape = "ramp"\nat = 1\n', "'slope' is missing"),
        ('[[scenario]]\nfault = "leak"\nshape = "step"\nat = 1\nslope = 2\n', "'slope' is unknown"),
        ('[[scenario]]\nfault = "leak"\nshape = "step"\nat = -1\n', "scenario 1: at must be 0 s or later"),
        ('[[scenario]]\nfault = "leak"\nshape = "step"\nat = 1\nsize = "big"\n', "scenario 1"),
    ],
)
def test_files_that_are_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "faults.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(FileFormatError, match=message):
        v.load_scenarios(path)
