"""Zeros and hidden modes of plants whose couplings multiply until they are rounding, or whose modes coincide.

Their numbers have few digits, whole combinations of the states mix them, and exact answers are known.
"""

from __future__ import annotations

from fractions import Fraction
from random import Random

import numpy as np
import pytest

import residua as rs
from exact import questions
from exact.plants import exact_plant
from exact_campaign import analyses, examination
from exact_campaign.analyses import zeros_missed
from exact_campaign.answers import FAILURES, Subject
from exact_campaign.cases import Case, Rows, base_units, plant_of, units
from residua.linear.poles.rational_zeros import RATIONAL, characteristic_polynomial, rational_roots, reduced

ZERO = Fraction(0)


def matrix(rows: int, columns: int) -> Rows:
    return [[ZERO] * columns for _ in range(rows)]


def mixed(rng: Random, A: Rows, C: Rows) -> tuple[Rows, Rows]:
    """Return a pair in coordinates that are whole combinations of the old ones, and back."""
    n = len(A)
    for _ in range(rng.choice([n, 2 * n, 3 * n])):
        i, j, k = rng.randrange(n), rng.randrange(n), rng.choice([-1, 1])
        if i != j:
            A[i] = [a + k * b for a, b in zip(A[i], A[j], strict=True)]
            for row in A + C:
                row[j] -= k * row[i]
    return A, C


def outputs(rng: Random, n: int, seen: int) -> Rows:
    """Return one output or two that read the first states."""
    C = [[Fraction(rng.randint(-3, 3) if j < seen else 0) for j in range(n)] for _ in range(rng.randint(1, 2))]
    for row in C:
        row[0] = row[0] or Fraction(1)
    return C


def weak_chain(rng: Random) -> tuple[Rows, Rows]:
    """Integrators one after the other, of which some are coupled by 2^-6 to 2^-12."""
    n = rng.randint(4, 9)
    A = matrix(n, n)
    for i in range(n - 1):
        if rng.random() < 0.9:
            A[i][i + 1] = Fraction(1, 2 ** rng.choice([0, 0, 6, 8, 10, 12]))
    if rng.random() < 0.3:
        A[n - 1][rng.randrange(n)] += Fraction(1, rng.choice([1, 2**10]))
    return mixed(rng, A, outputs(rng, n, n))


def hidden_rates(rng: Random) -> tuple[Rows, Rows]:
    """A hidden part that is a thousand times faster or slower than the rest."""
    n = rng.randint(3, 8)
    seen, rate = rng.randint(1, n - 1), Fraction(2) ** rng.choice([-10, -6, 6, 10])
    A = [[Fraction(rng.randint(-3, 3)) * (rate if i >= seen else 1) for _ in range(n)] for i in range(n)]
    for row in A[:seen]:
        row[seen:] = [ZERO] * (n - seen)
    return mixed(rng, A, outputs(rng, n, seen))


def slow_lags(rng: Random) -> tuple[Rows, Rows]:
    """Up to eight equal slow lags, one after the other, that no output sees."""
    seen, hidden = rng.randint(1, 2), rng.randint(4, 8)
    n, pole = seen + hidden, -Fraction(1, rng.choice([4, 64, 256]))
    A = matrix(n, n)
    for row in A[:seen]:
        row[:seen] = [Fraction(rng.randint(-3, 3)) for _ in range(seen)]
    for i in range(seen, n):
        A[i][i] = pole
        A[i][: min(seen, 1)] = [Fraction(rng.randint(0, 1))]
        if i + 1 < n:
            A[i][i + 1] = Fraction(1)
    return mixed(rng, A, outputs(rng, n, seen))


MAKERS = {"weak chain": weak_chain, "hidden rates": hidden_rates, "slow lags": slow_lags}


def case_of(kind: str, seed: int) -> Case:
    """Return a plant with a control and a disturbance."""
    rng = Random(f"{kind}/{seed}")
    A, C = MAKERS[kind](rng)
    n, p = len(A), len(C)
    Bu, Bd, Bf = ([[Fraction(rng.randint(-3, 3))] for _ in range(n)] for _ in range(3))
    Bd[0][0] = Bu[0][0] = Fraction(1)
    none = matrix(p, 1)
    return Case(kind, seed, A, Bu, C, none, Bd, none, Bf, none, sensors=(0,))


SEEDS = [(kind, seed) for kind in MAKERS for seed in range(25)]


@pytest.mark.parametrize(("kind", "seed"), SEEDS)
def test_zeros_hidden_modes_and_existence_are_exact(kind: str, seed: int) -> None:
    case = case_of(kind, seed)
    base = examination.Subject(case, base_units(case))
    asked(base)
    other = Subject(case, units(case, seed, powers_of_two=True), like=base)
    asked(other)
    examination.compare(base, other)
    found = [one for subject in (base, other) for record in subject.records.values() for one in record.problems]
    assert [one for one in found if one[0] in FAILURES] == []


def asked(subject: Subject) -> None:
    """Ask what zeros and hidden modes answer."""
    for which in ("u", "d", "none"):
        analyses._zeros(subject, which)
    analyses._detectability(subject)
    analyses._existence(subject)


@pytest.mark.parametrize(("kind", "seed"), SEEDS[::5])
def test_rational_zeros_are_those_of_the_largest_minors(kind: str, seed: int) -> None:
    plant = plant_of(case_of(kind, seed))
    X = exact_plant(plant)
    for which, B, D in (("d", plant.Bd, plant.Dd), ("none", plant.Bd[:, :0], plant.Dd[:, :0])):
        wanted, rank = questions.zeros_from(X, which)
        left = reduced(plant.A, B, plant.C, D, RATIONAL)
        polynomial = characteristic_polynomial(left.A)
        assert polynomial is not None
        zeros = rational_roots(polynomial)
        assert zeros is not None
        assert (left.rank, len(zeros)) == (rank - X.n, wanted.degree())
        assert zeros_missed(zeros, wanted, 1.0) < 1e-13
        if which == "none":
            basis = np.array([[float(x) for x in row] for row in left.basis])
            np.testing.assert_allclose(plant.C @ basis, 0, atol=1e-12 * np.abs(basis).max(initial=1.0))


def test_numbers_of_all_digits_may_be_rounded_and_stay_hidden_as_they_are() -> None:
    """A mode that rounding alone shows is hidden, though in rational numbers it is not."""
    turned = np.linalg.qr(np.arange(16.0).reshape(4, 4) ** 2 + np.eye(4))[0]
    A, C = np.diag([-1.0, -2.0, -3.0, 0.0]), np.array([[1.0, 1.0, 1.0, 0.0]])
    found = rs.linear.detectability(turned @ A @ turned.T, C @ turned.T)
    assert not found
    np.testing.assert_allclose(found.unobservable_modes, [0], atol=1e-13)
