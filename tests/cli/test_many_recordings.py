"""Several recordings of one run: an answer for each, files for each, and the worst exit status."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from cli_examples import Residua, assert_error, simulate, write_csv


@pytest.fixture(scope="module")
def days(made: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with recordings: healthy, faulty, far from the level of the fit, and too short to judge."""
    folder = tmp_path_factory.mktemp("days")
    for name in ("healthy", "faulty"):
        (folder / f"{name}.csv").write_bytes((made / f"{name}.csv").read_bytes())
    rows = simulate(400, 5)
    gain = np.linalg.solve(np.eye(2) - [[0.9, 0.05], [0.05, 0.8]], [0.1, 0.0])
    rows[:, 1:] += 50.0 * np.array([1.0, *gain])
    write_csv(folder / "unlike.csv", rows)
    write_csv(folder / "short.csv", simulate(2, 6))
    return folder


def test_each_recording_has_the_answer_that_it_has_alone(made: Path, days: Path, residua: Residua) -> None:
    paths = [days / f"{name}.csv" for name in ("healthy", "faulty")]
    alone = [residua("run", made / "monitor.json", path) for path in paths]
    status, out, err = residua("run", made / "monitor.json", *paths)
    assert (status, err) == (1, "")
    assert out == (
        f"{paths[0]}:\n{alone[0][1]}\n{paths[1]}:\n{alone[1][1]}\n2 recordings: 1 with an alarm, 1 without an alarm\n"
    )


@pytest.mark.parametrize(
    ("names", "worst"),
    [
        (("healthy",), 0),
        (("unlike",), 3),
        (("healthy", "healthy2"), 0),
        (("healthy", "unlike"), 3),
        (("unlike", "faulty", "healthy"), 1),
        (("faulty", "short", "unlike"), 2),
    ],
)
def test_the_exit_status_is_the_worst(
    names: tuple[str, ...], worst: int, made: Path, days: Path, residua: Residua
) -> None:
    (days / "healthy2.csv").write_bytes((days / "healthy.csv").read_bytes())
    assert residua("run", made / "monitor.json", *(days / f"{name}.csv" for name in names), "-q")[0] == worst


def test_a_recording_that_cannot_be_judged_does_not_hide_the_others(made: Path, days: Path, residua: Residua) -> None:
    (days / "text.csv").write_text("time,pump\n0,high\n")
    names = ("text", "faulty", "short")
    status, out, err = residua("run", made / "monitor.json", *(days / f"{name}.csv" for name in names))
    assert status == 2
    assert "Fault found: level 1 sensor" in out
    assert "3 recordings: 2 not judged, 1 with an alarm" in out
    assert [line.split(":")[0] for line in err.splitlines()] == ["error", "error"]
    assert "short.csv: no sample could be judged" in err


def test_json_has_a_line_for_each(made: Path, days: Path, residua: Residua) -> None:
    names = ("faulty", "healthy", "short")
    _, out, _ = residua("run", made / "monitor.json", *(days / f"{name}.csv" for name in names), "--json")
    faulty, healthy, short = map(json.loads, out.splitlines())
    assert faulty["recording"] == str(days / "faulty.csv")
    assert [one["status"] for one in (faulty, healthy, short)] == [1, 0, 2]
    assert faulty["verdict"] == "fault"
    assert faulty["alarms"][0]["candidates"][0]["faults"] == ["level 1 sensor"]
    assert healthy["alarms"] == []
    assert "no sample could be judged" in short["error"]


def test_each_recording_has_files_of_its_own(made: Path, days: Path, tmp_path: Path, residua: Residua) -> None:
    outputs = {"--report": "page.html", "--alarms": "alarms.jsonl", "--residuals": "residuals.csv"}
    options = [text for flag, name in outputs.items() for text in (flag, tmp_path / name)]
    _, out, _ = residua("run", made / "monitor.json", days / "faulty.csv", days / "healthy.csv", *options)
    names = [Path(name) for name in outputs.values()]
    written = {f"{name.stem}-{day}{name.suffix}" for name in names for day in ("faulty", "healthy")}
    assert {path.name for path in tmp_path.iterdir()} == written
    assert all(f"written: {tmp_path / name}" in out for name in written)
    assert "level 1 sensor" in (tmp_path / "alarms-faulty.jsonl").read_text()
    assert (tmp_path / "alarms-healthy.jsonl").read_text() == ""


def test_names_that_would_meet_are_refused(made: Path, days: Path, tmp_path: Path, residua: Residua) -> None:
    (tmp_path / "faulty.csv").write_bytes((days / "faulty.csv").read_bytes())
    run = ("run", made / "monitor.json", days / "faulty.csv", tmp_path / "faulty.csv")
    assert_error(residua(*run, "--report", tmp_path / "page.html"), "2 recordings are called faulty", "run them apart")
    assert residua(*run, "-q")[0] == 1
