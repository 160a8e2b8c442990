"""Polynomial matrices: null spaces of known dimension and degree, common factors that were put in."""

from __future__ import annotations

import numpy as np
import pytest

from residua.errors import ModelError
from residua.linear import (
    PolynomialMatrix,
    left_null_vectors,
    primitive_part,
    shortest_left_null_vectors,
)


def random_polynomials(rng: np.random.Generator, degree: int, rows: int, columns: int) -> PolynomialMatrix:
    return PolynomialMatrix(rng.standard_normal((degree + 1, rows, columns)))


def values(P: PolynomialMatrix) -> np.ndarray:
    return P.evaluate(np.exp(1j * np.linspace(0.1, 3, 17)))


@pytest.mark.parametrize("seed", range(20))
def test_arithmetic_agrees_with_values_at_points(seed: int) -> None:
    rng = np.random.default_rng(seed)
    P, Q, R = (random_polynomials(rng, int(rng.integers(0, 4)), 2, 2) for _ in range(3))
    assert np.allclose(values(P @ Q - R), values(P) @ values(Q) - values(R))
    assert np.allclose(values(P.beside(Q)), np.concatenate([values(P), values(Q)], axis=2))
    assert np.allclose(values(P.above(Q)), np.concatenate([values(P), values(Q)], axis=1))
    assert np.allclose(P.scaled(3.0).evaluate([0.2]), P.evaluate([0.6]))


def test_entries_have_their_highest_power_first() -> None:
    P = PolynomialMatrix.from_entries([[[1, 0, -4], 2], [[0, 3], [1, 1]]])
    assert P.evaluate([2.0])[0].real.tolist() == [[0, 2], [3, 3]]
    assert P.row_degrees == (2, 1)
    assert PolynomialMatrix(np.zeros((3, 1, 1))).degree == 0


@pytest.mark.parametrize(
    "make",
    [
        lambda: PolynomialMatrix(np.ones((2, 2))),
        lambda: PolynomialMatrix(np.full((1, 1, 1), np.nan)),
        lambda: PolynomialMatrix.from_entries([[1, 2], [1]]),
        lambda: PolynomialMatrix.from_entries([["x"]]),
        lambda: PolynomialMatrix.from_entries([[[[1]]]]),
        lambda: PolynomialMatrix.constant(np.eye(2)) @ PolynomialMatrix.constant(np.eye(3)),
        lambda: PolynomialMatrix.constant(np.eye(2)) + PolynomialMatrix.constant(np.eye(3)),
        lambda: primitive_part(PolynomialMatrix(np.zeros((1, 1, 2)))),
    ],
)
def test_what_is_no_polynomial_matrix_is_refused(make) -> None:
    with pytest.raises(ModelError):
        make()


@pytest.mark.parametrize("seed", range(30))
def test_null_vectors_annihilate_and_are_as_many_as_the_minimal_indices_say(seed: int) -> None:
    """For a generic rows x columns matrix of degree d the indices of its left null space sum up to columns * d."""
    rng = np.random.default_rng(seed)
    columns, d = int(rng.integers(1, 4)), int(rng.integers(1, 4))
    rows = columns + int(rng.integers(1, 3))
    P = PolynomialMatrix(rng.standard_normal((d + 1, rows, columns)) * 10.0 ** rng.uniform(-3, 3, rows)[:, None])
    low, more = divmod(columns * d, rows - columns)  # generic indices are as even as they can be
    indices = [low] * (rows - columns - more) + [low + 1] * more
    for degree in range(low + 3):
        found = left_null_vectors(P, degree)
        assert len(found.vectors) == sum(max(degree - index + 1, 0) for index in indices)
        for x in found.vectors:
            X = PolynomialMatrix(x[:, None])
            terms = np.abs(values(X)) @ np.abs(values(P))
            assert (np.abs(values(X @ P)) < 1e-12 * terms.max()).all()
    shortest = shortest_left_null_vectors(P, most=low + 3)
    assert shortest is not None
    assert shortest.degree == low
    assert shortest_left_null_vectors(P, most=low - 1) is None


@pytest.mark.parametrize("variable", [1e-4, 1.0, 1e4])
def test_the_size_of_the_variable_does_not_matter(variable: float) -> None:
    rng = np.random.default_rng(5)
    P = random_polynomials(rng, 2, 3, 2)
    there = P.scaled(1 / variable)  # the same matrix with a variable of that size
    here, far = left_null_vectors(P, 4), left_null_vectors(there, 4, variable=variable)
    assert len(here.vectors) == len(far.vectors) == 1
    ratio = PolynomialMatrix(far.vectors[0][:, None]).scaled(variable).coefficients / here.vectors[0][:, None]
    assert np.allclose(ratio, ratio.flat[0], rtol=1e-9)


@pytest.mark.parametrize("seed", range(30))
def test_a_common_factor_is_found_and_divided_out(seed: int) -> None:
    rng = np.random.default_rng(seed)
    P = random_polynomials(rng, int(rng.integers(1, 6)), 1, int(rng.integers(2, 6)))
    scale = 10.0 ** rng.uniform(-4, 4, P.shape[1])
    P = PolynomialMatrix(P.coefficients * scale)
    roots = rng.uniform(-0.95, 0.95, int(rng.integers(0, 3)))
    factor = np.atleast_1d(np.poly(roots))
    with_factor = PolynomialMatrix(factor[::-1][:, None, None]) @ P
    found = primitive_part(with_factor)
    assert np.allclose(np.sort(found.roots.real), np.sort(roots), atol=1e-6)
    assert found.matrix.degree == P.degree
    again = PolynomialMatrix(found.factor[::-1][:, None, None]) @ found.matrix
    assert np.allclose(values(again), values(with_factor), rtol=1e-9, atol=1e-9 * scale.min())


def test_roots_that_nearly_meet_are_no_common_factor() -> None:
    P = PolynomialMatrix.from_entries([[[1, -0.5], [1, -0.5 - 1e-5]]])
    assert len(primitive_part(P).roots) == 0
