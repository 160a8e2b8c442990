"""Which rows are attainable: against the known lists, exact arithmetic, and the designs that reach them."""

from __future__ import annotations

from fractions import Fraction
from itertools import product

import numpy as np
import pytest

import residua as rs
from effort import cases
from generated import random_plant, singular_plant
from refusals import Refused
from residua.analysis.coding import attainable, mutually_isolable
from residua.errors import AccuracyError, DesignError


def yuan() -> rs.Plant:
    A = np.diag([-1.0, -2, -2, -2]) + np.diag(np.ones(3), 1) + np.diag(np.ones(3), -1)
    leaks, blocks = np.eye(4), np.zeros((4, 4))
    for column, (high, low) in enumerate(((0, 1), (1, 2), (2, 3))):
        blocks[high, column], blocks[low, column] = 1, -1
    blocks[3, 3] = 1
    Bf = np.hstack([leaks, blocks])
    return rs.Plant(A, np.eye(4)[:, :1], np.eye(4)[[0, 2, 3]]).with_faults({f"f{i + 1}": Bf[:, i] for i in range(8)})


def all_rows(plant: rs.Plant) -> list[str]:
    return [row for row in map("".join, product("01", repeat=len(plant.faults))) if "1" in row]


def exact_rank(M: list[list[Fraction]]) -> int:
    """Return the rank by elimination in rational arithmetic."""
    M, rank = [list(row) for row in M], 0
    for c in range(len(M[0]) if M else 0):
        pivot = next((i for i in range(rank, len(M)) if M[i][c]), None)
        if pivot is None:
            continue
        M[rank], M[pivot] = M[pivot], M[rank]
        for i in range(rank + 1, len(M)):
            if M[i][c]:
                factor = M[i][c] / M[rank][c]
                M[i] = [a - factor * b for a, b in zip(M[i], M[rank], strict=True)]
        rank += 1
    return rank


def exactly(plant: rs.Plant, row: str) -> bool:
    """Tell whether a row is attainable: the pencil at one rational point, the model as its numbers are."""
    s, n = Fraction(1234567, 987654), plant.n_states
    E = np.eye(n) if plant.E is None else plant.E
    fraction = np.vectorize(Fraction, otypes=[object])
    top = np.hstack([fraction(plant.A) - s * fraction(E), fraction(plant.Bd), fraction(plant.Bf)])
    pencil = np.vstack([top, np.hstack([fraction(M) for M in (plant.C, plant.Dd, plant.Df)])])
    start = pencil.shape[1] - len(row)
    base = [*range(start), *(start + j for j, digit in enumerate(row) if digit == "0")]
    rank = exact_rank(pencil[:, base].tolist())
    ones = (start + j for j, digit in enumerate(row) if digit == "1")
    return all(exact_rank(pencil[:, [*base, j]].tolist()) > rank for j in ones)


def whole_numbers(rng: np.random.Generator) -> rs.Plant:
    """Return a small plant of few whole numbers: columns are often dependent, poles and zeros anywhere."""
    n, p = int(rng.integers(1, 5)), int(rng.integers(1, 4))
    few = [-2, -1, 0, 0, 0, 0, 1, 1, 3]
    A, B, C = (rng.choice(few, shape) for shape in ((n, n), (n, 2), (p, n)))
    plant = rs.Plant(A, B, C, dt=float(rng.choice([0, 1])))
    if rng.random() < 0.4:
        plant = plant.with_disturbances(
            {"d": (rng.choice([1, 0, 2], n) | (np.arange(n) == 0), rng.choice([0, 0, 1], p))}
        )
    directions = {f"f{i}": (rng.choice(few, n), rng.choice([0, 0, 0, 1], p)) for i in range(4)}
    directions = {name: (b, d) for name, (b, d) in directions.items() if b.any() or d.any()}
    return plant.with_faults(directions)


def tame(rng: np.random.Generator) -> rs.Plant:
    plant = random_plant(
        rng,
        n=int(rng.integers(2, 13)),
        inputs=int(rng.integers(1, 5)),
        outputs=int(rng.integers(2, 6)),
        disturbances=int(rng.random() < 0.3),
        faults=int(rng.integers(0, 3)),
        feedthrough=bool(rng.integers(2)),
        dt=float(rng.choice([0.0, 0.1])),
    )
    plant = plant.with_actuator_faults().with_sensor_faults()
    kept = rng.permutation(len(plant.faults))[: int(rng.integers(2, 6))]
    return plant.without_faults([name for i, name in enumerate(plant.faults) if i not in kept])


def test_v9_the_rows_of_gertlers_example() -> None:
    assert set(attainable(rs.library.gertler(sensor_faults=True)).digits) == {"0111", "1011", "1101", "1110", "1111"}


def test_v9_the_rows_of_yuans_example() -> None:
    plant = yuan()
    every = set(attainable(plant).digits)
    assert len(every) == 18
    assert every == set(attainable(plant, all_rows(plant)).digits)
    assert every == {row for row in all_rows(plant) if exactly(plant, row)}


@pytest.mark.parametrize("seed", range(120))
def test_whole_numbers_against_exact_arithmetic(seed: int) -> None:
    plant = whole_numbers(np.random.default_rng(seed))
    rows = all_rows(plant)
    exact = {row for row in rows if exactly(plant, row)}
    assert set(attainable(plant).digits) == exact
    assert set(attainable(plant, rows).digits) == exact


@pytest.mark.parametrize("seed", cases(range(110), 20))
def test_a_bank_reaches_just_these(seed: int) -> None:
    """Ranks of the pencil against subspaces, on generated plants of orders 2 to 12, both kinds of time."""
    rng = np.random.default_rng(seed)
    plant = tame(rng)
    rows = all_rows(plant)
    every = set(attainable(plant).digits)
    found = attainable(plant, rows)
    assert set(found.digits) == every
    assert set(found.reasons) == {name for name, row in zip(found.residuals, rows, strict=True) if row not in every}
    bank_rows = rows if len(rows) <= 15 else list(rng.permutation(rows)[:12])
    for row in bank_rows:
        try:
            reached = rs.design.structured_bank(plant, [str(row)]).structure[0]
        except DesignError:
            assert row not in every
        else:
            assert row in every
            assert "".join("01"[int(one)] for one in reached) == row


@pytest.mark.parametrize("seed", cases(range(15), 8))
@pytest.mark.refusals(at_most=0)
def test_singular_plants(seed: int, refused: Refused) -> None:
    rng = np.random.default_rng(seed)
    plant = singular_plant(rng, n=int(rng.integers(2, 5)), disturbances=int(rng.integers(0, 2)))
    plant = plant.without_faults([name for i, name in enumerate(plant.faults) if i >= 4])
    for row in all_rows(plant):
        expected = exactly(plant, row)
        assert bool(attainable(plant, [row])) == expected
        try:
            rs.design.structured_bank(plant, [row])
        except DesignError:
            assert not expected
        except AccuracyError as error:
            refused(error)  # says that it cannot be computed, not that it does not exist
        else:
            assert expected


@pytest.mark.parametrize("seed", range(20))
def test_units_make_no_difference(seed: int) -> None:
    rng = np.random.default_rng(seed)
    plant = tame(rng)
    x, y, f = (10.0 ** rng.uniform(-4, 4, k) for k in (plant.n_states, plant.n_outputs, len(plant.faults)))
    scaled = plant._with(
        A=plant.A / x[:, None] * x,
        C=plant.C * y[:, None] * x,
        **{f"B{role}": getattr(plant, f"B{role}") / x[:, None] for role in ("", "d", "w")},
        **{f"D{role}": getattr(plant, f"D{role}") * y[:, None] for role in ("", "d", "w")},
        Bf=plant.Bf / x[:, None] * f,
        Df=plant.Df * y[:, None] * f,
    )
    assert attainable(scaled).digits == attainable(plant).digits


@pytest.mark.parametrize("seed", range(40))
@pytest.mark.refusals(at_most=0)
def test_constant_faults_are_seen_for_good(seed: int, refused: Refused) -> None:
    """What a residual still shows of a constant fault is its gain at zero frequency."""
    rng = np.random.default_rng(seed)
    plant = whole_numbers(rng)
    limit = np.array([1.0 + 0j if plant.is_discrete else 0j])
    for row in attainable(plant).digits:
        try:
            bank = rs.design.structured_bank(plant, [row])
        except (AccuracyError, DesignError) as error:
            refused(error)
            continue  # whether it exists is decided in exact arithmetic above
        generator = bank.generator
        gain = np.abs(generator.internal_form().evaluate(limit)[0, :, : len(plant.faults)]).max(axis=0)
        at = np.abs(generator.internal_form().evaluate(limit * np.exp(0.3j) + 0.1j)[0, :, : len(plant.faults)])
        lasting = gain > 1e-7 * at.max()
        ones = np.array([digit == "1" for digit in row])
        assert bool(attainable(plant, [row], constant=True)) == bool(lasting[ones].all()), row


def test_reasons_name_who_hides_whom() -> None:
    plant = rs.Plant(-np.eye(3), np.eye(3)[:, :1], np.eye(3)).with_faults(
        {"a": [1, 0, 0], "b": [0, 1, 0], "c": [1, 1, 0], "a2": [2, 0, 0], "e": [0, 0, 1]}
    )
    found = attainable(plant, {"x": ["c", "e"], "y": ["a", "e"], "z": ["e"], "w": ["b", "a2", "c", "a"], "v": ["a"]})
    assert found.reasons["x"] == "a residual that ignores a, b cannot see c: together they can imitate it"
    assert found.reasons["y"] == "a residual that ignores a2 cannot see a: they span the same direction"
    assert "z" not in found.reasons
    assert "w" not in found.reasons
    assert found.reasons["v"] == "a residual that ignores b, c, a2, e sees nothing: all measurements are used up"
    twin = attainable(plant, {"t": ["a", "b", "c", "e"]})
    assert twin.reasons["t"] == "a residual that ignores a2 cannot see a: they span the same direction"


def test_columns_through_state_and_output_at_once() -> None:
    """``a`` and ``b`` have the transfer functions ((s+2)/(s+1), 1) and (1, (s+1)/(s+2)), which are parallel."""
    plant = rs.Plant(np.diag([-1.0, -2]), [[1], [0]], np.eye(2))
    plant = plant.with_faults({"a": ([1, 0], [1, 1]), "b": ([0, -1], [1, 1])})
    assert attainable(plant).digits == ("11",)
    assert mutually_isolable(plant).groups == (("a", "b"),)
    passing = rs.Plant([[-1.0]], [[1.0]], [[1.0]]).with_faults({"a": ([1], [-1])})  # -s/(s+1)
    assert attainable(passing).digits == ("1",)
    assert attainable(passing, constant=True).digits == ()
    assert "a constant a leaves no lasting trace" in attainable(passing, ["1"], constant=True).reasons["r1"]


def test_what_the_disturbances_hide() -> None:
    plant = rs.Plant(-np.eye(2), [[1], [0]], np.eye(2)).with_disturbances({"d": [1, 0]})
    plant = plant.with_faults({"a": [3, 0], "b": [0, 1]})
    found = attainable(plant, ["10", "01"])
    assert found.attainable.tolist() == [False, True]
    assert found.reasons["r1"].startswith("a residual that ignores b sees nothing")
    assert attainable(plant, ["11"]).reasons["r1"] == "no residual that ignores the disturbances sees a"
    assert attainable(plant).digits == ("01",)


def test_too_many_rows_are_told() -> None:
    plant = random_plant(np.random.default_rng(0), n=6, outputs=5, faults=8, sensors=True)
    with pytest.raises(DesignError, match="more than 100 rows"):
        attainable(plant, most=100)


@pytest.mark.parametrize("seed", range(60))
def test_mutual_isolability_is_about_attainable_rows(seed: int) -> None:
    """A pair is mutually isolable exactly when a row ignores the one and sees the other, either way."""
    plant = whole_numbers(np.random.default_rng(500 + seed))
    found = mutually_isolable(plant)
    rows = attainable(plant).coding_set.structure
    one = (rows[:, :, None] & ~rows[:, None, :]).any(axis=0)
    np.testing.assert_array_equal(found.matrix, one & one.T)
    assert {name for group in found.groups for name in group} == {
        name for j, name in enumerate(plant.faults) if rows[:, j].any()
    }
    for group in found.groups:
        for name in group if len(group) > 1 else ():
            assert all(other in found.reasons[name] for other in group if other != name)
