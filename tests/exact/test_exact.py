"""The oracles against one another, two ways for each answer, and against cases that are known by hand."""

from __future__ import annotations

from dataclasses import replace

import pytest

pytest.importorskip("flint", reason="exact arithmetic: pip install 'residua[test]'")

from flint import fmpq, fmpq_mat, fmpq_poly

from exact import pencils, questions, stability
from exact.matrices import block, exact, identity, is_zero, null_space, rank, zeros
from exact.plants import ExactPlant, at, exact_plant, integrators, with_answers_of
from exact_campaign.cases import plant_of, units
from exact_campaign.kinds import KINDS, case_of


def plants(kind: str, count: int = 6) -> list[ExactPlant]:
    out = []
    for seed in range(1000, 1000 + count):
        case = case_of(kind, seed)
        out += [exact_plant(plant_of(case)), exact_plant(plant_of(case, units(case, seed, powers_of_two=True)))]
    return out


def columns(plant: ExactPlant) -> list[tuple[fmpq_mat, fmpq_mat]]:
    none = zeros(plant.n, 0), zeros(plant.p, 0)
    return [(plant.B, plant.D), (plant.Bd, plant.Dd), none, plant.ignoring([0])]


@pytest.mark.parametrize("kind", KINDS)
def test_zeros_by_minors_are_those_by_reduction(kind: str) -> None:
    for plant in plants(kind):
        for B, D in columns(plant):
            P = plant.pencil(B, D)
            assert pencils.zero_polynomial(P) == pencils.zero_polynomial_by_reduction(P, plant.n)


@pytest.mark.parametrize("kind", KINDS)
def test_the_rank_drops_at_rational_zeros_and_nowhere_else(kind: str) -> None:
    for plant in plants(kind, 3):
        for B, D in columns(plant):
            P = plant.pencil(B, D)
            p, r = pencils.zero_polynomial(P), pencils.normal_rank(P)
            for s in (fmpq(k, 4) for k in range(-12, 13)):
                assert (rank(at(P, s)) < r) == (p(s) == 0)


@pytest.mark.parametrize("kind", KINDS)
def test_stability_by_routh_is_that_by_certified_roots(kind: str) -> None:
    for plant in plants(kind):
        for B, D in columns(plant):
            p = pencils.zero_polynomial(plant.pencil(B, D))
            for sampled in (False, True):
                on_it = any(abs(abs(z) - 1) < 1e-12 if sampled else abs(z.real) < 1e-12 for z, _ in stability.roots(p))
                inside = stability.all_stable(p, sampled) and not on_it
                assert stability.is_stable(p, sampled) == inside


@pytest.mark.parametrize(
    ("p", "sampled", "stable"),
    [
        ([2, 3, 1], False, True),  # -1, -2
        ([0, 1], False, False),
        ([1, 0, 1], False, False),  # on the axis
        ([-1, 0, 1], False, False),
        ([1, 2, 1, 2, 1], False, False),
        ([fmpq(1, 4), 1, 1], True, True),  # -1/2 twice
        ([1, 1], True, False),  # -1
        ([-1, 1], True, False),
        ([1, 0, 1], True, False),
        ([5], True, True),
    ],
)
def test_stability_of_known_polynomials(p: list, sampled: bool, stable: bool) -> None:
    assert stability.is_stable(fmpq_poly(p), sampled) == stable


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "singular E"])
def test_a_proper_estimate_by_solving_is_that_by_ranks(kind: str) -> None:
    for plant in plants(kind):
        for ignored in ([], [0]):
            assert questions.proper_estimate(plant, ignored) == questions.proper_estimate_by_ranks(plant, ignored)


@pytest.mark.parametrize("kind", KINDS)
def test_ranks_of_chosen_columns_are_those_of_the_pencil(kind: str) -> None:
    for plant in plants(kind):
        for ignored in ([], [0], [plant.faults - 1, 0], range(plant.faults)):
            wanted = pencils.normal_rank(plant.pencil(*plant.ignoring(sorted(set(ignored)))))
            assert questions.generic_rank(plant, ignored) == wanted


@pytest.mark.parametrize("kind", KINDS)
def test_answers_are_shared_with_the_same_plant_in_other_units_and_with_no_other(kind: str) -> None:
    for seed in range(1000, 1006):
        case = case_of(kind, seed)
        by = units(case, seed, powers_of_two=True)
        base, scaled = exact_plant(plant_of(case)), exact_plant(plant_of(case, by))
        assert with_answers_of(scaled, base, by).answers is base.answers
        for name in ("A", "B", "C", "D", "Bd", "Dd"):
            if any(getattr(scaled, name).entries()):
                bent = replace(scaled, **{name: getattr(scaled, name) * 3}, answers={})
                assert with_answers_of(bent, base, by).answers is not base.answers
        two = next((i for i in range(scaled.n) if scaled.Bf.ncols() and scaled.Bf[i, 0] != 0), None)
        if two is not None and any(scaled.Df[i, 0] != 0 for i in range(scaled.p)):
            bent = replace(scaled, Bf=scaled.Bf * 3, answers={})  # in the states alone, and not in the outputs
            assert with_answers_of(bent, base, by).answers is not base.answers


@pytest.mark.parametrize("kind", KINDS)
def test_null_spaces_in_the_limit_and_minimal_indices(kind: str) -> None:
    for plant in plants(kind):
        for B, D in columns(plant):
            P = plant.pencil(B, D)
            indices = pencils.left_indices(P)
            missing = P[0].nrows() - pencils.normal_rank(P)
            assert len(indices) == missing
            for s in (0, 1, fmpq(-1, 2)):
                V = pencils.null_space_in_the_limit(P, s)
                assert V.nrows() == missing
                assert is_zero(V * at(P, s))  # a limit of null vectors is one


def test_degrees_add_up_to_the_rank_of_the_pencil() -> None:
    """Left and right minimal indices, finite and infinite zeros fill the rank of ``[P1]`` together."""
    for kind in KINDS:
        for plant in plants(kind, 2):
            P = plant.pencil(plant.Bd, plant.Dd)
            turned = P[0].transpose(), P[1].transpose()
            r = pencils.normal_rank(P)
            reversed_zeros = pencils.zero_polynomial(
                (P[1], P[0])
            )  # infinite zeros are those of the reversed pencil at 0
            infinite = next(k for k in range(reversed_zeros.degree() + 1) if reversed_zeros[k] != 0)
            finite = pencils.zero_polynomial(P).degree()
            assert finite + infinite + sum(pencils.left_indices(P)) + sum(pencils.left_indices(turned)) == r


def test_cases_known_by_hand() -> None:
    # two masses in a chain: the force on the first, the position of the second: no zero; the other way: the same
    A = exact([[fmpq(0), fmpq(1)], [fmpq(-2), fmpq(-3)]])
    none = zeros(2, 0)
    C, b = exact([[fmpq(4), fmpq(1)]]), exact([[fmpq(0)], [fmpq(1)]])
    P = block([[A, b], [C, zeros(1, 1)]]), block([[-identity(2), zeros(2, 1)], [zeros(1, 3)]])
    assert pencils.zero_polynomial(P) == fmpq_poly([4, 1])
    assert none.ncols() == 0
    assert null_space(exact([[fmpq(1), fmpq(2)]])).ncols() == 1


def test_how_often_a_plant_integrates() -> None:
    """Of three chains, of two, one and three states, in other coordinates, beside a pole; with ``E``, sampled too."""
    n = 7
    links = {(0, 1): 1, (3, 4): 1, (4, 5): 2}
    A = fmpq_mat(n, n, [links.get((i, j), -3 if i == j == 6 else 0) for i in range(n) for j in range(n)])
    T = fmpq_mat(n, n, [int(i == j) + int(j == (2 * i + 1) % n) * (i > 2) for i in range(n) for j in range(n)])
    E = fmpq_mat(n, n, [int(i == j) + int(j == i + 1) for i in range(n) for j in range(n)])

    def plant(A: fmpq_mat, E: fmpq_mat, sampled: bool) -> ExactPlant:
        B, C, D = zeros(A.nrows(), 0), zeros(0, A.nrows()), zeros(0, 0)
        return ExactPlant(E, A, B, C, D, B, D, B, D, sampled, plain=False)

    for scaled in (A, T.inv() * A * T):
        assert integrators(plant(scaled, identity(n), sampled=False)) == 6
        assert integrators(plant(scaled + identity(n), identity(n), sampled=True)) == 6
        assert integrators(plant(E * scaled, E, sampled=False)) == 6
        assert integrators(plant(scaled + identity(n), identity(n), sampled=False)) == 0
    singular = exact([[fmpq(1), fmpq(0)], [fmpq(0), fmpq(0)]])
    chain = exact([[fmpq(0), fmpq(0)], [fmpq(0), fmpq(1)]])
    assert integrators(plant(chain, singular, sampled=False)) == 1
