"""Existence of unknown input observers: the reason in words and numbers, and both conditions independently."""

from __future__ import annotations

import numpy as np
import pytest

import residua as rs
from generated import random_plant
from residua.errors import DesignError
from residua.linear.poles.zeros import invariant_zeros


@pytest.mark.parametrize("seed", range(60))
def test_fixed_poles_are_the_invariant_zeros(seed: int) -> None:
    """000-6: the unobservable modes of (C, A1) are the invariant zeros of (A, E, C)."""
    rng = np.random.default_rng(seed)
    plant = random_plant(rng, n=5, outputs=2, disturbances=2, faults=1)
    found = rs.analysis.unknown_input_observer_existence(plant)
    zeros = invariant_zeros(plant.A, plant.Bd, plant.C).zeros
    assert found.rank_CE.rank == 2
    assert len(zeros) == len(found.fixed_poles)
    for zero in zeros:
        assert np.abs(found.fixed_poles - zero).min() < 1e-6
    stable = bool((np.abs(zeros) < 1).all() if plant.is_discrete else (zeros.real < 0).all())
    assert found.exists == stable
    if not stable:
        with pytest.raises(DesignError, match="invariant zero"):
            rs.design.unknown_input_observer(plant)


def test_the_rank_condition_names_the_disturbance() -> None:
    plant = rs.Plant([[-1, 1, 0], [0, -2, 1], [0, 0, -3]], [[0], [0], [1]], [[1, 0, 0], [0, 1, 0]])
    plant = plant.with_disturbances({"gust": [0, 0, 1], "load": [0, 1, 0]})
    found = rs.analysis.unknown_input_observer_existence(plant)
    assert not found
    assert "rank(CE)=1 < rank(E)=2" in found.reasons[0]
    assert "'gust'" in found.reasons[0]
    assert "'load'" not in found.reasons[0]


def test_a_disturbance_that_an_output_reads_is_not_named() -> None:
    A, C = [[-1, 0, 0], [1, -2, 0], [0, 1, -3]], [[0, 0, 1], [0, 0, 2]]
    plant = rs.Plant(A, np.zeros((3, 1)), C)
    both = plant.with_disturbances([[1, 0], [0, 1], [0, 0]], ["seen", "hidden"], output=[[1, 0], [0, 0]])
    reason = rs.analysis.unknown_input_observer_existence(both).reasons[0]
    assert "'hidden'" in reason
    assert "'seen'" not in reason


@pytest.mark.parametrize("scale", [1e-5, 1.0, 1e5])
def test_units_do_not_decide_existence(scale: float) -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        plant = random_plant(rng, n=4, outputs=3, disturbances=2, faults=1)
        T = scale ** rng.uniform(-1, 1, 4)
        other = rs.Plant(plant.A * T[:, None] / T, plant.B * T[:, None], plant.C / T, dt=plant.dt)
        other = other.with_disturbances(plant.Bd * T[:, None])
        assert rs.analysis.unknown_input_observer_existence(other).rank_CE.rank == 2


def test_a_residual_that_is_always_zero_is_refused() -> None:
    plant = rs.Plant([[-1, 0.5], [0, -2]], [[1], [1]], np.eye(2)).with_disturbances(np.eye(2)).with_sensor_faults()
    assert rs.analysis.unknown_input_observer_existence(plant)
    assert not rs.analysis.unknown_input_observer_existence(plant).useful
    with pytest.raises(DesignError, match="zero whatever fails"):
        rs.design.unknown_input_observer(plant).residual_generator()
    with pytest.raises(DesignError, match="used up"):
        rs.design.robust_detection_filter(plant)


def test_an_unseen_unstable_mode_is_told() -> None:
    plant = rs.Plant(np.diag([1.0, -2]), [[1], [1]], [[0, 1]]).with_sensor_faults()
    found = rs.analysis.unknown_input_observer_existence(plant)
    assert not found
    assert "no measurement sees the mode 1" in found.reasons[0]


# ------------------------------------------------- existence and design are one


def plant_of(A: list, E: list, C: list | np.ndarray) -> rs.Plant:
    A_ = np.array(A, dtype=float)
    return rs.Plant(A_, np.zeros((len(A_), 0)), C).with_disturbances(np.array(E, dtype=float))


@pytest.mark.parametrize(
    ("A", "E", "C", "zero"),
    [
        ([[3, -1, 3], [-3, 2, -1], [-2, -2, 3]], [[-2, -3], [-1, -1], [-1, -1]], [[1, 0, 0], [1, 1, 0]], 4.0),
        (
            [[0.1, 0.2, 0.3], [0.4, 0.5, 0.6], [0.7, 0.8, 0.9]],
            [[0.3, 0.1], [0.1, 0.7], [0.2, 0.1]],
            np.eye(3)[:2],
            0.675,
        ),
    ],
)
def test_an_unstable_zero_is_a_fixed_pole_that_no_observer_has(A: list, E: list, C: list, zero: float) -> None:
    plant = plant_of(A, E, C)
    found = rs.analysis.unknown_input_observer_existence(plant)
    assert not found
    np.testing.assert_allclose(found.fixed_poles, [zero], atol=1e-12)
    with pytest.raises(DesignError, match="fixed pole outside"):
        rs.design.unknown_input_observer(plant)


@pytest.mark.parametrize("seed", range(40))
def test_as_many_disturbances_as_outputs_leave_all_other_poles_fixed(seed: int) -> None:
    rng = np.random.default_rng(seed)
    plant = plant_of(rng.standard_normal((4, 4)), rng.standard_normal((4, 2)), np.eye(2, 4))
    found = rs.analysis.unknown_input_observer_existence(plant)
    zeros = invariant_zeros(plant.A, plant.Bd, plant.C).zeros
    assert len(found.fixed_poles) == len(zeros) == 2
    assert found.exists == bool((zeros.real < 0).all())
    if found:
        observer = rs.design.unknown_input_observer(plant)
        assert observer.evidence.conditions["size of K1"] < 1e6
    else:
        with pytest.raises(DesignError):
            rs.design.unknown_input_observer(plant)


def transport_aircraft() -> rs.Plant:
    A = [
        [0, 0, 1.132, 0, -1],
        [0, -0.0538, -0.1712, 0, 0.0705],
        [0, 0, 0, 1, 0],
        [0, 0.0485, 0, -0.8556, -1.013],
        [0, -0.2909, 0, 1.0532, -0.6859],
    ]
    E = np.array([[0, 0.00989, -0.07548, 0, 0], [0.01672, 0, 0, 0.05635, 0.06743]]).T
    return plant_of(A, E.tolist(), np.eye(3, 5))


def test_the_transport_aircraft_has_an_observer() -> None:
    plant = transport_aircraft()
    assert rs.analysis.unknown_input_observer_existence(plant)
    observer = rs.design.unknown_input_observer(plant, poles=[-1, -1.5, -2, -2.5, -3])
    np.testing.assert_allclose(np.sort(observer.poles.real), [-3, -2.5, -2, -1.5, -1], atol=1e-9)
    assert np.abs(observer.T @ plant.Bd).max() < 1e-12
    assert observer.evidence.conditions["pole error"] < 1e-9


@pytest.mark.parametrize("seed", range(30))
def test_existence_and_observer_are_the_same_in_all_units(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, p, q = int(rng.integers(2, 6)), int(rng.integers(2, 4)), int(rng.integers(1, 3))
    A, E, C = (rng.integers(-3, 4, shape) * 1.0 for shape in ((n, n), (n, q), (p, n)))
    T, Y, W = (2.0 ** rng.integers(-20, 21, k) for k in (n, p, q))
    plant = plant_of(A, E, C)
    other = plant_of(A / T[:, None] * T, E / T[:, None] * W, Y[:, None] * C * T)
    one, two = (rs.analysis.unknown_input_observer_existence(x) for x in (plant, other))
    assert one.exists == two.exists
    assert one.reasons == two.reasons
    np.testing.assert_allclose(one.fixed_poles, two.fixed_poles, rtol=1e-6, atol=1e-6)
    if one:
        first, second = (rs.design.unknown_input_observer(x, scaling="even") for x in (plant, other))
        for mine, scaled in ((first.F, second.F * T[:, None] / T), (first.H, second.H * T[:, None] * Y)):
            np.testing.assert_allclose(mine, scaled, rtol=1e-6, atol=1e-6 * np.abs(mine).max(initial=1e-12))


def slow_hidden(rates: list[float], *, equation: bool = False) -> rs.Plant:
    """A chain of slow states that no output sees, behind two fast ones that a disturbance moves with them."""
    A = np.zeros((5, 5))
    A[:2, :2] = [[-3, 2], [2, -3]]
    A[2:, 2:] = -np.diag(rates) + 0.5 * np.diag([1, 1], 1)
    A[2:, :2] = [[-2, -1], [0, 0], [-2, -1]]
    C, Bd, E = np.eye(2, 5), np.array([[1.0], [2], [-2], [2], [-1]]), None
    if equation:  # 0 = x6 - x1 besides, which changes nothing
        A = np.block([[A, np.zeros((5, 1))], [np.array([[-1.0, 0, 0, 0, 0, 1]])]])
        C, Bd, E = np.eye(2, 6), np.vstack([Bd, [[0.0]]]), np.diag([1.0] * 5 + [0])
    return rs.Plant(A, np.zeros((len(A), 1)), C, E=E).with_disturbances(Bd)


@pytest.mark.parametrize("equation", [False, True])
@pytest.mark.parametrize("rates", [[1e-5] * 3, [1e-5, 1.3e-5, 1.7e-5], [1e-5, 2e-5, 4e-5], [-1e-5, 2e-5, 4e-5]])
@pytest.mark.parametrize("unit", [1.0, 2.0**20])
def test_slow_states_that_nothing_sees_have_their_own_rates(rates: list[float], equation: bool, unit: float) -> None:
    """Each is known to rounding of the fastest rate, and the triple one to its third root."""
    plant = slow_hidden(rates, equation=equation)
    scaled = rs.Plant(plant.A, plant.B, unit * plant.C, E=plant.E).with_disturbances(plant.Bd)
    found = rs.analysis.unknown_input_observer_existence(scaled)
    assert found.exists == (min(rates) > 0)
    wanted = np.sort(-np.array(rates))
    np.testing.assert_allclose(np.sort(found.fixed_poles.real), wanted, atol=2e-7 if len(set(rates)) > 1 else 2e-6)
    np.testing.assert_allclose(found.fixed_poles.mean(), wanted.mean(), atol=1e-11)


def test_a_turned_block_of_hidden_states_has_its_modes_beside_an_equation() -> None:
    plant, rate = slow_hidden([1.0] * 3, equation=True), 2.0**-14
    A = plant.A.copy()
    A[2:5, 2:5] = np.array([[-8, 16, 4], [-4, 8, 4], [0, 0, 0]]) - rate * np.eye(3)
    turned = rs.Plant(A, plant.B, plant.C, E=plant.E).with_disturbances(plant.Bd)
    found = rs.analysis.unknown_input_observer_existence(turned)
    assert found.exists
    np.testing.assert_allclose(found.fixed_poles.mean(), -rate, rtol=1e-9)


@pytest.mark.parametrize("rates", [[1e-5, 1.3e-5, 1.7e-5], [1e-5, 2e-5, 4e-5]])
def test_an_observer_with_slow_hidden_states_has_their_rates(rates: list[float]) -> None:
    observer = rs.design.unknown_input_observer(slow_hidden(rates))
    np.testing.assert_allclose(np.sort(observer.evidence.fixed_poles.real), np.sort(-np.array(rates)), rtol=1e-2)
