"""A window holds the last samples that were judged: missing ones make it neither shorter nor a threshold too low."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import residua as rs
from residua.decide import NormThreshold
from residua.decide.window import WindowState, empty_window, moving_sum

RATE, MISSING = 0.01, (0.0, 0.1, 0.3, 0.5, 0.8)


def noise(seed: int, n: int, memory: float, k: int = 2) -> NDArray[np.float64]:
    e = np.random.default_rng(seed).standard_normal((n, k))
    for i in range(1, n):
        e[i] += memory * e[i - 1]
    return e


def with_holes(residual: NDArray[np.float64], share: float, seed: int) -> NDArray[np.float64]:
    holes = np.random.default_rng(seed).random(len(residual)) < share
    return np.where(holes[:, None], np.nan, residual)


def fitted(residual: NDArray[np.float64], test: Any) -> rs.Monitor:
    given = rs.identify.given_residuals([f"r{i}" for i in range(residual.shape[1])], dt=1.0)
    return rs.Monitor(given, test=test, isolate=None).fit(None, residual, false_alarm_rate=RATE)


TESTS = [
    rs.decide.NormThreshold(persistence=5, window=10),
    rs.decide.NormThreshold(persistence=2, window=20, groups="each"),
]


@pytest.mark.parametrize("test", TESTS, ids=["norm", "groups"])
@pytest.mark.parametrize("share", MISSING)
@pytest.mark.parametrize("memory", [-0.5, 0.0, 0.8])
def test_the_rate_is_kept_whatever_is_missing_from_what(memory: float, share: float, test: Any) -> None:
    """With half of the samples missing from the fit it was ten times what was asked on complete data."""
    monitor = fitted(with_holes(noise(0, 40_000, memory), share, 2), test)
    rate = monitor.run(None, noise(1, 100_000, memory)).false_alarm_fraction
    assert rate <= 1.5 * RATE
    assert rate >= (RATE / 10 if memory >= 0 else 0)  # the fewer independent samples, the more the threshold allows for
    again = monitor.run(None, with_holes(noise(5, 100_000, memory), share, 9))
    assert float(again.alarm[np.isfinite(again.statistic)].mean()) <= 1.5 * RATE


@pytest.mark.parametrize("test", TESTS, ids=["norm", "groups"])
def test_a_fault_is_seen_as_well_where_samples_are_missing(test: Any) -> None:
    """With half of the samples missing a step of 0.9 deviations was seen in 13 % of them, and in 79 % without."""
    monitor = fitted(noise(0, 40_000, 0.0), test)
    seen = []
    for share in MISSING:
        run = monitor.run(None, with_holes(noise(3, 20_000, 0.0) + 0.9, share, 4))
        seen.append(float(run.alarm[np.isfinite(run.statistic)].mean()))
    assert max(seen) - min(seen) < 0.05 * max(seen) + 0.02


@pytest.mark.parametrize("test", TESTS, ids=["norm", "groups"])
def test_a_step_at_a_time_is_judged_alike_around_missing_samples(test: Any) -> None:
    monitor = fitted(noise(0, 5_000, 0.0), test)
    residual = with_holes(noise(6, 400, 0.0) + 0.5, 0.4, 7)
    steps = [monitor.step(None, row) for row in residual]
    whole = monitor.run(None, residual)
    assert [step.alarm for step in steps] == whole.alarm.tolist()
    assert whole.alarm.any()
    np.testing.assert_array_equal([step.statistic for step in steps], whole.statistic)


@cache
def watched(window: int, isolation: int) -> rs.Monitor:
    plant = rs.Plant([[0.9, 0], [0.1, 0.8]], [[1], [0.2]], np.eye(2), dt=1.0, outputs=["a", "b"])
    plant = plant.with_sensor_faults().with_noise(process=1e-4 * np.eye(2), measurement=1e-2 * np.eye(2))
    test = NormThreshold(window=window, persistence=3)
    isolate = rs.decide.Directional(window=isolation)
    return rs.Monitor(rs.design.kalman_filter(plant), test=test, isolate=isolate).fit(*recorded(1, 5_000, 0.0))


def recorded(seed: int, time: int, fault: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A recording with a step of sensor ``a`` from 300 to 500."""
    plant, rng = rs.Plant([[0.9, 0], [0.1, 0.8]], [[1], [0.2]], np.eye(2), dt=1.0), np.random.default_rng(seed)
    u, x, y = rng.standard_normal((time, 1)), np.zeros(2), np.empty((time, 2))
    for k in range(time):
        y[k] = x + 0.1 * rng.standard_normal(2)
        x = plant.A @ x + plant.B @ u[k] + 0.01 * rng.standard_normal(2)
    y[300:500, 0] += fault
    return u, y


def longest(run: Any) -> Any:
    return max(run.alarms, key=lambda alarm: alarm.stop - alarm.start)


@pytest.mark.parametrize(("window", "isolation"), [(10, 50), (30, 50)])
@pytest.mark.parametrize("hole", ["a stop of 60", "a stop of 400", "half of them", "most of them"])
def test_a_fault_has_the_same_name_where_samples_are_missing(window: int, isolation: int, hole: str) -> None:
    """Where only the test reaches back across them, a name is that of what is healthy again."""
    monitor, wrong = watched(window, isolation), 0
    for seed in range(2, 14):
        u, y = recorded(seed, 1_500, 1.0)
        if hole.startswith("a stop"):
            gone = np.arange(500, 500 + int(hole[-3:]))
        else:
            gone = np.flatnonzero(
                np.random.default_rng(seed).random(len(y)) < (0.5 if hole.startswith("half") else 0.8)
            )
        y[gone] = np.nan
        run = monitor.run(u, y)
        wrong += longest(run).candidates[0].faults != ("a sensor",)
        monitor.reset()
        steps = [monitor.step(*row).alarm for row in zip(u, y, strict=True)] if seed == 2 else []
        assert not steps or steps == run.alarm.tolist()
    assert wrong == 0


@pytest.mark.parametrize("length", [1, 3, 10, 37])
def test_sums_leave_samples_out_and_come_out_the_same_for_any_cutting(length: int) -> None:
    rng = np.random.default_rng(8)
    values, judged = rng.standard_normal((3, 200, 2)), rng.random((3, 200)) < [[0.5], [1.0], [0.1]]
    sums, end = moving_sum(values, empty_window(3, 6, 2), judged)
    for plant in range(3):
        rows = np.flatnonzero(judged[plant])
        kept = values[plant, rows]
        expected = np.array([kept[max(i - 5, 0) : i + 1].sum(axis=0) for i in range(len(kept))])
        np.testing.assert_allclose(sums[plant, rows], expected, atol=1e-12)
        assert not sums[plant, ~judged[plant]].any()
    state: WindowState = empty_window(3, 6, 2)
    parts = []
    for first in range(0, 200, length):
        cut = slice(first, first + length)
        part, state = moving_sum(values[:, cut], state, judged[:, cut])
        parts.append(part)
    np.testing.assert_array_equal(np.concatenate(parts, axis=1), sums)
    for one, other in zip(state.arrays(), end.arrays(), strict=True):
        np.testing.assert_array_equal(one, other)
