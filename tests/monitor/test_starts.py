"""A start is estimated from the first samples: plants that are not at rest raise no alarm."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import residua as rs
from residua.decide import NormThreshold, PeakThreshold
from residua.errors import SettingError
from residua.linear import StateSpace
from residua.monitor.fused import run_block
from residua.monitor.running import initial_state


def tank() -> rs.Plant:
    """Return a level that integrates the flow, and a cart beside it that integrates twice; two sensors of each."""
    A = [[1, 0, 0], [0, 1, 0.1], [0, 0, 1]]
    plant = rs.Plant(
        A, [[0.1, 0.02], [0.001, 0.005], [0.02, 0.1]], [[1, 0, 0], [1, 0, 0], [0, 1, 0], [0, 1, 0]], dt=0.1
    )
    return plant.with_sensor_faults().with_actuator_faults().with_noise(process=1e-6, measurement=1e-4)


def under_way(samples: int, seed: int, fault: float = 0.0, start: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return data of the plant in the middle of a manoeuvre: far from rest at the first sample."""
    plant, rng = tank(), np.random.default_rng(seed)
    u = np.array([0.7, 0.3]) + 0.1 * rng.standard_normal((samples, 2))
    f = np.zeros((samples, 6))
    f[start:, 0] = fault
    w = rng.standard_normal((samples, len(plant.noises)))
    y = plant.system(("control", "fault", "noise")).simulate(np.hstack([u, f, w]), [3.0, -5.0, 40.0])
    return u, y


@cache
def designs() -> dict[str, object]:
    plant = tank()
    return {
        "Kalman filter": rs.design.kalman_filter(plant),
        "detection filter": rs.design.detection_filter(plant.without_faults(["u1 actuator", "u2 actuator"])),
        "bank": rs.design.sensor_fault_bank(plant),
    }


@pytest.mark.parametrize("kind", list(designs()))
def test_a_plant_that_is_under_way_raises_no_alarm(kind: str) -> None:
    """From rest it does, in each of these: a thousand deviations decay to 1 % only."""
    design = designs()[kind]
    test = NormThreshold(threshold=5.0) if kind == "Kalman filter" else NormThreshold()
    fitted = {start: rs.Monitor(design, test=test, start=start) for start in ("estimated", "rest")}
    for monitor in fitted.values():
        if not monitor.is_fitted:
            u, y = under_way(4000, 1)
            monitor.fit(u, y, false_alarm_rate=1e-3)
    found = fitted["estimated"].run(*under_way(600, 2))
    assert isinstance(found, rs.Diagnosis)
    assert found.decided.any()
    assert not found.alarm.any()
    if kind == "Kalman filter":
        rest = fitted["rest"].run(*under_way(600, 2))
        assert isinstance(rest, rs.Diagnosis)
        assert rest.alarm[rest.decided].any()
        assert "the plant was hardly at rest" in str(found)
        assert "partly removed" in str(found)
        assert "the plant was hardly at rest" not in str(rest)
    later = fitted["estimated"].run(*under_way(600, 2, fault=1.0, start=400))
    assert isinstance(later, rs.Diagnosis)
    assert later.alarm[400:].any()


def test_a_restart_after_a_gap_is_estimated_too() -> None:
    monitor = rs.Monitor(rs.design.kalman_filter(tank()), test=NormThreshold(threshold=5.0))
    u, y = under_way(1200, 3)
    y[400:460] = np.nan
    found = monitor.run(u, y)
    assert isinstance(found, rs.Diagnosis)
    assert found.recording.resets == 1
    assert found.decided[-500:].all()
    assert not found.alarm.any()


def test_missing_outputs_in_the_start_are_no_obstacle() -> None:
    """The recursion of the Kalman filter finds the state from what is there."""
    monitor = rs.Monitor(rs.design.kalman_filter(tank()), test=NormThreshold(threshold=5.0))
    u, y = under_way(600, 4)
    y[5:300:7, 0] = np.nan
    y[8:300:5, 1] = np.nan
    found = monitor.run(u, y)
    assert isinstance(found, rs.Diagnosis)
    settled = monitor.settling_samples
    assert found.decided[settled:][~found.missing[settled:]].all()
    assert not found.alarm.any()


def test_what_a_start_leaves_is_noise() -> None:
    """Without noise in the data the residual after the settling samples is rounding, however far the start was off."""
    plant = tank()
    for design in designs().values():
        monitor = rs.Monitor(design, test=NormThreshold(threshold=1.0))  # type: ignore[arg-type]
        u = np.ones((500, 2))
        y = plant.system(("control",)).simulate(u, [3.0, -5.0, 40.0])
        rest = rs.Monitor(design, test=NormThreshold(threshold=1.0), start="rest").run(u, y)  # type: ignore[arg-type]
        found = monitor.run(u, y)
        k = monitor.settling_samples
        assert isinstance(found, rs.Diagnosis)
        assert isinstance(rest, rs.Diagnosis)
        assert np.abs(rest.residuals[k : k + 10]).max() > 1e-3
        assert np.abs(found.residuals[k:]).max() < 1e-6


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), kind=st.sampled_from(list(designs())), settle=st.sampled_from([None, 0, 1, 9]))
def test_any_cutting_and_any_fleet_gives_the_same_bits(seed: int, kind: str, settle: int | None) -> None:
    rng = np.random.default_rng(seed)
    spec = rs.Monitor(designs()[kind], test=NormThreshold(threshold=1.0), settle=settle)._specification()
    data = np.stack([np.hstack(under_way(150, int(s))) for s in rng.integers(0, 99, 4)])
    data[0, rng.integers(0, 150, 3), rng.integers(0, 6, 3)] = np.nan
    data[1, : rng.integers(1, 40), rng.integers(0, 6)] = np.nan
    data[2, rng.integers(20, 60) : rng.integers(60, 90)] = np.nan
    state, whole = run_block(spec, initial_state(spec, 4), data)
    now, parts = initial_state(spec, 4), []
    cuts = np.arange(1, 150) if rng.random() < 0.3 else np.sort(rng.integers(0, 151, 9))
    for part in np.split(data, cuts, axis=1):
        now, found = run_block(spec, now, part)
        parts.append(found)
    alone = [run_block(spec, initial_state(spec, 1), one[None])[1] for one in data]
    for name in ("residuals", "statistic", "alarm", "usable"):
        expected = getattr(whole, name)
        joined = np.concatenate([getattr(part, name) for part in parts], axis=1)
        assert np.array_equal(joined, expected, equal_nan=expected.dtype.kind == "f"), name
        stacked = np.concatenate([getattr(one, name) for one in alone])
        assert np.array_equal(stacked, expected, equal_nan=expected.dtype.kind == "f"), name
    for name in ("x", "age", "starting", "start_sums", "moved", "resets"):
        assert np.array_equal(getattr(now.filter, name), getattr(state.filter, name)), name


@pytest.mark.parametrize("power", [-20, 20])
def test_units_do_not_matter(power: int) -> None:
    k = 2.0**power
    base = tank()
    scaled = rs.Plant(base.A, base.B, base.C * k, base.D, dt=0.1).with_sensor_faults().with_actuator_faults()
    scaled = scaled.with_noise(process=1e-6, measurement=1e-4 * k * k)
    u, y = under_way(400, 5)
    one = rs.Monitor(rs.design.kalman_filter(base)).run(u, y)
    two = rs.Monitor(rs.design.kalman_filter(scaled)).run(u, y * k)
    assert isinstance(one, rs.Diagnosis)
    assert isinstance(two, rs.Diagnosis)
    np.testing.assert_allclose(one.statistic[one.decided], two.statistic[one.decided], rtol=1e-6)


def test_a_fault_from_the_first_sample_is_still_found() -> None:
    """What looks like a start is taken out of the state, not out of what the fault does for good."""
    monitor = rs.Monitor(rs.design.kalman_filter(tank()), test=NormThreshold(threshold=5.0))
    found = monitor.run(*under_way(600, 8, fault=1.0))
    assert isinstance(found, rs.Diagnosis)
    assert found.alarm[found.decided].mean() > 0.9


def test_saved_in_the_middle_of_a_start_it_goes_on_bit_for_bit(tmp_path: Path) -> None:
    for start in ("estimated", "rest"):
        monitor = rs.Monitor(rs.design.kalman_filter(tank()), start=start)
        u, y = under_way(200, 6)
        monitor.update(u[:7], y[:7])
        monitor.save(tmp_path / "m.json")
        loaded = rs.Monitor.load(tmp_path / "m.json")
        assert loaded.start == start
        expected, found = monitor.update(u[7:], y[7:]), loaded.update(u[7:], y[7:])
        assert found.residuals.tobytes() == expected.residuals.tobytes()


def test_thresholds_that_are_bounds_start_from_rest_and_wait() -> None:
    """Their disturbances are no noise: what is known of them holds from rest, or once every start has died away."""
    monitor = rs.Monitor(rs.design.sensor_fault_bank(tank()), test=PeakThreshold(10.0, window=5))
    assert monitor._specification().first is None
    found = monitor.run(*under_way(3000, 7))
    assert isinstance(found, rs.Diagnosis)
    assert not found.alarm.any()
    fitted = rs.Monitor(rs.design.sensor_fault_bank(tank()), test=PeakThreshold(window=5)).fit(*under_way(3000, 7))
    assert fitted._specification().first is not None


def test_an_unknown_start_is_refused() -> None:
    with pytest.raises(SettingError, match="'estimated' or 'rest'"):
        rs.Monitor(rs.design.kalman_filter(tank()), start="guess")


def _diagnosis(monitor: rs.Monitor, u: np.ndarray, y: np.ndarray) -> rs.Diagnosis:
    found = monitor.run(u, y)
    assert isinstance(found, rs.Diagnosis)
    return found


@pytest.mark.parametrize("seed", [14, 16, 28, 39])
def test_a_fit_does_not_depend_on_units_of_the_states(seed: int) -> None:
    """Four residuals of two outputs: by what is left of a start, other orders of a model were chosen."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((4, 4))
    A *= 0.5 / np.abs(np.linalg.eigvals(A)).max()
    B, C = rng.standard_normal((4, 1)), rng.standard_normal((2, 4))
    system = StateSpace(A, np.hstack([B, 0.05 * np.eye(4)]), C, np.zeros((2, 5)), dt=0.5)
    u = rng.standard_normal((1_500, 1))
    y = system.simulate(np.hstack([u, rng.standard_normal((1_500, 4))])) + 0.1 * rng.standard_normal((1_500, 2))
    found = []
    for x, of_y in [(np.ones(4), np.ones(2)), (2.0 ** np.array([-20, 3, 20, 9]), 2.0 ** np.array([16, -7]))]:
        plant = rs.Plant(A * x / x[:, None], B / x[:, None], C * x * of_y[:, None], dt=0.5)
        plant = plant.with_sensor_faults().with_actuator_faults()
        plant = plant.with_noise(process=np.diag((0.05 / x) ** 2), measurement=np.diag((0.1 * of_y) ** 2))
        monitor = rs.Monitor(rs.design.detection_filter(plant), test=rs.decide.ChiSquared(false_alarm_rate=0.01))
        monitor.fit(u, y * of_y)
        found.append((monitor.threshold, monitor.norm_test.basis, _diagnosis(monitor, u, y * of_y).statistic))
    assert found[0][0] == pytest.approx(found[1][0], rel=1e-9)
    assert found[0][1] == found[1][1]
    np.testing.assert_allclose(found[0][2], found[1][2], rtol=1e-6)


def test_weights_of_a_start_are_saved(tmp_path: Path) -> None:
    """Of a threshold that is given, without noise."""
    x = np.array([1.0, 2.0**20])
    A = np.array([[0.9, 0.2], [0, 0.8]]) * x / x[:, None]
    plant = rs.Plant(A, [[1.0], [0.5 / x[1]]], [[1.0, 0.0], [0.5, x[1]]], dt=1.0).with_sensor_faults()
    design = rs.design.luenberger_observer(plant, poles=[0.7, 0.6]).residual_generator()
    monitor = rs.Monitor(design, test=NormThreshold(threshold=1.0))
    rng = np.random.default_rng(0)
    u = rng.standard_normal((60, 1))
    y = plant.system(("control",)).simulate(u, [3.0, -2.0])
    monitor.save(tmp_path / "m.json")
    content = json.loads((tmp_path / "m.json").read_text())
    assert "weights" in content["running"]["first"]
    again = rs.Monitor.load(tmp_path / "m.json")
    np.testing.assert_array_equal(_diagnosis(again, u, y).residuals, _diagnosis(monitor, u, y).residuals)
