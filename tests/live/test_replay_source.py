"""Recordings as if they came now."""

from __future__ import annotations

import json
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import residua.live.sources.replay as replay
from live.brokers import Run, wait_for
from residua.errors import SettingError
from residua.live.source import Message
from residua.live.sources.replay import Replay, Settings
from residua.plant import Plant
from residua.recording.recording import read_recording

PLANT = Plant(
    A=[[0.9]],
    B=[[0.1]],
    C=[[1.0], [2.0]],
    dt=0.5,
    name="tank",
    inputs=["valve"],
    outputs=["level", "flow"],
    states=["x"],
)
ROWS = 57


def write(path: Path, times: Any = None, seed: int = 0) -> Path:
    rng = np.random.default_rng(seed)
    values = rng.standard_normal((ROWS, 3))
    times = np.arange(ROWS) * 0.5 + 3.0 if times is None else times
    lines = ["time,flow,valve,level"]
    for k, (t, row) in enumerate(zip(times, values, strict=True)):
        cells = ["" if k == 4 and c == 1 else repr(float(x)) for c, x in enumerate(row)]
        lines.append(",".join([str(t), *cells]))
    path.write_text("\n".join(lines) + "\n")
    return path


def replayed(settings: Settings, models: dict[str, Plant], reached: dict[str, float] | None = None) -> list[Message]:
    source = Replay(settings, models)
    source.resume(reached or {})
    with Run(source, most=20) as run:
        wait_for(lambda: source.over and run.waiting == 0)
        assert source.health.good, source.health
        time.sleep(0.05)
    return run.messages


def rows_of(messages: list[Message], plant: str) -> tuple[list[Any], np.ndarray]:
    times: list[Any] = []
    values: list[list[float]] = []
    for content in (json.loads(m.payload) for m in messages):
        if content["plant"] == plant:
            packed = isinstance(content["t"], list)
            times += content["t"] if packed else [content["t"]]
            for u, y in zip(content["u"], content["y"], strict=True) if packed else [(content["u"], content["y"])]:
                values.append([np.nan if x is None else x for x in u + y])
    return times, np.array(values)


@pytest.mark.parametrize("rows", [1, 2, 10, 100])
def test_a_recording_comes_to_its_last_bit_whatever_the_size_of_messages(tmp_path: Path, rows: int) -> None:
    path = write(tmp_path / "a.csv")
    messages = replayed(Settings(str(path), speed=0, rows=rows), {"north": PLANT})
    assert len(messages) == -(-ROWS // rows)
    times, values = rows_of(messages, "north")
    recording = read_recording(path, PLANT)
    assert times == recording.time.tolist()
    np.testing.assert_array_equal(values, np.hstack([recording.u, recording.y]))
    assert np.isnan(values).sum() == 1


def test_a_large_file_is_read_piece_by_piece_with_the_same_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("pyarrow")
    pandas = pytest.importorskip("pandas")
    frame = pandas.read_csv(write(tmp_path / "a.csv"))
    frame["time"] = pandas.Timestamp("2026-03-01T12:00:00") + pandas.to_timedelta(frame["time"], unit="s")
    frame.to_parquet(tmp_path / "b.parquet")
    for path in (tmp_path / "a.csv", tmp_path / "b.parquet"):
        settings = Settings(str(path), speed=0, rows=10)
        whole = [m.payload for m in replayed(settings, {"north": PLANT})]
        with monkeypatch.context() as patched:
            patched.setattr(replay, "_LARGE", 1)
            patched.setattr(replay, "read_recording", None)  # not called
            assert [m.payload for m in replayed(settings, {"north": PLANT})] == whole


def test_dates_are_sent_with_their_zone(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", [f"2026-03-01T12:00:{k / 2:06.3f}+02:00" for k in range(ROWS)])
    times, _ = rows_of(replayed(Settings(str(path), speed=0, rows=10), {"north": PLANT}), "north")
    begin = datetime(2026, 3, 1, 10, tzinfo=UTC).timestamp()
    assert [datetime.fromisoformat(t).timestamp() for t in times] == [begin + k / 2 for k in range(ROWS)]


def test_plants_come_together_each_with_its_own_file_or_the_same(tmp_path: Path) -> None:
    a, b = write(tmp_path / "a.csv"), write(tmp_path / "b.csv", seed=1)
    models = dict.fromkeys(("north", "south", "west", "other"), PLANT)
    settings = Settings(str(a), files={"west": str(b)}, plants=("north", "south", "west"), speed=0, rows=5)
    messages = replayed(settings, models)
    for plant, path in (("north", a), ("south", a), ("west", b)):
        recording = read_recording(path, PLANT)
        np.testing.assert_array_equal(rows_of(messages, plant)[1], np.hstack([recording.u, recording.y]))
    order = [json.loads(m.payload)["t"][0] for m in messages]
    assert order == sorted(order)
    assert len(messages) == 3 * -(-ROWS // 5)
    assert {json.loads(m.payload)["plant"] for m in replayed(Settings(str(a), speed=0), models)} == set(models)


def test_after_a_restart_it_goes_on_after_the_last_row_of_each_plant(tmp_path: Path) -> None:
    models = {"north": PLANT, "south": PLANT}
    messages = replayed(Settings(str(write(tmp_path / "a.csv")), speed=0), models, {"north": 20.5, "south": 3.0})
    assert rows_of(messages, "north")[0] == [21.0 + k / 2 for k in range(ROWS - 36)]
    assert rows_of(messages, "south")[0] == [3.5 + k / 2 for k in range(ROWS - 1)]
    dated = write(tmp_path / "b.csv", [f"2026-03-01T12:00:{k / 2:06.3f}" for k in range(ROWS)])
    reached = datetime(2026, 3, 1, 12, 0, 7, 500_000, tzinfo=UTC).timestamp()
    messages = replayed(Settings(str(dated), speed=0), {"north": PLANT}, {"north": reached})
    assert rows_of(messages, "north")[0][0] == "2026-03-01T12:00:08+00:00"
    assert len(messages) == ROWS - 16


def test_repeats_go_on_in_time(tmp_path: Path) -> None:
    messages = replayed(Settings(str(write(tmp_path / "a.csv")), speed=0, repeat=3, rows=10), {"north": PLANT})
    times, values = rows_of(messages, "north")
    assert times == [3.0 + k / 2 for k in range(3 * ROWS)]
    np.testing.assert_array_equal(values[:ROWS], values[2 * ROWS :])
    source = Replay(Settings(str(tmp_path / "a.csv"), speed=0, repeat=0), {"north": PLANT})
    with Run(source) as run:
        run.wait_for(500)
    assert not source.over


def test_the_speed_is_that_of_the_recording_times_a_factor(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv")
    begin = time.monotonic()
    messages = replayed(Settings(str(path), speed=20), {"north": PLANT})
    assert 1.35 < time.monotonic() - begin < 5.0  # 28 s of recording
    arrived = np.array([m.arrived for m in messages])
    assert np.median(np.diff(arrived)) == pytest.approx(0.025, abs=0.01)


def test_times_of_now_begin_now_and_after_a_restart_past_the_store(tmp_path: Path) -> None:
    path = str(write(tmp_path / "a.csv"))
    times, _ = rows_of(replayed(Settings(path, speed=0, times="now", rows=7), {"north": PLANT}), "north")
    seconds = [datetime.fromisoformat(t).timestamp() for t in times]
    assert abs(seconds[0] - time.time()) < 20.0
    assert np.diff(seconds) == pytest.approx(0.5, abs=1e-5)
    ahead = time.time() + 5000.0
    again, _ = rows_of(replayed(Settings(path, speed=0, times="now"), {"north": PLANT}, {"north": ahead}), "north")
    assert datetime.fromisoformat(again[0]).timestamp() == pytest.approx(ahead + 0.5, abs=1e-5)
    assert len(again) == ROWS


def test_what_cannot_be_read_ends_it_and_is_said(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("time,level\n0,1\n1,2\n")
    source = Replay(Settings(str(path), speed=0), {"north": PLANT})
    with Run(source):
        wait_for(lambda: source.over)
    assert not source.health.good
    assert "missing columns 'valve', 'flow'" in source.health.text


def test_a_plant_without_a_model_or_a_file_is_named() -> None:
    with pytest.raises(SettingError, match="plants: south is not watched"):
        Replay(Settings(__file__, plants=("south",)), {"north": PLANT})
    with pytest.raises(SettingError, match="files: there is no recording of south"):
        Replay(Settings(files={"north": __file__}, plants=("south",)), {"north": PLANT, "south": PLANT})
