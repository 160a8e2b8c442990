"""Alarms of a live run are those of a recorded one, however rows come in batches and the run is cut off."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import residua as rs
from live_examples import alarms_of, alarms_of_run, fed, monitor, opened, recording, told
from residua.errors import DataError, FileFormatError, NotFittedError, SettingError
from residua.live.records import state_from_bytes, state_to_bytes
from residua.live.watched_model import WatchedModel

SAMPLES = 3000
KINDS = ("direction", "no names", "matched", "likelihood", "codes")


def run_in_batches(
    path: Path, model: WatchedModel, rows: np.ndarray, seed: int, cut_off: float
) -> list[dict[str, Any]]:
    """Return the events of two plants that are fed alike in batches of random length, with the run cut off at times."""
    rng, times, k = np.random.default_rng(seed), np.arange(len(rows), dtype=float), 0
    watch = opened(path, model, ["a", "b"])
    while k < len(rows):
        n = int(rng.choice([1, 1, 3, 10, 100, 700]))
        fed(watch, ["a", "b"], times[k : k + n], rows[k : k + n])
        k += n
        if rng.random() < cut_off:
            watch.store.close()  # what a kill leaves: nothing but what was committed
            watch = opened(path, model)
    watch.store.commit(watch.standing())
    events = told(watch, "a")
    assert events == told(watch, "b")
    watch.store.close()
    return events


@pytest.mark.parametrize("kind", KINDS)
def test_alarms_are_those_of_a_recorded_run(tmp_path: Path, kind: str) -> None:
    made, rows = monitor(kind), recording(SAMPLES)
    model = WatchedModel("tanks", made, history=4.0 * SAMPLES)
    events = run_in_batches(tmp_path / "live.db", model, rows, 0, 0.05)
    wanted = alarms_of_run(made, rows, np.arange(SAMPLES, dtype=float))
    assert len(wanted) >= 2
    assert alarms_of(events) == wanted
    assert [one["number"] for one in events] == list(range(1, len(events) + 1))


def test_events_do_not_depend_on_batches_or_on_being_cut_off(tmp_path: Path) -> None:
    model, rows = WatchedModel("tanks", monitor(), history=500.0), recording(SAMPLES)
    runs = [
        run_in_batches(tmp_path / f"{seed}.db", model, rows, seed, cut_off)
        for seed, cut_off in ((0, 0.0), (1, 0.1), (2, 0.3))
    ]
    assert runs[0] == runs[1] == runs[2]
    assert {one["kind"] for one in runs[0]} >= {"raised", "ended", "missing", "back", "standing"}


def test_old_rows_are_let_go(tmp_path: Path) -> None:
    model, rows = WatchedModel("tanks", monitor(), history=500.0), recording(6000)
    watch = opened(tmp_path / "live.db", model, ["a"])
    times = np.arange(len(rows), dtype=float)
    for k in range(0, len(rows), 250):
        fed(watch, ["a"], times[k : k + 250], rows[k : k + 250])
    kept = watch.store.rows(watch.plants["a"].key)
    assert kept[0][0] == watch.plants["a"].anchor_at >= 4500
    diagnosis = watch.diagnosis("a")
    assert diagnosis is not None
    whole = monitor().run(rows[:, :2], rows[:, 2:])
    assert isinstance(whole, rs.monitor.Diagnosis)
    np.testing.assert_array_equal(diagnosis.residuals, whole.residuals[-len(diagnosis.time) :])


def test_an_alarm_that_outlives_what_is_kept_keeps_its_beginning(tmp_path: Path) -> None:
    samples = 12_000
    k = np.arange(samples)
    run = rs.library.simulate_three_tank(samples, faults={"leak 3": 0.05 * (k >= 600)}, seed=1)
    rows, times = np.hstack([run.u, run.y]), k.astype(float)
    watch = opened(tmp_path / "live.db", WatchedModel("tanks", monitor(), history=500.0), ["a"])
    for start in range(0, samples, 500):
        fed(watch, ["a"], times[start : start + 500], rows[start : start + 500])
    watch.store.commit(watch.standing())
    assert watch.plants["a"].anchor_at > 1000
    events = [one for one in told(watch, "a") if one["kind"] in ("raised", "standing")]
    raised, standing = (next(one for one in events if one["kind"] == kind) for kind in ("raised", "standing"))
    assert [one["kind"] for one in events].count("raised") == 1
    for name in ("raised", "onset", "name"):
        assert standing[name] == raised[name]


def test_missing_values_are_told_once_and_so_is_that_they_are_back(tmp_path: Path) -> None:
    rows = recording(2000)
    rows[:, 0] = np.nan_to_num(rows[:, 0], nan=21.4)
    watch = opened(tmp_path / "live.db", WatchedModel("tanks", monitor()), ["a"])
    fed(watch, ["a"], np.arange(2000.0), rows)
    gaps = [one for one in told(watch, "a") if one["kind"] in ("missing", "back")]
    assert [one["kind"] for one in gaps] == ["missing", "back"]
    longest = watch.models["tanks"].longest_gap
    assert [one["time"] for one in gaps] == [1500.0 + longest - 1, 1550.0 + longest - 1]
    assert gaps[0]["channels"] == ["h2"]


def test_a_silent_plant_is_told_once(tmp_path: Path) -> None:
    watch = opened(tmp_path / "live.db", WatchedModel("tanks", monitor()), ["a", "never heard"])
    fed(watch, ["a"], np.arange(100.0), recording(2000)[:100])
    assert not watch.silent(59.0, 60.0)
    watch.store.commit(watch.silent(61.0, 60.0))
    assert not watch.silent(100.0, 60.0)
    (event,) = told(watch, "a")
    assert event["kind"] == "missing"
    assert event["channels"] == ["Q1", "Q2", "h1", "h2", "h3"]


def test_a_store_of_other_monitors_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "live.db"
    watch = opened(path, WatchedModel("tanks", monitor()), ["a"])
    fed(watch, ["a"], np.arange(10.0), recording(2000)[:10])
    watch.store.close()
    with pytest.raises(DataError, match="another monitor of 'tanks'"):
        opened(path, WatchedModel("tanks", monitor("no names")))
    with pytest.raises(DataError, match="which is not configured"):
        opened(path, WatchedModel("others", monitor()))


def test_only_fitted_monitors_run_live() -> None:
    made = rs.design.kalman_filter(
        rs.Plant([[0.5]], [[1.0]], [[1.0]], dt=1).with_sensor_faults().with_noise(process=1.0, measurement=1.0)
    )
    design = rs.design.luenberger_observer(rs.library.gertler(sensor_faults=True)).residual_generator()
    with pytest.raises(NotFittedError, match="fit it"):
        WatchedModel("x", rs.Monitor(design))
    with pytest.raises(SettingError, match=r"only a residua\.Monitor"):
        WatchedModel("x", made)  # type: ignore[arg-type]


@pytest.mark.parametrize("kind", KINDS)
def test_states_as_bytes_are_the_same_to_the_last_bit(kind: str) -> None:
    made, rows = monitor(kind), recording(2000)
    model = WatchedModel("tanks", made)
    state = model.run(model.start(), rows[:1600])
    content = state_to_bytes(state)
    again = state_from_bytes(content, model.spec)
    assert state_to_bytes(again) == content
    assert state_to_bytes(model.run(again, rows[1600:])) == state_to_bytes(model.run(state, rows[1600:]))
    for damaged in (b"", content[:-1], content + b"\0", b"\2" + content[1:]):
        with pytest.raises(FileFormatError, match="of another monitor"):
            state_from_bytes(damaged, model.spec)


def test_a_plant_that_is_reset_begins_anew(tmp_path: Path) -> None:
    rows, path = recording(2200), tmp_path / "live.db"
    model = WatchedModel("tanks", monitor(), history=500.0)
    watch = opened(path, model, ["a"])
    fed(watch, ["a"], 5000.0 + np.arange(1000.0), rows[:1000])
    watch.store.commit(watch.reset("a"))
    assert [one["kind"] for one in told(watch, "a")] == ["raised", "confirmed", "ended"]
    for first in range(0, 2200, 300):
        part = slice(first, first + 300)
        fed(watch, ["a"], np.arange(2200.0)[part], rows[part])
        if first == 900:
            watch.store.close()
            watch = opened(path, model)
    watch.store.commit(watch.standing())
    later = [one for one in told(watch, "a")[4:] if one["kind"] in ("ended", "standing")]
    wanted = alarms_of_run(monitor(), rows, np.arange(2200.0))
    assert [(one["raised"], one["onset"]) for one in later] == [(one["raised"], one["onset"]) for one in wanted]
