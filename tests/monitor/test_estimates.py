"""The estimated size of a fault: over time, in alarms, in files; of an estimator alone and beside a bank."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import residua as rs
from bank_examples import hand_made_bank, recording, sampled_plant, static_estimator, with_gaps
from residua.decide import Directional, NormThreshold, Structured
from residua.decide.sizes import estimates_of, fault_unit
from residua.design.core.decoupling import reached
from residua.errors import ModelError, SettingError
from residua.monitor.specification import with_estimator

FAULT = "y2 sensor"


def plant() -> rs.Plant:
    return sampled_plant(5, outputs=5)


def alone() -> rs.Monitor:
    monitor = rs.Monitor(static_estimator(plant(), FAULT), test=NormThreshold(window=20))
    return monitor.fit(*recording(plant(), 4000, seed=99))


def beside() -> rs.Monitor:
    p = plant()
    monitor = rs.Monitor(hand_made_bank(p), estimator=static_estimator(p, FAULT), test=NormThreshold(window=10))
    return monitor.fit(*recording(p, 4000, seed=99))


def run(monitor: rs.Monitor, u: np.ndarray, y: np.ndarray) -> rs.Diagnosis:
    found = monitor.run(u, y)
    assert isinstance(found, rs.Diagnosis)
    return found


@pytest.mark.parametrize("make", [alone, beside])
def test_the_time_course_is_the_estimate_itself(make) -> None:
    u, y = recording(plant(), faults={FAULT: 3.0})
    found = run(make(), u, y)
    generator = static_estimator(plant(), FAULT)
    point = plant().operating_point
    expected = generator.run(u - point.inputs, y - point.outputs)[:, 0]
    assert list(found.estimates) == [FAULT]
    np.testing.assert_allclose(found.estimates[FAULT], expected, rtol=1e-9, atol=1e-12)
    assert np.array_equal(found.columns()[f"estimate {FAULT}"], found.estimates[FAULT])
    spread = expected[:800].std()
    assert found.estimates[FAULT][800:].mean() == pytest.approx(3.0, abs=5 * spread / np.sqrt(700))


@pytest.mark.parametrize("make", [alone, beside])
def test_every_alarm_has_the_size_over_its_judged_window(make) -> None:
    found = run(make(), *with_gaps(*recording(plant(), faults={FAULT: 8.0})))
    alarm = found.main_alarm
    assert alarm is not None
    (size,) = alarm.sizes
    assert (size.fault, size.unit) == (FAULT, "m")
    over = np.flatnonzero((found.statistic > found.threshold) & found.decided)
    last = over[(over >= alarm.start) & (over < alarm.stop)][-1]
    rows = np.arange(max(alarm.start, last - found.naming.window + 1), last + 1)
    rows = rows[found.decided[rows]]
    assert size.mean == pytest.approx(found.estimates[FAULT][rows].mean())
    assert size.last == found.estimates[FAULT][rows[-1]]
    named = next(c for c in alarm.candidates if FAULT in c.faults)
    assert named.sizes == (size,)
    assert named.size == size.mean
    assert all(c.size is None for c in alarm.candidates if FAULT not in c.faults)


def test_a_bank_names_and_the_estimator_sizes() -> None:
    monitor = beside()
    found = run(monitor, *recording(plant(), faults={FAULT: 3.0}))
    assert found.candidates[0].faults == (FAULT,)
    assert found.candidates[0].size == pytest.approx(3.0, abs=0.5)
    assert f"estimated size {found.candidates[0].size:.3g} (m)" in str(found)
    without = rs.Monitor(hand_made_bank(plant()), test=NormThreshold(window=10)).fit(*recording(plant(), 4000, seed=99))
    same = run(without, *recording(plant(), faults={FAULT: 3.0}))
    np.testing.assert_allclose(found.parts.statistics, same.parts.statistics, rtol=1e-9)
    assert np.array_equal(found.parts.fired, same.parts.fired), "the estimator takes no part in alarms"
    assert same.estimates == {}
    assert same.main_alarm is not None
    assert same.main_alarm.sizes == ()


def test_without_data_the_noise_model_gives_the_thresholds_of_what_is_sampled() -> None:
    """Continuous bank and estimator, sampled by the monitor: residuals as large, and alarms as rare, as promised."""
    p = rs.Plant([[-1, 0.2], [0, -2]], [[1], [0.5]], np.eye(2)).with_actuator_faults().with_sensor_faults()
    p = p.with_noise(process=[0.1, 0.2], measurement=[0.01, 0.02])
    bank = rs.design.structured_bank(p, ["101", "110", "011"])
    estimator = rs.design.fault_estimator(bank.plant, faults="u1 actuator", bandwidth=5)
    test = NormThreshold(persistence=1, false_alarm_rate=0.01)
    sampled = p.discretize(0.1)
    y = sampled.system("noise").simulate(np.random.default_rng(0).standard_normal((60_000, len(sampled.noises))))
    for monitor in (rs.Monitor(estimator, test=test, dt=0.1), rs.Monitor(bank, estimator=estimator, test=test, dt=0.1)):
        found = run(monitor, np.zeros((60_000, 1)), y)
        covariance = monitor.generator.covariance
        assert covariance is not None
        seen = found.residuals[found.decided]
        size = np.sqrt(np.diag(covariance))
        np.testing.assert_allclose(np.atleast_2d(np.cov((seen / size).T)), covariance / np.outer(size, size), atol=0.05)
        assert 0.005 < found.false_alarm_fraction < 0.013


@pytest.mark.parametrize("make", [alone, beside])
def test_step_tells_the_size_now(make) -> None:
    monitor = make()
    u, y = recording(plant(), 60)
    found = run(monitor, u, y)
    monitor.reset()
    for k in range(60):
        assert monitor.step(u[k], y[k]).estimates == {FAULT: found.estimates[FAULT][k]}


def test_alarm_files_have_the_sizes(tmp_path: Path) -> None:
    found = run(alone(), *recording(plant(), faults={FAULT: 3.0}))
    found.write_alarms(tmp_path / "alarms.jsonl")
    lines = [json.loads(line) for line in (tmp_path / "alarms.jsonl").read_text().splitlines()]
    assert found.alarms
    for line, alarm in zip(lines, found.alarms, strict=True):
        (size,) = alarm.sizes
        assert line["sizes"] == [{"fault": FAULT, "mean": size.mean, "last": size.last, "unit": "m"}]
        assert "code" not in line


def test_an_estimator_alone_is_saved(tmp_path: Path) -> None:
    monitor = alone()
    monitor.save(tmp_path / "m.json")
    data = recording(plant(), faults={FAULT: 3.0})
    assert str(run(rs.Monitor.load(tmp_path / "m.json"), *data)) == str(run(monitor, *data))


def test_a_bank_with_its_estimator_is_saved(tmp_path: Path) -> None:
    monitor = beside()
    u, y = recording(plant(), faults={FAULT: 3.0})
    whole = run(monitor, u, y)
    monitor.reset()
    monitor.update(u[:700], y[:700])
    monitor.save(tmp_path / "m.json")
    rest = rs.Monitor.load(tmp_path / "m.json").update(u[700:], y[700:])
    assert np.array_equal(rest.residuals[0], whole.residuals[700:])
    assert np.array_equal(rest.fired[0], whole.parts.fired[700:])


def test_units_are_those_of_the_component() -> None:
    p = sampled_plant(0, actuators=True)
    p = rs.Plant(p.A, p.B, p.C, dt=0.5, units={"y1": "m", "u1": "V", "x1": "kg"}).with_sensor_faults()
    p = p.with_actuator_faults().with_faults({"leak": np.ones(4)})
    assert fault_unit(p, "y1 sensor") == "m"
    assert fault_unit(p, p.faults[4]) == "V"
    assert [fault_unit(p, name) for name in ("y2 sensor", "leak", "nobody")] == ["", "", ""]


def test_a_fault_estimated_twice_keeps_both() -> None:
    generator = hand_made_bank(sampled_plant(0))
    twice = replace(generator, estimated=(FAULT, *[""] * (generator.n_residuals - 2), FAULT))
    residuals = np.arange(generator.n_residuals, dtype=float)[None]
    found = estimates_of(twice, residuals)
    assert [value.tolist() for value in found.values()] == [[0.0], [residuals[0, -1]]]
    assert all(name.startswith(f"{FAULT} (r y") for name in found)


def test_what_cannot_run_beside_is_refused() -> None:
    p = plant()
    bank, estimator = hand_made_bank(p), static_estimator(p, FAULT)
    with pytest.raises(ModelError, match="runs beside a bank"):
        rs.Monitor(rs.design.kalman_filter(p), estimator=estimator)
    with pytest.raises(ModelError, match="estimates no fault"):
        rs.Monitor(bank, estimator=rs.design.kalman_filter(p))
    with pytest.raises(ModelError, match=r"different plants \(A, C, "):
        rs.Monitor(bank, estimator=static_estimator(replace_matrices(p), FAULT))
    with pytest.raises(ModelError, match=r"different plants \(Bw, Dw\)"):
        rs.Monitor(bank, estimator=static_estimator(p.with_noise(process=1.0, measurement=2.0), FAULT))
    for isolate in (Directional(), None):
        with pytest.raises(SettingError, match="read by code"):
            rs.Monitor(bank, estimator=estimator, isolate=isolate)
    assert isinstance(rs.Monitor(bank, estimator=estimator).isolate, Structured)


def replace_matrices(p: rs.Plant) -> rs.Plant:
    other = rs.Plant(0.9 * p.A, p.B, 2 * p.C, dt=p.dt)
    return other.with_sensor_faults()


@pytest.mark.parametrize("hold", ["linear", "zero"])
@pytest.mark.parametrize("sampled", [True, False])
def test_a_sampled_estimator_beside_a_bank_says_how_far_inputs_reach_both(hold: str, sampled: bool) -> None:
    """Also where the bank is exact, and has no such entry."""
    p, dt = rs.library.vtol(), 0.3
    exact = rs.design.sensor_fault_bank(p if sampled else p.discretize(dt), allow_missing=True).generator
    bank = exact.discretize(dt) if sampled else exact
    estimator = rs.design.fault_estimator(p, faults=["collective actuator"]).generator.discretize(dt, hold_outputs=hold)
    both = with_estimator(bank, estimator)
    for name, gain in reached(both.system, both.plant, both.state_map, both.static_map).items():
        assert gain == both.evidence.decoupling[f"{name}, sampled"] > 1e-7
