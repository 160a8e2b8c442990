"""Rows with gaps and irregular times on a grid: nothing moved, lost or made up without a word."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings, strategies as st

from residua.errors import DataError, SettingError
from residua.library import three_tank
from residua.recording.recording import Recording, read_recording, recording_from_frame
from residua.recording.table_writer import write_table
from residua.recording.time_grid import put_on_grid


def read(time: np.ndarray, **options: object) -> Recording:
    frame = pd.DataFrame({"time": time, "level": np.arange(len(time), dtype=float)})
    return recording_from_frame(frame, **options)  # pyright: ignore


def test_missing_rows_become_gaps() -> None:
    time = 50.0 + np.delete(np.arange(20.0), [3, 4, 5, 11])
    with pytest.raises(DataError, match=r"time is irregular: .* fill_gaps=True"):
        read(time)
    recording = read(time, fill_gaps=True)
    np.testing.assert_array_equal(recording.time, 50.0 + np.arange(20.0))
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(recording.y[:, 0])), [3, 4, 5, 11])
    np.testing.assert_array_equal(recording.y[~np.isnan(recording.y)], np.arange(16.0))
    assert (recording.n_inserted, recording.n_missing, recording.dt) == (4, 4, 1.0)
    assert recording.notes == (
        "put on a grid of 1 s: 4 rows inserted as missing, in 2 gaps: 0.2 of the grid; the longest is 4 s from 52 s on",
    )


def test_regular_times_stay_as_they_are() -> None:
    plain, filled = (read(np.arange(30) / 3, fill_gaps=fill) for fill in (False, True))
    np.testing.assert_allclose(filled.time, plain.time, rtol=1e-14)
    np.testing.assert_array_equal(filled.y, plain.y)
    assert (filled.notes, filled.n_inserted) == ((), 0)


@settings(max_examples=100, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 10**6),
    step=st.sampled_from([2.0**-20, 0.01, 1.0, 60.0, 2.0**20]),
    drift=st.sampled_from([0.0, 5e-4, -5e-4]),
    jitter=st.sampled_from([0.0, 0.03, 0.07]),
)
def test_every_row_comes_back_at_its_point(seed: int, step: float, drift: float, jitter: float) -> None:
    """Whatever is missing, in any unit of time, with a clock that jitters and drifts: each row at its own place."""
    rng = np.random.default_rng(seed)
    places = np.cumsum(rng.choice([1, 1, 1, 1, 1, 2, 3, 40], size=200))
    time = 1000 * step + step * (1 + drift) * (places + rng.uniform(-jitter, jitter, 200))
    # The fitted grid lies off the true one by a part of the jitter: hence 0.07 at most where 0.1 is let pass.
    grid = put_on_grid(time, step, 0.1, 0, "test")
    np.testing.assert_array_equal(grid.places, places - places[0])
    np.testing.assert_allclose(grid.time[grid.places], time, atol=0.1 * step)
    assert grid.inserted == places[-1] - places[0] + 1 - 200
    assert grid.offset <= 0.1


def test_times_that_stand_on_no_grid_are_refused_with_the_numbers() -> None:
    time = np.arange(40.0)
    time[10] += 0.3
    with pytest.raises(
        DataError, match=r"no grid of 1 s: 1 of 40 rows are more than 0.1 of a step .* the worst, row 10, 0.3 of one"
    ):
        read(time, fill_gaps=True)
    moved = read(time, fill_gaps=True, tolerance=0.4)
    assert "times up to 0.3 of a step off it" in moved.notes[0]
    for tolerance in (0.0, 0.5, 2.0):
        with pytest.raises(SettingError, match=r"between 0 and 0\.5"):
            read(time, fill_gaps=True, tolerance=tolerance)
    with pytest.raises(SettingError, match="over 0"):
        read(time, tolerance=-1.0)


def test_rows_at_the_same_time() -> None:
    time = np.insert(np.arange(40.0), 10, 10.0)
    recording = read(time, fill_gaps=True)
    assert len(recording) == 40
    assert (
        "1 rows at the time of another left out, the nearest kept (1 of them with other values)" in recording.notes[0]
    )
    np.testing.assert_array_equal(recording.y[9:12, 0], [9, 10, 12])
    with pytest.raises(DataError, match="20 of 40 rows fall on a point of the grid of 1 s that has another row"):
        read(np.repeat(np.arange(20.0), 2), fill_gaps=True)
    with pytest.raises(DataError, match="every row has the same time"):
        read(np.zeros(5), fill_gaps=True)


def test_what_no_grid_can_mend() -> None:
    time = np.arange(40.0)
    time[20] = 3.0
    with pytest.raises(DataError, match="time goes backwards in row 20"):
        read(time, fill_gaps=True)
    time = np.arange(40.0)
    time[20] = np.nan
    with pytest.raises(DataError, match="the time in row 20 is missing"):
        read(time, fill_gaps=True)
    time = np.arange(40.0)
    time[20:] += 1e9
    with pytest.raises(DataError, match=r"grid of 1e\+09 points of 1 s; the longest gap, before row 20, is 1e\+09 s"):
        read(time, fill_gaps=True)
    with pytest.raises(DataError, match="fill_gaps needs times"):
        recording_from_frame(pd.DataFrame({"level": np.arange(3.0)}), dt=1, fill_gaps=True)


def test_the_step_of_the_plant_or_of_the_caller_is_that_of_the_grid(tmp_path: Path) -> None:
    names = ("Q1", "Q2", "h1", "h2", "h3")
    time = np.delete(np.arange(40.0), [7, 8]) * 1.0004  # a clock that drifts against the plant
    path = write_table(tmp_path / "data.csv", {"time": time} | dict.fromkeys(names, time))
    recording = read_recording(path, three_tank(), fill_gaps=True)
    assert (recording.dt, len(recording), recording.n_inserted) == (1.0, 40, 2)
    for dt in (0.5, 2.0):
        with pytest.raises(DataError, match=r"are usually 1\.0004 s apart, and a grid of"):
            read_recording(path, three_tank(dt=0), dt=dt, fill_gaps=True)
    with pytest.raises(DataError, match=r"drift by more than 0\.001"):
        read_recording(path, three_tank(dt=0), dt=0.99, fill_gaps=True)


def test_dt_gets_round_a_time_column(tmp_path: Path) -> None:
    """Rows are simply dt apart, and the recording says what became of its times; a named column must agree."""
    path = write_table(tmp_path / "data.csv", {"time": np.array([0.0, 1, 2, 7, 8]), "level": np.arange(5.0)})
    recording = read_recording(path, dt=1.0)
    np.testing.assert_array_equal(recording.time, np.arange(5.0))
    assert recording.notes[0].startswith("its time column 'time' was not used, rows are 1 s apart as dt= says (")
    assert "the step to row 5 is 5 s" in recording.notes[0]
    with pytest.raises(DataError, match="irregular"):
        read_recording(path, dt=1.0, time="time")
    path.write_text("time;level\nmorning;1\nnoon;2\n", encoding="utf-8")
    assert "expected a time, got 'morning'" in read_recording(path, dt=3.0).notes[0]
    path = write_table(tmp_path / "data.csv", {"time": 5 + 2.0 * np.arange(5), "level": np.arange(5.0)})
    assert "the steps do not agree" in read_recording(path, dt=1.0).notes[0]
    agreed = read_recording(path, dt=2.0)
    assert (agreed.notes, agreed.time[0]) == ((), 5.0)  # times that say the same are kept
