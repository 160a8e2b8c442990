"""Numbers of any size in what is computed without rounding."""

import warnings
from fractions import Fraction

import numpy as np
import pytest

from residua.linear.poles import settled_zeros
from residua.linear.poles.rational_zeros import (
    RATIONAL,
    Field,
    Matrix,
    Reduced,
    characteristic_polynomial,
    different_factors,
    rational_roots,
    reduced,
)
from residua.linear.poles.settled_zeros import counted_hidden, settled, settled_hidden_part


def _product(*factors: list[Fraction]) -> list[Fraction]:
    out = [Fraction(1)]
    for p in factors:
        new = [Fraction(0)] * (len(out) + len(p) - 1)
        for i, a in enumerate(out):
            for j, b in enumerate(p):
                new[i + j] += a * b
        out = new
    return out


@pytest.mark.parametrize("apart", [31, 61, 89, 122])
def test_modes_that_are_powers_of_two_apart_are_two(apart: int) -> None:
    """Modulo a Mersenne prime they were one, which no output sees."""
    A = -np.diag(2.0 ** np.array([21, 21 - apart]))
    assert counted_hidden(A, np.ones((1, 2))) == 0


@pytest.mark.parametrize("n", [0, 1, 2, 7, 11])
def test_characteristic_polynomials_are_the_determinants(n: int) -> None:
    rng = np.random.default_rng(n)
    whole = rng.integers(-3, 4, (n, n))
    polynomial = characteristic_polynomial([[Fraction(x, 3) for x in row] for row in whole.tolist()])
    known = np.rint(np.poly(whole)).astype(int).tolist() if n else [1]
    assert polynomial == [Fraction(c, 3**k) for k, c in enumerate(known)]


def test_numbers_too_long_to_wait_for_have_no_characteristic_polynomial() -> None:
    rows = [[Fraction(2.0 ** (40 * (i - j)) + 1 / 3) for j in range(20)] for i in range(20)]
    assert characteristic_polynomial(rows) is None


def test_roots_beyond_the_largest_and_the_least_numbers_are_not_found_without_a_word() -> None:
    far = [Fraction(10) ** (25 * k) for k in range(-10, 10)]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert rational_roots([Fraction(1), Fraction(0), Fraction(1, 2**2100)]) is None
        assert rational_roots(_product(*([Fraction(1), -x] for x in far))) is None


def test_repeated_factors_are_told_from_near_ones() -> None:
    one, near = [Fraction(1), Fraction(-1)], [Fraction(1), Fraction(-1) - Fraction(1, 2**60)]
    assert different_factors(_product(one, near)) == [(_product(one, near), 1)]
    assert different_factors(_product(one, one, one, near)) == [(near, 1), (one, 3)]


def test_where_residues_count_nothing_no_rational_number_is_computed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 23 states with 32 binary digits they took seconds, to say the same."""

    def watched(A: Matrix, B: Matrix, C: Matrix, D: Matrix, field: Field) -> Reduced:
        assert field is not RATIONAL
        return reduced(A, B, C, D, field)

    monkeypatch.setattr(settled_zeros, "reduced", watched)
    A, C = np.rint(np.random.default_rng(0).normal(0, 2**20, (8, 8))), np.eye(1, 8)
    found = settled_hidden_part(A, C, np.zeros(0, dtype=complex))
    assert found is not None
    assert found.modes is not None
    assert (found.basis.shape, found.modes.shape) == ((8, 0), (0,))
    rank, zeros = settled((A, np.eye(8, 0), C, np.eye(1, 0)), (1, None))
    assert zeros is not None
    assert (rank, zeros.shape) == (0, (0,))
