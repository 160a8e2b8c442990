"""What observers and residuals a plant admits: exact answers."""

from __future__ import annotations

from collections.abc import Sequence

from flint import fmpq_mat, fmpq_poly

from exact.matrices import block, identity, is_zero, part, rank, zeros
from exact.pencils import left_indices, normal_rank, null_space_in_the_limit, zero_polynomial
from exact.plants import ExactPlant
from exact.stability import is_stable


def hidden_polynomial(plant: ExactPlant) -> fmpq_poly:
    """Return the polynomial of the modes that no output sees."""
    return zero_polynomial(plant.pencil(zeros(plant.n, 0), zeros(plant.p, 0)))


def detectable(plant: ExactPlant) -> bool:
    """Tell whether every hidden mode dies out."""
    return is_stable(hidden_polynomial(plant), plant.sampled)


def fixed_polynomial(plant: ExactPlant, ignored: Sequence[int] = ()) -> fmpq_poly:
    """Return the polynomial of the zeros from the disturbances to the outputs."""
    return zero_polynomial(plant.pencil(*plant.ignoring(ignored)))


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


def unknown_input_observer(plant: ExactPlant, ignored: Sequence[int] = ()) -> tuple[bool, bool]:
    """Return conditions (i) and (ii): a proper estimate exists; it can be stable."""
    B, D = plant.ignoring(ignored)
    if not proper_estimate(plant, ignored):
        return False, False
    full = normal_rank(plant.pencil(B, D)) == plant.n + rank(block([[B], [D]]))
    return True, full and is_stable(fixed_polynomial(plant, ignored), plant.sampled)


def residual_indices(plant: ExactPlant, ignored: Sequence[int] = ()) -> list[int]:
    """Return the orders of a minimal basis of the residuals that ignore disturbances and faults."""
    return left_indices(plant.pencil(*plant.ignoring(ignored)))


def residual_exists(plant: ExactPlant, ignored: Sequence[int] = ()) -> bool:
    """Tell whether any residual ignores disturbances and faults."""
    P = plant.pencil(*plant.ignoring(ignored))
    return plant.n + plant.p > normal_rank(P)


def visible(plant: ExactPlant, ignored: Sequence[int] = ()) -> list[bool]:
    """Tell which faults some residual sees that ignores others."""
    least = normal_rank(plant.pencil(*plant.ignoring(ignored)))
    ranks = (normal_rank(plant.pencil(*plant.ignoring([*ignored, i]))) for i in range(plant.faults))
    return [i not in ignored and r > least for i, r in enumerate(ranks)]


def lasting_columns(plant: ExactPlant, ignored: Sequence[int] = ()) -> fmpq_mat:
    """Return what all residuals that ignore some settle to, for a constant fault of each kind: one column each."""
    V = null_space_in_the_limit(plant.pencil(*plant.ignoring(ignored)), 1 if plant.sampled else 0)
    return V * block([[plant.Bf], [plant.Df]])


def lasting(plant: ExactPlant, ignored: Sequence[int] = ()) -> list[bool]:
    """Tell which faults leave a lasting trace while constant, in residuals that ignore others whatever they do."""
    columns = lasting_columns(plant, ignored)
    return [not is_zero(part(columns, columns=[i])) for i in range(plant.faults)]


def isolable(plant: ExactPlant) -> list[list[bool]]:
    """Return ``[i][j]``: some residual sees fault ``i`` and ignores fault ``j``."""
    by_ignored = [visible(plant, [j]) for j in range(plant.faults)]
    return [[i != j and by_ignored[j][i] for j in range(plant.faults)] for i in range(plant.faults)]


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
