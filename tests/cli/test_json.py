"""The option --json of every command that prints an answer."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from cli_examples import Residua

SCENARIOS = """
[[scenario]]
fault = "level 1 sensor"
shape = "step"
at = 150
size = [0.1, 0.5]
"""


@pytest.fixture
def answer(made: Path, residua: Residua, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Any:
    """Return the document that a command prints; the command is written as in the folder of the examples."""
    monkeypatch.chdir(made)

    def call(command: str) -> Any:
        status, out, _ = residua(*command.format(out=tmp_path).split(), "--json")
        assert status == 0
        assert "NaN" not in out
        return json.loads(out)

    return call


def test_analyze(answer: Any) -> None:
    assert [one["name"] for one in answer("analyze plant.toml")["faults"]] == [
        "level 1 sensor",
        "pump actuator",
        "leak",
    ]


def test_codes(answer: Any) -> None:
    found = answer("codes plant.toml")
    assert found["faults"] == ["level 1 sensor", "pump actuator", "leak"]
    assert set(found["coding_set"]["rows"]) <= {one["row"] for one in found["rows"] if one["attainable"]}
    asked = answer("codes plant.toml --structure 111,100")
    assert [one["row"] for one in asked["rows"]] == ["111", "100"]
    assert all(one["attainable"] == (one["reason"] is None) for one in asked["rows"])


def test_suggest(answer: Any) -> None:
    found = answer("suggest plant.toml")
    assert found["best"] == "kalman-filter"
    best = next(one for one in found["designs"] if one["method"] == "kalman-filter")
    assert set(best["smallest_sizes"]) == {"level 1 sensor", "pump actuator", "leak"}


def test_design(answer: Any, tmp_path: Path) -> None:
    found = answer("design plant.toml -o {out}/m.json --show-call")
    assert found["method"] == "kalman-filter"
    assert found["call"].startswith("rs.design.kalman_filter(plant")
    assert found["monitor"] == str(tmp_path / "m.json")
    assert [one["fault"] for one in found["faults"]] == ["level 1 sensor", "pump actuator", "leak"]
    assert found["faults"][1]["cannot be told from"] == "leak"
    assert "monitor" not in answer("design plant.toml --show-call")


def test_fit(answer: Any) -> None:
    found = answer("fit design.json normal.csv -o {out}/m.json")
    assert (found["recordings"], found["samples"], found["incomplete"]) == (1, 3000, 0)
    assert found["thresholds"]["norm"] > 0
    assert {one["fault"] for one in found["smallest_faults"]} == {"level 1 sensor", "pump actuator", "leak"}


def test_identify_and_learn(answer: Any) -> None:
    found = answer("identify normal.csv --inputs pump -o {out}/p.toml")
    assert found["model"]["order"] == len(found["model"]["poles"]) == 2
    assert [one["output"] for one in found["model"]["outputs"]] == ["level 1", "level 2"]
    learnt = answer("learn normal.csv --inputs pump -o {out}/l.json")
    assert learnt["model"] == learnt["model"] | {"method": found["model"]["method"]}
    assert learnt["chosen"] in {one["form"] for one in learnt["tried"]}
    assert learnt["guessed"] is False


def test_validate_and_tune(answer: Any, tmp_path: Path) -> None:
    (tmp_path / "faults.toml").write_text(SCENARIOS)
    runs = " --scenarios {out}/faults.toml --runs 4 --samples 300"
    found = answer("validate monitor.json" + runs)
    assert found["runs"] == 4
    assert len(found["detection"]) == 2
    assert 0 <= found["false_alarm_rate"]["low"] <= found["false_alarm_rate"]["high"] <= 1
    best = answer("tune design.json --windows 1,5 --persistences 1 --false-alarm-rate 0.05 -o {out}/t.json" + runs)
    assert best["window"] in (1, 5)
    assert len(best["candidates"]) == 2
