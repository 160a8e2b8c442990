"""Recordings as others write them: dates, decimal commas, tables without a header, and the public sets beside."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from residua.errors import DataError, FileFormatError, SettingError
from residua.library import three_tank
from residua.recording.recording import read_recording, recording_from_frame


def written(path: Path, stamps: list[str], separator: str = ";") -> Path:
    rows = [f"{stamp}{separator}{k + 0.5}" for k, stamp in enumerate(stamps)]
    path.write_text("\n".join([f"time{separator}level", *rows]), encoding="utf-8")
    return path


# ----------------------------------------------------------------------- dates

#: The same three moments, 30 s apart, from 8 o'clock in the evening of 20 November 2026 on.
STAMPS = {
    "%m/%d/%Y %H:%M:%S": "11/20/2026 20:00:%s",
    "day first": "20/11/2026 20:00:%s",
    "dots": "20.11.2026 20:00:%s",
    "dashes": "20-11-2026 20:00:%s",
    "year first": "2026/11/20 20:00:%s",
    "half a day": "11/20/2026 8:00:%s PM",
    "half a day, small": "11/20/2026 08:00:%s p.m.",
    "iso": "2026-11-20T20:00:%s",
    "iso with a zone": "2026-11-20T20:00:%s+01:00",
}


@pytest.mark.parametrize("kind", STAMPS)
def test_dates_of_many_kinds(tmp_path: Path, kind: str) -> None:
    stamps = [STAMPS[kind] % "00", STAMPS[kind] % "30", STAMPS[kind].replace(":00:", ":01:") % "00"]
    recording = read_recording(written(tmp_path / "data.csv", stamps))
    np.testing.assert_allclose(recording.time, [0, 30, 60], atol=1e-9)
    assert recording.dt == 30.0
    assert recording.origin.startswith("2026-11-20T20")
    frame = recording_from_frame(pd.DataFrame({"time": np.array(stamps, dtype=object), "level": [1.0, 2.0, 3.0]}))
    assert (frame.dt, frame.origin) == (recording.dt, recording.origin)


def test_other_ways_to_write_dates_are_said(tmp_path: Path) -> None:
    path = written(tmp_path / "data.csv", ["20-Nov-2026 08:00", "20-Nov-2026 08:01"])
    with pytest.raises(DataError, match=r"line 2: expected a time, got '20-Nov-2026 08:00'; known are .* time_format="):
        read_recording(path)
    recording = read_recording(path, time_format="%d-%b-%Y %H:%M")
    assert (recording.dt, recording.origin) == (60.0, "2026-11-20T08:00:00")
    with pytest.raises(DataError, match=r"line 2: expected a time as '%Y', got '20-Nov"):
        read_recording(path, time_format="%Y")
    with pytest.raises(DataError, match="expected a time as '%Q'"):
        read_recording(path, time_format="%Q")
    path = written(tmp_path / "numbers.csv", ["20261120", "20261121"])
    assert read_recording(path, time_format="%Y%m%d").dt == 86400.0
    with pytest.raises(DataError, match="a year of two digits can be any of its three numbers: set time_format="):
        read_recording(written(tmp_path / "data.csv", ["20/11/26 08:00", "20/11/26 08:01"]))


def test_day_or_month_first_is_asked_about(tmp_path: Path) -> None:
    path = written(tmp_path / "data.csv", [f"3/4/2026 08:00:{s:02d}" for s in range(30)])
    with pytest.raises(DataError, match=r"'3/4/2026 08:00:00' \(line 2\) may be day 3 of month 4, or day 4 of month 3"):
        read_recording(path)
    assert read_recording(path, dayfirst=True).origin == "2026-04-03T08:00"
    assert read_recording(path, dayfirst=False).origin == "2026-03-04T08:00"
    path = written(tmp_path / "dots.csv", [f"3.4.2026 08:00:{s:02d}" for s in range(30)])
    assert read_recording(path).origin.startswith("2026-04-03")
    path = written(tmp_path / "same.csv", [f"4/4/2026 08:00:{s:02d}" for s in range(30)])
    assert read_recording(path).origin.startswith("2026-04-04")


def test_later_dates_tell_day_from_month(tmp_path: Path) -> None:
    days = [f"3/{d}/2026" for d in range(1, 29)]
    recording = read_recording(written(tmp_path / "data.csv", days))
    assert (recording.dt, recording.origin[:10]) == (86400.0, "2026-03-01")
    with pytest.raises(DataError, match=r"line 14: '3/13/2026' would be of month 13: with dayfirst=True the second"):
        read_recording(tmp_path / "data.csv", dayfirst=True)
    with pytest.raises(DataError, match=r"no order of day and month fits both '13/3/2026' \(line 2\) and '3/14/2026'"):
        read_recording(written(tmp_path / "data.csv", ["13/3/2026", "3/14/2026"]))
    with pytest.raises(DataError, match=r"line 3: '31/2/2026', read as day/month/year, is not a time"):
        read_recording(written(tmp_path / "data.csv", ["30/1/2026", "31/2/2026"]))
    with pytest.raises(DataError, match=r"line 3: '14/1/2026 25:00', read as"):
        read_recording(written(tmp_path / "data.csv", ["14/1/2026 00:00", "14/1/2026 25:00"]))
    with pytest.raises(DataError, match=r"line 3: expected a time like '13/1/2026', got '14.1.2026'"):
        read_recording(written(tmp_path / "data.csv", ["13/1/2026", "14.1.2026"]))


# -------------------------------------------------------------- decimal commas


def test_a_comma_in_a_number_is_asked_about(tmp_path: Path) -> None:
    path = tmp_path / "data.csv"
    path.write_text("time;level\n0;1,5\n1;2,25\n", encoding="utf-8")
    with pytest.raises(
        DataError, match=r"'level', line 2: expected a number, got '1,5'; .* decimal=','; if it separates"
    ):
        read_recording(path)
    np.testing.assert_array_equal(read_recording(path, decimal=",").y[:, 0], [1.5, 2.25])
    path.write_text("time;level\n0;1,234.5\n1;2,345.5\n", encoding="utf-8")
    for decimal in ".,":
        with pytest.raises(DataError, match="the first separates thousands"):
            read_recording(path, decimal=decimal)
    path.write_text("time;level\n0;1,5\n1;2.5\n", encoding="utf-8")
    with pytest.raises(DataError, match=r"got '2\.5'; decimal=',' was given, so a point is not a decimal mark"):
        read_recording(path, decimal=",")
    path.write_text('time,level\n"0,0","1,5"\n"0,5","2,5"\n', encoding="utf-8")
    assert read_recording(path, decimal=",").dt == 0.5
    with pytest.raises(SettingError, match="decimal must be"):
        read_recording(path, decimal=";")


# ---------------------------------------------------------- text of other kinds


def test_blanks_between_the_cells(tmp_path: Path) -> None:
    path = tmp_path / "data.dat"
    path.write_text(
        "# made by a simulator\n#  time   Q1  Q2 h1 h2 h3\n 0  1 2 3 4 5\n 1 6  7 8 9 1e1\n", encoding="utf-8"
    )
    recording = read_recording(path, three_tank())
    np.testing.assert_array_equal(recording.u, [[1, 2], [6, 7]])
    np.testing.assert_array_equal(recording.y, [[3, 4, 5], [8, 9, 10]])
    path.write_text("time a b\n0 1 2\n1 2\n", encoding="utf-8")
    with pytest.raises(DataError, match="line 3 has 2 cells, the header has 3"):
        read_recording(path)
    path.write_text("level of tank\n1\n2\n", encoding="utf-8")  # one column, whose name has blanks
    assert list(read_recording(path, dt=1).columns) == ["level of tank"]


def test_a_line_that_says_what_separates(tmp_path: Path) -> None:
    path = tmp_path / "data.csv"
    path.write_text("sep=;\nDate Time;level, mean\n2026-11-20 08:00;1,5\n2026-11-20 08:01;2,5\n", encoding="utf-8")
    recording = read_recording(path, decimal=",")
    assert (recording.dt, list(recording.columns)) == (60.0, ["level, mean"])
    path.write_text("Stamp;level\n2026-11-20 08:00;1.5\n2026-11-20 08:01;2.5\n", encoding="utf-8")
    with pytest.raises(DataError, match=r"time= with the name of the column \(text is in 'Stamp'\)"):
        read_recording(path)
    assert read_recording(path, dt=1).notes == ("columns of text, left out: 'Stamp'",)
    assert read_recording(path, time="Stamp").dt == 60.0


def test_text_without_a_header(tmp_path: Path) -> None:
    path = tmp_path / "data.dat"
    path.write_text("  1 2 3 4 5\n 6 7 8 9 10\n11 12 13 14 15\n", encoding="utf-8")
    names = ["Q1", "Q2", "h1", "h2", "h3"]
    with pytest.raises(DataError, match=r"must name the columns, .* name its 5 columns in order, columns="):
        read_recording(path, three_tank())
    recording = read_recording(path, three_tank(), columns=names)
    np.testing.assert_array_equal(recording.u, [[1, 2], [6, 7], [11, 12]])
    assert recording.notes == ("no header: every line is data, the columns are named as asked",)
    with pytest.raises(DataError, match="has 5 columns, expected 2"):
        read_recording(path, three_tank(), columns=names[:2])
    bare = read_recording(path, dt=180)
    assert list(bare.columns) == [f"column{k}" for k in range(1, 6)]
    assert "called column1 to column5" in bare.notes[0]
    timed = read_recording(path, columns=["time", *"abcd"])
    assert (timed.dt, timed.y.shape) == (5.0, (3, 4))
    along = read_recording(path, dt=1, transpose=True)
    np.testing.assert_array_equal(along.y, bare.y.T)
    path.write_text("a b\n1 2\n", encoding="utf-8")
    with pytest.raises(DataError, match="transpose is for"):
        read_recording(path, transpose=True)


# ------------------------------------------------------------ the public sets


def present(shared_data: Path, folder: str, pattern: str) -> list[Path]:
    files = sorted((shared_data / folder).glob(pattern))
    if not files:
        pytest.skip(f"{folder} is not there")
    return files


def test_the_water_loop(shared_data: Path) -> None:
    """35 files of a water loop, whose clock skips a second now and then, and once four minutes."""
    files = present(shared_data, "skab", "*/*.csv")
    rows = missing = 0
    for path in files:
        with pytest.raises(DataError, match=r"time is irregular: .*fill_gaps=True"):
            read_recording(path)
        recording = read_recording(path, fill_gaps=True)
        frame = pd.read_csv(path, sep=";", parse_dates=["datetime"])
        span = (frame["datetime"].iloc[-1] - frame["datetime"].iloc[0]).total_seconds()
        assert (recording.dt, len(recording)) == (1.0, span + 1)
        assert recording.n_inserted == len(recording) - len(frame)
        assert f"{recording.n_inserted} rows inserted as missing" in recording.notes[0]
        there = ~np.isnan(recording.y).all(axis=1)
        np.testing.assert_array_equal(recording.y[there], frame.iloc[:, 1:].to_numpy(float))
        rows, missing = rows + len(frame), missing + recording.n_inserted
    assert len(files) == 35
    assert (rows, missing) == (46806, 3223)


@pytest.mark.parametrize("name", ["SZCAV", "SZVAV", "MZVAV-2-1", "MZVAV-2-2"])
def test_the_air_handling_units(shared_data: Path, name: str) -> None:
    """Dates as Americans write them, and whole days, weeks or months between them."""
    (path,) = present(shared_data, "lbnl_ahu", f"{name}.csv")
    recording = read_recording(path, fill_gaps=True)
    frame = pd.read_csv(path)
    first = pd.to_datetime(frame["Datetime"].iloc[0], format="%m/%d/%Y %H:%M")
    assert recording.dt == 60.0
    assert recording.origin.startswith(first.date().isoformat())
    assert len(recording) - recording.n_inserted == len(frame)


def test_the_chemical_plant(shared_data: Path) -> None:
    """44 tables of blanks without a header, one of them with time along the rows."""
    for path in present(shared_data, "tep", "*.dat"):
        recording = read_recording(path, dt=180.0, transpose=path.name == "d00.dat")
        assert recording.y.shape == (960 if "_te" in path.name else 500 if path.name == "d00.dat" else 480, 52)
        assert recording.n_missing == 0


def test_the_valve(shared_data: Path) -> None:
    """A matrix with time along its rows; a file of version 7.3 says what to do."""
    (path,) = present(shared_data, "damadics", "OneHour*.mat")
    names = ["time", "P1", "P2", "T", "F", "CV", "X", "PV", "F74", "P74", "T74"]
    recording = read_recording(path, columns=names, transpose=True)
    assert (recording.dt, recording.y.shape) == (1.0, (3600, 10))
    for path in present(shared_data, "damadics", "actuator_data.mat"):
        with pytest.raises(FileFormatError, match=r"version 7\.3"):
            read_recording(path, dt=1)
