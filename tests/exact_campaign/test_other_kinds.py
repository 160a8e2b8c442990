"""Plants of kinds that the campaign does not have, against exact answers; whole numbers, many in turned coordinates."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import residua as rs
from exact import questions
from exact.plants import exact_plant
from residua.errors import AccuracyError, DesignError, ResiduaError
from residua.plant import Plant

Rng = np.random.Generator


def whole(rng: Rng, low: int, high: int, shape: tuple[int, ...]) -> NDArray[np.float64]:
    return rng.integers(low, high, shape).astype(float)


def turned(rng: Rng, n: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return a matrix of whole numbers whose inverse has whole numbers too, and that inverse."""
    T = np.eye(n)
    for _ in range(2 * n):
        i, j = rng.choice(n, 2, replace=False)
        T[i] += rng.integers(-1, 2) * T[j]
    return T, np.asarray(np.round(np.linalg.inv(T)), dtype=float)


def watched(rng: Rng, A: NDArray, C: NDArray, dt: float | None = None) -> Plant:
    """Return a plant with an input, up to two disturbances, two faults and two sensors that may fail."""
    n, p = len(A), len(C)
    B = whole(rng, -2, 3, (n, 1))
    B[0] += not B.any()
    plant = Plant(A, B, C, dt=float(rng.choice([0.0, 1.0])) if dt is None else dt)
    for i in range(int(rng.integers(0, 3))):
        E, D = whole(rng, -2, 3, (n,)), whole(rng, -1, 2, (p,)) * (rng.random() < 0.3)
        E[0] += not (E.any() or D.any())
        plant = plant.with_disturbances({f"d{i}": (E, D)})
    F = whole(rng, -2, 3, (2, n))
    F[:, 0] += ~F.any(axis=1)
    return plant.with_faults({"f": F[0], "g": F[1]}).with_sensor_faults(list(range(min(p, 2))))


def ring(rng: Rng) -> Plant:
    """States in a ring, each driven by the next."""
    n = int(rng.integers(3, 7))
    A = np.diag(whole(rng, -3, 1, (n,))) + np.roll(np.diag(whole(rng, -2, 3, (n,))), 1, axis=1)
    return watched(rng, A, whole(rng, -1, 2, (int(rng.integers(1, 4)), n)))


def twins(rng: Rng) -> Plant:
    """Two equal parts, of which sensors read the difference, or the difference and the sum."""
    k = int(rng.integers(1, 4))
    A, c = np.kron(np.eye(2), whole(rng, -3, 4, (k, k)) / 4), whole(rng, -2, 3, (1, k))
    T, back = turned(rng, 2 * k)
    C = np.vstack([np.hstack([c, -c]), np.hstack([c, c])])[: int(rng.integers(1, 3))]
    return watched(rng, T @ A @ back, C @ back)


def weakly_coupled(rng: Rng) -> Plant:
    """Couplings of 1 to 2^-18 at random."""
    n = int(rng.integers(3, 7))
    A = whole(rng, -3, 4, (n, n)) * 2.0 ** rng.integers(-18, 1, (n, n)) * (rng.random((n, n)) < 0.6)
    return watched(rng, A, whole(rng, -2, 3, (2, n)) * 2.0 ** rng.integers(-10, 1, (2, n)))


def chains(rng: Rng) -> Plant:
    """Chains of one mode, often on the boundary, in turned coordinates."""
    n = int(rng.integers(3, 7))
    A = float(rng.choice([0, 1, -1, -0.5, 0.5])) * np.eye(n) + np.diag(1.0 * (rng.random(n - 1) < 0.8), -1)
    T, back = turned(rng, n)
    return watched(rng, T @ A @ back, whole(rng, -1, 2, (int(rng.integers(1, 4)), n)) @ back)


def compartments(rng: Rng) -> Plant:
    """Flows between compartments that lose nothing: a mode at 0."""
    n = int(rng.integers(3, 7))
    A = whole(rng, 0, 3, (n, n)) * (rng.random((n, n)) < 0.5)
    np.fill_diagonal(A, 0)
    return watched(rng, (A - np.diag(A.sum(axis=0))) / 2, whole(rng, 0, 2, (2, n)), dt=0.0)


def mixing(rng: Rng) -> Plant:
    """Rows that sum to one, sampled: a mode at 1."""
    n = int(rng.integers(3, 6))
    A = whole(rng, 0, 4, (n, n))
    A[:, 0] += A.sum(axis=1) == 0
    size = 2.0 ** np.ceil(np.log2(A.sum(axis=1)))
    A[:, 0] += size - A.sum(axis=1)
    return watched(rng, A / size[:, None], whole(rng, 0, 2, (2, n)), dt=1.0)


def without_loss(rng: Rng) -> Plant:
    """Skew symmetric: all modes on the imaginary axis."""
    n = int(rng.choice([2, 4, 6]))
    M = whole(rng, -2, 3, (n, n))
    return watched(rng, M - M.T, whole(rng, -1, 2, (2, n)), dt=0.0)


def moving_averages(rng: Rng) -> Plant:
    n = int(rng.integers(2, 7))
    return watched(rng, np.eye(n, k=-1) * whole(rng, 1, 4, (n,)), whole(rng, -1, 2, (2, n)), dt=1.0)


def of_rank_one(rng: Rng) -> Plant:
    """A matrix of rank one beside a multiple of the identity."""
    n = int(rng.integers(3, 7))
    A = whole(rng, -2, 3, (n, 1)) @ whole(rng, -2, 3, (1, n)) / 4 - np.eye(n) * float(rng.choice([0, 1]))
    return watched(rng, A, whole(rng, -1, 2, (int(rng.integers(1, 4)), n)))


def slow_and_fast(rng: Rng) -> Plant:
    """Triangular, with rates over seven decades."""
    n = int(rng.integers(3, 7))
    above = np.triu(whole(rng, -2, 3, (n, n)) * (rng.random((n, n)) < 0.4), 1) * 2.0 ** rng.integers(-12, 1)
    return watched(rng, np.diag(-(2.0 ** rng.integers(-16, 7, n))) + above, whole(rng, -2, 3, (2, n)), dt=0.0)


OTHERS: Mapping[str, Callable[[Rng], Plant]] = {
    made.__name__: made
    for made in (
        *(ring, twins, weakly_coupled, chains, compartments, mixing),
        *(without_loss, moving_averages, of_rank_one, slow_and_fast),
    )
}


def in_other_units(plant: Plant, rng: Rng) -> Plant:
    """Return a plant in units by powers of two, of time too if it is continuous."""

    def powers(count: int) -> NDArray[np.float64]:
        return np.asarray(2.0 ** rng.integers(-20, 21, count), dtype=float)

    x, y, time = powers(plant.n_states), powers(plant.n_outputs)[:, None], 1.0 if plant.dt else float(powers(1)[0])
    changes = {"A": time * plant.A / x[:, None] * x, "C": y * plant.C * x}
    for role in ("", "d", "f"):
        B, D = getattr(plant, f"B{role}"), getattr(plant, f"D{role}")
        units = powers(B.shape[1])
        changes |= {f"B{role}": time * B / x[:, None] * units, f"D{role}": y * D * units}
    return plant._with(**changes)


def answered(plant: Plant) -> dict[str, Any]:
    """Return what the package answers to questions about a plant."""
    found, made = rs.diagnosability(plant), rs.analysis.unknown_input_observer_existence(plant)
    seen = rs.linear.detectability(plant.A, plant.C, dt=plant.dt)
    zeros = {
        role: rs.linear.invariant_zeros(plant.A, B, plant.C, D)
        for role, B, D in (("u", plant.B, plant.D), ("d", plant.Bd, plant.Dd))
    }
    return {
        "detectable faults": found.detectable.tolist(),
        "isolable": found.isolable.tolist(),
        "constant": found.strongly_detectable.tolist(),
        "isolable, constant": found.strongly_isolable.tolist(),
        "observer": bool(made),
        "detectability": (bool(seen), len(seen.unobservable_modes)),
        "zeros": {role: (len(one.zeros), plant.n_states + one.normal_rank) for role, one in zeros.items()},
        "attainable": sorted(rs.coding.attainable(plant).digits),
        "attainable, constant": sorted(rs.coding.attainable(plant, constant=True).digits),
    }


def exactly(plant: Plant) -> dict[str, Any]:
    """Return the same in rational numbers."""
    x = exact_plant(plant)
    zeros = {role: questions.zeros_from(x, role) for role in "ud"}
    rows = [row for row in itertools.product((False, True), repeat=x.faults) if any(row)]

    def attainable(constant: bool) -> list[str]:
        ask = partial(questions.attainable, x, constant=constant)
        return sorted("".join("01"[one] for one in row) for row in rows if ask(row))

    return {
        "detectable faults": questions.visible(x),
        "isolable": questions.isolable(x),
        "constant": questions.lasting(x),
        "isolable, constant": questions.lasting_isolable(x),
        "observer": all(questions.unknown_input_observer(x)),
        "detectability": (questions.detectable(x), max(questions.hidden_polynomial(x).degree(), 0)),
        "zeros": {role: (max(P.degree(), 0), rank) for role, (P, rank) in zeros.items()},
        "attainable": attainable(False),
        "attainable, constant": attainable(True),
    }


def designed(plant: Plant, wanted: Mapping[str, Any]) -> list[str]:
    """Return which designs contradict the exact answers; a design may miss its own accuracy, and says so."""

    def made(design: Callable[[], Any]) -> Any:
        try:
            return design()
        except AccuracyError:
            return "missed"
        except DesignError:
            return None

    wrong = []
    observer = made(lambda: rs.design.unknown_input_observer(plant))
    if observer != "missed" and (observer is not None) != wanted["observer"]:
        wrong.append("unknown input observer")
    for j, name in enumerate(plant.faults):
        answers = [row[j] for row in wanted["isolable"]]
        found = made(lambda name=name: rs.design.decoupled_residual(plant, insensitive_to=name))
        seen = [False] * len(answers) if found is None else found if found == "missed" else found.structure.any(axis=0)
        if found != "missed" and list(seen) != answers:
            wrong.append(f"residual without {name}")
    for row in wanted["attainable"][:2]:
        bank = made(lambda row=row: rs.design.structured_bank(plant, [row]))
        if bank != "missed" and (bank is None or bank.structure[0].tolist() != [one == "1" for one in row]):
            wrong.append(f"bank of {row}")
    return wrong


def compared(kind: str, seed: int) -> list[str]:
    """Return what is wrong of one plant, or other in other units."""
    rng = np.random.default_rng([seed, list(OTHERS).index(kind)])
    plant = OTHERS[kind](rng)
    wanted, out = exactly(plant), []
    for units, one in (("base", plant), ("other", in_other_units(plant, rng))):
        try:
            found = answered(one)
        except ResiduaError as error:
            out.append(f"{units} units: {type(error).__name__}: {str(error)[:80]}")
            continue
        out += [
            f"{name} in {units} units: {found[name]}, exactly {wanted[name]}"
            for name in found
            if found[name] != wanted[name]
        ]
    return out + designed(plant, wanted)


@pytest.mark.parametrize("kind", OTHERS)
def test_answers_about_other_kinds_of_plants_are_the_exact_ones(kind: str) -> None:
    assert {seed: wrong for seed in range(5) if (wrong := compared(kind, seed))} == {}


@pytest.mark.campaign
@pytest.mark.parametrize("kind", OTHERS)
def test_answers_about_many_plants_of_other_kinds_are_the_exact_ones(kind: str) -> None:
    assert {seed: wrong for seed in range(5, 200) if (wrong := compared(kind, seed))} == {}
