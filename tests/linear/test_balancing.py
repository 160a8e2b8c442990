"""Balanced units settle, also where no scaling gives all rows and columns one norm."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import residua as rs
from generated import random_plant
from residua.linear.systems.balancing import balance_system, descriptor_units, evened


def spread(*scales: np.ndarray) -> float:
    """Ratio of the largest to the smallest scale, as a power of two."""
    logs = np.log2(np.concatenate(scales))
    return float(np.ptp(logs))


@pytest.mark.parametrize("count", [2, 3, 4, 7])
@pytest.mark.parametrize("driven", [0.0, 1.0])
def test_outputs_that_share_a_disturbance_and_see_no_state(count: int, driven: float) -> None:
    C = np.vstack([[1.0], np.zeros((count, 1))])
    D = np.zeros((count + 1, 2))
    D[1:, 1] = 1.0
    found = balance_system([[-1.0]], [[1.0, driven]], C, D)
    assert spread(found.outputs) <= 4
    assert spread(found.inputs) <= 4
    units = descriptor_units(np.array([[-1.0]]), np.array([[2.0]]), np.array([[1.0, driven]]), C, D)
    assert spread(units.outputs) <= 6


@pytest.mark.parametrize("count", [4, 6, 9])
def test_many_sensors_of_one_state_do_not_run_away_from_the_rest(count: int) -> None:
    """The state alone has no coupling that holds its scale: with count rows of one norm its column is always longer."""
    C = np.zeros((count + 1, 3))
    C[:count, 0], C[count, 1:] = 1.0, 1.0
    A = np.array([[-1.0, 0, 0], [0, -2, 1], [0, -1, -3]])
    found = balance_system(A, np.zeros((3, 0)), C, np.zeros((count + 1, 0)))
    assert spread(found.states) <= 6
    assert spread(found.outputs) <= 6


@pytest.mark.parametrize("seed", range(10))
def test_rows_and_columns_of_ordinary_plants_match_in_norm(seed: int) -> None:
    """In whatever units the plant was written."""
    rng = np.random.default_rng(seed)
    p = random_plant(rng, n=4, outputs=3, inputs=2, faults=0, feedthrough=True, dt=0.0)
    t, y, u = (10.0 ** rng.uniform(-4, 4, k) for k in (4, 3, 2))
    found = balance_system(t[:, None] * p.A / t, t[:, None] * p.B * u, y[:, None] * p.C / t, y[:, None] * p.D * u)
    W = np.block([[found.A, found.B], [found.C, found.D]])
    np.fill_diagonal(W[:4, :4], 0.0)
    ratio = np.linalg.norm(W[:4], axis=1) / np.linalg.norm(W[:, :4], axis=0)
    assert np.all((ratio > 0.45) & (ratio < 2.2))
    for norms in (np.linalg.norm(W[4:], axis=1), np.linalg.norm(W[:, 4:], axis=0)):
        assert norms.max() / norms.min() < 2.5


@pytest.mark.parametrize("count", [2, 3, 4])
def test_an_estimator_decouples_faults_that_several_outputs_read(count: int) -> None:
    """The scales that ran away hid a fault that several sensors read from the check of the estimator."""
    plant = rs.Plant(
        [[-1.0, 0.5], [0.3, -2.0]], [[1.0], [1.0]], np.vstack([[1.0, 0.3], [0.7, 1.0], np.zeros((count, 2))])
    )
    plant = plant.with_faults(
        {"drift": ([1.0, 0.7], np.zeros(count + 2)), "supply": ([0.0, 0.0], [0.0] + [1.0] * (count + 1))}
    )
    found = rs.design.fault_estimator(plant, faults=["drift", "supply"])
    s = 0.5j
    from_faults = plant.C @ np.linalg.solve(s * np.eye(2) - plant.A, plant.Bf) + plant.Df
    K = found.system
    gain = K.C @ np.linalg.solve(s * np.eye(K.n_states) - K.A, K.B) + K.D
    assert np.abs((gain[:, 1:] @ from_faults)[0, 1]) < 1e-9


def test_evening_ends_early_with_the_factors_of_all_sweeps() -> None:
    rng = np.random.default_rng(3)
    differ = 0
    for _ in range(200):
        p, q = rng.integers(1, 7, 2)
        W = np.where(rng.random((p, q)) < 0.6, 2.0 ** rng.uniform(-10, 10, (p, q)), 0.0)  # nothing of it is residue
        start = np.ones(p), np.ones(q)
        step = start
        for sweeps in range(1, 7):
            before, step = step, evened(W, *step, sweeps=1)
            whole = evened(W, *start, sweeps=sweeps)
            assert np.array_equal(whole[0], step[0])
            assert np.array_equal(whole[1], step[1])
            differ += sweeps > 1 and not (np.array_equal(step[0], before[0]) and np.array_equal(step[1], before[1]))
    assert differ > 20  # a second sweep does matter


@pytest.mark.parametrize("seed", range(100))
def test_the_level_of_whole_numbers_is_the_same_in_all_units(seed: int) -> None:
    # few entries of simple plants have a level halfway between two powers of two, which rounds either way
    rng = np.random.default_rng(seed)
    n, m, p = 2, 3, 3
    A = np.triu(rng.integers(0, 2, (n, n)), 1) * 1.0
    B, C = (rng.integers(-1, 3, shape) * 1.0 for shape in ((n, m), (p, n)))
    D = rng.integers(0, 2, (p, m)) * rng.integers(0, 2, (p, m)) * 1.0
    T, U, Y = (2.0 ** rng.integers(-20, 21, count) for count in (n, m, p))
    here = balance_system(A, B, C, D)
    there = balance_system(A / T[:, None] * T, B / T[:, None] * U, Y[:, None] * C * T, Y[:, None] * D * U)
    for one, other in zip((here.A, here.B, here.C, here.D), (there.A, there.B, there.C, there.D), strict=True):
        assert_array_equal(other, one)
