"""Relations that keep faults to directions, as relations of several copies of one plant."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from residua.design.core.generator import ResidualGenerator
from residua.design.core.internal_form import frequency_grid
from residua.design.parity.relation import Relation
from residua.design.parity.relation_model import RelationModel
from residua.errors import AccuracyError
from residua.linear.polynomials.pair_relations import PairRelations
from residua.linear.polynomials.polynomial_basis import PolynomialBasis
from residua.linear.subspaces.quotient import without_rounding
from residua.plant import Plant

Matrix = NDArray[np.float64]
#: A response may be this far from its direction, relative to its peak over frequency.
_OFF = 1e-6


@dataclass(frozen=True, eq=False)
class Directions:
    r"""The directions that residuals are to have when faults are there.

    Relations ``x_1 ... x_r`` keep a fault ``F_j`` to the direction ``d_j`` when side by side, as one relation of ``r``
    copies of the plant, they ignore :math:`c \otimes F_j` for every ``c`` at right angles to ``d_j``.

    Attributes
    ----------
    faults : tuple of str
    vectors : ndarray, shape (residuals, faults)
    equations : PairRelations
        Of the copies, in which the residuals have the units ``levels``.
    """

    faults: tuple[str, ...]
    vectors: Matrix
    equations: PairRelations | None = field(default=None, repr=False)

    @property
    def count(self) -> int:
        """The number of residuals."""
        return len(self.vectors)

    @property
    def levels(self) -> Matrix:
        """The units of the residuals, in which directions have entries of one size."""
        level = np.abs(self.vectors / np.linalg.norm(self.vectors, axis=0)).max(axis=1, initial=0.0)
        return np.where(level > 0, level, 1.0)

    @property
    def units(self) -> Matrix:
        """The directions in units of ``levels``, of length one."""
        d = self.vectors / self.levels[:, None]
        return d / np.linalg.norm(d, axis=0)

    def kept_by(self, model: RelationModel, ignored: Sequence[str]) -> Directions:
        """Return the same with the relations of the copies that keep to them and ignore some faults."""
        copies, balanced = np.eye(self.count), model.balanced
        known, (B, D) = model.plant.faults, model.unknown(ignored)
        columns = [_copied(copies, B), _copied(copies, D)]
        for name, d in zip(self.faults, self.units.T, strict=True):
            across = without_rounding(np.linalg.svd(d[:, None])[0][:, 1:])
            for i, part in enumerate(balanced.faults):
                columns[i] = np.hstack([columns[i], _copied(across, part[:, [known.index(name)]])])
        A, C = _copied(copies, balanced.A), _copied(copies, balanced.C)
        return replace(self, equations=PairRelations.of(A, columns[0], C, columns[1]))

    def responses(self, model: RelationModel) -> tuple[Matrix, Matrix]:
        """Return ``B`` and ``D`` of the directed faults in the copies, each along its direction."""
        chosen = [model.plant.faults.index(name) for name in self.faults]
        B, D = (
            np.column_stack([np.kron(d, part[:, j]) for d, j in zip(self.units.T, chosen, strict=True)])
            for part in model.balanced.faults
        )
        return B, D

    def apart(self, p: Matrix, q: Matrix, basis: PolynomialBasis, equations: PairRelations) -> list[Relation]:
        """Return a relation of the copies as one relation for each residual."""
        parts = zip(np.split(p, self.count, axis=1), np.split(q, self.count, axis=1), strict=True)
        return [Relation(equations, *part, basis) for part in parts]

    def moved(self, rows: Sequence[Relation], basis: PolynomialBasis) -> list[Relation]:
        """Return relations in another basis, made exact there with their directions."""
        assert self.equations is not None
        p, q = (np.hstack([getattr(row, part) for row in rows]) for part in "pq")
        apart = self.apart(*self.equations.moved(p, q, rows[0].basis, basis), basis, self.equations)
        return [replace(row, p=one.p, q=one.q, basis=basis) for row, one in zip(rows, apart, strict=True)]

    def sign(self, rows: Sequence[Relation], plant: Plant) -> float:
        """Return the sign with which the first response to the first of the directed faults is along its direction."""
        j, (B, D) = plant.faults.index(self.faults[0]), plant.balanced.faults
        along = self.units[:, 0] @ np.array([row.p @ B[:, j] + row.q @ D[:, j] for row in rows])
        present = np.flatnonzero(np.abs(along) > 1e-9 * np.abs(along).max())
        return float(np.sign(along[present[-1]])) if len(present) else 1.0


def _copied(weights: Matrix, M: Matrix) -> Matrix:
    """Return copies of a matrix, one below the other, each with its weight."""
    return np.asarray(np.kron(weights, M), dtype=np.float64)


def check_directions(generator: ResidualGenerator, directions: Directions) -> float:
    """Return how far responses to faults are from their directions at most, relative to their peaks, or raise.

    Raises
    ------
    AccuracyError
        If the response to a fault leaves its direction, or is lost.
    """
    form = generator.internal_form()
    chosen = [generator.faults.index(name) for name in directions.faults]
    response = form.frequency_response(frequency_grid(form))[:, :, chosen] / directions.levels[:, None]
    along = np.einsum("wij,ij->wj", response, directions.units)
    off = np.linalg.norm(response - along[:, None] * directions.units, axis=1).max(axis=0)
    peak = np.linalg.norm(response, axis=1).max(axis=0)
    missed = off / np.where(peak > 0, peak, 1.0)
    for name, share, size in zip(directions.faults, missed, peak, strict=True):
        if not share <= _OFF or not size > 0 or generator.subspaces[name].shape[1] != 1:
            raise AccuracyError(
                f"the response to {name!r} misses its direction by {share:.2g} of its peak, {size:.2g} "
                f"(limit {_OFF:.0e}): the relations are too ill-conditioned with these poles; choose poles near those "
                "of the plant, or ask for fewer directions"
            )
    return float(missed.max())
