"""Numbers of any size in what is computed without rounding."""

import warnings
from fractions import Fraction

import numpy as np
import pytest

from residua.linear.poles.rational_zeros import characteristic_polynomial, different_factors, rational_roots
from residua.linear.poles.settled_zeros import counted_hidden


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
