"""The three-tank benchmark: linearisation, simulation, and agreement with the recordings of others."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import scipy.io

from residua.errors import ModelError
from residua.library import simulate_three_tank, three_tank, three_tank_fault, three_tank_rate
from residua.library.three_tank import AREA, FLOWS, LEVELS


def slope(function, step: float) -> np.ndarray:
    return (function(step) - function(-step)) / (2 * step)


def test_linear_model_is_the_derivative_of_the_nonlinear_one() -> None:
    plant, h, q = three_tank(dt=0), np.array(LEVELS), np.array(FLOWS)
    eye = np.eye(3)
    for i in range(3):
        found = slope(lambda s, i=i: three_tank_rate(h + s * eye[i], q), 1e-4)
        np.testing.assert_allclose(found, plant.A[:, i], atol=1e-9)
    directions = {name: plant.Bf[:, i] for i, name in enumerate(plant.faults)}
    for i in range(2):
        found = slope(lambda s, i=i: three_tank_rate(h, q + s * np.eye(2)[i]), 1e-3)
        np.testing.assert_allclose(found, plant.B[:, i], atol=1e-9)
        np.testing.assert_array_equal(directions[f"Q{i + 1} actuator"], plant.B[:, i])
    for i, pipe in enumerate(("13", "20", "32")):
        found = slope(lambda s, i=i: three_tank_rate(h, q, clogs=s * eye[i]), 1e-4)
        np.testing.assert_allclose(found, directions[f"clog {pipe}"], atol=1e-9)
        found = slope(lambda s, i=i: three_tank_rate(h, q, leaks=s * eye[i]), 1e-4)
        np.testing.assert_allclose(found, directions[f"leak {i + 1}"], atol=1e-9)


def test_names_units_and_operating_point() -> None:
    plant = three_tank()
    assert plant.dt == 1.0
    assert plant.fault_kinds == ("actuator",) * 2 + ("sensor",) * 3 + ("component",) * 6
    assert plant.fault_components[5:] == ("tank 1", "tank 2", "tank 3", "pipe 13", "pipe 20", "pipe 32")
    assert plant.operating_point.inputs == FLOWS
    assert plant.operating_point.outputs == LEVELS
    assert set(plant.units.values()) == {"cm", "cm3/s"}
    np.testing.assert_allclose(plant.measurement_noise, 0.02 * np.eye(3), rtol=1e-14)
    np.testing.assert_allclose(plant.process_noise, 1e-4 * np.eye(3), rtol=1e-14)


@pytest.fixture(scope="module")
def undisturbed() -> np.ndarray:
    """The levels of 400 steps with constant pumps and without noise."""
    return simulate_three_tank(400, u=np.tile(FLOWS, (400, 1)), noise=0).y


@pytest.mark.parametrize("name", three_tank().faults)
def test_small_faults_move_the_simulation_as_the_linear_plant_says(name: str, undisturbed: np.ndarray) -> None:
    size = 1e-3 if name.endswith(("actuator", "sensor")) else 1e-5
    steps, command = 400, np.tile(FLOWS, (400, 1))
    moved = simulate_three_tank(steps, u=command, noise=0, faults={name: size}).y
    change = (moved - undisturbed) / size
    plant = three_tank()
    expected = plant.system("fault").select(inputs=[name]).simulate(np.ones((steps, 1)))
    np.testing.assert_allclose(change, expected, rtol=2e-3, atol=2e-3 * np.abs(expected).max())


def test_closed_loop_holds_the_levels_against_a_leak() -> None:
    run = simulate_three_tank(2001, faults=three_tank_fault(7), noise=0)
    np.testing.assert_allclose(run.y[-1, :2], LEVELS[:2], atol=0.2)
    assert run.u[-1, 0] > FLOWS[0] + 20
    follow = simulate_three_tank(2001, noise=0, setpoints=(42.0, 31.0))
    np.testing.assert_allclose(follow.y[-1, :2], (42.0, 31.0), atol=0.01)


def test_sensor_faults_deceive_the_controller() -> None:
    run = simulate_three_tank(2001, faults={"h1 sensor": 1.0}, noise=0)
    np.testing.assert_allclose(run.y[-1, 0], LEVELS[0], atol=0.01)
    np.testing.assert_allclose(run.x[-1, 0], LEVELS[0] - 1.0, atol=0.01)


def test_noise_is_that_of_the_plant_and_repeatable() -> None:
    first, again, other = (simulate_three_tank(3000, seed=seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.y, again.y)
    assert (first.y != other.y).any()
    np.testing.assert_allclose((first.y - first.x).var(axis=0), 0.02, rtol=0.1)
    u, x = first.u, first.x
    drift = x[1:] - x[:-1] - np.array([three_tank_rate(x[k], u[k]) for k in range(2999)])
    np.testing.assert_allclose(drift.var(axis=0), 1e-4 + np.array([0.05, 0.02, 0]) / AREA**2, rtol=0.1)


def test_pumps_and_tanks_have_limits() -> None:
    run = simulate_three_tank(2000, u=np.full((2000, 2), 500.0), noise=0)
    assert run.x.max() == 62.0
    run = simulate_three_tank(3000, u=np.zeros((3000, 2)), noise=0)
    assert run.x.min() >= 0.0
    np.testing.assert_allclose(run.x[-1], 0.0, atol=0.5)


@pytest.mark.parametrize("number", range(1, 13))
def test_benchmark_faults_begin_at_their_onset(number: int) -> None:
    for name, course in three_tank_fault(number).items():
        assert name in three_tank().faults
        assert not course[:201].any()
        assert course[201:].any()


@pytest.mark.parametrize("number", [7, 8, 9, 10, 11, 12])
def test_component_faults_balance_the_recordings_of_others(number: int, shared_data: Path) -> None:
    """What flows in and out of each tank in the recordings agrees with the model that has the fault."""
    data = scipy.io.loadmat(shared_data / "three_tank_dts200" / "test_5ch.mat")[f"fault{number:02d}"]
    u, y = data[:, :2], data[:, 2:]
    last = slice(1701, 2001)
    name, course = next(iter(three_tank_fault(number).items()))
    extent = np.eye(3)[{"1": 0, "2": 1, "3": 2, "13": 0, "20": 1, "32": 2}[name.split()[1]]] * course[last].mean()
    faults = {"leaks": extent} if "leak" in name else {"clogs": extent}
    h, q = y[last].mean(axis=0), u[last].mean(axis=0)
    moving = (y[1901:].mean(axis=0) - y[1701:1801].mean(axis=0)) / 200
    balance = AREA * (three_tank_rate(h, q, **faults) - moving)
    without = AREA * (three_tank_rate(h, q) - moving)
    assert np.abs(balance).max() < 1.0  # cm3/s
    assert np.abs(without).max() > 7.0


def test_bad_input() -> None:
    with pytest.raises(ModelError, match="unknown fault 'leak 4'; known: Q1 actuator"):
        simulate_three_tank(10, faults={"leak 4": 1.0})
    with pytest.raises(ModelError, match=r"fault 'leak 1': expected shape \(10,\), got \(9,\)"):
        simulate_three_tank(10, faults={"leak 1": np.ones(9)})
    with pytest.raises(ModelError, match=r"u: expected shape \(10, 2\)"):
        simulate_three_tank(10, u=np.ones((9, 2)))
    with pytest.raises(ModelError, match="finite"):
        simulate_three_tank(10, faults={"leak 1": np.nan})
    with pytest.raises(ModelError, match="dt must lie in"):
        simulate_three_tank(10, dt=100.0)
    with pytest.raises(ModelError, match="positive whole number"):
        simulate_three_tank(0)
    with pytest.raises(ModelError, match="faults 1 to 12, not 13"):
        three_tank_fault(13)
