"""The same residual by ranks, subspaces, polynomials and eigenvectors, on generated plants, against exact ranks."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np

import residua as rs
from generated import random_plant
from residua.design.detection_filters.eigenstructure_assignment import eigenstructure_assignment
from residua.errors import AccuracyError, DesignError

#: Ranks of rational matrices are taken modulo this prime, where they are what they are over the rationals unless it
#: divides one of their minors: by chance in one of 1e17 cases.
_PRIME = 2**61 - 1
#: A transformation both ways; with zeros and poles, or, where these are too ill-conditioned, without.
ONE_FILTER = ("identical", "scale", "poles", "transformation")
NOT_MORE = (*ONE_FILTER, "filter", "part")


def generated(seed: int) -> rs.Plant:
    """Return a plant of order 2 to 12 with 1 to 4 inputs, 2 to 5 outputs and 2 to 7 faults; every third one sparse."""
    rng = np.random.default_rng([20, seed])
    plant = _sparse(rng) if seed % 3 == 2 else _dense(rng)
    plant = plant.with_actuator_faults().with_sensor_faults()
    kept = rng.permutation(len(plant.faults))[: int(rng.integers(2, 8))]
    return plant.without_faults([name for i, name in enumerate(plant.faults) if i not in kept])


def _dense(rng: np.random.Generator) -> rs.Plant:
    plant = random_plant(
        rng,
        n=int(rng.integers(2, 13)),
        inputs=int(rng.integers(1, 5)),
        outputs=int(rng.integers(2, 6)),
        faults=int(rng.integers(0, 4)),
        feedthrough=bool(rng.integers(2)),
        dt=float(rng.choice([0.0, 0.1])),
    )
    if rng.random() < 0.35:
        d = rng.standard_normal(plant.n_states), rng.standard_normal(plant.n_outputs) * rng.integers(2)
        plant = plant.with_disturbances({"d": d})
    return plant


def _sparse(rng: np.random.Generator) -> rs.Plant:
    """Return a plant of few whole numbers: a chain, or entries anywhere; sensors on states; dependent columns."""
    n, m, p = int(rng.integers(2, 13)), int(rng.integers(1, 5)), int(rng.integers(2, 6))
    few = np.array([-2, -1, 0, 0, 0, 0, 0, 1, 1, 3])
    if rng.random() < 0.5:
        A = np.diag(rng.choice([-3.0, -2, -1], n)) + np.diag(rng.choice([1.0, 2], n - 1), -1)
        A += np.diag(rng.choice([0.0, 0, 1], n - 1), 1)
    else:
        A = rng.choice(few, (n, n)) * (rng.random((n, n)) < 3 / n) - np.diag(rng.choice([0.0, 1, 2], n))
    sampled = bool(rng.integers(2))
    if sampled:
        A = A / 4.0  # exact, and poles near the circle
    C = np.eye(n)[rng.integers(0, n, p)] if rng.random() < 0.5 else rng.choice(few, (p, n)).astype(float)
    B = np.eye(n)[:, rng.integers(0, n, m)] if rng.random() < 0.5 else rng.choice(few, (n, m)).astype(float)
    D = rng.choice([0, 0, 0, 0, 1], (p, m)) if rng.random() < 0.3 else None
    B[0, ~B.any(axis=0)] = 1.0
    C[~C.any(axis=1), 0] = 1.0
    plant = rs.Plant(A, B, C, D, dt=0.5 if sampled else 0.0)
    if rng.random() < 0.35:
        plant = plant.with_disturbances({"d": np.eye(n)[int(rng.integers(n))]})
    columns = {f"f{i}": rng.choice(few, n) for i in range(int(rng.integers(0, 4)))}
    return plant.with_faults({name: b for name, b in columns.items() if b.any()})


def ignored_sets(plant: rs.Plant, rng: np.random.Generator, most: int) -> list[tuple[str, ...]]:
    """Return sets of faults to ignore: of all sizes up to what counting allows, and one more."""
    beyond = max(plant.n_outputs - len(plant.disturbances), 1)
    sizes = range(min(beyond, len(plant.faults) - 1) + 1)
    chosen: dict[tuple[str, ...], None] = {}
    for k in range(3 * most):
        size = sizes[-1 - k % len(sizes)]
        picked = sorted(rng.permutation(len(plant.faults))[:size].tolist())
        chosen.setdefault(tuple(plant.faults[i] for i in picked))
    return list(chosen)[:most]


# ------------------------------------------------------------------- exact ranks


def _rank(M: list[list[int]]) -> int:
    """Return the rank of a matrix over the whole numbers modulo the prime."""
    M, rank = [list(row) for row in M], 0
    for c in range(len(M[0]) if M else 0):
        pivot = next((i for i in range(rank, len(M)) if M[i][c]), None)
        if pivot is None:
            continue
        M[rank], M[pivot] = M[pivot], M[rank]
        inverse = pow(M[rank][c], -1, _PRIME)
        for i in range(rank + 1, len(M)):
            if M[i][c]:
                factor = M[i][c] * inverse % _PRIME
                M[i] = [(a - factor * b) % _PRIME for a, b in zip(M[i], M[rank], strict=True)]
        rank += 1
    return rank


def _whole(x: float) -> int:
    fraction = Fraction(float(x))
    return fraction.numerator * pow(fraction.denominator, -1, _PRIME) % _PRIME


def visible(plant: rs.Plant, ignored: tuple[str, ...]) -> tuple[str, ...]:
    """Return the faults that some residual sees which ignores a set: ranks of the pencil at one random point, exact."""
    point = 1234567890123456789 % _PRIME
    top = np.hstack([plant.A, plant.Bd, plant.Bf])
    whole = np.vstack([top, np.hstack([plant.C, plant.Dd, plant.Df])])
    M = [[_whole(x) for x in row] for row in whole]
    for i in range(plant.n_states):
        M[i][i] = (M[i][i] - point) % _PRIME
    start = whole.shape[1] - len(plant.faults)
    base = [*range(start), *(start + plant.faults.index(name) for name in ignored)]

    def rank(columns: list[int]) -> int:
        return _rank([[row[j] for j in columns] for row in M])

    least = rank(base)
    others = [name for name in plant.faults if name not in ignored]
    return tuple(name for name in others if rank([*base, start + plant.faults.index(name)]) > least)


# ------------------------------------------------------------------- one row, all methods


@dataclass
class Findings:
    """What the methods said, counted, and where they contradict one another or the exact ranks."""

    counts: Counter[str] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)
    without: list[str] = field(default_factory=list)  # eigenvectors, which need not exist


def compare(plant: rs.Plant, ignored: tuple[str, ...], told: str, out: Findings) -> None:
    """Ask every method for residuals that ignore a set, and compare what they say with the exact ranks."""
    others = tuple(name for name in plant.faults if name not in ignored)
    seen = visible(plant, ignored)
    rows = {others}
    if seen:
        rows.add(seen)  # what is left when the faults that cannot be seen are given up
    for row in rows:
        _one_row(plant, row, row == seen, seen, f"{told}, ignores {'+'.join(ignored) or 'nothing'}", out)


def _one_row(
    plant: rs.Plant, row: tuple[str, ...], exact: bool, seen: tuple[str, ...], told: str, out: Findings
) -> None:
    code = "".join("01"[name in row] for name in plant.faults)
    told = f"{told}, row {code}"
    ignored = tuple(name for name in plant.faults if name not in row)
    out.counts["rows"] += 1
    out.counts["attainable"] += exact
    if bool(rs.coding.attainable(plant, [code]).attainable[0]) != exact:
        out.wrong.append(f"{told}: the pencil ranks say {not exact}")
    bank = _made(lambda: rs.design.structured_bank(plant, [code]).generator, "bank", exact, told, out)
    parity = _made(lambda: rs.design.structured_parity(plant, [code]).generator, "parity", exact, told, out)
    for name, made in (("bank", bank), ("parity", parity)):
        if made is not None and made.codes is not None and made.codes[0].tolist() != [c == "1" for c in code]:
            out.wrong.append(f"{told}: {name} has the code {made.codes[0]}")
    if bank is not None and parity is not None:
        _compared(bank, parity, "parity", told, out)
    for side in ("right", "left"):
        _eigenvectors(plant, side, ignored, exact, bank, told, out)


def _eigenvectors(
    plant: rs.Plant,
    side: str,
    ignored: tuple[str, ...],
    exact: bool,
    bank: rs.design.ResidualGenerator | None,
    told: str,
    out: Findings,
) -> None:
    """Ask for eigenvectors, which need not exist, and never see more."""
    name = f"{side} eigenvectors"
    try:
        made = eigenstructure_assignment(plant, side=side, insensitive_to=ignored)
    except DesignError as error:
        out.without.append(f"{told}: {name}: {error}")
        return
    except AccuracyError as error:
        out.counts[f"{name}: refused for accuracy"] += 1
        out.refused.append(f"{told}: {name}: {error}")
        return
    sees = {fault for fault, answers in zip(plant.faults, made.structure.T, strict=True) if answers.any()}
    can = set(visible(plant, ignored))
    if not sees <= can:
        out.wrong.append(f"{told}: {name} see {sees - can}, which no residual can")
    out.counts[f"{name}: exist"] += 1
    if exact:
        out.counts[f"{name}: exist, row attainable"] += 1
        out.counts[f"{name}: reach the row"] += sees == can
        if side == "right" and sees != can:
            out.wrong.append(f"{told}: {name} are blind to {can - sees}")
    if bank is not None:
        _compared(bank, made, name, told, out)


def _made(
    design: Callable[[], rs.design.ResidualGenerator], name: str, exact: bool, told: str, out: Findings
) -> rs.design.ResidualGenerator | None:
    """Return a design, or nothing when it was refused; what it says about existence must be true."""
    try:
        made = design()
    except AccuracyError as error:
        out.counts[f"{name}: refused for accuracy"] += 1
        out.refused.append(f"{told}: {name}: {error}")
        return None
    except DesignError as error:
        if exact:
            out.wrong.append(f"{told}: {name} says that there is none: {error}")
        return None
    if not exact:
        out.wrong.append(f"{told}: {name} reaches what is not attainable")
        return None
    out.counts[f"{name}: reached"] += 1
    return made


def _compared(
    whole: rs.design.ResidualGenerator, other: rs.design.ResidualGenerator, name: str, told: str, out: Findings
) -> None:
    """The geometric residual holds every other one that ignores the same; a scalar one is any of them, filtered."""
    found = whole.equivalent_to(other)
    scalar = whole.n_residuals == other.n_residuals == 1
    out.counts[f"{name}: {'one residual, ' if scalar else ''}{found.kind}"] += 1
    if found.kind not in (ONE_FILTER if scalar else NOT_MORE):
        out.wrong.append(f"{told}: {name} is {found.kind}, {found.error:.1e}")
