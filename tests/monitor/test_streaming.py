"""Recordings read piece by piece: the diagnosis, the page and the tables of the whole, or the error of the whole."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import residua as rs
from residua.cli import run_command
from residua.cli.app import app
from residua.decide import CUSUM, NormThreshold, PeakThreshold
from residua.errors import DataError, FileFormatError, ResiduaError
from residua.monitor import alarms, streaming
from residua.monitor.streaming import AT_ONCE, judged_file
from residua.recording import streams
from residua.recording.columns import ReadOptions
from residua.recording.recording import read_recording
from residua.recording.table_writer import write_table
from residua.report import decimate

pytest.importorskip("pyarrow")

ROWS = 4000
PLANT = (
    rs.Plant([[0.9, 0.1], [0.0, 0.8]], [[0.1], [0.2]], np.eye(2), dt=0.5, inputs=["valve"], outputs=["level", "flow"])
    .with_sensor_faults()
    .with_noise(process=1e-3, measurement=1e-2)
)


@pytest.fixture(autouse=True)
def small_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make pieces, blocks and charts so small that recordings of a test have many."""
    monkeypatch.setattr(streams, "ROWS", 173)
    monkeypatch.setattr(streams, "BYTES", 5000)
    monkeypatch.setattr(decimate, "POINTS", 500)


def table(step: float = 0.5) -> dict[str, np.ndarray]:
    """A recording with noise, gaps, a value that cannot be one, and a fault to the end."""
    rng = np.random.default_rng(7)
    y = 0.1 * rng.standard_normal((ROWS, 2))
    y[ROWS // 4 :, 0] += 4.0
    y[100:103, 1] = np.nan
    y[200, 0] = 1e300
    y[300:330] = np.nan
    columns = {"time": 10.0 + step * np.arange(ROWS), "valve": np.zeros(ROWS), "level": y[:, 0], "flow": y[:, 1]}
    return columns


def write_npz(path: Path, columns: dict[str, np.ndarray]) -> None:
    np.savez(path, **columns)


def write_u_y(path: Path, columns: dict[str, np.ndarray]) -> None:
    y = np.asfortranarray(np.column_stack([columns["level"], columns["flow"]]))
    np.savez(path, time=columns["time"], u=columns["valve"][:, None], y=y)


def write_quoted(path: Path, columns: dict[str, np.ndarray]) -> None:
    write_table(path, columns)
    lines = [",".join(f'"{cell}"' for cell in line.split(",")) for line in path.read_text().splitlines()]
    path.write_bytes("\r\n".join(["# a note", "# " + lines[0], *lines[1:], "", "  ", ""]).encode("utf-8-sig"))


def write_dates(path: Path, columns: dict[str, np.ndarray]) -> None:
    since = (columns["time"] * 1e9).astype("timedelta64[ns]")
    write_table(path, columns | {"time": np.datetime64("2026-03-01T00:00:00", "ns") + since})


def write_counts(path: Path, columns: dict[str, np.ndarray]) -> None:
    columns = {name: values for name, values in columns.items() if name != "time"}
    write_table(path, columns | {"valve": columns["valve"].astype(np.int32), "text": columns["valve"].astype(str)})


FILES: dict[str, tuple[str, Callable[[Path, dict[str, np.ndarray]], object]]] = {
    "csv": ("a.csv", write_table),
    "quoted csv": ("a.csv", write_quoted),
    "parquet": ("a.parquet", write_table),
    "dates": ("a.parquet", write_dates),
    "no times, whole numbers": ("a.parquet", write_counts),
    "npz": ("a.npz", write_npz),
    "matrices": ("a.npz", write_u_y),
}
MONITORS: dict[str, Callable[[], rs.Monitor]] = {
    "direction": lambda: rs.Monitor(rs.design.kalman_filter(PLANT)),
    "held values": lambda: rs.Monitor(rs.design.kalman_filter(PLANT), isolate=None, test=NormThreshold(threshold=3.0)),
    "cusum": lambda: rs.Monitor(rs.design.kalman_filter(PLANT), test=CUSUM(threshold=8.0)),
    "bank": lambda: rs.Monitor(rs.design.sensor_fault_bank(PLANT)),
    "peak": lambda: rs.Monitor(rs.design.sensor_fault_bank(PLANT), test=PeakThreshold(thresholds=[2.0, 2.0], window=5)),
    "matched": lambda: rs.Monitor(rs.design.matched_filters(PLANT)),
}


def assert_same(one: Any, other: Any, what: str = "") -> None:
    """Compare to the last bit, arrays within dataclasses included."""
    if isinstance(one, np.ndarray):
        assert one.dtype == other.dtype, what
        assert np.ascontiguousarray(one).tobytes() == np.ascontiguousarray(other).tobytes(), what
    elif is_dataclass(one) and any(isinstance(getattr(one, f.name), np.ndarray) for f in fields(one)):
        for f in fields(one):
            assert_same(getattr(one, f.name), getattr(other, f.name), f"{what}.{f.name}")
    elif not callable(one) and what not in ("generator", "isolation", "codes"):
        assert one == other or one is other or repr(one) == repr(other), what


def options(monitor: rs.Monitor) -> ReadOptions:
    return ReadOptions(monitor.design.plant, None, None, None, None)


@pytest.mark.parametrize("name", FILES)
def test_a_file_is_judged_as_the_whole_is(tmp_path: Path, name: str) -> None:
    file, write = FILES[name]
    write(tmp_path / file, table())
    monitor = MONITORS["direction"]()
    whole = monitor.run(tmp_path / file)
    assert isinstance(whole, rs.Diagnosis)
    assert whole.alarms
    state = monitor._state
    with judged_file(monitor, tmp_path / file, options(monitor)) as streamed:
        assert streamed is not None
        for one in fields(whole):
            assert_same(getattr(whole, one.name), getattr(streamed, one.name), one.name)
        assert str(streamed) == str(whole)
    assert_same(state, monitor._state, "state")


@pytest.mark.parametrize("kind", MONITORS)
def test_every_kind_of_monitor(tmp_path: Path, kind: str) -> None:
    path, monitor = tmp_path / "a.parquet", MONITORS[kind]()
    write_table(path, table())
    whole = monitor.run(path)
    assert isinstance(whole, rs.Diagnosis)
    whole.to_html(tmp_path / "whole.html")
    whole.write_alarms(tmp_path / "whole.jsonl")
    write_table(tmp_path / "whole.csv", whole.columns())
    parts = {"residuals": tmp_path / "part.csv", "alarms": tmp_path / "part.jsonl", "report": tmp_path / "part.html"}
    part = monitor.run_file(path, **parts)
    for ending in ("html", "jsonl", "csv"):
        assert (tmp_path / f"part.{ending}").read_bytes() == (tmp_path / f"whole.{ending}").read_bytes()
    assert (part.alarms, part.notes, part.n_missing) == (whole.alarms, whole.notes, whole.n_missing)
    assert str(part) == str(whole)
    assert part.false_alarm_fraction == whole.false_alarm_fraction
    assert part.why_undecided == whole.why_undecided


def test_a_continuous_generator_learns_the_step_from_the_file(tmp_path: Path) -> None:
    plant = rs.Plant([[-0.2]], [[0.1]], [[1.0]], inputs=["valve"], outputs=["level"]).with_sensor_faults()
    made = rs.design.luenberger_observer(
        plant.with_noise(process=1e-3, measurement=1e-2), poles=[-0.5]
    ).residual_generator()
    write_table(tmp_path / "a.csv", table(0.25))
    one, other = (rs.Monitor(made, test=NormThreshold(threshold=3.0)) for _ in range(2))
    whole, part = one.run(tmp_path / "a.csv"), other.run_file(tmp_path / "a.csv")
    assert part.recording.thinned
    assert str(part) == str(whole)
    assert other.generator.dt == one.generator.dt == 0.25


def test_a_thinned_diagnosis(tmp_path: Path) -> None:
    path, monitor = tmp_path / "a.parquet", MONITORS["direction"]()
    write_table(path, table())
    whole = monitor.run(path)
    assert isinstance(whole, rs.Diagnosis)
    calls: list[tuple[int, int]] = []
    part = monitor.run_file(path, residuals=tmp_path / "out.parquet", progress=lambda *now: calls.append(now))
    assert calls[-1] == (ROWS, ROWS)
    assert part.recording.thinned
    assert len(part.time) == len(part.residuals) == len(part.alarm) <= 500
    np.testing.assert_array_equal(np.nanmax(part.residuals, axis=0), np.nanmax(whole.residuals, axis=0))
    np.testing.assert_array_equal(np.nanmin(part.residuals, axis=0), np.nanmin(whole.residuals, axis=0))
    assert part.alarm.any()
    assert part.missing.any()
    with pytest.raises(DataError, match=r"keeps 500 points of 4000 samples.*the full table is in .*out\.parquet"):
        part.columns()
    with pytest.raises(DataError, match=r"run_file\(report=\.\.\.\) writes the page"):
        part.to_html(tmp_path / "page.html")
    with pytest.raises(DataError, match="run_file"):
        part.plot()
    with pytest.raises(DataError, match=r"run_file\(residuals=\.\.\.\)"):
        monitor.run_file(path).columns()


def test_a_short_recording_is_kept_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(decimate, "POINTS", 10_000)
    path, monitor = tmp_path / "a.csv", MONITORS["direction"]()
    write_table(path, table())
    part, whole = monitor.run_file(path), monitor.run(path)
    assert not part.recording.thinned
    for one in fields(part):
        assert_same(getattr(whole, one.name), getattr(part, one.name), one.name)


# ------------------------------------------------------------------ bad input


def _shift(columns: dict[str, np.ndarray], by: float) -> None:
    columns["time"] = columns["time"].copy()
    columns["time"][3000:] += by


WRONG_TIMES = {"backwards": -7.0, "repeats": -0.5, "a step": 0.25, "missing": np.nan}


@pytest.mark.parametrize("by", WRONG_TIMES.values(), ids=WRONG_TIMES)
@pytest.mark.parametrize("file", ["a.csv", "a.parquet", "a.npz"])
def test_times_that_change_midway(tmp_path: Path, file: str, by: float) -> None:
    columns, path = table(), tmp_path / file
    _shift(columns, by)
    (write_npz if file.endswith("npz") else write_table)(path, columns)
    assert_same_error(path)


@pytest.mark.parametrize("change", ["a word", "a cell more", "a cell less", "text at the end", "an empty time"])
def test_text_that_changes_midway(tmp_path: Path, change: str) -> None:
    path = tmp_path / "a.csv"
    write_table(path, table())
    lines = path.read_text().splitlines()
    row = lines[3500].split(",")
    new = {
        "a word": [*row[:3], "x\x1b[31m"],
        "a cell more": [*row, "1"],
        "a cell less": row[:3],
        "an empty time": ["", *row[1:]],
    }
    lines[3500] = ",".join(new.get(change, row))
    path.write_text("\n".join(lines) + ("\nthe end" if change == "text at the end" else ""))
    assert_same_error(path)


@pytest.mark.parametrize("file", ["a.parquet", "a.npz"])
@pytest.mark.parametrize("part", [0.3, 0.999])
def test_a_file_that_is_cut_off(tmp_path: Path, file: str, part: float) -> None:
    path = tmp_path / file
    (write_npz if file.endswith("npz") else write_table)(path, table())
    path.write_bytes(path.read_bytes()[: int(part * path.stat().st_size)])
    assert_same_error(path)


@pytest.mark.parametrize("at", [0.2, 0.5, 0.8])
@pytest.mark.parametrize("file", ["a.parquet", "a.npz"])
def test_a_file_with_a_damaged_part(tmp_path: Path, file: str, at: float) -> None:
    path = tmp_path / file
    (write_npz if file.endswith("npz") else write_table)(path, table())
    content = bytearray(path.read_bytes())
    for k in range(40):
        content[int(at * len(content)) + k] ^= 0xA5
    path.write_bytes(content)
    monitor = MONITORS["direction"]()
    try:
        whole: Any = str(monitor.run(path))
    except ResiduaError:
        assert_same_error(path)
        return
    assert str(monitor.run_file(path)).removesuffix(AT_ONCE).strip() == whole


def test_a_file_that_is_made_to_fill_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Equal values take no room in the file."""
    monkeypatch.setenv("RESIDUA_MAX_UNPACKED", "1000000")
    path, count = tmp_path / "a.parquet", 2_000_000
    write_table(tmp_path / "a.parquet", dict.fromkeys(("valve", "level", "flow"), np.zeros(count)))
    import pyarrow.parquet as parquet

    parquet.write_table(parquet.read_table(path), path, row_group_size=count, compression="zstd")
    assert 24 * count > 1000 * path.stat().st_size
    assert_same_error(path)


@pytest.mark.parametrize("missing", ["level", "valve"])
def test_a_missing_column(tmp_path: Path, missing: str) -> None:
    for file in ("a.csv", "a.parquet"):
        columns = table()
        columns["other"] = columns.pop(missing)
        write_table(tmp_path / file, columns)
        assert_same_error(tmp_path / file)


def assert_same_error(path: Path) -> None:
    """Compare with the error of ``run``; no output file is left."""
    monitor = MONITORS["direction"]()
    with pytest.raises(ResiduaError) as whole:
        monitor.run(path)
    folder = path.parent / "out"
    folder.mkdir(exist_ok=True)
    with pytest.raises(ResiduaError) as part:
        monitor.run_file(path, residuals=folder / "r.csv", alarms=folder / "a.jsonl", report=folder / "p.html")
    assert (type(part.value), str(part.value)) == (type(whole.value), str(whole.value))
    assert list(folder.iterdir()) == []


class Full:
    """A file on a disk without room after some writes."""

    def __init__(self, after: int) -> None:
        self.left = after

    def write(self, content: Any) -> int:
        self.left -= 1
        if self.left < 0:
            raise OSError(28, "No space left on device")
        return len(content)

    def seek(self, *where: int) -> int:
        return 0

    def close(self) -> None: ...


def test_no_room_on_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.parquet"
    write_table(path, table())
    monkeypatch.setattr(streaming.tempfile, "TemporaryFile", lambda **_: Full(3))
    with pytest.raises(FileFormatError, match=r"cannot be stored there.*No space left.*TMPDIR"):
        MONITORS["direction"]().run_file(path, residuals=tmp_path / "r.csv")
    assert [one.name for one in tmp_path.iterdir()] == ["a.parquet"]


def test_an_interruption_leaves_nothing(tmp_path: Path) -> None:
    path = tmp_path / "a.parquet"
    write_table(path, table())

    def interrupt(done: int, of: int) -> None:
        if done > ROWS // 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        MONITORS["direction"]().run_file(path, residuals=tmp_path / "r.csv", progress=interrupt)
    assert [one.name for one in tmp_path.iterdir()] == ["a.parquet"]


@pytest.mark.parametrize("what", ["dates", "blanks", "compressed", "latin-1"])
def test_what_is_read_at_once_says_so(tmp_path: Path, what: str) -> None:
    path, columns = tmp_path / ("a.npz" if what == "compressed" else "a.csv"), table()
    if what == "compressed":
        np.savez_compressed(path, **columns)
    else:
        write_table(path, columns)
        lines = path.read_text().splitlines()
        if what == "blanks":
            lines = [" ".join(cell or "nan" for cell in line.split(",")) for line in lines]
        elif what == "dates":
            lines[1:] = [
                f"2026-01-01T00:{k // 120:02d}:{k % 120 / 2:04.1f},{line.split(',', 1)[1]}"
                for k, line in enumerate(lines[1:])
            ]
        else:
            lines = [lines[0] + ",Größe", *(line + ",1" for line in lines[1:])]
        path.write_text("\n".join(lines), encoding="latin-1")
    monitor = MONITORS["direction"]()
    whole, part = monitor.run(path), monitor.run_file(path)
    assert isinstance(whole, rs.Diagnosis)
    assert part.notes == (*whole.notes, AT_ONCE)
    assert not part.recording.thinned
    assert part.alarms == whole.alarms


def test_the_name_of_the_table_is_checked_first(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    write_table(path, table())
    with pytest.raises(DataError, match=r"written as \.csv or \.parquet"):
        MONITORS["direction"]().run_file(path, residuals="r.xlsx")
    with pytest.raises(FileFormatError, match="recording not found"):
        MONITORS["direction"]().run_file(tmp_path / "absent.csv")


# ------------------------------------------------------------------ the command line


@pytest.mark.parametrize("fault", [True, False])
@pytest.mark.parametrize("file", ["a.csv", "a.parquet", "cut.parquet", "dates.csv"])
def test_the_command_says_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, file: str, fault: bool) -> None:
    columns, path = table(), tmp_path / file
    if not fault:
        columns["level"] = columns["flow"] = np.zeros(ROWS)
    if file == "cut.parquet":
        _shift(columns, -7.0)
    write_table(path, columns)
    MONITORS["direction"]().save(tmp_path / "m.json")
    answers = []
    for above, folder in ((10**9, "whole"), (0, "part")):
        monkeypatch.setattr(run_command, "STREAMED", above)
        (tmp_path / folder).mkdir()
        monkeypatch.chdir(tmp_path / folder)
        outputs = ["--residuals", "r.csv", "--alarms", "a.jsonl", "--report", "p.html"]
        said = CliRunner().invoke(app, ["run", str(tmp_path / "m.json"), str(path), *outputs])
        content = {one.name: one.read_bytes() for one in (tmp_path / folder).iterdir()}
        answers.append((said.exit_code, said.output, content))
    assert answers[0] == answers[1]
    assert answers[0][0] == (2 if file == "cut.parquet" else int(fault))


# ------------------------------------------------------------------ what bounds memory


def test_beginnings_by_a_bounded_number_of_samples() -> None:
    """Whatever the pieces, the samples that are looked at are the last ones before and the first ones after."""
    rng = np.random.default_rng(0)
    usable, residuals = rng.random(5000) > 0.3, rng.standard_normal((5000, 2))
    residuals[rng.integers(0, 5000, 50)] = np.nan
    judged = np.flatnonzero(usable & np.isfinite(residuals).all(axis=1))
    for piece, most in ((7, 10**6), (1000, 300), (10**6, 300)):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(alarms, "_PIECE", piece)
            patch.setattr(alarms, "MOST_ROWS", most)
            for start, stop in ((0, 5000), (10, 4000), (5, 5), (4990, 5000)):
                rows = judged[(judged >= start) & (judged < stop)]
                assert_same(rows[-most:], alarms._judged(residuals, usable, start, stop, last=True))
                assert_same(rows[:most], alarms._judged(residuals, usable, start, stop, last=False))


def test_read_recording_agrees_with_the_stream(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    write_quoted(path, table())
    recording = read_recording(path, PLANT)
    pieces = list(streams.open_stream(path, ReadOptions(PLANT, None, None, None, None)).pieces())
    assert len(pieces) > 5
    assert_same(np.hstack([recording.u, recording.y]), np.vstack([piece.values for piece in pieces]))
    assert_same(recording.time, np.concatenate([piece.time for piece in pieces if piece.time is not None]))


def test_runs_of_alarms_are_those_of_the_whole_series(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(alarms, "_PIECE", 7)
    rng = np.random.default_rng(0)
    for _ in range(300):
        flags = rng.random(int(rng.integers(0, 40))) < rng.random()
        edges = np.flatnonzero(np.diff(flags, prepend=False, append=False)).reshape(-1, 2)
        assert alarms._runs(flags) == list(map(tuple, edges.tolist()))
