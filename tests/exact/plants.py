"""A plant in rational numbers, and its pencils."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from flint import fmpq, fmpq_mat

from exact.matrices import block, exact, identity, part, zeros


@dataclass(frozen=True, eq=False)
class ExactPlant:
    """``E x' = A x + Bu u + Bd d + Bf f``, ``y = C x + Du u + Dd d + Df f``, in fractions."""

    E: fmpq_mat
    A: fmpq_mat
    Bu: fmpq_mat
    C: fmpq_mat
    Du: fmpq_mat
    Bd: fmpq_mat
    Dd: fmpq_mat
    Bf: fmpq_mat
    Df: fmpq_mat
    sampled: bool
    plain: bool

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
        C, Du, Dd, Df = (part(M, rows=rows) for M in (self.C, self.Du, self.Dd, self.Df))
        return ExactPlant(self.E, self.A, self.Bu, C, Du, self.Bd, Dd, self.Bf, Df, self.sampled, self.plain)

    def pencil(self, B: fmpq_mat, D: fmpq_mat) -> tuple[fmpq_mat, fmpq_mat]:
        """Return ``P0, P1`` of ``P(s) = P0 + s P1 = [A - sE, B; C, D]``."""
        m = B.ncols()
        first = block([[self.A, B], [self.C, D]])
        second = block([[-self.E, zeros(self.n, m)], [zeros(self.p, self.n + m)]])
        return first, second


def exact_plant(plant: Any) -> ExactPlant:
    """Return a plant of floats as the rational one that it is; only its matrices are read."""
    n = plant.A.shape[0]
    M = {name: exact(getattr(plant, name)) for name in ("A", "Bu", "C", "Du", "Bd", "Dd", "Bf", "Df")}
    E = identity(n) if plant.E is None else exact(plant.E)
    return ExactPlant(E=E, sampled=plant.dt > 0, plain=plant.E is None, **M)


def at(P: tuple[fmpq_mat, fmpq_mat], s: fmpq | int) -> fmpq_mat:
    """Return a pencil at a point."""
    return P[0] + P[1] * s
