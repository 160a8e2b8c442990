"""What the disturbances of a plant leave of each fault, and in how short a relation, where floats say nothing.

Rates that are decades apart make of what is left of a fault, of the angle between two of them, or of what a relation
leaves of the states, less than any limit above rounding. Numbers of few digits are exact: of them ranks modulo a large
prime tell what is there in rational numbers.

References
----------
J. H. Wilkinson, Linear differential equations and Kronecker's canonical form, in Recent Advances in Numerical Analysis
(1978) 231-265: null vectors in the limit by the spaces that the coefficients of their power series run through.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.linear.poles.rational_zeros import MODULAR, Rows, eliminated
from residua.linear.poles.settled_zeros import SMALL, are_exact
from residua.linear.subspaces.rank import DEFAULT_RTOL
from residua.plant import Plant

#: Where the pencil is evaluated: a whole number that no plant has to do with.
_POINT = 271828182845904523


@dataclass(frozen=True, eq=False)
class RationalColumns:
    """What residuals that ignore the disturbances see of each fault, as residues modulo a prime.

    Attributes
    ----------
    rows : list of rows
        A row for each independent residual, a column for each fault.
    faults : int
    """

    rows: Rows
    faults: int

    @property
    def present(self) -> NDArray[np.bool_]:
        """Which faults any of the residuals sees."""
        return np.array([any(row[j] for row in self.rows) for j in range(self.faults)], dtype=bool)

    def inside(self, chosen: Iterable[int]) -> NDArray[np.bool_]:
        """Return which faults the residuals do not see that ignore these too."""
        basis = list(chosen)
        return ~_after([[row[j] for j in basis] for row in self.rows], self.rows, self.faults).present

    def isolable(self) -> NDArray[np.bool_]:
        """Return ``[i, j]``: a residual sees fault ``i`` and ignores fault ``j``."""
        apart = [~self.inside([j]) for j in range(self.faults)]
        return np.array(apart, dtype=bool).reshape(self.faults, self.faults).T


def are_rational(plant: Plant, rtol: float) -> bool:
    """Tell whether ranks of a plant are asked for in rational numbers: of a small one, with numbers of few digits.

    Whoever allows more than rounding does not take all digits of the numbers for what they are.
    """
    p = plant
    if rtol > DEFAULT_RTOL or p.n_states + max(p.n_outputs, p.Bd.shape[1] + p.Bf.shape[1]) > SMALL:
        return False
    return are_exact(p.A, p.C, p.Bd, p.Dd, p.Bf, p.Df, *(() if p.E is None else (p.E,)))


def rational_columns(plant: Plant) -> RationalColumns:
    """Return what is left of each fault at almost every point."""
    here, along, faults = _pencil(plant)
    P = [_sum(row, _POINT, slope) for row, slope in zip(here, along, strict=True)]
    return _after(P, faults, len(plant.faults))


def rational_limit_columns(plant: Plant) -> RationalColumns:
    """Return what is left of each constant fault in the end: at ``s = 0`` (``z = 1``), as a limit.

    Null vectors ``x0 + x1 s + ...`` of ``P0 + s P1`` have ``x0 P0 = 0`` and ``x0 P1 = -x1 P0``, and so on: ``x0`` must
    be of the largest space whose rows go on within it.
    """
    here, along, faults = _pencil(plant)
    point = 1 if plant.is_discrete else 0
    P0 = [_sum(row, point, slope) for row, slope in zip(here, along, strict=True)]
    columns, space = len(P0[0]) if P0 else 0, _unit(len(P0))
    while True:
        following = _leading_into(along, _product(space, P0, columns), columns)
        if len(following) == len(space):
            break
        space = following
    count = len(plant.faults)
    return _after(_product(space, P0, columns), _product(space, faults, count), count)


def least_degree(plant: Plant, outputs: Sequence[int]) -> int | None:
    """Return the degree of the shortest rows of polynomials that annihilate the pencil; nothing where there are none.

    Of those that read no other outputs than the numbered ones.
    That of ``x0 + x1 s + ... + xk s^k`` ends with ``xk P1 = 0``; what ``xk`` may be goes on from ``x0 P0 = 0``.
    """
    n = plant.n_states
    here, along = ([*M[:n], *(M[n + i] for i in outputs)] for M in _pencil(plant)[:2])
    columns = len(here[0]) if here else 0
    space, degree = _leading_into(here, [], columns), 0
    while True:
        onwards = _product(space, along, columns)
        if len(eliminated([list(row) for row in onwards], columns, MODULAR)) < len(space):
            return degree
        following = _leading_into(here, onwards, columns)
        if len(following) == len(space):
            return None
        space, degree = following, degree + 1


def _leading_into(M: Rows, space: Rows, columns: int) -> Rows:
    """Return a basis of the rows ``x`` for which ``x M`` is in the span of some rows."""
    size = len(M)
    rows = [[*row, *([0] * size)] for row in space]
    rows += [[*row, *one] for row, one in zip(M, _unit(size), strict=True)]
    pivots = eliminated(rows, columns, MODULAR)
    found = [row[columns:] for row in rows[len(pivots) :]]
    return found[: len(eliminated(found, size, MODULAR))]


def _unit(size: int) -> Rows:
    return [[int(i == j) for j in range(size)] for i in range(size)]


def _pencil(plant: Plant) -> tuple[Rows, Rows, Rows]:
    """Return ``P0`` and ``P1`` of the pencil with the disturbances, and the columns of the faults, as residues."""
    n, p = plant.n_states, plant.n_outputs
    E = np.eye(n) if plant.E is None else plant.E
    here = np.hstack([np.vstack([plant.A, plant.C]), np.vstack([plant.Bd, plant.Dd])])
    along = np.zeros_like(here)
    along[:n, :n] = -E
    faults = np.vstack([plant.Bf, plant.Df]).reshape(n + p, -1)
    residues = [[[MODULAR.of(x) for x in row] for row in M.tolist()] for M in (here, along, faults)]
    return residues[0], residues[1], residues[2]


def _after(P: Rows, faults: Rows, count: int) -> RationalColumns:
    """Return what rows that annihilate a matrix leave of so many faults."""
    columns = len(P[0]) if P else 0
    rows = [[*row, *fault] for row, fault in zip(P, faults, strict=True)]
    pivots = eliminated(rows, columns, MODULAR)
    return RationalColumns([row[columns:] for row in rows[len(pivots) :]], count)


def _sum(row: list[int], factor: int, other: list[int]) -> list[int]:
    return [MODULAR.reduced(a + factor * b) for a, b in zip(row, other, strict=True)]


def _product(M: Rows, N: Rows, columns: int) -> Rows:
    """Return a product of matrices of residues, the second with so many columns."""
    out = []
    for row in M:
        new = [0] * columns
        for factor, other in zip(row, N, strict=True):
            if factor:
                new = _sum(new, factor, other)
        out.append(new)
    return out
