"""Entries that are nothing but rounding of a design's own products are no couplings, and no answers."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest

import residua as rs
from guards import trips
from residua.design.observers.reduced_order import _check
from residua.errors import AccuracyError, DesignError
from residua.linear.subspaces.far_gain import refuse_far_gain

#: A gain of a plant of small whole numbers and fractions; one of rounding is 1e15.
GAIN = 1e3


def sparse() -> rs.Plant:
    A = np.zeros((6, 6))
    A[0, 0], A[1, :3], A[2, 2] = 0.25, [0.75, -0.5, -0.25], -0.5
    A[3, [0, 2]], A[4, [0, 4]], A[5, 0] = -0.75, [0.5, -0.25], -0.5
    C = np.eye(6)[[5, 2, 5, 1]]
    plant = rs.Plant(A, np.zeros((6, 0)), C, dt=0.5).with_disturbances({"d1": [0, 2, -3, 0, -2, 0]})
    faults = {"f1": [0, 0, 0, 0, 2, 0], "f2": [0, 2, 0, 0, 3, 0], "f3": [0, 0, 0, 3, 0, 0]}
    return plant.with_faults(faults).with_sensor_faults([0, 2])


def chain_of_delays() -> rs.Plant:
    A = np.diag(np.ones(4), -1)
    A[1, 1] = 0.5
    plant = rs.Plant(A, np.zeros((5, 0)), np.eye(5)[[0, 4, 4, 1]], dt=0.5)
    plant = plant.with_disturbances({"d1": [0, 0, 0, 0, 1], "d2": [-2, 0, 0, -3, 0]})
    return plant.with_faults({"f1": [3, 1, 3, -2, 0]}).with_sensor_faults([2])


def dead_sensor() -> rs.Plant:
    A = [[3, -2, -3, 0, 3], [2, 0, -1, 0, 1], [1, -3, -2, 0, -2], [-2, -2, -2, 2, 1], [0, 0, 0, 3, 0]]
    B = [[1, 1], [-3, 1], [1, -2], [0, 1], [-2, 0]]
    C = np.eye(5)[[3, 0, 0, 4]]
    C[2] = 0
    plant = rs.Plant(A, B, C).with_disturbances({"d1": [-3, -3, 2, 2, 2], "d2": [3, 3, 0, 3, 2]})
    return plant.with_faults({"f1": [0, 3, 0, -2, 0]}).with_actuator_faults([1]).with_sensor_faults([3])


@pytest.mark.parametrize(
    ("plant", "design"),
    [
        (sparse(), rs.design.robust_detection_filter),
        (chain_of_delays(), rs.design.unknown_input_observer),
        (dead_sensor(), rs.design.detection_filter),
    ],
    ids=["sparse", "delays", "dead sensor"],
)
def test_no_pole_is_placed_through_rounding(plant: rs.Plant, design: Any) -> None:
    made = design(plant)
    assert made.evidence.conditions["size of K1"] < GAIN
    assert np.abs(made.system.A).max(initial=0.0) < GAIN


def test_the_gain_of_left_eigenvectors_does_not_reach_the_other_states() -> None:
    """It left 1e-17 of nothing there, which seemed to couple two delays: the gain that moved them was 2e14."""
    A = np.diag(np.ones(3), -1)
    A[2, 2] = 0.5
    C = [[0, 3, 0, 0], [1, 0, -1, 2], [-1, -1, -3, 1], [-3, -1, 0, -3]]
    plant = rs.Plant(A, np.zeros((4, 0)), C, dt=0.5).with_disturbances({"d1": [3, 0, 0, 0]})
    plant = plant.with_faults({"f1": [0, 0, -3, 0]}).with_sensor_faults([0, 1, 2, 3])
    made = rs.design.eigenstructure_assignment(plant, side="left", insensitive_to="f1")
    assert made.observer is not None
    assert np.abs(made.observer.K).max() < GAIN


@pytest.mark.parametrize("design", [rs.design.reduced_order_observer, rs.design.descriptor_observer])
@pytest.mark.parametrize("outputs", [None, [0, 1, 2]])
def test_a_hidden_unstable_mode_is_not_seen_through_rounding(design: Any, outputs: list[int] | None) -> None:
    """The mode at -1.25 stays whatever the outputs say; a coupling of 1e-16 seemed to see it."""
    A = np.array([[0, 0, 0, 0, 2, 0], [1, 3, 6, -2, 7, 0], [3, 0, 0, 1, -1, 0]]) / 4
    A = np.vstack([A, np.array([[5, 5, 9, -3, 12, 0], [3, 0, 0, 0, 1, 0], [-1, -4, 1, 3, -1, -5]]) / 4])
    C = [[0, -1, 0, 1, -1, 0], [0, 2, 0, -1, 1, 0], [0, -1, 0, 1, -1, 0], [1, 0, 0, 0, 0, 0]]
    plant = rs.Plant(A, [[3], [-2], [0], [1], [-1], [-3]], C, dt=0.5)
    with pytest.raises(DesignError, match=r"mode -1\.25 is not seen"):
        design(plant.with_disturbances({"d1": [0, -3, -3, 1, 0, 3]}), outputs=outputs)


def test_an_observer_that_rounding_made_unstable_is_refused() -> None:
    plant, one, none = rs.Plant([[0.5]], [[1]], [[1]], dt=1.0), np.eye(1), np.zeros((1, 1))
    _check(plant, one, 0.9 * one, none, one, none, np.ones(1), 1e-10)
    with pytest.raises(AccuracyError, match=r"not stable, with poles 1\.1"):
        _check(plant, one, 1.1 * one, none, one, none, np.ones(1), 1e-10)


def test_a_mode_behind_a_difference_of_equal_sensors_stays_fixed() -> None:
    found = rs.analysis.unknown_input_observer_existence(chain_of_delays())
    # a double zero at 0, known to the root of rounding
    np.testing.assert_allclose(found.fixed_poles, [0.0, 0.0], atol=1e-7)


def test_a_silent_response_beside_large_terms_does_not_overflow() -> None:
    A = [[1, 1, 0], [0, 1, 2], [0, 0, 1]]
    plant = rs.Plant(A, [[0], [0], [-3]], [[0, 1, 0], [0, 1, 0], [0, 0, 1]], dt=0.5)
    plant = plant.with_disturbances({"d1": [0, 3, -2]}).with_faults({"f1": [2, -1, 3], "f2": [0, 0, 1]})
    plant = plant.with_actuator_faults([0]).with_sensor_faults([2])
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        made = rs.design.decoupled_residual(plant, insensitive_to=[plant.faults[0]])
    assert all(0.0 <= value < np.inf for name, value in made.evidence.conditions.items() if "rounding" in name)


@trips("linear.subspaces.far_gain:refuse_far_gain")
@pytest.mark.parametrize("design", [rs.design.unknown_input_observer, rs.design.detection_filter])
def test_what_only_a_huge_gain_moves_is_refused(design: Any) -> None:
    """Two modes a ten thousand millionth apart in one output: what tells them apart may be rounding."""
    plant = rs.Plant(np.diag([-1, -1 - 2.0**-33]), np.zeros((2, 0)), [[1, 1]]).with_faults({"f1": [1, 2]})
    with pytest.raises(AccuracyError, match="the mode -1 is seen too weakly"):
        design(plant, margin=1.5)


@trips("linear.subspaces.far_gain:refuse_far_gain")
@pytest.mark.parametrize("side", ["right", "left"])
def test_nor_are_they_moved_beside_assigned_eigenvectors(side: str) -> None:
    plant = rs.Plant(np.diag([-2, -1, -1 - 2.0**-33]), np.zeros((3, 0)), [[1, 0, 0], [0, 1, 1]])
    ignored = [1, 0, 0] if side == "right" else [0, 1, 2]
    plant = plant.with_faults({"ignored": ignored, "other": [1, 1, 1]})
    with pytest.raises(AccuracyError, match="the mode -1 is seen too weakly"):
        rs.design.eigenstructure_assignment(plant, side=side, insensitive_to="ignored", margin=1.5, combine=False)


def test_a_gain_that_far_poles_take_is_not_refused() -> None:
    A = np.diag(np.ones(3), 1)
    K = np.array([[4e3], [6e6], [4e9], [1e12]])  # all four poles of a chain of integrators at -1000
    refuse_far_gain(A, np.eye(4)[:1], K, 1000.0)
    with pytest.raises(AccuracyError, match="seen too weakly"):
        refuse_far_gain(A, np.eye(4)[:1], K, 1.0)


def in_units(plant: rs.Plant, x: list[int], y: list[int], f: list[int]) -> rs.Plant:
    """Return a plant in other units, by powers of two; its faults of sensors are in those of the outputs."""
    X, Y = 2.0 ** np.array(x), 2.0 ** np.array(y)
    other = rs.Plant(plant.A / X[:, None] * X, plant.B / X[:, None], plant.C * X / Y[:, None], dt=plant.dt)
    other = other.with_disturbances(
        {name: plant.Bd[:, i] / X for i, name in enumerate(plant.disturbances)},
    )
    own = [i for i, kind in enumerate(plant.fault_kinds) if kind == "component"]
    other = other.with_faults({plant.faults[i]: plant.Bf[:, i] / X * 2.0 ** f[i] for i in own})
    return other.with_sensor_faults([plant.outputs.index(z.component) for z in plant.fault_list if z.kind == "sensor"])


def test_estimators_of_faults_do_not_depend_on_units() -> None:
    base = rs.design.sensor_fault_estimators(sparse())
    x, y, f = [-3, 20, -9, -12, -16, 0], [-1, -9, 12, 10], [19, -7, -14]
    other = rs.design.sensor_fault_estimators(in_units(sparse(), x, y, f))
    assert list(other) == list(base)


def test_the_derivatives_of_a_perfect_observer_do_not_depend_on_units() -> None:
    """The disturbance alone drives a state that only ``E`` connects with the others."""
    plant = rs.Plant([[12, 0], [0, 0]], [[0], [2]], [[1, 3], [-3, -1], [-1, 2]]).with_disturbances({"d1": [0, 1]})
    plant = plant.with_faults({"f1": [2, -2]})
    for k in (-20, -7, 0, 13, 20):
        other = in_units(plant, [k, -k], [0, k, 0], [0])
        assert rs.design.perfect_observer(other, least_order=True).index == 2
        assert rs.design.perfect_observer(other).index == 3


def test_a_kalman_filter_keeps_apart_what_nothing_connects() -> None:
    A = np.zeros((4, 4))
    A[0, 2], A[2, [0, 3]], A[3, 0] = -1.5, [2.0**-8, -(2.0**-7)], -(2.0**-7)
    plant = rs.Plant(A, np.zeros((4, 0)), np.eye(4)[[1, 0]]).with_faults({"f1": [2, 0, 0, -1]})
    made = rs.design.kalman_filter(plant.with_sensor_faults().with_noise(process=1.0, measurement=1.0))
    np.testing.assert_array_equal(made.structure, [[False, True, False], [True, False, True]])


def with_dead_output(seed: int) -> tuple[rs.Plant, int]:
    """Return a plant, singular or not, with disturbances in states and outputs, of which one reads nothing."""
    rng = np.random.default_rng([2, seed])
    n, p, q = int(rng.integers(2, 6)), int(rng.integers(2, 5)), int(rng.integers(0, 3))
    dead, units = int(rng.integers(p)), 2.0 ** rng.integers(-20, 20, p)[:, None]
    E = np.diag((rng.random(n) < 0.7).astype(float)) if rng.random() < 0.3 else None
    A, C = rng.integers(-3, 4, (n, n)).astype(float), units * rng.integers(-3, 4, (p, n))
    Bd, Dd = rng.integers(-2, 3, (n, q)) + 10 * np.eye(n, q), units * rng.integers(-2, 3, (p, q)) * (rng.random() < 0.6)
    C[dead], Dd[dead] = 0, 0
    plant = rs.Plant(A, np.eye(n)[:, :1], C, E=E, dt=float(rng.choice([0, 0.5])))
    return plant.with_disturbances({f"d{i}": (Bd[:, i], Dd[:, i]) for i in range(q)}), dead


def test_a_dead_output_gets_no_gain() -> None:
    made = 0
    for seed in range(150):
        plant, dead = with_dead_output(seed)
        H0 = np.where(np.arange(plant.n_outputs) == dead, 0.0, np.ones((plant.n_states, 1)))
        for design, options in (
            (rs.design.luenberger_observer, {}),
            (rs.design.unknown_input_observer, {}),
            (rs.design.unknown_input_observer, {"H0": H0}),
            (rs.design.reduced_order_observer, {}),
            (rs.design.descriptor_observer, {}),
        ):
            try:
                observer = design(plant, **options)
            except (DesignError, AccuracyError):
                continue
            made += 1
            assert not np.any(observer.K[:, dead]), (seed, design.__name__)
            assert not np.any(observer.H[:, dead]), (seed, design.__name__)
    assert made > 300


@pytest.mark.parametrize("unit", [2.0**-20, 1.0, 2.0**20])
def test_an_output_is_not_mixed_with_others_because_a_disturbance_enters_these(unit: float) -> None:
    """Nothing says how large it is beside them: the mixture would depend on its unit."""
    plant = rs.Plant(np.zeros((0, 0)), np.zeros((0, 0)), np.zeros((3, 0)), dt=0.5)
    plant = plant.with_disturbances({"d": ([], [0, -2, 2])}).with_sensor_faults([1, 2])
    plant = with_output_units(plant, np.array([unit, 1, 1]))
    read = rs.design.decoupled_residual(plant).system.D
    assert (read != 0).tolist() == [[True, False, False], [False, True, True]]
    dynamic = rs.Plant([[-1.0]], [[1.0]], [[unit], [0], [0]]).with_disturbances({"d": ([0], [0, -2, 2])})
    made = rs.design.decoupled_residual(dynamic.with_sensor_faults([1, 2]))
    apart = np.any(made.system.D[:, 1:2], axis=1), np.any(made.system.D[:, 2:], axis=1)
    assert not np.any(np.logical_and(*apart))


def with_output_units(plant: rs.Plant, units: np.ndarray) -> rs.Plant:
    """Return a plant with its outputs in other units, so that the faults of its sensors are in these too."""
    scaled = {name: units[:, None] * getattr(plant, name) for name in ("C", "D", "Dd", "Df")}
    return plant._with(**scaled)
