"""Recordings on the command line: several for one fit, gaps, dates, commas, names."""

from __future__ import annotations

import gzip
import json
import shlex
from pathlib import Path

import numpy as np
import pytest

from cli_examples import Residua, assert_error, simulate, write_csv
from residua.cli.recording_options import parse_columns


def test_fit_takes_several_recordings(made: Path, tmp_path: Path, residua: Residua) -> None:
    days = [write_csv(tmp_path / f"day{k}.csv", simulate(1500, k)) for k in (1, 2, 3)]
    status, out, err = residua("fit", made / "design.json", *days, "-o", tmp_path / "m.json")
    assert status == 0
    assert err == ""
    assert out.splitlines()[1].startswith("false alarms: 1 in ")
    assert "fault-free samples: 4500 in 3 recordings over 4497 s" in out
    assert "; 3 recordings, each from its own start" in out
    assert residua("run", tmp_path / "m.json", made / "faulty.csv")[0] == 1
    one = residua("fit", made / "design.json", days[0], "-o", tmp_path / "one.json")[1]
    assert "fault-free samples: 1500 over 1499 s" in one
    assert json.loads((tmp_path / "one.json").read_text()) != json.loads((tmp_path / "m.json").read_text())
    outcome = residua("fit", made / "design.json", days[0], days[1], days[0], "-o", tmp_path / "m.json")
    assert_error(outcome, "day1.csv is given twice")
    short = write_csv(tmp_path / "short.csv", simulate(5, 5))
    outcome = residua("fit", made / "design.json", days[0], short, "-o", tmp_path / "m.json")
    assert_error(outcome, "recording 2 of 2 has no usable sample: 5 samples")
    outcome = residua("fit", made / "design.json", days[0], tmp_path / "none.csv", "-o", tmp_path / "m.json")
    assert_error(outcome, "none.csv: recording not found")
    outcome = residua("fit", made / "design.json", *days, "-o", days[1])
    assert_error(outcome, "is read by this command")


def test_gaps_are_filled_and_said(made: Path, tmp_path: Path, residua: Residua) -> None:
    path = write_csv(tmp_path / "gaps.csv", np.delete(simulate(3000, 1), [700, 701, 1500], axis=0))
    fit = ("fit", made / "design.json", path, "-o", tmp_path / "m.json", "--false-alarm-rate", "0.001")
    fit = (*fit, "--held-out", "0")  # no alarm then on what was fitted
    assert_error(residua(*fit), "time is irregular", "; --fill-gaps puts the rows on a grid and leaves gaps in it")
    status, out, _ = residua(*fit, "--fill-gaps")
    assert status == 0
    assert "gaps.csv: put on a grid of 1 s: 3 rows inserted as missing, in 2 gaps" in out
    assert "3000 over 2999 s" in out
    status, out, _ = residua("run", tmp_path / "m.json", path, "--fill-gaps")
    assert status == 0
    assert "put on a grid of 1 s: 3 rows inserted as missing, in 2 gaps" in out
    status, out, _ = residua("run", tmp_path / "m.json", path, "--dt", "1")
    assert status == 0
    assert "its time column 'time' was not used, rows are 1 s apart as --dt says" in out
    assert_error(
        residua("run", tmp_path / "m.json", path, "--fill-gaps", "--tolerance", "0.7"), "tolerance is a fraction"
    )
    moved = simulate(400, 2)
    moved[200, 0] += 0.3
    path = write_csv(tmp_path / "moved.csv", moved)
    outcome = residua("run", tmp_path / "m.json", path, "--fill-gaps")
    assert_error(outcome, "1 of 400 rows", "give the step by --dt, allow more by --tolerance (below 0.5)")
    assert residua("run", tmp_path / "m.json", path, "--fill-gaps", "--tolerance", "0.4")[0] == 0


def test_dates_commas_and_names(made: Path, tmp_path: Path, residua: Residua) -> None:
    """One recording as a European logger writes it: the verdict is that of the plain file."""
    rows = simulate(400, 3, sensor=0.5, from_=200)
    lines = ["Zeit;Pumpe;Stand 1;Stand 2"]
    for k, row in enumerate(rows):
        numbers = ";".join(repr(float(x)).replace(".", ",") for x in row[1:])
        lines.append(f"3/4/2026 10:{k // 60:02d}:{k % 60:02d};{numbers}")
    path = tmp_path / "logger.dat"
    path.write_text("\n".join(lines), encoding="utf-8")
    run = ["run", made / "monitor.json", path, "--time", "Zeit"]
    assert_error(residua(*run), "missing columns 'pump'")
    run += ["--columns", "pump=Pumpe,level 1=Stand 1, level 2 = Stand 2"]
    assert_error(residua(*run), "got '", "if its comma is a decimal comma, set --decimal comma")
    run += ["--decimal", "comma"]
    assert_error(residua(*run), "may be day 3 of month 4", "set --day-first or --month-first")
    status, out, _ = residua(*run, "--day-first")
    plain = residua("run", made / "monitor.json", made / "faulty.csv")
    assert (status, plain[0]) == (1, 1)
    assert "times count from 2026-04-03T10:00" in out
    verdicts = [text.splitlines()[0].split(", alarm raised at ")[0] for text in (out, plain[1])]
    assert verdicts == ["Fault found: level 1 sensor, a good match"] * 2
    assert "2026-04-03 10:03:2" in out.splitlines()[0]  # 208 s after 10 o'clock: the clock of the file
    assert "times count from 2026-03-04" in residua(*run, "--month-first")[1]
    assert residua(*run, "--time-format", "%d/%m/%Y %H:%M:%S")[0] == 1
    assert_error(residua(*run, "--time-format", "%H"), "expected a time as '%H'")


def test_text_without_a_header(made: Path, tmp_path: Path, residua: Residua) -> None:
    path = tmp_path / "data.dat"
    np.savetxt(path, simulate(400, 3, sensor=0.5, from_=200)[:, 1:])
    outcome = residua("run", made / "monitor.json", path)
    assert_error(outcome, "must name the columns", 'name its 3 columns in order, --columns "NAME,NAME,..."')
    status, out, _ = residua("run", made / "monitor.json", path, "--columns", "pump,level 1,level 2")
    assert status == 1
    assert "no header: every line is data" in out
    np.savetxt(path, simulate(400, 3, sensor=0.5, from_=200)[:, 1:].T)
    assert residua("run", made / "monitor.json", path, "--columns", "pump,level 1,level 2", "--transpose")[0] == 1
    assert_error(
        residua("run", made / "monitor.json", made / "faulty.csv", "--columns", "pump,level 1"),
        "--columns takes CHANNEL=COLUMN here",
    )


def test_columns_as_text(made: Path, residua: Residua) -> None:
    assert parse_columns("a, b c ,d") == ["a", "b c", "d"]
    assert parse_columns("a=x,b = y z") == {"a": "x", "b": "y z"}
    for text in ("a,,b", "a=x,b", "a=,b=y", "a=x,a=y", ""):
        with pytest.raises(ValueError, match=r"empty|give either|twice"):
            parse_columns(text)
    status, _, err = residua("run", made / "monitor.json", made / "faulty.csv", "--columns", "a=x,b")
    assert status == 2
    assert "CHANNEL=COLUMN" in err


# ------------------------------------------------------------------ wrong inputs


def renamed(path: Path, made: Path, header: str, **cells: str) -> Path:
    """Write the faulty recording with other names, and other words in its rows."""
    lines = (made / "faulty.csv").read_text(encoding="utf-8").splitlines()
    lines[0] = header
    for row, cell in cells.items():
        number = int(row.removeprefix("row"))
        lines[number] = f"{lines[number].rsplit(',', 1)[0]},{cell}"
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


WRONG = {
    "names": (
        "log.csv", "time,pump,tank level 1,tank level 2",
        "missing columns 'level 1' (did you mean 'tank level 1'?), 'level 2' (did you mean 'tank level 2'?)",
        'choose by --columns "level 1=tank level 1,level 2=tank level 2"',
    ),
    "ambiguous": (
        "log.csv", "time,pump,Level 1,LEVEL_1", "'level 1' (may be 'Level 1' or 'LEVEL_1')",
        'choose by --columns "level 1=Level 1,level 2=LEVEL_1"',
    ),
    "commas": (
        "log.csv", 'time,pump,"level 1, top",level 2', "did you mean 'level 1, top'?",
        "choose by --columns '\"level 1=level 1, top\"'",
    ),
    "sheet": ("log.xlsx", "", "this is a spreadsheet: save the sheet as CSV (UTF-8), and give that"),
}  # fmt: skip


@pytest.mark.parametrize("kind", WRONG)
def test_a_wrong_recording_is_said_with_what_to_do(made: Path, tmp_path: Path, residua: Residua, kind: str) -> None:
    name, header, *parts = WRONG[kind]
    outcome = residua("run", made / "monitor.json", renamed(tmp_path / name, made, header))
    assert_error(outcome, *parts)
    if kind in ("names", "commas"):
        option = shlex.split(outcome[2][outcome[2].index("--columns") :])
        assert residua("run", made / "monitor.json", tmp_path / name, *option)[0] == 1


def test_marks_and_spellings_are_read_with_a_note(made: Path, tmp_path: Path, residua: Residua) -> None:
    header = "Time [s],Pump,LEVEL 1 [cm],level_2 (cm)"
    path = renamed(tmp_path / "log.csv", made, header, row5="Bad", row6="No Data", row7="aus")
    outcome = residua("run", made / "monitor.json", path)
    assert_error(outcome, "expected a number, got 'aus'; if that stands for a missing value, give --missing \"aus\"")
    status, out, _ = residua("run", made / "monitor.json", path, "--missing", "aus", "--missing", "-9999")
    assert status == 1
    assert "matched by name but for case, blanks and units: 'pump' is 'Pump', 'level 1' is 'LEVEL 1 [cm]'" in out
    assert "taken as missing values: 'Bad' once in 'level_2 (cm)'" in out
    packed = tmp_path / "log.csv.gz"
    packed.write_bytes(gzip.compress(path.read_bytes()))
    assert residua("run", made / "monitor.json", packed, "--missing", "aus")[0] == 1


def test_a_faulty_recording_is_fitted_by_force_alone(made: Path, tmp_path: Path, residua: Residua) -> None:
    path = write_csv(tmp_path / "bad.csv", simulate(1500, 4, sensor=0.5, from_=700))
    fit = ("fit", made / "design.json", path, "-o", tmp_path / "m.json")
    assert_error(
        residua(*fit),
        "this does not look like a fault-free recording: the mean of 'r level 1' steps by ",
        " at sample 700 of 1,500; leave the faulty rows out;",
        "or give --force",
    )
    assert not (tmp_path / "m.json").exists()
    assert residua(*fit, "--force")[0] == 0
    late = write_csv(tmp_path / "late.csv", simulate(1500, 4, sensor=0.5, from_=1275))
    outcome = residua("fit", made / "design.json", late, "-o", tmp_path / "m.json")
    assert_error(outcome, "held-out samples are in alarm, the first at sample 1,27", "or give --force")
