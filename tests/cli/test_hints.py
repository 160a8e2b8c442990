"""The mistakes of newcomers, and the message for each."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pytest

from cli_examples import Residua

#: Commands as they are typed in the folder of the examples, and a part of the message.
MISTAKES = {
    "run faulty.csv monitor.json": "the monitor comes first: residua run monitor.json faulty.csv",
    "run healthy.csv faulty.csv monitor.json": "residua run monitor.json healthy.csv faulty.csv",
    "fit normal.csv design.json -o out.json": "the monitor comes first: residua fit design.json normal.csv",
    "run faulty.csv": "Missing argument 'DATA.csv...'",
    "run faulty.csv healthy.csv": "faulty.csv is a recording, not a monitor: the monitor comes first",
    "run plant.toml faulty.csv": "make a monitor from it first: residua design plant.toml -o MONITOR.json",
    "fit plant.toml normal.csv -o out.json": "make a monitor from it first: residua design plant.toml -o MONITOR.json",
    "run monitor.json plant.toml": "plant.toml is a plant file, not a recording: give a log of measured inputs",
    "run monitor.json monitor.json": "monitor.json is a monitor, not a recording: give a log of measured inputs",
    "run monitor.json faulty.csv faulty.csv": "faulty.csv is given twice: give each recording once",
    "design normal.csv -o out.json": "normal.csv is a recording, not a plant file: without a model, 'residua learn'",
    "design monitor.json -o out.json": "give the plant file from which the monitor was designed",
    "design plant.toml out.json": "unexpected extra argument(s) (out.json): the file to write is named by -o",
    "design plant.toml": "name the monitor to write, such as MONITOR.json",
    "design plant.toml -o out.json --method kalman": "'kalman' (did you mean 'kalman-filter'?)",
    "design plant.toml -o out.json --pole 0.1": "No such option: --pole",
    "analyze normal.csv": "without a model, 'residua learn' makes a monitor of it, 'residua identify' a plant file",
    "codes normal.csv": "normal.csv is a recording, not a plant file",
    "suggest monitor.json": "monitor.json is a monitor, not a plant file",
    "learn plant.toml -o out.json": "plant.toml is a plant file, not a recording",
    "identify monitor.json -o out.toml": "monitor.json is a monitor, not a recording",
    "validate plant.toml": "plant.toml is a plant file, not a monitor",
    "tune plant.toml --scenarios plant.toml --false-alarm-rate 0.01 -o out.json": "plant.toml is a plant file, not a",
    "export plant.toml -o out": "plant.toml is a plant file, not a monitor",
    "live monitor.json": "name the monitor in a configuration; 'residua live --example' prints one",
    "live plant.toml": "plant.toml is a plant file, not a configuration",
    "live faulty.csv": "'residua run' judges a recording",
    "run monitor.json absent.csv": "absent.csv: recording not found",
    "run absent.json faulty.csv": "absent.json: monitor not found",
    "analyze absent.toml": "absent.toml: plant file not found",
    "live absent.toml": "absent.toml: configuration not found",
    "run monitor.json .": ". is a folder; name a recording",
    "demo jet": "there is no demo 'jet' (did you mean 'jet-engine'?); there are three-tank and jet-engine",
    "demo Three-tanks": "(did you mean 'three-tank'?)",
    "demo pump": "there is no demo 'pump'; there are three-tank and jet-engine",
    "demo": "Missing argument 'three-tank|jet-engine'",
    "analyse plant.toml": "No such command 'analyse'. Did you mean 'analyze'?",
    "train normal.csv": "No such command 'train'. Did you mean 'residua fit'?",
    "diagnose monitor.json faulty.csv": "No such command 'diagnose'. Did you mean 'residua run'?",
    "help": "Did you mean 'residua --help'?",
    "plant.toml": "plant.toml is a file. Name a command first, such as: residua analyze plant.toml",
    "normal.csv": "Name a command first, such as: residua learn normal.csv",
}


@pytest.fixture
def here(made: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of the examples, in which commands run."""
    monkeypatch.chdir(made)
    return made


@pytest.mark.parametrize("command", MISTAKES)
def test_a_mistake_gets_a_hint(command: str, here: Path, residua: Residua) -> None:
    before = sorted(here.iterdir())
    status, out, err = residua(*command.split())
    assert (status, out) == (2, "")
    assert MISTAKES[command] in err
    assert "Traceback" not in err
    assert sorted(here.iterdir()) == before


@pytest.mark.parametrize(
    ("file", "change", "command", "advice"),
    [
        ("monitor.json", (r'"version": \d+', '"version": 99'), "run {} faulty.csv", "version 99, this residua reads"),
        ("plant.toml", ("residua-plant/1", "residua-plant/2"), "analyze {}", "got 'residua-plant/2'"),
    ],
)
def test_a_file_of_a_newer_version_asks_for_an_upgrade(
    file: str, change: tuple[str, str], command: str, advice: str, here: Path, tmp_path: Path, residua: Residua
) -> None:
    newer = tmp_path / file
    newer.write_text(re.sub(*change, (here / file).read_text(), count=1))
    status, _, err = residua(*command.format(newer).split())
    assert status == 2
    assert advice in err
    assert "upgrade residua" in err


def test_a_monitor_of_an_older_version_is_to_be_made_again(here: Path, tmp_path: Path, residua: Residua) -> None:
    content = json.loads((here / "monitor.json").read_text()) | {"version": 0}
    (tmp_path / "old.json").write_text(json.dumps(content))
    _, _, err = residua("run", tmp_path / "old.json", "faulty.csv")
    assert "version 0, this residua reads version 1" in err
    assert "design and fit the monitor again" in err


def test_the_ending_of_a_file_does_not_matter_where_it_names_no_other_kind(
    here: Path, tmp_path: Path, residua: Residua
) -> None:
    shutil.copy(here / "monitor.json", tmp_path / "tank.monitor")
    shutil.copy(here / "plant.toml", tmp_path / "tank.plant")
    assert residua("run", tmp_path / "tank.monitor", "faulty.csv", "-q")[0] == 1
    assert residua("analyze", tmp_path / "tank.plant")[0] == 0
