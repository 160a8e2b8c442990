"""Fault estimators on single plants: sampling, smoothing, noise; as generators and in banks; what is refused."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.signal

import residua as rs
from generated import random_plant
from residua.design import fault_estimator
from residua.errors import DesignError, ModelError, SettingError
from residua.testing import check_residual_generator


def test_run_sampled_the_error_shrinks_with_the_square_of_the_step() -> None:
    aircraft = rs.library.vtol()
    names = aircraft.faults[:2]
    estimator = fault_estimator(aircraft, faults=names, poles=[-3, -4, -5, -6], bandwidth=8)
    fine, end = 1e-4, 4.0
    times = np.arange(round(end / fine) + 1) * fine
    u = np.sign(np.sin(2.0 * np.floor(times / 0.04)))[:, None] * [1.0, 0.5]  # held over every step below
    f = np.column_stack([np.sin(3 * times), np.cos(times) - 1])
    plant = aircraft.without_faults(aircraft.faults[2:]).system(("control", "fault"))
    y = plant.discretize(fine, hold=["zero"] * 2 + ["linear"] * 2).simulate(np.hstack([u, f]))
    reference = estimator.estimate(u, y, dt=fine)
    errors = []
    for h in (0.04, 0.02, 0.01, 0.005):
        every = round(h / fine)
        errors.append(np.abs(estimator.estimate(u[::every], y[::every], dt=h) - reference[::every]).max())
    ratios = np.array(errors[:-1]) / errors[1:]
    assert ((ratios > 3.3) & (ratios < 4.7)).all(), errors


def test_a_jump_of_a_measurement_costs_first_order() -> None:
    aircraft = rs.library.vtol()
    estimator = fault_estimator(aircraft, faults=["pitch sensor", "collective actuator"], margin=2, bandwidth=5)
    errors = []
    for h in (0.02, 0.01, 0.005, 0.0025):
        times = np.arange(round(3 / h) + 1) * h
        y = np.zeros((len(times), 3))
        y[:, 2] = times >= 1
        estimate = estimator.estimate(np.zeros((len(times), 2)), y, dt=h)
        wanted = np.where(times >= 1, 1 - np.exp(-5 * (times - 1)), 0.0)
        errors.append(np.abs(estimate[:, 0] - wanted).max())
    ratios = np.array(errors[:-1]) / errors[1:]
    assert ((ratios > 1.6) & (ratios < 2.4)).all(), errors


def test_smoothing_of_a_sampled_estimate_is_a_first_order_filter() -> None:
    plant = rs.library.vtol().discretize(0.01)
    names = ["collective actuator", "pitch sensor"]
    estimator = fault_estimator(plant, faults=names, margin=5, bandwidth=20)
    rng = np.random.default_rng(0)
    f = rng.standard_normal((1200, 2))
    u = rng.standard_normal((1200, 2))
    every = np.zeros((1200, 5))
    every[:, [0, 4]] = f
    y = plant.system(("control", "fault")).simulate(np.hstack([u, every]))
    a = np.exp(-0.2)
    smooth = np.asarray(scipy.signal.lfilter([1 - a], [1, -a], f, axis=0))
    smooth[1:, 0] = smooth[:-1, 0]  # the actuator's is one step late
    np.testing.assert_allclose(estimator.estimate(u, y)[1000:], smooth[1000:], atol=1e-8)
    assert estimator.lag["pitch sensor"] == pytest.approx(0.01 * a / (1 - a))
    assert estimator.lag["collective actuator"] == pytest.approx(0.01 + 0.01 * a / (1 - a))


def test_the_noise_gain_in_the_evidence_is_what_noise_does() -> None:
    plant = rs.library.vtol().discretize(0.01).with_noise(process=1e-4, measurement=[1e-4, 4e-4, 1e-4])
    rng = np.random.default_rng(1)
    for names in (["collective actuator"], ["pitch sensor"]):
        estimator = fault_estimator(plant, faults=names, margin=5, bandwidth=30)
        y = plant.system("noise").simulate(rng.standard_normal((60000, len(plant.noises))))
        estimate = estimator.estimate(np.zeros((60000, 2)), y)[1000:]
        promised = estimator.evidence.conditions[f"noise of {names[0]}, rms"]
        assert np.sqrt(np.mean(estimate**2)) == pytest.approx(promised, rel=0.05)


def test_a_wider_bandwidth_passes_more_noise_and_follows_faster() -> None:
    gains, lags = [], []
    for bandwidth in (5, 50, 500):
        found = fault_estimator(rs.library.vtol(), faults="cyclic actuator", margin=5, bandwidth=bandwidth)
        gains.append(found.evidence.conditions["peak gain, outputs to cyclic actuator"])
        lags.append(found.lag["cyclic actuator"])
    assert gains == sorted(gains)
    assert lags == [1 / 5, 1 / 50, 1 / 500]


def test_white_noise_of_a_continuous_plant_is_said_to_have_no_variance() -> None:
    plant = rs.library.vtol().with_noise(measurement=1e-4)
    evidence = fault_estimator(plant, faults="cyclic actuator").evidence
    assert evidence.conditions["noise of cyclic actuator, rms"] == np.inf
    assert any("reaches the estimate of cyclic actuator directly" in note for note in evidence.notes)


@pytest.mark.parametrize("dt", [0.0, 0.01])
def test_as_residual_generator(dt: float) -> None:
    plant = rs.library.vtol() if not dt else rs.library.vtol().discretize(dt)
    names = ("collective actuator", "pitch sensor")
    generator = fault_estimator(plant, faults=names).residual_generator()
    assert generator.estimated == names
    assert generator.method == "fault estimator"
    columns = [plant.faults.index(name) for name in names]
    np.testing.assert_array_equal(generator.structure[:, columns], np.eye(2, dtype=bool))
    for k, name in enumerate(names):
        np.testing.assert_allclose(generator.steady_directions[name], np.eye(2)[k], atol=1e-9)
    check_residual_generator(generator)


def test_sampled_as_a_generator_it_is_the_sampled_estimator() -> None:
    plant = rs.library.vtol()
    estimator = fault_estimator(plant, faults=["collective actuator", "pitch sensor"], margin=5)
    sampled = estimator.residual_generator().discretize(0.01)
    assert sampled.estimated == estimator.faults
    check_residual_generator(sampled)
    rng = np.random.default_rng(0)
    u, y = rng.standard_normal((50, 2)), rng.standard_normal((50, 3))
    np.testing.assert_array_equal(sampled.run(u, y), estimator.estimate(u, y, dt=0.01))


def test_an_integrator_with_singular_a_is_no_obstacle() -> None:
    plant = rs.Plant([[0, 1], [0, 0]], [[0], [1]], [[1, 0], [0, 1]], inputs="force").with_actuator_faults()
    with pytest.raises(DesignError, match="A is singular, rank 1 < 2"):
        rs.design.inverse_form_observer(plant)
    generator = fault_estimator(plant, bandwidth=3).residual_generator()
    s = np.array([0.5, 1j, 2 + 1j])
    np.testing.assert_allclose(generator.internal_form().evaluate(s)[:, 0, 0], 1 / (s / 3 + 1), atol=1e-10)


def test_virtual_outputs_are_what_healthy_sensors_read() -> None:
    rng = np.random.default_rng(5)
    plant = random_plant(rng, n=4, outputs=3, inputs=2, faults=0, sensors=True, feedthrough=True, dt=0.1)
    estimator = fault_estimator(plant, faults="y2 sensor")
    u, f = rng.standard_normal((300, 2)), np.zeros((300, 3))
    f[100:, 1] = np.sin(np.arange(200.0))
    system = plant.system(("control", "fault"))
    healthy, y = system.simulate(np.hstack([u, 0 * f])), system.simulate(np.hstack([u, f]))
    late = slice(150, None)
    size = np.abs(y).max()
    np.testing.assert_allclose(estimator.virtual_outputs(u, y)[late], healthy[late], atol=1e-8 * size)
    np.testing.assert_allclose(y[late] - healthy[late], f[late], atol=1e-8 * size)
    assert np.abs(estimator.consistency().run(u, y)[late]).max() < 1e-8 * size


def test_the_bank_reports_the_sensors_that_cannot_be_estimated() -> None:
    plant = rs.Plant(np.diag([1.0, -1.0]), [[1], [1]], [[1, 0], [0, 1], [0, 2]], outputs=["only", "first", "second"])
    bank = rs.design.sensor_fault_estimators(plant)
    assert list(bank) == ["first", "second"]
    assert "detectable" in bank.failures["only"]
    with pytest.raises(KeyError, match="detectable"):
        bank["only"]
    assert "only: none" in str(bank)
    with pytest.raises(DesignError, match="no fault of a sensor"):
        rs.design.sensor_fault_estimators(plant, outputs=["only"])


def test_refusals_say_why() -> None:
    aircraft = rs.library.vtol()
    with pytest.raises(DesignError, match=r"cannot be told .*rank"):
        fault_estimator(aircraft.with_faults({"copy": aircraft.B[:, 0]}), faults=["copy", "collective actuator"])
    with pytest.raises(DesignError, match="no observer of the state ignores"):
        fault_estimator(aircraft)
    with pytest.raises(DesignError, match="no fault"):
        fault_estimator(aircraft.without_faults())
    with pytest.raises(SettingError, match="bandwidth"):
        fault_estimator(aircraft, faults="pitch sensor", bandwidth=0)
    with pytest.raises(ModelError, match="unknown fault"):
        fault_estimator(aircraft, faults="rotor")
    with pytest.raises(DesignError, match="enters the outputs"):
        rs.design.inverse_form_observer(aircraft, faults="pitch sensor")
    good = rs.design.inverse_form_observer(aircraft, faults=aircraft.faults[:2], poles=[-20, -25, -30, -50])
    with pytest.raises(DesignError, match="not stable"):
        rs.design.inverse_form_observer(aircraft, faults=aircraft.faults[:2], K=-good.K)
    with pytest.raises(DesignError, match="N_BF is singular"):
        rs.design.inverse_form_observer(aircraft, faults=aircraft.faults[:2], K=0 * good.K)
    with pytest.raises(DesignError, match="poles or K"):
        rs.design.inverse_form_observer(aircraft, faults=aircraft.faults[:2], K=np.zeros((4, 3)), poles=[-1] * 4)


def test_a_sensor_filter_makes_sensor_faults_actuator_faults_in_sampled_time_too() -> None:
    plant = rs.library.vtol().discretize(0.02)
    extended = rs.plant.augment_sensor_filter(plant, ["pitch"], 10)
    rng = np.random.default_rng(3)
    v = rng.standard_normal((100, 2 + 5))
    raw = plant.system(("control", "fault")).simulate(v)
    filtered = rs.plant.sensor_filter(plant, ["pitch"], 10).simulate(raw)
    np.testing.assert_allclose(extended.system(("control", "fault")).simulate(v), filtered, atol=1e-10)
    with pytest.raises(ModelError, match="rate"):
        rs.plant.augment_sensor_filter(plant, ["pitch"], -1)
