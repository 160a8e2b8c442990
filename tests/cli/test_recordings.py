"""Recordings on the command line: several for one fit, gaps, dates, commas, names."""

from __future__ import annotations

import gzip
import json
import shlex
from pathlib import Path

import numpy as np
import pytest
import typer

from cli_examples import Residua, assert_error, simulate, write_csv
from residua.cli.call_options import READ


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
    assert_error(residua(*fit), "time is irregular", "; --read fill_gaps puts the rows on a grid and leaves gaps in it")
    status, out, _ = residua(*fit, "--read", "fill_gaps")
    assert status == 0
    assert "gaps.csv: put on a grid of 1 s: 3 rows inserted as missing, in 2 gaps" in out
    assert "3000 over 2999 s" in out
    status, out, _ = residua("run", tmp_path / "m.json", path, "--read", "fill_gaps")
    assert status == 0
    assert "put on a grid of 1 s: 3 rows inserted as missing, in 2 gaps" in out
    status, out, _ = residua("run", tmp_path / "m.json", path, "--read", "dt=1")
    assert status == 0
    assert "its time column 'time' was not used, rows are 1 s apart as --read dt= says" in out
    assert_error(
        residua("run", tmp_path / "m.json", path, "--read", "fill_gaps", "--read", "tolerance=0.7"),
        "tolerance is a fraction",
    )
    moved = simulate(400, 2)
    moved[200, 0] += 0.3
    path = write_csv(tmp_path / "moved.csv", moved)
    outcome = residua("run", tmp_path / "m.json", path, "--read", "fill_gaps")
    assert_error(outcome, "1 of 400 rows", "give the step by --read dt=, allow more by --read tolerance= (below 0.5)")
    assert residua("run", tmp_path / "m.json", path, "--read", "fill_gaps", "--read", "tolerance=0.4")[0] == 0


def test_dates_commas_and_names(made: Path, tmp_path: Path, residua: Residua) -> None:
    """One recording as a European logger writes it: the verdict is that of the plain file."""
    rows = simulate(400, 3, sensor=0.5, from_=200)
    lines = ["Zeit;Pumpe;Stand 1;Stand 2"]
    for k, row in enumerate(rows):
        numbers = ";".join(repr(float(x)).replace(".", ",") for x in row[1:])
        lines.append(f"3/4/2026 10:{k // 60:02d}:{k % 60:02d};{numbers}")
    path = tmp_path / "logger.dat"
    path.write_text("\n".join(lines), encoding="utf-8")
    run = ["run", made / "monitor.json", path, "--read", "time=Zeit"]
    assert_error(residua(*run), "missing columns 'pump'")
    run += ["--read", "columns=pump=Pumpe; level 1=Stand 1; level 2 = Stand 2"]
    assert_error(residua(*run), "got '", "if its comma is a decimal comma, set --read decimal=,")
    run += ["--read", "decimal=,"]
    assert_error(residua(*run), "may be day 3 of month 4", "set --read dayfirst or --read dayfirst=false")
    status, out, _ = residua(*run, "--read", "dayfirst")
    plain = residua("run", made / "monitor.json", made / "faulty.csv")
    assert (status, plain[0]) == (1, 1)
    assert "times count from 2026-04-03T10:00" in out
    verdicts = [text.splitlines()[0].split(", alarm raised at ")[0] for text in (out, plain[1])]
    assert verdicts == ["Fault found: level 1 sensor, a good match"] * 2
    assert "2026-04-03 10:03:2" in out.splitlines()[0]  # 208 s after 10 o'clock: the clock of the file
    assert "times count from 2026-03-04" in residua(*run, "--read", "dayfirst=no")[1]
    assert residua(*run, "--read", "time_format=%d/%m/%Y %H:%M:%S")[0] == 1
    assert_error(residua(*run, "--read", "time_format=%H"), "expected a time as '%H'")


def test_text_without_a_header(made: Path, tmp_path: Path, residua: Residua) -> None:
    path = tmp_path / "data.dat"
    np.savetxt(path, simulate(400, 3, sensor=0.5, from_=200)[:, 1:])
    outcome = residua("run", made / "monitor.json", path)
    assert_error(outcome, "must name the columns", 'name its 3 columns in order, --read "columns=NAME,NAME,..."')
    status, out, _ = residua("run", made / "monitor.json", path, "--read", "columns=pump,level 1,level 2")
    assert status == 1
    assert "no header: every line is data" in out
    np.savetxt(path, simulate(400, 3, sensor=0.5, from_=200)[:, 1:].T)
    assert (
        residua("run", made / "monitor.json", path, "--read", "columns=pump,level 1,level 2", "--read", "transpose")[0]
        == 1
    )
    assert_error(
        residua("run", made / "monitor.json", made / "faulty.csv", "--read", "columns=pump,level 1"),
        "columns= takes CHANNEL=COLUMN here",
    )


@pytest.mark.parametrize(
    ("texts", "values"),
    [
        (None, {}),
        (["columns=a, b c ,d"], {"columns": ("a", "b c", "d")}),
        (["columns=a=x;b = y z"], {"columns": {"a": "x", "b": "y z"}}),
        (["missing=out,-9999", "missing=bad"], {"missing": ("out", "-9999", "bad")}),
        (["fill_gaps", "dayfirst=no", "dt=60"], {"fill_gaps": True, "dayfirst": False, "dt": 60.0}),
        (["time-format=%H:%M=%S", "decimal=,"], {"time_format": "%H:%M=%S", "decimal": ","}),
    ],
)
def test_arguments_of_reading(texts: list[str] | None, values: dict[str, object]) -> None:
    assert READ.values(texts) == values


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("colums=a", "did you mean 'columns'"),
        ("columns=a=x;b", "'b' has no '='"),
        ("columns=a=x;a=y", "'a' occurs twice"),
        ("dt=soon", "dt: 'soon' is not a number"),
        ("dt", "write dt=NUMBER, got 'dt'"),
        ("fill_gaps=3", "write fill_gaps=true|false"),
        ("decimal=comma", "'comma' is not one of ., ,"),
        ("columns=a,,b", "columns: a name is empty"),
        ("columns=a=;b=y", "columns: a name is empty"),
        ("transpose=", "write transpose=true|false"),
    ],
)
def test_wrong_arguments_of_reading(made: Path, residua: Residua, text: str, message: str) -> None:
    status, _, err = residua("run", made / "monitor.json", made / "faulty.csv", "--read", text)
    assert status == 2
    assert message in err


def test_columns_are_given_in_one_form() -> None:
    for texts in (["columns=a=x", "columns=b"], ["columns=b", "columns=a=x"], ["columns=a=x", "columns=b=y"]):
        with pytest.raises(typer.BadParameter, match="columns is given twice"):
            READ.values(texts)


def test_the_arguments_are_listed(residua: Residua) -> None:
    for command, option in (("run", "--read"), ("learn", "--model")):
        status, out, _ = residua(command, option, "help")
        assert status == 0
        assert len(out.splitlines()) > 9


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
        'choose by --read "columns=level 1=tank level 1;level 2=tank level 2"',
    ),
    "ambiguous": (
        "log.csv", "time,pump,Level 1,LEVEL_1", "'level 1' (may be 'Level 1' or 'LEVEL_1')",
        'choose by --read "columns=level 1=Level 1;level 2=LEVEL_1"',
    ),
    "commas": (
        "log.csv", 'time,pump,"level 1, top",level 2', "did you mean 'level 1, top'?",
        'choose by --read "columns=level 1=level 1, top"',
    ),
    "sheet": ("log.xlsx", "", "this is a spreadsheet: save the sheet as CSV (UTF-8), and give that"),
}  # fmt: skip


@pytest.mark.parametrize("kind", WRONG)
def test_a_wrong_recording_is_said_with_what_to_do(made: Path, tmp_path: Path, residua: Residua, kind: str) -> None:
    name, header, *parts = WRONG[kind]
    outcome = residua("run", made / "monitor.json", renamed(tmp_path / name, made, header))
    assert_error(outcome, *parts)
    if kind in ("names", "commas"):
        option = shlex.split(outcome[2][outcome[2].index("--read") :])
        assert residua("run", made / "monitor.json", tmp_path / name, *option)[0] == 1


def test_marks_and_spellings_are_read_with_a_note(made: Path, tmp_path: Path, residua: Residua) -> None:
    header = "Time [s],Pump,LEVEL 1 [cm],level_2 (cm)"
    path = renamed(tmp_path / "log.csv", made, header, row5="Bad", row6="No Data", row7="aus")
    outcome = residua("run", made / "monitor.json", path)
    assert_error(
        outcome, "expected a number, got 'aus'; if that stands for a missing value, give --read \"missing=aus\""
    )
    status, out, _ = residua("run", made / "monitor.json", path, "--read", "missing=aus", "--read", "missing=-9999")
    assert status == 1
    assert "matched by name but for case, blanks and units: 'pump' is 'Pump', 'level 1' is 'LEVEL 1 [cm]'" in out
    assert "taken as missing values: 'Bad' once in 'level_2 (cm)'" in out
    packed = tmp_path / "log.csv.gz"
    packed.write_bytes(gzip.compress(path.read_bytes()))
    assert residua("run", made / "monitor.json", packed, "--read", "missing=aus")[0] == 1


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
