"""Coding sets, structured residuals and matched filters on the command line."""

from __future__ import annotations

import json
import re
import time
from pathlib import Path

import pytest

from cli_examples import PLANT, Residua, assert_error
from residua.analysis import coding
from residua.cli import screen
from residua.cli.option_types import parse_rows


def design(made: Path, tmp_path: Path, residua: Residua, method: str, *options: str) -> tuple[int, str, str]:
    return residua("design", made / "plant.toml", "-o", tmp_path / "out.json", "--method", method, *options)


def run(made: Path, tmp_path: Path, residua: Residua, recording: str = "faulty.csv") -> tuple[int, str, str]:
    """Fit what was designed, and run it."""
    assert residua("fit", tmp_path / "out.json", made / "normal.csv", "-o", tmp_path / "out.json")[0] == 0
    return residua("run", tmp_path / "out.json", made / recording, "--alarms", tmp_path / "a.jsonl")


# --------------------------------------------------------------------------- codes


def test_codes_lists_what_is_attainable_and_chooses(made: Path, residua: Residua) -> None:
    status, out, err = residua("codes", made / "plant.toml")
    assert (status, err) == (0, "")
    assert "two tanks: 3 of 3 rows attainable; 2 independent residuals" in out
    assert "no method distinguishes: pump actuator, leak" in out
    assert out.endswith("as an option: --structure 011,100\n")


def test_codes_calls_two_tables_by_two_names(made: Path, residua: Residua) -> None:
    _, out, _ = residua("codes", made / "plant.toml")
    listed, chosen = out.split("\n\n")
    assert re.findall(r"^(\S+ \d+)  ", listed, flags=re.MULTILINE) == ["row 1", "row 2", "row 3"]
    assert re.findall(r"^(r\d+)  ", chosen, flags=re.MULTILINE) == ["r1", "r2"]


def test_codes_for_constant_faults(made: Path, residua: Residua) -> None:
    status, out, _ = residua("codes", made / "plant.toml", "--constant")
    assert status == 0
    assert "attainable for constant faults" in out
    assert "all of this for residuals that answer for as long as a constant fault lasts" in out


def test_codes_says_what_it_does_when_that_takes_long(
    made: Path, residua: Residua, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = coding.choose

    def slow(*given: object, **options: object) -> object:
        time.sleep(0.3)
        return real(*given, **options)  # pyright: ignore

    monkeypatch.setattr(coding, "choose", slow)
    status, out, err = residua("codes", made / "plant.toml")
    assert (status, err) == (0, "")
    monkeypatch.setattr(screen, "_PATIENCE", 0.15)
    again, same, err = residua("codes", made / "plant.toml")
    assert (again, same) == (0, out)
    assert err.endswith("choosing among 3 rows, for 10 s at most ...\n")


def test_a_slip_in_the_rows_names_no_other_methods(made: Path, tmp_path: Path, residua: Residua) -> None:
    for method in ("structured-bank", "structured-parity"):
        told = design(made, tmp_path, residua, method, "--structure", "01,10")
        assert_error(told, "row '01': expected 3 digits 0 or 1, one per fault")
        assert "exist" not in told[2]


def test_codes_says_why_a_row_is_not_attainable(made: Path, residua: Residua) -> None:
    status, out, _ = residua("codes", made / "plant.toml", "--structure", "011, 110")
    assert status == 0
    assert "a residual that ignores leak cannot see pump actuator: they span the same direction" in out
    assert "2 residuals, 3 faults: weakly isolating" in out  # of the set, attainable or not
    assert_error(residua("codes", made / "plant.toml", "--structure", "01"), "expected 3 digits")


def test_codes_chooses_weakly_when_asked(made: Path, residua: Residua) -> None:
    _, out, _ = residua("codes", made / "plant.toml", "--quality", "weak")
    assert "2 residuals, 3 faults:" in out
    status, _, err = residua("codes", made / "plant.toml", "--quality", "perfect")
    assert status == 2
    assert "--quality" in err


def test_rows_as_text() -> None:
    assert parse_rows("011,101") == ["011", "101"]
    assert parse_rows(" 01 1 ,101") == ["011", "101"]
    for text in ("", "012", "01,1", "0111,,0111", "0x1"):
        with pytest.raises(ValueError, match="are not rows"):
            parse_rows(text)


def test_rows_that_are_none_are_usage_errors(made: Path, residua: Residua) -> None:
    status, out, err = residua("codes", made / "plant.toml", "--structure", "012")
    assert (status, out) == (2, "")
    assert "--structure" in err


# -------------------------------------------------------------- structured residuals


def test_a_structured_bank_names_by_a_chosen_code(made: Path, tmp_path: Path, residua: Residua) -> None:
    status, out, _ = design(made, tmp_path, residua, "structured-bank", "--false-alarm-rate", "0.01")
    assert status == 0
    assert re.search(r"^level 1 sensor +\. +x +-$", out, flags=re.MULTILINE)
    assert re.search(r"^leak +x +\. +pump actuator$", out, flags=re.MULTILINE)
    status, out, _ = run(made, tmp_path, residua)
    assert status == 1
    assert "Fault found: level 1 sensor" in out


def test_parity_relations_with_rows_of_ones_own(made: Path, tmp_path: Path, residua: Residua) -> None:
    options = ("--structure", "111,100", "--false-alarm-rate", "0.01", "--window", "20")
    status, out, _ = design(made, tmp_path, residua, "structured-parity", *options)
    assert status == 0
    assert "structured parity relations\n  poles: 0, 0" in out
    assert re.search(r"^level 1 sensor +x +x +-$", out, flags=re.MULTILINE)
    assert "a code is part of another" in out
    status, out, _ = run(made, tmp_path, residua)
    assert status == 1
    assert "Fault found: either level 1 sensor, pump actuator, leak or something not listed" in out
    assert run(made, tmp_path, residua, "healthy.csv")[0] == 0


def test_rows_that_are_not_attainable_are_refused_or_left_out(made: Path, tmp_path: Path, residua: Residua) -> None:
    for method in ("structured-parity", "structured-bank"):
        refused = design(made, tmp_path, residua, method, "--structure", "011,110")
        assert refused[0] == 2
        assert "--allow-missing" in refused[2]
        status, out, _ = design(made, tmp_path, residua, method, "--structure", "011,110", "--allow-missing")
        assert status == 0
        assert re.search(r"^fault +r1 +cannot be told from$", out, flags=re.MULTILINE)
        assert re.search(r"^  note: no member 'r2': .*ignores .*leak", out, flags=re.MULTILINE)


@pytest.mark.parametrize(
    ("method", "options", "part"),
    [
        (
            "kalman-filter",
            ("--structure", "011"),
            "--structure is for --method structured-bank and structured-parity, not for kalman-filter",
        ),
        ("structured-parity", ("--margin", "0.1"), "fault-estimator, not for structured-parity"),
        ("structured-bank", ("--poles", "0.3,0.3"), "fault-estimator, not for structured-bank"),
        ("structured-parity", ("--poles", "0.3,0.3,0.3"), "structured-parity: "),
        (
            "structured-parity",
            ("--scheme", "dedicated"),
            "--scheme is for --method actuator-fault-bank and sensor-fault-bank",
        ),
        ("matched-filters", ("--allow-missing",), "--allow-missing is for --method actuator-fault-bank"),
        ("matched-filters", ("--poles", "0.3,0.3"), "fault-estimator, not for matched-filters"),
    ],
)
def test_options_that_do_not_go_together(
    made: Path, tmp_path: Path, method: str, options: tuple[str, ...], part: str, residua: Residua
) -> None:
    assert_error(design(made, tmp_path, residua, method, *options), part)
    assert not list(tmp_path.iterdir())


# ------------------------------------------------------------------ matched filters


def test_matched_filters_tell_arrival_and_size(made: Path, tmp_path: Path, residua: Residua) -> None:
    status, out, _ = design(made, tmp_path, residua, "matched-filters", "--window", "30")
    assert status == 0
    assert "deviation of its size after 15 samples  after 30" in out
    assert re.search(r"^pump actuator +stays +[\d.]+ +[\d.]+ +- +leak$", out, flags=re.MULTILINE)
    status, out, _ = run(made, tmp_path, residua)
    assert status == 1
    assert "Fault found: level 1 sensor, a good match, alarm raised at 202 s." in out
    found = re.search(r"Estimated size of level 1 sensor: ([\d.]+) ± ([\d.]+)", out)
    assert found is not None
    assert float(found[1]) == pytest.approx(0.5, abs=4 * float(found[2]))
    alarm = json.loads((tmp_path / "a.jsonl").read_text().splitlines()[-1])
    assert alarm["onset"] == 200
    assert run(made, tmp_path, residua, "healthy.csv")[0] == 0


def test_matched_filters_of_a_continuous_plant_need_the_step(tmp_path: Path, residua: Residua) -> None:
    text = PLANT.replace("dt = 1.0", "").replace("[[0.9, 0.05], [0.05, 0.8]]", "[[-1.0, 0.1], [0.1, -2.0]]")
    (tmp_path / "c.toml").write_text(text)
    command = ("design", tmp_path / "c.toml", "-o", tmp_path / "out.json", "--method", "matched-filters")
    assert_error(residua(*command), "matched-filters: it counts samples: give --dt")
    assert residua(*command, "--dt", "0.1")[0] == 0
