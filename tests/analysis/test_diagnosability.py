"""What can be told before any design, against independent rank computations and simulated filters."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

import residua as rs
from generated import random_plant
from refusals import Refused
from residua.errors import DesignError, ModelError


def exact_rank(M: list[list[Fraction]]) -> int:
    """Return the rank of a rational matrix by elimination."""
    rows, rank = [row[:] for row in M], 0
    for column in range(len(rows[0]) if rows else 0):
        pivot = next((i for i in range(rank, len(rows)) if rows[i][column] != 0), None)
        if pivot is None:
            continue
        rows[rank], rows[pivot] = rows[pivot], rows[rank]
        for i in range(rank + 1, len(rows)):
            if rows[i][column] != 0:
                factor = rows[i][column] / rows[rank][column]
                rows[i] = [a - factor * b for a, b in zip(rows[i], rows[rank], strict=True)]
        rank += 1
    return rank


def exact_pencil_rank(plant: rs.Plant, faults: list[int], s: Fraction) -> int:
    """Return the rank of [sI - A, Bd, bf; C, Dd, df] in exact arithmetic (integer matrices)."""
    A, C = plant.A, plant.C
    n = len(A)
    left = np.vstack([plant.Bd, plant.Dd])
    right = np.vstack([plant.Bf, plant.Df])[:, faults]
    rows = []
    for i in range(n + len(C)):
        first = (
            [(s if i == j else Fraction(0)) - Fraction(int(A[i, j])) for j in range(n)]
            if i < n
            else [Fraction(int(x)) for x in C[i - n]]
        )
        rows.append(first + [Fraction(int(x)) for x in (*left[i], *right[i])])
    return exact_rank(rows)


def integer_plant(rng: np.random.Generator) -> rs.Plant:
    n, p, q = int(rng.integers(1, 6)), int(rng.integers(1, 4)), int(rng.integers(0, 3))
    plant = rs.Plant(rng.integers(-3, 4, (n, n)), rng.integers(-2, 3, (n, 1)), rng.integers(-1, 2, (p, n)))
    if q:
        E = rng.integers(-1, 2, (n, q)).astype(float)
        keep = [j for j in range(q) if E[:, j].any()]
        keep = keep[: np.linalg.matrix_rank(E[:, keep])] if keep else []
        if keep and np.linalg.matrix_rank(E[:, keep]) == len(keep):
            plant = plant.with_disturbances(E[:, keep])
    plant = plant.with_sensor_faults()
    first = np.eye(n, dtype=int)[0] * 3
    return plant.with_faults({f"f{i}": rng.integers(-1, 2, n) + first for i in range(3)})


@pytest.mark.parametrize("seed", range(60))
def test_against_exact_arithmetic(seed: int) -> None:
    plant = integer_plant(np.random.default_rng(seed))
    found = rs.diagnosability(plant)
    s = Fraction(7919, 613)  # no eigenvalue or zero of a small integer matrix
    base = exact_pencil_rank(plant, [], s)
    alone = [exact_pencil_rank(plant, [i], s) for i in range(len(plant.faults))]
    for i in range(len(plant.faults)):
        assert found.detectable[i] == (alone[i] > base)
        for j in range(len(plant.faults)):
            expected = i != j and exact_pencil_rank(plant, [i, j], s) > alone[j]
            assert found.isolable[i, j] == expected


@pytest.mark.parametrize("seed", range(60))
@pytest.mark.refusals(at_most=2)
def test_constant_faults_against_exact_arithmetic_where_zero_is_no_zero(seed: int, refused: Refused) -> None:
    plant = integer_plant(np.random.default_rng(1000 + seed))
    if exact_pencil_rank(plant, [], Fraction(0)) < exact_pencil_rank(plant, [], Fraction(7919, 613)):
        refused.skip("s = 0 is a zero of this plant: the limit counts there")
    found = rs.diagnosability(plant)
    base = exact_pencil_rank(plant, [], Fraction(0))
    for i in range(len(plant.faults)):
        strong = found.detectable[i] and exact_pencil_rank(plant, [i], Fraction(0)) > base
        assert found.strongly_detectable[i] == strong


@pytest.mark.parametrize("seed", range(40))
@pytest.mark.refusals(at_most=0)
def test_what_is_said_to_be_detectable_an_observer_sees(seed: int, refused: Refused) -> None:
    """Independent of the pencil: the steady and the moving response of an unknown input observer's residual."""
    rng = np.random.default_rng(2000 + seed)
    plant = random_plant(rng, n=5, disturbances=1, faults=2, sensors=True)
    found = rs.diagnosability(plant)
    assert found.unknown_input_observer is not None
    if not found.unknown_input_observer:
        refused.skip(found.unknown_input_observer)
    try:
        generator = rs.design.unknown_input_observer(plant).residual_generator()
    except DesignError as error:
        refused.skip(error)
    for i, name in enumerate(plant.faults):
        assert found.detectable[i] == (generator.subspaces[name].shape[1] > 0)
        assert found.strongly_detectable[i] == bool(np.any(generator.steady_directions[name]))


def test_an_integrator_hides_the_bias_of_its_sensor() -> None:
    plant = rs.Plant([[0, 1], [0, 0]], [[0], [1]], np.eye(2), outputs=["position", "speed"]).with_sensor_faults()
    found = rs.diagnosability(plant)
    assert found.detectable.tolist() == [True, True]
    assert found.strongly_detectable.tolist() == [False, True]
    assert "only its changes" in found.reasons()["position sensor"]


def test_the_limit_counts_where_the_plant_has_a_zero_at_zero() -> None:
    """d reaches y through s / (s + 1)^2: at s = 0 alone it is invisible, yet no filter can use that."""
    A, C = [[-2, -1], [1, 0]], [[1, 0]]
    plant = rs.Plant(A, np.zeros((2, 0)), C).with_disturbances([[1], [0]]).with_faults({"f": [0, 1]})
    found = rs.diagnosability(plant)
    assert not found.detectable[0]
    assert not found.strongly_detectable[0]


def test_groups_and_their_reasons_print() -> None:
    plant = rs.library.three_tank()
    text = str(rs.diagnosability(plant))
    assert "three" in text.lower()
    groups = {frozenset(group) for group in rs.diagnosability(plant).groups if len(group) > 1}
    assert len(groups) == 2, "each pump cannot be told from a leak of its tank"
    assert all(any("actuator" in name for name in group) for group in groups)


def test_descriptor_plants_are_analysed_too() -> None:
    E = np.diag([1.0, 0])
    plant = rs.Plant([[-1, 1], [1, -1]], [[1], [0]], np.eye(2), E=E).with_sensor_faults().with_faults({"f": [0, 1]})
    found = rs.diagnosability(plant)
    assert found.detectable.all()
    assert found.unknown_input_observer


@pytest.mark.parametrize("unit", [1.0, 1e-13])
def test_an_equation_in_another_unit_changes_no_answer_about_observers(unit: float) -> None:
    plant = rs.Plant([[-1, 0], [unit, -2 * unit]], [[1], [0]], np.eye(2), E=np.diag([1.0, unit]))
    found = rs.diagnosability(plant.with_sensor_faults().with_disturbances({"d": [1, 0]}))
    assert found.unknown_input_observer.exists
    assert "an unknown input observer exists" in str(found)


def test_singular_pencils_and_plants_without_faults_are_refused() -> None:
    with pytest.raises(ModelError, match=r"det\(sE - A\)"):
        rs.diagnosability(rs.Plant([[0, 0], [0, -1]], [[1], [1]], np.eye(2), E=np.diag([0, 1.0])).with_sensor_faults())
    with pytest.raises(ModelError, match="no faults"):
        rs.diagnosability(rs.library.gertler().without_faults())


@pytest.mark.parametrize("units", [1e-6, 1e6])
def test_units_do_not_matter(units: float) -> None:
    rng = np.random.default_rng(0)
    plant = random_plant(rng, n=4, disturbances=1, faults=3, sensors=True, outputs=3)
    T = np.array([1, units, 1, 1 / units])
    other = (
        rs.Plant(plant.A * T[:, None] / T, plant.B * T[:, None], plant.C / T, dt=plant.dt)
        .with_disturbances(plant.Bd * T[:, None])
        .with_faults({name: plant.Bf[:, i] * T for i, name in enumerate(plant.faults) if name.startswith("f")})
        .with_sensor_faults()
    )
    a, b = rs.diagnosability(plant), rs.diagnosability(other)
    assert a.detectable.tolist() == b.detectable.tolist()
    assert np.array_equal(a.isolable, b.isolable)


def test_a_fault_in_state_and_output_is_seen_with_the_right_sign() -> None:
    """From the fault to the output -s / (s + 1): nothing of it lasts."""
    plant = rs.Plant([[-1]], [[1]], [[1]]).with_faults({"a": ([1], [-1])})
    result = rs.diagnosability(plant)
    assert result.detectable.tolist() == [True]
    assert result.strongly_detectable.tolist() == [False]


def test_faults_with_parallel_transfer_functions_cannot_be_told_apart() -> None:
    plant = rs.Plant(np.diag([-1.0, -2.0]), [[1], [1]], np.eye(2))
    plant = plant.with_faults({"a": ([1, 0], [1, 1]), "b": ([0, -1], [1, 1])})  # (s + 2, s + 1) over each of the poles
    assert not rs.diagnosability(plant).isolable.any()
    for row in ("10", "01"):
        with pytest.raises(DesignError):
            rs.design.structured_bank(plant, [row])


@pytest.mark.parametrize("seed", range(20))
def test_an_integrator_in_any_coordinates_hides_nothing(seed: int) -> None:
    """A pole at zero comes out as rounding of some size, which says nothing about where the pencil is looked at."""
    Q = np.linalg.qr(np.random.default_rng(seed).standard_normal((2, 2)))[0]
    A, B, C = Q @ np.diag([0.0, -1.0]) @ Q.T, Q @ np.array([[1.0], [1.0]]), np.array([[1.0, 0], [0, 1]]) @ Q.T
    plant = rs.Plant(A, B, C[1:]).with_faults({"f": (-Q @ np.array([0.0, 1.0]), [1.0])})  # s / (s + 1)
    assert rs.diagnosability(plant).detectable.all()
    assert rs.coding.attainable(plant, ["1"]).attainable.all()
