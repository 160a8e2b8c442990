"""Fault accommodation: separation, compensation, virtual sensors, and loops that are not well-posed."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

import residua as rs
from generated import random_plant
from residua.design import closed_loop, compensation_gain, fault_estimator, luenberger_observer
from residua.errors import DesignError, ModelError, SettingError
from residua.linear.poles.spectrum import match_poles


def regulator(plant: rs.Plant) -> np.ndarray:
    """Return the gain of a linear-quadratic regulator with unit weights."""
    A, B = plant.A, plant.B
    solve = scipy.linalg.solve_discrete_are if plant.dt else scipy.linalg.solve_continuous_are
    X = solve(A, B, np.eye(len(A)), np.eye(B.shape[1]))
    return np.linalg.solve(np.eye(B.shape[1]) + B.T @ X @ B, B.T @ X @ A) if plant.dt else B.T @ X


def aircraft(dt: float) -> rs.Plant:
    return rs.library.vtol().discretize(dt) if dt else rs.library.vtol()


@pytest.mark.parametrize("seed", range(20))
def test_estimation_and_feedback_keep_their_poles(seed: int) -> None:
    rng = np.random.default_rng(seed)
    dt = (0.0, 0.1)[seed % 2]
    plant = random_plant(rng, n=4, outputs=3, inputs=2, faults=0, dt=dt, feedthrough=seed % 3 == 0)
    plant = plant.with_actuator_faults().with_sensor_faults()
    estimator = fault_estimator(plant, faults=["u1 actuator"])
    K = regulator(plant)
    loop = closed_loop(plant, estimator, K)
    wanted = np.concatenate([np.linalg.eigvals(plant.A - plant.B @ K), estimator.system.poles()])
    found = loop.poles()
    scale = np.abs(wanted).max()
    # as polynomials: poles may be multiple
    assert np.abs(np.poly(found / scale) - np.poly(wanted / scale)).max() < 1e-8
    assert loop.is_stable()


@pytest.mark.parametrize("dt", [0.0, 0.02])
def test_an_actuator_fault_leaves_no_lasting_effect(dt: float) -> None:
    plant = aircraft(dt)
    estimator = fault_estimator(plant, faults=["collective actuator", "cyclic actuator"], margin=8)
    K = regulator(plant)
    gains = {}
    for compensate in (True, False):
        loop = closed_loop(plant, estimator, K, compensate=compensate)
        gains[compensate] = loop.dc_gain()
    actuators = [loop.inputs.index(name) for name in estimator.faults]
    states = [loop.outputs.index(f"state {name}") for name in plant.states]
    assert np.abs(gains[True][np.ix_(states, actuators)]).max() < 1e-9
    assert np.abs(gains[False][np.ix_(states, actuators)]).max() > 0.01
    estimates = [loop.outputs.index(f"estimate {name}") for name in estimator.faults]
    for gain in gains.values():
        np.testing.assert_allclose(gain[np.ix_(estimates, actuators)], np.eye(2), atol=1e-9)


@pytest.mark.parametrize("dt", [0.0, 0.02])
def test_a_sensor_fault_reaches_the_plant_only_without_accommodation(dt: float) -> None:
    plant = aircraft(dt)
    fault = "v_horizontal sensor"
    estimator, plain = fault_estimator(plant, faults=fault, margin=8), luenberger_observer(plant, margin=8)
    K = regulator(plant)
    F = np.linalg.lstsq(plant.C.T, K.T, rcond=None)[0].T * 0.05  # a weak output feedback
    loops = {
        "virtual state": closed_loop(plant, estimator, K),
        "virtual outputs": closed_loop(plant, estimator, F, acts_on="outputs"),
        "measured outputs": closed_loop(plant, estimator, F, acts_on="outputs", virtual=False),
        "plain observer": closed_loop(plant, plain, K),
    }
    points = np.exp(1j * np.linspace(0.1, 3, 7)) * 1.5 if dt else np.array([2j, 1 + 1j, 3.0, 5 + 2j])
    reached = {}
    for name, loop in loops.items():
        states = [loop.outputs.index(f"state {x}") for x in plant.states]
        controls = [loop.outputs.index(f"control {x}") for x in plant.inputs]
        gain = loop.evaluate(points)[:, states + controls, loop.inputs.index(fault)]
        reached[name] = np.abs(gain).max()
    assert reached["virtual state"] < 1e-9
    assert reached["virtual outputs"] < 1e-9
    assert reached["measured outputs"] > 1e-3
    assert reached["plain observer"] > 1e-3


@pytest.mark.parametrize("feedthrough", [False, True])
def test_the_loop_is_the_one_that_a_simulation_step_by_step_gives(feedthrough: bool) -> None:
    """Plant, estimator and feedback in turn, sample by sample; the algebraic loop by a solver of its own."""
    rng = np.random.default_rng(7)
    plant = random_plant(rng, n=3, outputs=3, inputs=2, faults=0, dt=0.1, feedthrough=feedthrough)
    plant = plant.with_actuator_faults().with_noise(process=1.0, measurement=1.0).with_disturbances({"gust": [1, 0, 1]})
    estimator = fault_estimator(plant, faults=["u2 actuator"])
    K = regulator(plant)
    loop = closed_loop(plant, estimator, K)
    v = rng.standard_normal((40, loop.n_inputs))
    found = loop.simulate(v)
    P = plant.system(("control", "fault", "disturbance", "noise"))
    J = estimator.joint_system
    Gamma = compensation_gain(plant, ["u2 actuator"]).gain
    x, q = np.zeros(3), np.zeros(J.n_states)
    for k in range(40):
        r, rest = v[k, :2], v[k, 2:]

        def outputs(u: np.ndarray, x=x, q=q, rest=rest) -> tuple[np.ndarray, np.ndarray]:
            y = P.C @ x + P.D @ np.concatenate([u, rest])
            return y, J.C @ q + J.D @ np.concatenate([u, y])

        def missed(u: np.ndarray, r=r, outputs=outputs) -> np.ndarray:
            _, e = outputs(u)
            return r - K @ e[1:] - Gamma @ e[:1] - u

        base = missed(np.zeros(2))
        slope = np.column_stack([missed(e) - base for e in np.eye(2)])
        u = np.linalg.solve(-slope, base)
        y, e = outputs(u)
        np.testing.assert_allclose(found[k], [*y, *x, *e[:1], *u], atol=1e-8 * (1 + np.abs(found).max()))
        x = P.A @ x + P.B @ np.concatenate([u, rest])
        q = J.A @ q + J.B @ np.concatenate([u, y])


def test_a_feedback_with_dynamics() -> None:
    """An integrator on the virtual outputs brings two of them to rest, against a constant actuator fault too."""
    plant = aircraft(0.0)
    estimator = fault_estimator(plant, faults=["collective actuator"], margin=8)
    G = plant.system("control").dc_gain()[:2]
    integral = rs.StateSpace(
        np.zeros((2, 2)), np.eye(2, 3), 0.2 * np.linalg.inv(G), np.zeros((2, 3)), inputs=None, outputs=None
    )
    loop = closed_loop(plant, estimator, integral, acts_on="outputs", compensate=False)
    assert loop.is_stable()
    fault = loop.inputs.index("collective actuator")
    np.testing.assert_allclose(loop.dc_gain()[:2, fault], 0, atol=1e-9)
    np.testing.assert_allclose(loop.dc_gain()[loop.outputs.index("control collective"), fault], -1, atol=1e-9)


def test_what_no_input_can_undo_is_reported() -> None:
    plant = rs.library.vtol().with_faults({"mixed": [0, 0, 0, 1.0], "half": rs.library.vtol().B @ [0.3, -2]})
    found = compensation_gain(plant, ["mixed", "half", "pitch sensor"])
    assert found.left["mixed"] > 0.9
    assert found.left["half"] == 0
    assert found.left["pitch sensor"] == 0
    np.testing.assert_allclose(found.gain[:, 1], [0.3, -2], atol=1e-12)
    np.testing.assert_array_equal(found.gain[:, 2], 0)


def test_a_singular_plant_keeps_its_equations() -> None:
    plant = rs.Plant(
        [[-1, 0], [1, -1]], [[1], [0]], np.eye(2), E=[[1, 0], [0, 0]], inputs="valve"
    ).with_actuator_faults()
    estimator = fault_estimator(plant, bandwidth=5)
    loop = closed_loop(plant, estimator, [[0.5, 0.0]])
    assert loop.E is not None
    fault = loop.inputs.index("valve actuator")
    assert np.abs(loop.dc_gain()[:2, fault]).max() < 1e-9


def test_refusals() -> None:
    plant = aircraft(0.0)
    estimator = fault_estimator(plant, faults="pitch sensor")
    with pytest.raises(SettingError, match="acts_on"):
        closed_loop(plant, estimator, np.zeros((2, 4)), acts_on="faults")
    with pytest.raises(ModelError, match="feedback"):
        closed_loop(plant, estimator, np.zeros((2, 4)), acts_on="outputs")
    with pytest.raises(ModelError, match="dt"):
        closed_loop(plant.discretize(0.1), estimator, np.zeros((2, 4)))
    with pytest.raises(ModelError, match="other inputs"):
        closed_loop(random_plant(np.random.default_rng(0), n=4, outputs=3, inputs=2, dt=0.0), estimator, np.eye(2, 4))
    with pytest.raises(DesignError, match="no control input"):
        compensation_gain(rs.library.twardy())
    direct = rs.Plant([[-1.0]], [[1.0]], [[1.0]], [[1.0]]).with_sensor_faults()
    loop = fault_estimator(direct.with_faults({"leak": [1.0]}), faults="leak")
    with pytest.raises(DesignError, match="ill-posed"):
        closed_loop(loop.plant, loop, [[-1.0]], acts_on="outputs", virtual=False)


def test_poles_of_both_are_those_of_the_parts_on_the_aircraft() -> None:
    plant = aircraft(0.0)
    estimator = fault_estimator(plant, faults=["collective actuator"], poles=[-10, -12, -14, -16], bandwidth=30)
    K = regulator(plant)
    wanted = np.concatenate([np.linalg.eigvals(plant.A - plant.B @ K), [-10, -12, -14, -16, -30]])
    found = closed_loop(plant, estimator, K).poles()
    assert np.abs(found[match_poles(wanted, found)] - wanted).max() < 1e-6
