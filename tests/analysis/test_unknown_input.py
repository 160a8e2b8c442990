"""Existence of unknown input observers: the reason in words and numbers, and both conditions independently."""

from __future__ import annotations

import numpy as np
import pytest

import residua as rs
from generated import random_plant
from residua.errors import DesignError
from residua.linear.zeros import invariant_zeros


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


@pytest.mark.parametrize("scale", [1e-5, 1.0, 1e5])
def test_units_do_not_decide_existence(scale: float) -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        plant = random_plant(rng, n=4, outputs=3, disturbances=2, faults=1)
        T = scale ** rng.uniform(-1, 1, 4)
        other = rs.Plant(plant.A * T[:, None] / T, plant.Bu * T[:, None], plant.C / T, dt=plant.dt)
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
