"""A plant in rational numbers, and its pencils."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from flint import fmpq, fmpq_mat

from exact.matrices import block, exact, identity, part, rank, zeros


@dataclass(frozen=True, eq=False)
class ExactPlant:
    """``E x' = A x + B u + Bd d + Bf f``, ``y = C x + D u + Dd d + Df f``, in fractions."""

    E: fmpq_mat
    A: fmpq_mat
    B: fmpq_mat
    C: fmpq_mat
    D: fmpq_mat
    Bd: fmpq_mat
    Dd: fmpq_mat
    Bf: fmpq_mat
    Df: fmpq_mat
    sampled: bool
    plain: bool
    answers: dict[Any, Any] = field(default_factory=dict, repr=False)  # that do not depend on units, once each

    @property
    def n(self) -> int:
        """Number of states."""
        return self.A.nrows()

    @property
    def p(self) -> int:
        """Number of outputs."""
        return self.C.nrows()

    @property
    def faults(self) -> int:
        """Number of faults."""
        return self.Bf.ncols()

    def ignoring(self, faults: Sequence[int]) -> tuple[fmpq_mat, fmpq_mat]:
        """Return the columns of the disturbances and of some faults, in the states and in the outputs."""
        faults = list(faults)
        return block([[self.Bd, part(self.Bf, columns=faults)]]), block([[self.Dd, part(self.Df, columns=faults)]])

    def reading(self, outputs: Sequence[int]) -> ExactPlant:
        """Return the plant with some of its outputs."""
        rows = list(outputs)
        C, Du, Dd, Df = (part(M, rows=rows) for M in (self.C, self.D, self.Dd, self.Df))
        return ExactPlant(self.E, self.A, self.B, C, Du, self.Bd, Dd, self.Bf, Df, self.sampled, self.plain)

    def pencil(self, B: fmpq_mat, D: fmpq_mat) -> tuple[fmpq_mat, fmpq_mat]:
        """Return ``P0, P1`` of ``P(s) = P0 + s P1 = [A - sE, B; C, D]``."""
        m = B.ncols()
        first = block([[self.A, B], [self.C, D]])
        second = block([[-self.E, zeros(self.n, m)], [zeros(self.p, self.n + m)]])
        return first, second


def exact_plant(plant: Any) -> ExactPlant:
    """Return a plant of floats as the rational one that it is; only its matrices are read."""
    n = plant.A.shape[0]
    M = {name: exact(getattr(plant, name)) for name in ("A", "B", "C", "D", "Bd", "Dd", "Bf", "Df")}
    E = identity(n) if plant.E is None else exact(plant.E)
    return ExactPlant(E=E, sampled=plant.dt > 0, plain=plant.E is None, **M)


def with_answers_of(plant: ExactPlant, other: ExactPlant, by: Any) -> ExactPlant:
    """Return a plant with the answers about another, when it is that one in units ``by`` to the last bit, or as it is.

    Units of states, signals and equations are invertible: no rank, polynomial, index or existence depends on them.
    """
    left = by.r if not plant.plain else 1 / by.x
    rows, outputs = _factors(left), _factors(1 / by.y)
    columns = {"A": by.x, "E": by.x, "C": by.x, "B": by.u, "D": by.u, "Bd": by.d, "Dd": by.d}
    for name, factors in columns.items():
        if name == "E" and plant.plain:
            continue
        above = outputs if name in ("C", "D", "Dd") else rows
        if not _is_scaled(getattr(plant, name), getattr(other, name), above, _factors(factors)):
            return plant
    through, wanted = (block([[X.Bf], [X.Df]]) for X in (plant, other))
    above = rows + outputs
    for j in range(plant.faults):  # a fault of a channel has the unit of the channel, one of its own has its own
        i = next((i for i in range(len(above)) if wanted[i, j] != 0), None)
        unit = fmpq(1) if i is None else through[i, j] / (above[i] * wanted[i, j])
        if unit == 0 or any(through[i, j] != above[i] * wanted[i, j] * unit for i in range(len(above))):
            return plant
    return replace(plant, answers=other.answers)


def _factors(values: Any) -> list[fmpq]:
    return [fmpq(*float(x).as_integer_ratio()) for x in values]


def _is_scaled(M: fmpq_mat, other: fmpq_mat, rows: list[fmpq], columns: list[fmpq]) -> bool:
    """Tell whether a matrix is another with its rows and columns multiplied."""
    shape = M.nrows(), M.ncols()
    return shape == (other.nrows(), other.ncols()) == (len(rows), len(columns)) and all(
        M[i, j] == rows[i] * other[i, j] * columns[j] for i in range(shape[0]) for j in range(shape[1])
    )


def integrators(plant: ExactPlant) -> int:
    """Return how often a plant integrates, all chains together: poles at ``s = 0``, or ``z = 1``.

    It is how often a filter may have to be zero there: combinations of outputs integrate more often than any one.
    """
    A = plant.A - plant.E if plant.sampled else plant.A
    n = plant.n
    # a shift of a regular pencil that is no other pole leaves its pole at 0 that of one matrix
    shifts = (A - c * plant.E for c in range(1, n + 2))
    regular = next((M for M in shifts if rank(M) == n), None)
    if regular is None:
        raise ValueError("the pencil of the plant is not regular")
    N = regular.solve(A) if n else A
    power = identity(n)
    for _ in range(n):
        power = power * N
    return n - rank(power)


def at(P: tuple[fmpq_mat, fmpq_mat], s: fmpq | int) -> fmpq_mat:
    """Return a pencil at a point."""
    return P[0] + P[1] * s
