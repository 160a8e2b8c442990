"""The state map of a filter is found again from the filter alone, whatever poles it shares with the plant."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

import residua as rs
from generated import random_plant, singular_plant
from residua.design.core.balanced_filter import state_map_of
from residua.design.core.decoupling import leak
from residua.design.observers.perfect_observer import differential_filter


def transfer(plant: rs.Plant) -> np.ndarray:
    return np.eye(plant.n_states) if plant.E is None else plant.E


def with_hidden_states(system: rs.StateSpace, rng: np.random.Generator) -> rs.StateSpace:
    """Return the same filter in other coordinates, with two states that its outputs do not see."""
    k = system.n_states
    hidden = scipy.linalg.block_diag(system.A, [[0.3, 0.1], [0.0, -0.2]])
    hidden[k:, :k] = rng.standard_normal((2, k))
    B = np.vstack([system.B, rng.standard_normal((2, system.n_inputs))])
    M = np.linalg.qr(rng.standard_normal((k + 2, k + 2)))[0] * 2.0 ** rng.integers(-8, 8, (k + 2, 1))
    C = np.hstack([system.C, np.zeros((system.n_outputs, 2))])
    inverse = np.linalg.inv(M)
    return system.replaced(A=M @ hidden @ inverse, B=M @ B, C=C @ inverse, states=None)


def plant_of(seed: int) -> rs.Plant:
    """Return an ordinary plant, one with an invertible E, or a singular one."""
    rng = np.random.default_rng(seed)
    if seed % 3 == 2:
        return singular_plant(rng, disturbances=seed % 2)
    plant = random_plant(rng, disturbances=seed % 2, sensors=True, feedthrough=True)
    if seed % 3 == 0:
        return plant
    E = rng.standard_normal((plant.n_states, plant.n_states))
    of_E = rs.Plant(E @ plant.A, E @ plant.B, plant.C, plant.D, E=E, dt=plant.dt)
    of_E = of_E.with_disturbances(E @ plant.Bd) if plant.disturbances else of_E
    return of_E.with_faults({"f": E @ plant.Bf[:, 0]})


def of_higher_index(rng: np.random.Generator, index: int, dt: float) -> rs.Plant:
    """Return a plant whose algebraic equations have to be differentiated ``index - 1`` times."""
    E = scipy.linalg.block_diag(np.eye(3), np.eye(index, k=1))
    A = scipy.linalg.block_diag(0.5 * rng.standard_normal((3, 3)), np.eye(index))
    n = len(E)
    P, Q = rng.standard_normal((2, n, n))
    plant = rs.Plant(P @ A @ Q, rng.standard_normal((n, 1)), rng.standard_normal((4, n)), E=P @ E @ Q, dt=dt)
    return plant.with_sensor_faults()


@pytest.mark.parametrize("design", [rs.design.decoupled_residual, rs.design.parity_relations])
@pytest.mark.parametrize("seed", range(24))
def test_the_map_of_a_design_is_found_again(seed: int, design) -> None:
    plant = plant_of(seed)
    made = design(plant)
    system, T, V = state_map_of(made.system, plant)
    assert system is made.system
    E, known = transfer(plant), made.state_map
    size = max(1.0, np.abs(known @ E).max(initial=0.0))
    np.testing.assert_allclose(T @ E, known @ E, atol=1e-9 * size)
    if V is not None:
        np.testing.assert_allclose(V, made.static_map, atol=1e-9 * max(1.0, np.abs(V).max()))
    found = leak(system, plant, T, V)
    assert found.gains.max(initial=0.0) < 1e-9
    assert found.defects < 1e-9


@pytest.mark.parametrize("seed", range(24))
def test_what_a_filter_does_not_show_is_left_out(seed: int) -> None:
    plant = plant_of(seed)
    made = rs.design.decoupled_residual(plant)
    system, T, V = state_map_of(with_hidden_states(made.system, np.random.default_rng(seed)), plant)
    assert system.n_states == made.system.n_states
    points = np.array([0.3 + 0.2j, -1.1 + 0.7j])
    wanted = made.system.evaluate(points)
    np.testing.assert_allclose(system.evaluate(points), wanted, atol=1e-8 * np.abs(wanted).max())
    found = leak(system, plant, T, V)
    assert found.gains.max(initial=0.0) < 1e-9
    assert found.defects < 1e-9


@pytest.mark.parametrize("seed", range(12))
def test_poles_that_plant_and_filter_share(seed: int) -> None:
    """A chain of three equal modes, of which the filter has as many: the Sylvester equation alone is singular."""
    rng = np.random.default_rng(seed)
    dt = 0.1 if seed % 2 else 0.0
    mode = 0.0 if dt else -1.0
    J = scipy.linalg.block_diag(np.eye(3, k=1) + mode * np.eye(3), [[0.5 if dt else -2.0]])
    M = rng.standard_normal((4, 4))
    plant = rs.Plant(M @ J @ np.linalg.inv(M), rng.standard_normal((4, 1)), rng.standard_normal((3, 4)), dt=dt)
    plant = plant.with_sensor_faults()
    plant = plant.with_disturbances({"d": rng.standard_normal(4)}) if seed % 3 else plant
    order = rs.design.decoupled_residual(plant).system.n_states
    made = rs.design.decoupled_residual(plant, poles=[mode] * order)
    system, T, V = state_map_of(made.system, plant)
    assert V is None
    np.testing.assert_allclose(T, made.state_map, atol=1e-9)
    assert leak(system, plant, T).defects < 1e-12


@pytest.mark.parametrize("dt", [0.0, 0.1])
@pytest.mark.parametrize("index", [1, 2, 3])
@pytest.mark.parametrize("seed", range(4))
def test_algebraic_equations_of_higher_index(seed: int, index: int, dt: float) -> None:
    plant = of_higher_index(np.random.default_rng(seed), index, dt)
    for made in (rs.design.decoupled_residual(plant), rs.design.parity_relations(plant)):
        system, T, V = state_map_of(made.system, plant)
        assert V is not None
        np.testing.assert_allclose(V @ plant.E, 0.0, atol=1e-10 * max(1.0, np.abs(V).max()))
        assert leak(system, plant, T, V).defects < 1e-10


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_a_relation_of_delays_or_lags_has_its_own_map(dt: float) -> None:
    """The relation ``y'' + a y' + b y = u`` of two states, over two lags or delays with a pole that the plant has."""
    a, b = (-0.5, 0.0) if dt else (3.0, 2.0)
    plant = rs.Plant([[0, 1], [-b, -a]], [[0], [1]], [[1, 0]], dt=dt)
    P = [np.array([[-1.0, b]]), np.array([[0.0, a]]), np.array([[0.0, 1.0]])]
    made = differential_filter(P, dt=dt, bandwidth=2.0, inputs=["u1", "y1"], outputs=["r"])
    system, T, V = state_map_of(made, plant)
    assert system.n_states == 2
    found = leak(system, plant, T, V)
    assert found.gains.max() < 1e-14
    assert found.defects < 1e-13


@pytest.mark.parametrize("seed", range(6))
def test_units_change_the_map_alone(seed: int) -> None:
    rng = np.random.default_rng(seed)
    plant = random_plant(rng, n=4, disturbances=1, sensors=True)
    made = rs.design.decoupled_residual(plant)
    X, U, Y = (2.0 ** rng.integers(-20, 20, k) for k in (4, len(plant.inputs), plant.n_outputs))
    Z = 2.0 ** rng.integers(-20, 20, made.system.n_states)
    A, B, C = plant.A / X[:, None] * X, plant.B / X[:, None] * U, Y[:, None] * plant.C * X
    other = rs.Plant(A, B, C, dt=plant.dt).with_disturbances(plant.Bd / X[:, None])
    s, signals = made.system, np.concatenate([U, 1 / Y])
    scaled = s.replaced(A=Z[:, None] * s.A / Z, B=Z[:, None] * s.B * signals, C=s.C / Z, D=s.D * signals)
    _, T, _ = state_map_of(s, plant)
    _, again, _ = state_map_of(scaled, other)
    np.testing.assert_allclose(again / X / Z[:, None], T, atol=1e-9 * np.abs(T).max())


def test_a_filter_that_is_no_residual_misses_the_equations() -> None:
    plant = rs.library.gertler()
    made = rs.design.decoupled_residual(plant, insensitive_to="p1")
    wrong = made.system.replaced(D=made.system.D + 0.1)
    system, T, V = state_map_of(wrong, plant)
    found = leak(system, plant, T, V)
    assert found.gains.max() > 1e-3
    assert found.defects > 1e-3


def test_a_static_residual_and_a_plant_without_states() -> None:
    plant = rs.Plant([[0.5]], [[1]], [[1], [2]], dt=1)
    static = rs.StateSpace(np.zeros((0, 0)), np.zeros((0, 3)), np.zeros((1, 0)), [[0, 2, -1]], dt=1)
    system, T, V = state_map_of(static, plant)
    assert system is static
    assert T.shape == (0, 1)
    assert V is None
    nothing = rs.Plant(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[2.0]], dt=1)
    lag = rs.StateSpace([[0.5]], [[2.0, -1.0]], [[1.0]], [[0.0, 0.0]], dt=1)
    assert state_map_of(lag, nothing)[1].shape == (1, 0)
