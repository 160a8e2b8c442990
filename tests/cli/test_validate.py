"""The command ``validate``: the same figures as the function, and what it refuses."""

from __future__ import annotations

from pathlib import Path

import pytest

import residua as rs
from cli_examples import Residua
from residua import validate as v

FAULTS = """
[[scenario]]
fault = "level 1 sensor"
shape = "step"
at = 100
size = [0.02, 0.1, 0.5]

[[scenario]]
fault = "leak"
shape = "ramp"
slope = 0.02
at = [80, 120]
size = 0.4
"""


@pytest.fixture
def faults(tmp_path: Path) -> Path:
    path = tmp_path / "faults.toml"
    path.write_text(FAULTS, encoding="utf-8")
    return path


def test_the_command_prints_the_figures_of_the_function(
    residua: Residua, made: Path, faults: Path, tmp_path: Path
) -> None:
    page, runs = tmp_path / "campaign.html", tmp_path / "runs.npz"
    options = ["--runs", 20, "--samples", 200, "--seed", 3, "--report", page, "--resume", runs]
    status, out, _ = residua("validate", made / "monitor.json", "--scenarios", faults, *options)
    assert status == 0
    campaign = v.campaign(
        rs.Monitor.load(made / "monitor.json"), v.load_scenarios(faults), runs=20, samples=200, seed=3
    )
    assert f"false-alarm rate {campaign.false_alarm_rate()}" in out
    for table in (campaign.table(), campaign.confusion()):
        for row in table.cells():
            assert " ".join(row) in " ".join(out.split())
    assert str(v.Campaign.load(runs)) == str(campaign)
    assert "False alarms" in page.read_text(encoding="utf-8")


def test_tuning_writes_the_best_monitor(residua: Residua, made: Path, faults: Path, tmp_path: Path) -> None:
    best = tmp_path / "best.json"
    options = ["--false-alarm-rate", 0.02, "--windows", "1,5", "--persistences", 1, "--runs", 20, "--samples", 200]
    status, out, _ = residua("tune", made / "design.json", "--scenarios", faults, "-o", best, *options)
    assert status == 0
    monitor = rs.Monitor.load(best)
    assert f"best: window {monitor.norm_test.window}, persistence 1, threshold {monitor.threshold:.4g}" in out
    status, _, err = residua("tune", made / "monitor.json", "--scenarios", faults, "-o", best, *options)
    assert status == 2
    assert "was fitted to recordings" in err
    status, _, err = residua(
        "tune", made / "design.json", "--scenarios", faults, "-o", best, *options, "--windows", "a"
    )
    assert status == 2
    assert "expected numbers of samples" in err


def test_without_scenarios_false_alarms_are_counted(residua: Residua, made: Path) -> None:
    status, out, _ = residua("validate", made / "monitor.json", "--runs", 5, "--samples", 200)
    assert status == 0
    assert "mean time between false alarms" in out
    assert "detection" not in out


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--scenarios", "nowhere.toml"], "nowhere.toml"),
        (["--runs", 0], "--runs"),
        (["--within", -1], "must be positive"),
        (["--report", "nowhere/page.html"], "does not exist"),
        (["--samples", 60, "--scenarios", "FAULTS"], "after the last sample"),
    ],
)
def test_what_is_refused(residua: Residua, made: Path, faults: Path, options: list, message: str) -> None:
    options = [faults if one == "FAULTS" else one for one in options]
    status, _, err = residua("validate", made / "monitor.json", *options)
    assert status == 2
    assert message in err
