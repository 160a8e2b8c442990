"""What observers and residuals a plant admits: exact answers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import wraps
from typing import TypeVar

from flint import fmpq_mat, fmpq_poly

from exact.matrices import block, identity, is_zero, part, rank, rank_modulo, zeros
from exact.pencils import generic_values, left_indices, normal_rank, null_space_in_the_limit, zero_polynomial
from exact.plants import ExactPlant
from exact.stability import is_stable

T = TypeVar("T")


def once(question: Callable[..., T]) -> Callable[..., T]:
    """Answer each question about a plant once."""

    @wraps(question)
    def asked(plant: ExactPlant, *sets: Sequence[int], **options: bool) -> T:
        key = question.__name__, *map(tuple, sets), *sorted(options.items())
        if key not in plant.answers:
            plant.answers[key] = question(plant, *sets, **options)
        return plant.answers[key]

    return asked


def generic_rank(plant: ExactPlant, ignored: Iterable[int] = ()) -> int:
    """Return the normal rank of the pencil with the columns of the disturbances and of some faults."""
    key = "generic rank", tuple(sorted(set(ignored)))
    if key not in plant.answers:
        kept = [*range(plant.n + plant.Bd.ncols()), *(plant.n + plant.Bd.ncols() + i for i in key[1])]
        plant.answers[key] = max(
            rank_modulo([[row[j] for j in kept] for row in values]) for values in _generic_values(plant)
        )
    return plant.answers[key]


@once
def _generic_values(plant: ExactPlant) -> list[list[list[int]]]:
    """Return the pencil with all disturbances and faults at two points, modulo a prime."""
    return generic_values(plant.pencil(*plant.ignoring(range(plant.faults))))


@once
def zeros_from(plant: ExactPlant, inputs: str) -> tuple[fmpq_poly, int]:
    """Return the zero polynomial and the normal rank from controls, disturbances, these with faults, or no inputs."""
    columns = {
        "u": (plant.B, plant.D),
        "d": (plant.Bd, plant.Dd),
        "f": plant.ignoring(range(plant.faults)),
        "none": (zeros(plant.n, 0), zeros(plant.p, 0)),
    }[inputs]
    P = plant.pencil(*columns)
    return zero_polynomial(P), normal_rank(P)


@once
def hidden_polynomial(plant: ExactPlant) -> fmpq_poly:
    """Return the polynomial of the modes that no output sees."""
    return zero_polynomial(plant.pencil(zeros(plant.n, 0), zeros(plant.p, 0)))


def detectable(plant: ExactPlant) -> bool:
    """Tell whether every hidden mode dies out."""
    return is_stable(hidden_polynomial(plant), plant.sampled)


@once
def fixed_polynomial(plant: ExactPlant, ignored: Sequence[int] = ()) -> fmpq_poly:
    """Return the polynomial of the zeros from the disturbances to the outputs."""
    return zero_polynomial(plant.pencil(*plant.ignoring(ignored)))


@once
def proper_estimate(plant: ExactPlant, ignored: Sequence[int] = ()) -> bool:
    """Tell whether the state is had from the outputs without differentiating anything twice (condition i).

    Solvability of ``X0 E = 0, X0 B = Y0 D, X1 E - X0 A + Y0 C = I, X1 B = Y1 D``.
    """
    B, D = plant.ignoring(ignored)
    n, p, q = plant.n, plant.p, B.ncols()
    M = block(
        [
            [plant.E, -B, -plant.A, zeros(n, q)],
            [zeros(n, n), zeros(n, q), plant.E, -B],
            [zeros(p, n), D, plant.C, zeros(p, q)],
            [zeros(p, n), zeros(p, q), zeros(p, n), D],
        ]
    )
    wanted = block([[zeros(n, n), zeros(n, q), identity(n), zeros(n, q)]])
    return rank(M) == rank(block([[M], [wanted]]))


def proper_estimate_by_ranks(plant: ExactPlant, ignored: Sequence[int] = ()) -> bool:
    """Tell the same by Hautus's rank condition; for ``E = I`` only."""
    B, D = plant.ignoring(ignored)
    q = B.ncols()
    M = block([[plant.C * B, D], [D, zeros(plant.p, q)]])
    return rank(M) == rank(D) + rank(block([[B], [D]]))


@once
def unknown_input_observer(plant: ExactPlant, ignored: Sequence[int] = ()) -> tuple[bool, bool]:
    """Return conditions (i) and (ii): a proper estimate exists; it can be stable."""
    B, D = plant.ignoring(ignored)
    if not proper_estimate(plant, ignored):
        return False, False
    full = generic_rank(plant, ignored) == plant.n + rank(block([[B], [D]]))
    return True, full and is_stable(fixed_polynomial(plant, ignored), plant.sampled)


@once
def residual_indices(plant: ExactPlant, ignored: Sequence[int] = ()) -> list[int]:
    """Return the orders of a minimal basis of the residuals that ignore disturbances and faults."""
    return left_indices(plant.pencil(*plant.ignoring(ignored)))


def residual_exists(plant: ExactPlant, ignored: Sequence[int] = ()) -> bool:
    """Tell whether any residual ignores disturbances and faults."""
    return plant.n + plant.p > generic_rank(plant, ignored)


def visible(plant: ExactPlant, ignored: Sequence[int] = ()) -> list[bool]:
    """Tell which faults some residual sees that ignores others."""
    least = generic_rank(plant, ignored)
    ranks = (generic_rank(plant, [*ignored, i]) for i in range(plant.faults))
    return [i not in ignored and r > least for i, r in enumerate(ranks)]


def lasting_columns(plant: ExactPlant, ignored: Sequence[int] = ()) -> fmpq_mat:
    """Return what all residuals that ignore some settle to, for a constant fault of each kind: one column each."""
    V = null_space_in_the_limit(plant.pencil(*plant.ignoring(ignored)), 1 if plant.sampled else 0)
    return V * block([[plant.Bf], [plant.Df]])


@once
def lasting(plant: ExactPlant, ignored: Sequence[int] = ()) -> list[bool]:
    """Tell which faults leave a lasting trace while constant, in residuals that ignore others whatever they do."""
    columns = lasting_columns(plant, ignored)
    return [not is_zero(part(columns, columns=[i])) for i in range(plant.faults)]


def isolable(plant: ExactPlant) -> list[list[bool]]:
    """Return ``[i][j]``: some residual sees fault ``i`` and ignores fault ``j``."""
    by_ignored = [visible(plant, [j]) for j in range(plant.faults)]
    return [[i != j and by_ignored[j][i] for j in range(plant.faults)] for i in range(plant.faults)]


@once
def lasting_isolable(plant: ExactPlant) -> list[list[bool]]:
    """Return the same for faults that stay constant too: of those, the pairs whose lasting traces are independent."""
    columns, apart = lasting_columns(plant), isolable(plant)
    out = []
    for i in range(plant.faults):
        row = []
        for j in range(plant.faults):
            alone = rank(part(columns, columns=[j]))
            row.append(apart[i][j] and rank(part(columns, columns=[i, j])) > alone)
        out.append(row)
    return out


def attainable(plant: ExactPlant, row: Sequence[bool], *, constant: bool = False) -> bool:
    """Tell whether some residual answers to the ones of a row and ignores its zeros."""
    ignored = [j for j, one in enumerate(row) if not one]
    seen = lasting(plant, ignored) if constant else visible(plant, ignored)
    return all(seen[i] for i, one in enumerate(row) if one)


def is_regular(plant: ExactPlant) -> bool:
    """Tell whether ``det(sE - A)`` is not zero for every ``s``."""
    return normal_rank((plant.A, -plant.E)) == plant.n
