"""The demos say what they claim to say, and say so when they do not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cli_examples import Residua, assert_error
from page_reader import read, words
from residua.library import three_tank
from residua.plant import load_plant
from residua.plant.plant_writer import differences


def test_demo_jet_engine(tmp_path: Path, residua: Residua) -> None:
    status, out, err = residua("demo", "jet-engine", "--output", tmp_path / "new")
    assert (status, err) == (0, "")
    assert f"report page: {tmp_path / 'new' / 'jet-engine.html'}" in out
    assert "names 3 of 3 sensors right" in out
    assert "names 1 of 3 sensors right" in out
    page = (tmp_path / "new" / "jet-engine.html").read_text(encoding="utf-8")
    assert len(page) < 4e6
    text = words(page)
    assert text.startswith(f"{2 * 'Jet engine: which sensor failed? '}⚠ Fault found: either n_low sensor")
    folded = [one for tag, one in read(page).tags if tag == "details" and one.get("class") == "case"]
    assert [one.get("open", "closed") for one in folded] == 7 * ["closed"]
    assert text.count("What to look at") == 7  # of the open case, and of six folded ones
    for shown in (text, out):
        assert "NPD" not in shown
        assert "Normalised projection distance" in shown
        assert shown.count("Beard") == shown.count("lain detection filter (Beard)") > 0


def test_jet_engine_distances_are_the_ideal_ones() -> None:
    """Distances of constant sensor faults in the disturbance-free case, computed by algebra."""
    from residua.demos.jet_engine import ROBUST, diagnose

    cases, _ = diagnose()
    found = [list(case.distances.values()) for case in cases if case.filter == ROBUST and case.fault]
    ideal = [[0, 0.48443, 0.85635], [0.41584, 0, 0.70509], [0.21139, 0.20276, 0]]
    np.testing.assert_allclose(found, ideal, atol=1e-5)


def test_demo_says_when_it_fails(tmp_path: Path, residua: Residua, monkeypatch: pytest.MonkeyPatch) -> None:
    from residua.demos import jet_engine

    monkeypatch.setattr(jet_engine, "MISLED", ("n_low sensor",))
    status, out, err = residua("demo", "jet-engine", "-o", tmp_path)
    assert status == 2
    assert "report page: " in out
    assert err.startswith("error: the demo did not come out as it should")


def test_demo_three_tank_and_the_same_by_hand(tmp_path: Path, residua: Residua) -> None:
    status, out, err = residua("demo", "three-tank", "-o", tmp_path)
    assert (status, err) == (0, "")
    assert "Diagnosis:          leak 3 (good match); alarm at " in out
    assert len(out.splitlines()) <= 10
    page = (tmp_path / "three-tank.html").read_text(encoding="utf-8")
    assert len(page.encode()) < 1e6
    title, first = words(page).split(" ⚠ ")[:2]
    assert first.startswith("Fault found: leak 3, a good match")
    assert "." not in title  # no sentence before it
    plant, monitor = tmp_path / "three_tank.toml", tmp_path / "by_hand.json"
    assert "  residua design three_tank.toml -o tank.json\n" in out
    residua("design", plant, "-o", monitor)
    status, _, err = residua("fit", monitor, tmp_path / "normal.csv", "-o", monitor)
    assert (status, err) == (0, "")  # no warning that its own data are too few
    status, out, _ = residua("run", monitor, tmp_path / "leak.csv")
    assert status == 1
    assert "Fault found: leak 3" in out
    assert residua("run", monitor, tmp_path / "healthy.csv", "-q")[0] == 0
    assert differences(load_plant(plant), three_tank()) == []


def test_demo_folder_that_is_a_file(made: Path, residua: Residua) -> None:
    assert_error(residua("demo", "three-tank", "-o", made / "plant.toml"), "is a file; name a folder")


def test_learn_on_the_log_of_the_demo(tmp_path: Path, residua: Residua) -> None:
    """Its pumps are moved by controllers, and its levels hardly move: of a leak nobody is sure."""
    assert residua("demo", "three-tank", "-o", tmp_path)[0] == 0
    learn = ("learn", tmp_path / "normal.csv", "-o", tmp_path / "learnt.json")
    status, out, err = residua(*learn)
    assert (status, out) == (2, "")
    assert "'Q1', 'Q2', 'h1' and 'h2' follow from one another exactly" in err
    assert "name the columns that drive the plant, --inputs" in err
    status, _, err = residua(*learn, "--inputs", "Q1,Q2")
    assert status == 0
    told = "the model explains 3 % of its outputs at most, one sample ahead"
    assert told in err
    status, out, _ = residua("run", tmp_path / "learnt.json", tmp_path / "leak.csv")
    assert status == 1
    headline = out.splitlines()[0]
    assert told[0].upper() + told[1:] in headline
    assert "a poor match: no listed fault explains it" in headline
    assert "good match" not in out
    status, out, _ = residua("run", tmp_path / "learnt.json", tmp_path / "healthy.csv")
    assert status == 0
    assert "No fault found." in out.splitlines()[0]
    assert "The smallest constant faults that are seen in nine of ten cases" in out
