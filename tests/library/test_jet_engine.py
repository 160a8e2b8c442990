"""The jet engine of Chen, Patton and Zhang and its second-order model."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import scipy.integrate

from residua.errors import ModelError
from residua.library import E_HAT, jet_engine, jet_engine_rate, jet_engine_steady_state, simulate_jet_engine


def test_matrices_are_the_papers(shared_data: Path) -> None:
    paper = json.loads((shared_data / "jet_engine_uio" / "jet_engine_chen1996.json").read_text())
    engine = jet_engine(corrected=False)
    for mine, key in ((engine.A, "A"), (engine.B, "B"), (engine.C, "C"), (np.array(E_HAT), "E_star")):
        np.testing.assert_array_equal(mine, paper[key])
    corrected = jet_engine()
    assert corrected.C[5, 2] == 0.61199
    assert np.count_nonzero(corrected.C != engine.C) == 1


def test_faults_and_disturbances() -> None:
    engine = jet_engine()
    assert engine.faults == ("n_low sensor", "n_high sensor", "fuel_flow sensor", "fuel actuator")
    assert np.linalg.matrix_rank(engine.Bd) == engine.Bd.shape[1] == 2
    assert jet_engine(disturbances=False).disturbances == ()


def test_linear_model_is_the_derivative_of_the_second_order_one() -> None:
    engine, h = jet_engine(), 1e-6
    for i in range(3):
        step = h * np.eye(3)[i]
        slope = (jet_engine_rate(step, [0.0]) - jet_engine_rate(-step, [0.0])) / (2 * h)
        np.testing.assert_allclose(slope, engine.A[:, i], atol=1e-9)
    slope = (jet_engine_rate(np.zeros(3), [h]) - jet_engine_rate(np.zeros(3), [-h])) / (2 * h)
    np.testing.assert_allclose(slope, engine.B[:, 0], atol=1e-9)


@pytest.mark.parametrize("u", [-0.2, 0.0, 0.1, 0.2])
def test_steady_states_are_at_rest_and_are_reached(u: float) -> None:
    x = jet_engine_steady_state(u)
    assert np.abs(jet_engine_rate(x, [u])).max() < 1e-12
    np.testing.assert_allclose(simulate_jet_engine(np.full(4000, u), dt=0.01).x[-1], x, atol=1e-9)


def test_simulation_agrees_with_scipy() -> None:
    run = simulate_jet_engine(np.full(301, 0.2), dt=0.01)
    start = np.zeros(3)
    solution = scipy.integrate.solve_ivp(
        lambda _, x: jet_engine_rate(x, [0.2]), (0, 3), start, t_eval=run.time, rtol=1e-10, atol=1e-12
    )
    np.testing.assert_allclose(run.x, solution.y.T, atol=2e-7)


def test_faults_enter_where_they_should() -> None:
    command = np.full(2000, 0.1)
    healthy = simulate_jet_engine(command)
    np.testing.assert_allclose(healthy.y, healthy.x @ jet_engine().C.T, atol=1e-15)
    sensor = simulate_jet_engine(command, faults={"p2 sensor": 0.3})
    np.testing.assert_allclose(sensor.y - healthy.y, 0.3 * np.eye(6)[3] * np.ones((2000, 1)), atol=1e-15)
    relative = simulate_jet_engine(command, faults={"n_high sensor": 0.02}, relative=True)
    np.testing.assert_allclose(relative.y[:, 1], 1.02 * healthy.y[:, 1], rtol=1e-14)
    actuator = simulate_jet_engine(command, faults={"fuel actuator": np.full(2000, 0.1)})
    np.testing.assert_array_equal(actuator.x, simulate_jet_engine(2 * command).x)
    np.testing.assert_array_equal(actuator.u, healthy.u)


def test_noise_is_repeatable() -> None:
    runs = [simulate_jet_engine(np.zeros(5000), noise=0.1, seed=seed).y for seed in (1, 1, 2)]
    np.testing.assert_array_equal(runs[0], runs[1])
    assert (runs[0] != runs[2]).all()
    assert runs[0].std() == pytest.approx(0.1, rel=0.03)


def test_bad_input() -> None:
    with pytest.raises(ModelError, match="unknown fault 'n_lo sensor'; known: fuel actuator"):
        simulate_jet_engine(np.zeros(5), faults={"n_lo sensor": 1.0})
    with pytest.raises(ModelError, match=r"fault .n_low sensor.: expected shape \(5,\), got \(4,\)"):
        simulate_jet_engine(np.zeros(5), faults={"n_low sensor": np.ones(4)})
    with pytest.raises(ModelError, match="dt must lie in"):
        simulate_jet_engine(np.zeros(5), dt=1.0)
    with pytest.raises(ModelError, match="runs away"):
        simulate_jet_engine(np.full(5000, -3.0))
