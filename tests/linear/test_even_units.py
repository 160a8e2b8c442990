"""Balanced units: no answer depends on those that a model was written in."""

from __future__ import annotations

import numpy as np
import pytest

from residua.linear import invariant_zeros
from residua.linear.systems.scaling import scaling


def sparse(rng: np.random.Generator, *shape: int, density: float = 0.6) -> np.ndarray:
    """Return a matrix of small whole numbers, many of them zero."""
    return rng.integers(-3, 4, shape) * (rng.random(shape) < density) * 1.0


def powers(rng: np.random.Generator, count: int) -> np.ndarray:
    return 2.0 ** rng.integers(-20, 21, count)


def test_residue_is_no_coupling() -> None:
    A = np.array([[-1.0, 1e-17, 0], [2, -3, 1], [1e-18, 1, -2]])
    clean = np.where(np.abs(A) > 1e-10, A, 0.0)
    B, C, D = np.ones((3, 1)), np.ones((1, 3)), np.zeros((1, 1))
    one, other = scaling(A, B, C, D, sampled=False), scaling(clean, B, C, D, sampled=False)
    assert np.array_equal(one.states, other.states)


def test_a_plant_in_mixed_units_has_no_zero_that_it_has_not_in_others() -> None:
    A = [[-3, 64, 0], [0.03125, 0, 2**-37], [17179869184, 274877906944, -1]]
    C = [[0, 268435456, 2**-10], [-805306368, 0, 0.03125]]
    assert not invariant_zeros(A, [[-(2**-30)], [0], [-24]], C).zeros.size
    assert not invariant_zeros(
        [[-3, 2, 0], [1, 0, 2], [2, 1, -1]], [[-1], [0], [-3]], [[0, 1, 1], [-3, 0, 1]]
    ).zeros.size


@pytest.mark.parametrize("decimal", [False, True])
@pytest.mark.parametrize("seed", range(60))
def test_zeros_do_not_depend_on_units(seed: int, decimal: bool) -> None:
    rng = np.random.default_rng(seed)
    n, m, p = int(rng.integers(2, 8)), int(rng.integers(1, 4)), int(rng.integers(1, 4))
    A, B, C = sparse(rng, n, n), sparse(rng, n, m), sparse(rng, p, n)
    T, U, Y = (10.0 ** rng.integers(-6, 7, k) if decimal else powers(rng, k) for k in (n, m, p))
    one = invariant_zeros(A, B, C)
    other = invariant_zeros(A / T[:, None] * T, B / T[:, None] * U, Y[:, None] * C * T)
    assert one.normal_rank == other.normal_rank
    assert len(one.zeros) == len(other.zeros)
