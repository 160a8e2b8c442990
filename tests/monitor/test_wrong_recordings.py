"""Recordings as historians and spreadsheets write them: what is read with a note, and what the errors say to do."""

from __future__ import annotations

import gzip
import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import polars as pl
import pytest
import scipy.io

import residua as rs
from residua.errors import DataError, FileFormatError, SettingError
from residua.library import three_tank
from residua.recording import csv_arrow
from residua.recording.columns import ReadOptions
from residua.recording.missing import MARKS
from residua.recording.recording import read_recording, recording_from_frame
from residua.recording.streams import open_stream

PLANT = three_tank()
CHANNELS = ("Q1", "Q2", "h1", "h2", "h3")
VALUES = np.random.default_rng(3).standard_normal((30, 5)).round(3)
HEADER = f"time,{','.join(CHANNELS)}"


def text(header: str = HEADER, last: dict[int, str] | None = None, more: str = "") -> str:
    """Return a table whose last channel has some other cells, and ``more`` cells behind it."""
    lines = [header + (f",{more}" if more else "")]
    for k, row in enumerate(VALUES.tolist()):
        cells = [str(k), *map(str, row[:4]), (last or {}).get(k, str(row[4]))]
        lines.append(",".join([*cells, *(["running"] if more else [])]))
    return "\n".join(lines) + "\n"


def written(path: Path, content: str) -> Path:
    path.write_text(content, encoding="utf-8")
    return path


# ------------------------------------------------------------------------ marks


@pytest.mark.parametrize("mark", MARKS)
def test_marks_of_historians_are_missing_values(tmp_path: Path, mark: str) -> None:
    last = {3: mark, 7: mark.upper(), 8: f" {mark.lower()} ", 9: "", 10: "nan"}
    recording = read_recording(written(tmp_path / "data.csv", text(last=last)), PLANT)
    assert recording.n_missing == 5
    assert np.isnan(recording.y[[3, 7, 8, 9, 10], 2]).all()
    (note,) = recording.notes
    assert note.startswith("taken as missing values: ")
    assert note.count(" in 'h3'") == len({mark, mark.upper(), mark.lower()})


@pytest.mark.parametrize("word", ["Good", "OK", "On", "Uncertain", "Good_Unspecified", "Doubtful", "Scan On", "yes"])
def test_words_for_good_values_are_no_marks(tmp_path: Path, word: str) -> None:
    path = written(tmp_path / "data.csv", text(last={3: word}))
    with pytest.raises(
        DataError,
        match=rf"column 'h3', line 5: expected a number, got '{word}'; if that stands for a missing value, give "
        rf"missing=\['{word}'\]",
    ):
        read_recording(path, PLANT)


def test_marks_are_counted_by_mark_and_column(tmp_path: Path) -> None:
    content = text(last={3: "Bad", 4: "Bad", 5: "I/O Timeout"}).replace("\n6,", "\n6,Bad,", 1)
    content = re.sub(r"(\n6,Bad),[^,]*", r"\1", content)
    recording = read_recording(written(tmp_path / "data.csv", content), PLANT)
    assert recording.notes == (
        "taken as missing values: 'Bad' 2 times in 'h3' and once in 'Q1'; 'I/O Timeout' once in 'h3'",
    )
    assert recording.n_missing == 4


def test_further_marks_are_texts_and_numbers(tmp_path: Path) -> None:
    path = written(tmp_path / "data.csv", text(last={3: "aus", 4: "AUS", 5: "-9999", 6: "-9999.0", 7: "-9.999e3"}))
    recording = read_recording(path, PLANT, missing=["aus", -9999])
    assert np.isnan(recording.y[3:8, 2]).all()
    assert recording.n_missing == 5
    assert "'-9999' 3 times in 'h3'" in recording.notes[0]
    np.savez(tmp_path / "data.npz", **dict(zip(CHANNELS, VALUES.T, strict=True)) | {"h3": [-9999.0, *VALUES[1:, 4]]})
    recording = read_recording(tmp_path / "data.npz", PLANT, dt=1.0, missing="-9999")
    assert recording.notes == ("taken as missing values: '-9999' once in 'h3'",)
    with pytest.raises(SettingError, match=r"missing must be marks, such as \['out', '-9999'\], got"):
        read_recording(path, PLANT, missing=["", "x"])


def test_marks_in_text_without_a_header(tmp_path: Path) -> None:
    path = written(tmp_path / "data.dat", "0;1;Bad\n1;2;3\n2;No Data;4\n")
    note = "taken as missing values: 'No Data' once in 'h1'; 'Bad' once in 'h2'"
    assert read_recording(path, columns=["time", "h1", "h2"]).notes[1] == note
    assert "'Bad' once in 'column3'" in read_recording(path, dt=1.0).notes[1]
    assert "'Bad' once in 'line 3'" in read_recording(path, dt=1.0, transpose=True).notes[1]


@pytest.mark.parametrize("make", [pd.DataFrame, pl.DataFrame])
def test_marks_in_frames(make: Any) -> None:
    table = {"time": np.arange(30.0)} | dict(zip(CHANNELS, VALUES.T.tolist(), strict=True))
    table["h3"] = ["Bad Input", *map(str, VALUES[1:, 4])]
    table["state"] = ["Bad", *["on"] * 29]
    recording = recording_from_frame(make(table), PLANT)
    assert recording.notes == ("taken as missing values: 'Bad Input' once in 'h3'",)
    np.testing.assert_array_equal(recording.y[1:], VALUES[1:, 2:])
    assert recording_from_frame(make(table)).notes == ("columns of text, left out: 'state'", *recording.notes)


def test_large_tables_and_streams_count_the_same(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    path = written(tmp_path / "data.csv", text(last={3: "Bad", 4: "No Data", 5: "-9999", 6: "Bad", 7: ""}))
    slow = read_recording(path, PLANT, missing=["-9999"])
    monkeypatch.setattr(csv_arrow, "LARGE", 0)
    fast = read_recording(path, PLANT, missing=["-9999"])
    stream = open_stream(path, ReadOptions(PLANT, None, None, None, None, missing=["-9999"]))
    pieces = list(stream.pieces())
    assert slow.notes == fast.notes == stream.notes
    np.testing.assert_array_equal(slow.y, fast.y)
    np.testing.assert_array_equal(slow.y, np.vstack([one.values for one in pieces])[:, 2:])


def test_a_file_that_is_run_piece_by_piece_has_the_same_notes(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    path = written(tmp_path / "data.csv", text("time,q1,Q2,h1 [cm],h2,h3", last={3: "Bad", 4: "No Data"}))
    monitor = rs.Monitor(rs.design.kalman_filter(PLANT.with_noise(process=1e-3, measurement=1e-2)))
    pieces, whole = monitor.run_file(path), monitor.run(path)
    assert isinstance(whole, rs.Diagnosis)
    assert pieces.notes == whole.notes
    assert any("'h1' is 'h1 [cm]'" in note for note in pieces.notes)
    assert any("'Bad' once in 'h3'" in note for note in pieces.notes)


# ------------------------------------------------------------------------ names


SPELLINGS = {
    "case": ("q1", "Q2", "H1", "h2", "h3"),
    "units": ("Q1 [cm3/s]", "Q2 (cm3/s)", "h1 [cm]", "h2 {cm}", "h3[cm]"),
    "blanks": (" Q1 ", "Q2", "' h1'", "h2  ", "h3"),
    "all": ("q1 [cm3/s]", "Q2", "H1 (cm)", "h2", " H3 [cm] "),
}


@pytest.mark.parametrize("spelling", SPELLINGS)
@pytest.mark.parametrize("kind", ["csv", "parquet", "npz", "mat", "frame"])
def test_other_spellings_of_a_name_are_matched(tmp_path: Path, spelling: str, kind: str) -> None:
    names = ("time", *SPELLINGS[spelling])
    table = dict(zip(names, np.column_stack([np.arange(30.0), VALUES]).T, strict=True))
    path = tmp_path / f"data.{kind}"
    if kind == "csv":
        pd.DataFrame(table).to_csv(path, index=False)
    elif kind == "parquet":
        pd.DataFrame(table).to_parquet(path)
    elif kind == "npz":
        np.savez(path, **{name.replace("/", " per "): values for name, values in table.items()})
    elif kind == "mat":
        scipy.io.savemat(path, table)
    recording = recording_from_frame(pd.DataFrame(table), PLANT) if kind == "frame" else read_recording(path, PLANT)
    np.testing.assert_array_equal(np.hstack([recording.u, recording.y]), VALUES)
    assert tuple(recording.columns) == CHANNELS
    if any(name.strip() != one for name, one in zip(names[1:], CHANNELS, strict=True)):
        assert recording.notes[0].startswith("matched by name but for case, blanks and units: ")


def test_another_unit_is_pointed_out(tmp_path: Path) -> None:
    path = written(tmp_path / "data.csv", text("time,Q1,Q2,h1 [mm],h2 [CM],h3"))
    (note,) = read_recording(path, PLANT).notes
    assert note.endswith(
        "'h2' is 'h2 [CM]'; the units differ, and nothing is converted: 'h1 [mm]', where the plant has cm"
    )


AMBIGUOUS = {
    "two of a name": ("time,Q1,Q2,H1,h1 [cm],h2", r"missing columns 'h1' \(may be 'H1' or 'h1 \[cm\]'\), 'h3'"),
    "similar": ("time,Q1,Q2,tank h1,h2,h3", r"missing column 'h1' \(did you mean 'tank h1'\?\); there are: .*"
                r"; choose by columns=\{'h1': 'tank h1'\}$"),
    "several": ("time,Q1,Q2,level_h1,level_h2,h3", r"choose by columns=\{'h1': 'level_h1', 'h2': 'level_h2'\}$"),
    "none": ("time,Q1,Q2,a,b,h3", r"where names differ, give columns=\{'h1': '...', 'h2': '...'\}$"),
}  # fmt: skip


@pytest.mark.parametrize("kind", AMBIGUOUS)
def test_what_is_only_similar_is_offered(tmp_path: Path, kind: str) -> None:
    header, message = AMBIGUOUS[kind]
    with pytest.raises(DataError, match=message):
        read_recording(written(tmp_path / "data.csv", text(header)), PLANT)


def test_a_time_is_never_taken_for_a_channel(tmp_path: Path) -> None:
    plant = rs.Plant([[-1.0]], [[1.0]], [[1.0]], inputs=["Q"], outputs=["T"])
    path = written(tmp_path / "data.csv", "t,Q\n0,1\n1,2\n")
    with pytest.raises(DataError, match="missing column 'T'"):
        read_recording(path, plant)


def test_a_number_in_brackets_is_no_unit(tmp_path: Path) -> None:
    plant = rs.Plant([[-1.0]], [[1.0]], [[1.0]], inputs=["Q"], outputs=["T (1)"])
    with pytest.raises(DataError, match=r"missing column 'T \(1\)' \(did you mean 'T \(2\)'\?\)"):
        read_recording(written(tmp_path / "data.csv", "time,Q,T (2)\n0,1,2\n1,2,3\n"), plant)


# ------------------------------------------------------------------------- text


def test_columns_of_text_are_left_out_where_all_are_taken(tmp_path: Path) -> None:
    path = written(tmp_path / "data.csv", text(more="state"))
    recording = read_recording(path)
    assert tuple(recording.columns) == CHANNELS
    assert recording.notes == ("columns of text, left out: 'state'",)
    assert read_recording(path, PLANT).notes == ()
    frame = recording_from_frame(pd.read_csv(path))
    assert (tuple(frame.columns), frame.notes) == (CHANNELS, recording.notes)
    pd.read_csv(path).to_parquet(tmp_path / "data.parquet")
    assert read_recording(tmp_path / "data.parquet").notes == recording.notes


def test_a_column_of_text_that_is_needed_is_an_error(tmp_path: Path) -> None:
    path = written(tmp_path / "data.csv", text(last=dict.fromkeys(range(30), "shut")))
    with pytest.raises(DataError, match=r"got 'shut'; no cell of this column is a number: choose another by columns="):
        read_recording(path, PLANT)
    with pytest.raises(DataError, match="no column holds numbers, there is text alone: 'state'"):
        read_recording(written(tmp_path / "words.csv", "time,state\n0,on\n1,off\n"))


def log(rows: int = 1500) -> pd.DataFrame:
    """Return a log with a column of text, one that never changes, and one without a value."""
    rng = np.random.default_rng(0)
    pump, level = np.repeat(rng.uniform(-1, 1, rows // 50), 50), np.zeros(rows)
    for k in range(1, rows):
        level[k] = 0.9 * level[k - 1] + 0.1 * pump[k - 1] + 0.01 * rng.standard_normal()
    measured = level[:, None] * [1, 2] + 0.02 * rng.standard_normal((rows, 2))
    table = {"time": np.arange(float(rows)), "Pump [%]": pump, "level": measured[:, 0], "temp": measured[:, 1]}
    return pd.DataFrame(table | {"dead": 5.0, "operator": "me", "spare": np.nan})


LEFT_OUT = "columns that never change, left out: 'dead' (5) and 'spare' (no value)"


def test_learning_leaves_out_what_says_nothing() -> None:
    learnt = rs.learn(log())
    assert (learnt.inputs, learnt.outputs) == (("Pump [%]",), ("level", "temp"))
    assert LEFT_OUT in learnt.notes
    assert "recording 1: columns of text, left out: 'operator'" in learnt.notes
    model = rs.identify.subspace(log(), inputs=["pump"])
    assert (model.plant.inputs, model.plant.outputs) == (("pump",), ("level", "temp"))
    assert LEFT_OUT in model.report.notes
    assert any("'pump' is 'Pump [%]'" in note for note in model.report.notes)


def test_a_still_column_that_is_named_is_an_error() -> None:
    with pytest.raises(DataError, match="dead never moves"):
        rs.identify.subspace(log(), inputs=["pump"], outputs=["level", "dead"])
    with pytest.raises(
        DataError, match=r"missing column 'pumpe' \(did you mean 'Pump \[%\]'\?\).*give inputs and outputs the names of"
    ):
        rs.identify.subspace(log(), inputs=["pumpe"])


# ------------------------------------------------------------------------ files


@pytest.mark.parametrize("ending", ["csv.gz", "txt.gz", "log.gz", "gz"])
def test_packed_text_is_read(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"data.{ending}"
    path.write_bytes(gzip.compress(text().encode()))
    np.testing.assert_array_equal(read_recording(path, PLANT).y, VALUES[:, 2:])


@pytest.mark.parametrize("ending", ["log", "asc", "prn", "data", ""])
def test_other_endings_are_tried_as_text(tmp_path: Path, ending: str) -> None:
    path = written(tmp_path / f"data.{ending}", text().replace(",", ";"))
    np.testing.assert_array_equal(read_recording(path, PLANT).y, VALUES[:, 2:])


def test_text_of_excel_in_utf_16_is_read(tmp_path: Path) -> None:
    path = tmp_path / "data.txt"
    path.write_bytes(text().replace(",", "\t").encode("utf-16"))
    np.testing.assert_array_equal(read_recording(path, PLANT).y, VALUES[:, 2:])


FILES = {
    "sheet.xlsx": (b"PK\x03\x04", r"sheet.xlsx: this is a spreadsheet: save the sheet as CSV \(UTF-8\)"),
    "sheet.XLS": (b"\xd0\xcf\x11\xe0", "this is a spreadsheet: save the sheet as CSV"),
    "monitor.json": (b"{}", r"this is not a recording; a monitor is saved as \.json"),
    "plant.toml": (b"", r"this is not a recording; a plant is saved as \.toml"),
    "picture.log": (b"\x89PNG\r\n\x1a\n\x00\x00", r"not a table of text .*: export it as CSV in UTF-8"),
    "cut.csv.gz": (gzip.compress(b"time,h1\n" * 99)[:30], r"not a readable \.gz file"),
    "data.parquet.gz": (gzip.compress(b"PAR1"), r"only text is read packed: unpack it first \(gunzip data"),
}


@pytest.mark.parametrize("name", FILES)
def test_files_that_are_no_text(tmp_path: Path, name: str) -> None:
    content, message = FILES[name]
    (tmp_path / name).write_bytes(content)
    with pytest.raises(FileFormatError, match=message):
        read_recording(tmp_path / name, PLANT)


def test_packed_text_that_fills_the_memory_is_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("RESIDUA_MAX_UNPACKED", "1000")
    (tmp_path / "data.csv.gz").write_bytes(gzip.compress(b"0" * 100_000))
    with pytest.raises(FileFormatError, match="larger than 1000 bytes"):
        read_recording(tmp_path / "data.csv.gz", PLANT)


# --------------------------------------------------------- recordings by name


def test_a_recording_read_without_a_plant_is_matched_by_name(tmp_path: Path) -> None:
    rows = 800
    rng = np.random.default_rng(1)
    values = rng.standard_normal((rows, 5)) * 0.1 + 1
    header = "time,h3,note,H2,h1 [cm],Q2,Q1"
    lines = [f"{k},{v[4]},x,{v[3]},{v[2]},{v[1]},{v[0]}" for k, v in enumerate(values.tolist())]
    path = written(tmp_path / "data.csv", "\n".join([header, *lines]))
    design = rs.design.kalman_filter(PLANT.with_noise(process=1e-3, measurement=1e-2))
    bare = read_recording(path)
    assert bare.u.shape == (rows, 0)
    expected = rs.Monitor(design).fit(values[:, :2], values[:, 2:]).run(values[:, :2], values[:, 2:])
    found = rs.Monitor(design).fit(bare).run(bare)
    assert isinstance(expected, rs.Diagnosis)
    assert isinstance(found, rs.Diagnosis)
    np.testing.assert_array_equal(found.statistic, expected.statistic)
    assert any("'h1' is 'h1 [cm]'" in note for note in found.notes)
    part = read_recording(path, columns={"Q1": "Q1", "h1": "h1 [cm]"})
    with pytest.raises(DataError, match=r"missing columns 'Q2', 'h2'"):
        rs.Monitor(design).fit(part)
