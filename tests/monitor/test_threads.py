"""Threads: one monitor runs several recordings at once, a stream is followed by one call at a time."""

from __future__ import annotations

import copy
import pickle
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any

import numpy as np
import pytest

import residua as rs
from residua.library import three_tank
from residua.monitor import monitor as monitor_module, online
from residua.monitor.fitted_thresholds import fitted_test
from running_examples import plant, recording


@pytest.fixture(autouse=True)
def _often() -> Iterator[None]:
    """Let threads change places often."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(before)


def test_runs_in_several_threads_do_not_disturb_each_other() -> None:
    """With the state of a run in the monitor, false alarms appeared: each went on from the state of another."""
    monitor = rs.Monitor(rs.design.kalman_filter(plant())).fit(*recording(2000, seed=9))
    data = [recording(3000, seed=k, fault="p1" if k % 2 else "", start=1000) for k in range(6)]
    expected = [monitor.run(u, y).statistic for u, y in data]  # type: ignore[union-attr]

    def one(k: int) -> bool:
        u, y = data[k % 6]
        return np.array_equal(monitor.run(u, y).statistic, expected[k % 6], equal_nan=True)  # type: ignore[union-attr]

    with ThreadPoolExecutor(6) as pool:
        assert all(pool.map(one, range(60)))


def test_the_first_runs_of_a_continuous_design_at_once() -> None:
    """Sampling and the specification are made on first use, by one thread."""
    found = rs.library.simulate_three_tank(400, seed=1)
    design = rs.design.kalman_filter(three_tank())
    expected = rs.Monitor(design).run(found.u, found.y).statistic  # type: ignore[union-attr]
    continuous = rs.design.detection_filter(three_tank(dt=0).without_faults(["leak 3", "clog 32"]))
    for _ in range(5):
        many = rs.Monitor(design)
        late = rs.Monitor(continuous, test=rs.decide.NormThreshold(threshold=1.0))
        with ThreadPoolExecutor(6) as pool:
            runs = [pool.submit(many.run, found.u, found.y) for _ in range(6)]
            others = [pool.submit(late.run, found.u, found.y, dt=1.0) for _ in range(6)]
            for run in runs:
                assert np.array_equal(run.result().statistic, expected, equal_nan=True)  # type: ignore[union-attr]
            first = others[0].result().statistic  # type: ignore[union-attr]
            for run in others[1:]:
                assert np.array_equal(run.result().statistic, first, equal_nan=True)  # type: ignore[union-attr]


def test_samples_of_a_stream_are_taken_one_after_the_other() -> None:
    """All samples are alike, so that their order cannot matter: each must be counted, and none twice."""
    monitor = rs.Monitor(rs.design.kalman_filter(plant()))
    u, y = np.full(1, 3.0), np.array([1.0, 2.0])
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda _: monitor.step(u, y), range(400)))
    assert monitor._state is not None
    assert monitor._state.count == 400
    assert monitor._state.filter.age[0] == 400


def test_a_copy_has_a_state_of_its_own() -> None:
    monitor = rs.Monitor(rs.design.kalman_filter(plant()))
    u, y = recording(200)
    monitor.update(u[:100], y[:100])
    for other in (copy.deepcopy(monitor), pickle.loads(pickle.dumps(monitor))):
        assert (
            other.update(u[100:], y[100:]).statistic.tobytes()
            == copy.deepcopy(monitor).update(u[100:], y[100:]).statistic.tobytes()
        )
    assert monitor._state is not None
    assert monitor._state.count == 100


def test_no_sample_is_taken_in_the_middle_of_a_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    """A step went on with the old thresholds, and left its state to the new ones."""
    monitor = rs.Monitor(rs.design.kalman_filter(plant()), test=rs.decide.NormThreshold(window=3))
    inside, on = threading.Event(), threading.Event()

    def fitted(*arguments: Any, **settings: Any) -> Any:
        made = fitted_test(*arguments, **settings)
        inside.set()
        assert on.wait(60)
        return made

    monkeypatch.setattr(monitor_module, "fitted_test", fitted)
    u, y = recording(600)
    with ThreadPoolExecutor(2) as pool:
        fit = pool.submit(monitor.fit, u, y)
        assert inside.wait(60)
        step = pool.submit(monitor.step, u[0], y[0])
        assert not wait([step], timeout=0.2).done
        on.set()
        fit.result()
        step.result()
    assert monitor._state is not None
    assert monitor._state.count == 1


@pytest.mark.parametrize("made", [copy.copy, copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one))])
def test_a_copy_waits_for_the_block_that_is_under_way(made: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """It had the count of the samples before the block, and the state of its middle."""
    monitor = rs.Monitor(rs.design.kalman_filter(plant()))
    inside, on = threading.Event(), threading.Event()
    go_on = online.Online.go_on

    def held(*arguments: Any) -> Any:
        inside.set()
        assert on.wait(60)
        return go_on(*arguments)

    monkeypatch.setattr(online.Online, "go_on", held)
    u, y = recording(600)
    with ThreadPoolExecutor(2) as pool:
        block = pool.submit(monitor.update, u, y)
        assert inside.wait(60)
        copies = pool.submit(made, monitor)
        assert not wait([copies], timeout=0.2).done
        on.set()
        block.result()
        other = copies.result()
    assert other._state.count == 600
    other.step(u[0], y[0])
    assert monitor._state is not None
    assert monitor._state.count == 600


def test_a_stream_does_not_follow_a_recording_that_ran_with_other_thresholds() -> None:
    monitor = rs.Monitor(rs.design.kalman_filter(plant()))
    u, y = recording(600)
    expected = monitor.run(u, y)
    assert monitor._state is not None

    def fit(done: int, samples: int) -> None:
        monitor.fit(u, y, false_alarm_rate=0.1)

    found = monitor.run(u, y, progress=fit)
    assert monitor._state is None
    assert (found.threshold, found.notes) == (expected.threshold, expected.notes)  # type: ignore[union-attr]
    assert monitor.run(u, y).threshold < found.threshold  # type: ignore[union-attr]


def test_a_fleet_goes_on_as_it_was_made_when_its_monitor_is_fitted_anew() -> None:
    """Its snapshots were of the new monitor then, and plants that came changed the thresholds of those before."""
    monitor = rs.Monitor(rs.design.kalman_filter(plant()))
    before, (u, y) = copy.deepcopy(monitor), recording(600)
    fleet, expected = (rs.Fleet(one, plants=["north"]) for one in (monitor, before))
    monitor.fit(u, y, false_alarm_rate=0.1)
    for one in (fleet, expected):
        one.update(u[None], y[None])
        one.add(["south"])
        one.tick(None, u[:2], y[:2])
    assert fleet.snapshot() == expected.snapshot()
    rs.Fleet.restore(fleet.snapshot(), before)
