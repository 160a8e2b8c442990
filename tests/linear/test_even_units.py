"""Even units: the scaled matrices are the same to the last bit for all units that are powers of two."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from residua.linear import invariant_zeros
from residua.linear.systems.balancing import balance_system, descriptor_units
from residua.linear.systems.units import matrix_units, output_weights, pencil_units, system_units


def sparse(rng: np.random.Generator, *shape: int, density: float = 0.6) -> np.ndarray:
    """Return a matrix of small whole numbers, many of them zero."""
    return rng.integers(-3, 4, shape) * (rng.random(shape) < density) * 1.0


def powers(rng: np.random.Generator, count: int) -> np.ndarray:
    return 2.0 ** rng.integers(-20, 21, count)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_balanced_systems_are_the_same_in_all_units(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, m, p = rng.integers(0, 8), rng.integers(0, 4), rng.integers(0, 4)
    A, B, C, D = sparse(rng, n, n), sparse(rng, n, m), sparse(rng, p, n), sparse(rng, p, m, density=0.2)
    T, U, Y = powers(rng, n), powers(rng, m), powers(rng, p)
    one = balance_system(A, B, C, D)
    other = balance_system(A / T[:, None] * T, B / T[:, None] * U, Y[:, None] * C * T, Y[:, None] * D * U)
    for name in "ABCD":
        assert np.array_equal(getattr(one, name), getattr(other, name))


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_descriptor_units_are_the_same_in_all_units(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, m, p = rng.integers(1, 7), rng.integers(0, 4), rng.integers(0, 4)
    A, E = sparse(rng, n, n), sparse(rng, n, n)
    B, C, D = sparse(rng, n, m), sparse(rng, p, n), sparse(rng, p, m, density=0.2)
    R, T, U, Y = (powers(rng, int(k)) for k in (n, n, m, p))

    def scaled(A: np.ndarray, E: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray) -> list[np.ndarray]:
        u = descriptor_units(A, E, B, C, D)
        r, y = u.equations[:, None], u.outputs[:, None]
        return [r * A * u.states, u.unit * r * E * u.states, r * B * u.inputs, y * C * u.states, y * D * u.inputs]

    first = scaled(A, E, B, C, D)
    R_, Y_ = R[:, None], Y[:, None]
    second = scaled(R_ * A * T, R_ * E * T, R_ * B * U, Y_ * C * T, Y_ * D * U)
    assert all(np.array_equal(a, b) for a, b in zip(first, second, strict=True))


@pytest.mark.parametrize("seed", range(20))
def test_units_of_matrices_and_pencils(seed: int) -> None:
    rng = np.random.default_rng(seed)
    M, E = sparse(rng, 4, 6), sparse(rng, 4, 6)
    R, S = powers(rng, 4), powers(rng, 6)
    r, c = matrix_units(M)
    r2, c2 = matrix_units(R[:, None] * M * S)
    assert np.array_equal(r[:, None] * M * c, r2[:, None] * R[:, None] * M * S * c2)
    u, v = pencil_units(M, E), pencil_units(R[:, None] * M * S, 2.0**-9 * R[:, None] * E * S)
    assert np.array_equal(
        u.unit * u.rows[:, None] * E * u.columns, v.unit * v.rows[:, None] * 2.0**-9 * R[:, None] * E * S * v.columns
    )


@pytest.mark.parametrize("seed", range(20))
def test_weights_of_outputs_follow_any_unit(seed: int) -> None:
    """Weighted outputs are the same also in units that are no powers of two, up to one factor for all."""
    rng = np.random.default_rng(seed)
    A, B, C = rng.standard_normal((3, 3)), rng.standard_normal((3, 1)), rng.standard_normal((4, 3))
    D = np.zeros((4, 1))
    T, Y = 10.0 ** rng.uniform(-6, 6, 3), 10.0 ** rng.uniform(-6, 6, 4)
    one = output_weights(A, B, C, D)
    other = output_weights(A * T / T[:, None], B / T[:, None], Y[:, None] * C * T, D) * Y
    np.testing.assert_allclose(other / other[0], one / one[0], rtol=1e-9)


def test_residue_is_no_coupling() -> None:
    A = np.array([[-1.0, 1e-17, 0], [2, -3, 1], [1e-18, 1, -2]])
    clean = np.where(np.abs(A) > 1e-10, A, 0.0)
    B, C, D = np.ones((3, 1)), np.ones((1, 3)), np.zeros((1, 1))
    assert np.array_equal(system_units(A, B, C, D).states, system_units(clean, B, C, D).states)


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
    if not decimal:
        assert np.array_equal(one.zeros, other.zeros)
