"""Recordings from files and frames: the same numbers whatever the format, and clear errors."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import polars as pl
import pytest
import scipy.io

from residua.errors import DataError, FileFormatError, MissingExtraError, SettingError
from residua.library import simulate_three_tank, three_tank
from residua.recording.recording import Recording, read_recording, recording_from_frame
from residua.recording.table_writer import write_table

PLANT = three_tank()
CHANNELS = ("Q1", "Q2", "h1", "h2", "h3")
DATA = np.random.default_rng(5).standard_normal((40, 5)) * [1e-3, 1, 1e3, 1 / 3, 1]
TIME = 100.0 + np.arange(40)


def columns(names: tuple[str, ...] = CHANNELS) -> dict[str, np.ndarray]:
    return {"time": TIME} | dict(zip(names, DATA.T, strict=True))


def write_csv(path: Path, separator: str = ",", comma: str = ".", names: tuple[str, ...] = CHANNELS) -> Path:
    rows = [separator.join(["time", *names])]
    rows += [separator.join(repr(float(x)).replace(".", comma) for x in row) for row in np.column_stack([TIME, DATA])]
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")
    return path


def assert_read(recording: Recording, missing: int = 0) -> None:
    np.testing.assert_array_equal(recording.u, DATA[:, :2])
    np.testing.assert_array_equal(recording.y, DATA[:, 2:])
    np.testing.assert_allclose(recording.time - recording.time[0], TIME - TIME[0], atol=1e-9)
    assert recording.dt == 1.0
    assert recording.n_missing == missing
    assert len(recording) == 40


# ------------------------------------------------------------------ formats


@pytest.mark.parametrize(("separator", "comma"), [(",", "."), (";", "."), (";", ","), ("\t", "."), ("\t", ",")])
def test_csv(tmp_path: Path, separator: str, comma: str) -> None:
    path = write_csv(tmp_path / "data.csv", separator, comma)
    recording = read_recording(path, PLANT, decimal=comma)
    assert_read(recording)
    np.testing.assert_array_equal(recording.time, TIME)
    assert recording.source == "data.csv"
    assert recording.columns == {name: name for name in CHANNELS}


@pytest.mark.parametrize(
    "change", ["windows", "bom", "utf-16", "latin-1", "quoted", "blank lines", "spaces", "old mac"]
)
def test_csv_as_programs_write_it(tmp_path: Path, change: str) -> None:
    path = write_csv(tmp_path / "data.csv")
    text = path.read_text(encoding="utf-8")
    content = {
        "windows": text.replace("\n", "\r\n").encode(),
        "old mac": text.replace("\n", "\r").encode(),
        "bom": b"\xef\xbb\xbf" + text.encode(),
        "utf-16": text.encode("utf-16"),
        "latin-1": text.replace("time,", "time,cm³,").replace("\n1", "\n1", 1).encode("latin-1"),
        "quoted": text.replace("h1", '"h1"').encode(),
        "blank lines": (text + "\n\n\n").encode(),
        "spaces": text.replace(",", " , ").encode(),
    }[change]
    if change == "latin-1":
        lines = text.replace("time,", "time,cm³,", 1).split("\n")
        content = "\n".join(lines[:1] + [line.replace(",", ",0,", 1) for line in lines[1:]]).encode("latin-1")
    path.write_bytes(content)
    assert_read(read_recording(path, PLANT))


def test_columns_in_any_order_with_others_between(tmp_path: Path) -> None:
    shuffled = {"note": np.zeros(40)} | dict(reversed(columns().items())) | {"pressure": np.ones(40)}
    assert_read(read_recording(write_table(tmp_path / "data.csv", shuffled), PLANT))
    assert_read(read_recording(write_table(tmp_path / "data.parquet", shuffled), PLANT))


def test_parquet(tmp_path: Path) -> None:
    assert_read(read_recording(write_table(tmp_path / "data.parquet", columns()), PLANT))


def test_npz(tmp_path: Path) -> None:
    path = tmp_path / "data.npz"
    np.savez(path, **columns())
    assert_read(read_recording(path, PLANT))
    np.savez(path, u=DATA[:, :2], y=DATA[:, 2:], t=TIME)
    assert_read(read_recording(path, PLANT))
    np.savez(path, everything=DATA)
    assert_read(read_recording(path, PLANT))
    np.savez(path, everything=np.column_stack([TIME, DATA]))
    assert_read(read_recording(path, PLANT, columns=["time", *CHANNELS]))


def test_mat(tmp_path: Path) -> None:
    path = tmp_path / "data.mat"
    for content in (
        columns(),
        {name: values[:, None] for name, values in columns().items()},
        {"u": DATA[:, :2], "y": DATA[:, 2:], "t": TIME},
        {"normal": DATA},
    ):
        scipy.io.savemat(path, content)
        assert_read(read_recording(path, PLANT))
    scipy.io.savemat(path, {"first": DATA, "second": 2 * DATA})
    assert_read(read_recording(path, PLANT, variable="first"))
    with pytest.raises(DataError, match="several matrices have 5 columns: choose one with variable="):
        read_recording(path, PLANT)
    with pytest.raises(DataError, match="no array 'third'; there are: first 40 x 5, second 40 x 5"):
        read_recording(path, PLANT, variable="third")
    scipy.io.savemat(path, {"first": DATA.T})
    with pytest.raises(DataError, match="time runs down the rows: transpose it"):
        read_recording(path, PLANT, variable="first")


@pytest.mark.parametrize("make", [pd.DataFrame, pl.DataFrame])
def test_frames(make: Callable) -> None:
    assert_read(recording_from_frame(make(columns()), PLANT))


@pytest.mark.parametrize("make", [pd.DataFrame, pl.DataFrame])
def test_frames_with_missing_values_and_dates(make: Callable) -> None:
    content: dict = columns()
    content["time"] = pd.date_range("2026-11-20 08:00", periods=40, freq="s").to_numpy()
    content["h1"] = [None if k in (3, 4) else x for k, x in enumerate(content["h1"])]
    recording = recording_from_frame(make(content), PLANT)
    assert recording.n_missing == 2
    assert np.isnan(recording.y[[3, 4], 0]).all()
    np.testing.assert_allclose(recording.time, np.arange(40.0))
    assert recording.origin.startswith("2026-11-20T08:00")


def test_an_index_of_dates_is_the_time() -> None:
    frame = pd.DataFrame(columns()).drop(columns="time")
    frame.index = pd.date_range("2026-11-20 08:00", periods=40, freq="s")
    assert_read(recording_from_frame(frame, PLANT))


@pytest.mark.parametrize(
    "stamp",
    ["2026-11-20T08:00:%02d", "2026-11-20 08:00:%02d.000", "2026-11-20T08:00:%02d+01:00", "2026-11-20T08:00:%02dZ"],
)
def test_iso_dates_in_csv(tmp_path: Path, stamp: str) -> None:
    path = write_csv(tmp_path / "data.csv")
    lines = path.read_text(encoding="utf-8").splitlines()
    lines = lines[:1] + [stamp % k + line[line.index(",") :] for k, line in enumerate(lines[1:])]
    path.write_text("\n".join(lines), encoding="utf-8")
    recording = read_recording(path, PLANT)
    assert_read(recording)
    assert recording.origin.startswith("2026-11-20")


# ------------------------------------------------------------ times and steps


def test_without_times_the_plant_or_the_caller_gives_the_step(tmp_path: Path) -> None:
    path = write_table(tmp_path / "data.csv", {name: columns()[name] for name in CHANNELS})
    recording = read_recording(path, PLANT)
    assert recording.dt == 1.0
    np.testing.assert_array_equal(recording.time, np.arange(40.0))
    assert read_recording(path, three_tank(dt=0), dt=0.5).dt == 0.5
    with pytest.raises(DataError, match=r"no time column .* give dt="):
        read_recording(path, three_tank(dt=0))
    with pytest.raises(DataError, match="do not agree: dt= says"):
        read_recording(path, PLANT, dt=0.5)
    with pytest.raises(DataError, match="positive step"):
        read_recording(path, PLANT, dt=-1)


@pytest.mark.parametrize("name", ["t", "T", "Time", "timestamp", "Time [s]", "time (s)"])
def test_time_columns_by_name(tmp_path: Path, name: str) -> None:
    path = write_table(tmp_path / "data.csv", {name: TIME / 2} | {c: columns()[c] for c in CHANNELS})
    assert read_recording(path, three_tank(dt=0)).dt == pytest.approx(0.5)
    assert read_recording(path, three_tank(dt=0), time=name).dt == pytest.approx(0.5)


TIMES = {
    "irregular": (10, 0.5, "time is irregular: the step to row 12 is 1.5 s, the usual one 1 s"),
    "repeated": (10, -1.0, "time repeats in row 12: 109 s after 109 s"),
    "backwards": (10, -3.0, "time goes backwards in row 12: 107 s after 109 s"),
    "missing": (10, np.nan, "the time in row 12 is missing"),
}


@pytest.mark.parametrize("case", TIMES)
def test_irregular_times(tmp_path: Path, case: str) -> None:
    k, change, message = TIMES[case]
    time = TIME.copy()
    time[k] += change
    path = write_table(tmp_path / "data.csv", columns() | {"time": time})
    with pytest.raises(DataError, match=message):
        read_recording(path, PLANT)


def test_jitter_within_the_tolerance_passes(tmp_path: Path) -> None:
    jitter = np.random.default_rng(0).uniform(-0.004, 0.004, 40)
    path = write_table(tmp_path / "data.csv", columns() | {"time": TIME + jitter})
    assert read_recording(path, PLANT).dt == 1.0
    with pytest.raises(DataError, match="irregular"):
        read_recording(path, PLANT, tolerance=1e-4)


def test_step_of_another_plant(tmp_path: Path) -> None:
    path = write_table(tmp_path / "data.csv", columns())
    with pytest.raises(DataError, match="do not agree: its times are 1 s apart, the plant is sampled at"):
        read_recording(path, three_tank(dt=0.5))


def test_times_far_from_zero_are_regular_up_to_their_rounding(tmp_path: Path) -> None:
    time = 1.8e9 + 1e-4 * np.arange(40)
    path = write_table(tmp_path / "data.csv", columns() | {"time": time})
    assert read_recording(path, three_tank(dt=0)).dt == pytest.approx(1e-4, rel=1e-2)


# ------------------------------------------------------------- missing things


@pytest.mark.parametrize("cell", ["", "nan", "NaN", "#VALUE!", "#N/A", "NULL", " "])
def test_missing_cells_are_counted(tmp_path: Path, cell: str) -> None:
    path = write_csv(tmp_path / "data.csv")
    lines = path.read_text(encoding="utf-8").splitlines()
    cells = lines[8].split(",")
    cells[3] = cell
    lines[8] = ",".join(cells)
    path.write_text("\n".join(lines), encoding="utf-8")
    recording = read_recording(path, PLANT)
    assert recording.n_missing == 1
    assert np.isnan(recording.y[7, 0])
    assert np.isfinite(np.delete(recording.y.ravel(), 21)).all()


def test_missing_columns_are_listed_with_what_is_there(tmp_path: Path) -> None:
    path = write_csv(tmp_path / "data.csv", names=("Q1", "q2", "h1", "H_2", "h3"))
    with pytest.raises(
        DataError,
        match=r"data.csv: missing column 'h2' \(did you mean 'H_2'\?\); there are: 'time'.*; choose by "
        r"columns=\{'h2': 'H_2'\}$",
    ):
        read_recording(path, PLANT)
    assert_read(read_recording(path, PLANT, columns={"Q2": "q2", "h2": "H_2"}))
    with pytest.raises(DataError, match="no channel 'Q3'"):
        read_recording(path, PLANT, columns={"Q3": "q2"})
    with pytest.raises(DataError, match="missing column 'clock'"):
        read_recording(path, PLANT, columns={"Q2": "q2", "h2": "H_2"}, time="clock")


def test_a_column_that_is_matched_is_not_what_was_meant_by_another(tmp_path: Path) -> None:
    path = write_csv(tmp_path / "data.csv", names=("Q1", "Q2", "h1", "x", "h3"))
    with pytest.raises(DataError, match=r"missing column 'h2'; there are: 'time'.*give columns=\{'h2': '...'\}"):
        read_recording(path, PLANT)


def test_missing_arrays_are_listed(tmp_path: Path) -> None:
    path = tmp_path / "data.npz"
    np.savez(path, **{name: columns()[name] for name in ("Q1", "Q2", "h1", "h3")})
    with pytest.raises(DataError, match="missing column 'h2'"):
        read_recording(path, PLANT)


def test_without_a_plant_every_column_is_an_output(tmp_path: Path) -> None:
    recording = read_recording(write_csv(tmp_path / "data.csv"))
    np.testing.assert_array_equal(recording.y, DATA)
    assert recording.u.shape == (40, 0)
    assert tuple(recording.columns) == CHANNELS


TEXTS = {
    "empty": ("", DataError, "the file is empty"),
    "blank": ("\n \n", DataError, "the file is empty"),
    "header only": ("time,Q1,Q2,h1,h2,h3\n", DataError, "a header but no data"),
    "no header": ("1,2,3,4,5,6\n2,3,4,5,6,7\n", DataError, "the first line must name the columns"),
    "short row": ("time,Q1,Q2,h1,h2,h3\n0,1,2,3,4,5\n1,2,3\n", DataError, "line 3 has 3 cells, the header has 6"),
    "long row": ("time,Q1,Q2,h1,h2,h3\n0,1,2,3,4,5,6\n", DataError, "line 2 has 7 cells"),
    "text": (
        "time,Q1,Q2,h1,h2,h3\n0,1,2,3,4,5\n1,2,3,on,5,6\n",
        DataError,
        "column 'h1', line 3: expected a number, got 'on'",
    ),
    "time in words": (
        "time,Q1,Q2,h1,h2,h3\nnow,1,2,3,4,5\n",
        DataError,
        "column 'time', line 2: expected a time, got 'now'",
    ),
    "column twice": ("time,Q1,Q2,h1,h1,h2,h3\n0,1,2,3,4,5,6\n", DataError, "more than one column is called 'h1'"),
    "binary": ("\x00\x01\x02", FileFormatError, "not a table of text .* export it as CSV"),
}


@pytest.mark.parametrize("case", TEXTS)
def test_bad_text(tmp_path: Path, case: str) -> None:
    text, kind, message = TEXTS[case]
    path = tmp_path / "data.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(kind, match=message):
        read_recording(path, PLANT)


@pytest.mark.parametrize("ending", ["parquet", "mat", "npz"])
@pytest.mark.parametrize("content", [b"", b"hello, this is text and longer than a header of any kind" * 10])
def test_files_that_are_not_what_they_say(tmp_path: Path, ending: str, content: bytes) -> None:
    path = tmp_path / f"data.{ending}"
    path.write_bytes(content)
    with pytest.raises(FileFormatError, match=rf"data\.{ending}: "):
        read_recording(path, PLANT)


def test_other_endings_and_objects_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "data.npz"
    np.savez(path, h1=np.array([{"a": 1}], dtype=object))
    with pytest.raises(FileFormatError, match="Python objects"):
        read_recording(path, PLANT)
    with pytest.raises(FileFormatError, match="recording not found"):
        read_recording(tmp_path / "absent.csv", PLANT)
    with pytest.raises(DataError, match="expected a data frame"):
        recording_from_frame([1, 2, 3], PLANT)
    with pytest.raises(DataError, match="mapping"):
        read_recording(write_csv(tmp_path / "data.csv"), PLANT, columns=["Q1"])


def test_text_and_lengths_in_arrays_and_frames(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="column 'h2', row 0: expected a number, got 'x'"):
        recording_from_frame(pd.DataFrame(columns() | {"h2": np.array(["x"] * 40, dtype=object)}), PLANT)
    with pytest.raises(DataError, match="there are no data rows"):
        recording_from_frame(pd.DataFrame(columns()).iloc[:0], PLANT)
    path = tmp_path / "data.npz"
    np.savez(path, **(columns() | {"h2": np.ones(39)}))
    with pytest.raises(DataError, match="differ in length"):
        read_recording(path, PLANT)


@pytest.mark.parametrize(("package", "extra"), [("narwhals", "frames"), ("pyarrow", "parquet")])
def test_absent_packages_name_their_extra(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, package: str, extra: str
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    make = {
        "narwhals": lambda: recording_from_frame({}, PLANT),
        "pyarrow": lambda: write_table(tmp_path / "data.parquet", columns()),
    }
    with pytest.raises(MissingExtraError, match=rf"residua\[{extra}\]"):
        make[package]()


# -------------------------------------------------------------------- writing


@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_tables_come_back_to_the_last_bit(tmp_path: Path, ending: str) -> None:
    values = np.array([1 / 3, -1e-300, 1e300, np.nan, 0.1])
    path = write_table(tmp_path / f"out.{ending}", {"a, b": values, "alarm": np.array([True, False] * 2 + [True])})
    recording = read_recording(path, dt=1.0)
    np.testing.assert_array_equal(recording.y, np.column_stack([values, [1, 0, 1, 0, 1]]))


def test_tables_that_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match=r"\.csv or \.parquet, not '\.xlsx'"):
        write_table(tmp_path / "out.xlsx", {"a": [1.0]})
    with pytest.raises(DataError, match="differ in length"):
        write_table(tmp_path / "out.csv", {"a": [1.0], "b": [1.0, 2.0]})


def test_recordings_that_others_made(shared_data: Path) -> None:
    normal = read_recording(shared_data / "three_tank_dts200" / "train_5ch.mat", PLANT)
    assert normal.u.shape == (16008, 2)
    np.testing.assert_allclose(normal.y.mean(axis=0), PLANT.operating_point.outputs, atol=1e-2)
    fault = read_recording(shared_data / "three_tank_dts200" / "test_5ch.mat", PLANT, variable="fault08")
    assert fault.y.shape == (2001, 3)


def test_errors_say_what_to_do(tmp_path: Path) -> None:
    plant = PLANT
    names = [*plant.inputs, *plant.outputs]
    path = tmp_path / "data.csv"
    path.write_text("time," + ",".join(["renamed", *names[1:]]) + "\n0" + ",1" * len(names) + "\n")
    with pytest.raises(DataError, match="where names differ, give columns="):
        read_recording(path, plant)
    path.write_text("time," + ",".join(names) + "\ns" + ",m" * len(names) + "\n0" + ",1" * len(names) + "\n")
    with pytest.raises(DataError, match="if this line holds units, take it out"):
        read_recording(path, plant, dt=1.0)
    for times in ("0,0,1", "0,nan,2"):
        rows = "\n".join(time + ",1" * len(names) for time in times.split(","))
        path.write_text("time," + ",".join(names) + "\n" + rows + "\n")
        with pytest.raises(DataError, match="where the rows are evenly apart, give their step dt"):
            read_recording(path, plant, time="time")
    for options in ({"dt": "x"}, {"dt": np.nan}):
        with pytest.raises(DataError, match="dt must be a positive step"):
            read_recording(path, plant, **options)  # pyright: ignore[reportArgumentType]
    with pytest.raises(SettingError, match=r"plant must be a residua\.Plant"):
        read_recording(path, 5)  # pyright: ignore[reportArgumentType]


def test_a_recording_prints_as_a_short_table_of_its_channels() -> None:
    table = {f"H{k} [cm]": np.full(9, float(k)) for k in range(25)}
    table["H1 [cm]"][4] = np.nan
    lines = repr(recording_from_frame(pd.DataFrame(table), dt=2.0)).splitlines()
    assert lines[0] == "data frame: 9 samples, 2 s apart, 0 inputs, 25 outputs, 1 value missing"
    assert lines[1].split() == ["channel", "column", "mean", "std.", "dev.", "missing"]
    assert lines[3].split() == ["H1", "[cm]", "H1", "[cm]", "1", "0", "1"]
    assert (lines[-1], len(lines)) == ("and 5 more channels", 23)
    simulated = simulate_three_tank(10)
    assert repr(simulated) == "SimulatedRecording(10 samples, 1 s apart: u (10, 2), y (10, 3), x (10, 3))"
