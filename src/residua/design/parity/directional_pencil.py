"""The equations of relations that share directions, as one pencil."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from residua.design.core.generator import ResidualGenerator
from residua.design.core.internal_form import frequency_grid
from residua.design.parity.relation import Relation
from residua.design.parity.relation_model import state_pencil
from residua.errors import AccuracyError
from residua.linear.polynomials.pencil_null_space import PENCIL_RTOL, Pencil, pencil_null_vectors, refined
from residua.linear.polynomials.polynomial_basis import PolynomialBasis
from residua.linear.subspaces.rank import RankDecision, left_null_basis
from residua.linear.systems.array_cache import copied
from residua.plant import Plant
from residua.tolerances import RESIDUE

#: A response may be this far from its direction, relative to its peak over frequency.
_OFF = 1e-6


@dataclass(frozen=True, eq=False)
class Directions:
    """Where the residuals shall point when a fault is there.

    Attributes
    ----------
    faults : tuple of str
    vectors : ndarray, shape (residuals, faults)
    """

    faults: tuple[str, ...]
    vectors: NDArray[np.float64]

    @property
    def count(self) -> int:
        """The number of residuals."""
        return len(self.vectors)


@dataclass(frozen=True, eq=False)
class DirectionalPencil:
    r"""Relations ``x_1 ... x_r`` and scalar polynomials ``gamma_1 ... gamma_s`` with :math:`x_i F_j = d_{ij} \gamma_j`.

    ``[x_1 ... x_r, gamma_1 ... gamma_s]`` is a left null vector of one pencil. Its constant columns, those of the
    directions and of what is ignored, are solved once and for all: what is left has the columns of the states only.

    Attributes
    ----------
    reduced : Pencil
        For coordinates ``y`` of the vectors ``y L^T`` that annihilate the constant columns, in balanced units.
    constant : ndarray, shape (rows, rows of reduced)
        ``L``, orthonormal.
    rows : ndarray, shape (rows,)
        Balanced units of ``[x_1 ... x_r, gamma_1 ... gamma_s]``.
    decision : RankDecision
        The rank of the constant columns.
    residuals, equations, outputs : int
        ``r``, the length of each ``x_i``, and how many of its last entries read outputs.
    """

    reduced: Pencil
    constant: NDArray[np.float64]
    rows: NDArray[np.float64]
    decision: RankDecision
    residuals: int
    equations: int
    outputs: int

    def balanced(self, y: NDArray) -> tuple[NDArray, NDArray]:
        """Return relations, shape (..., residuals, equations), and gammas, (..., faults), in balanced units."""
        X = y @ self.constant.T
        n = self.residuals * self.equations
        return X[..., :n].reshape(*X.shape[:-1], self.residuals, self.equations), X[..., n:]

    def relations(self, y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the coefficients of the relations, shape (degree + 1, residuals, equations), in their own units."""
        X, _ = self.balanced(y)
        X = np.where(np.abs(X) > RESIDUE * np.abs(X).max(initial=0.0), X, 0.0)
        return X * self.rows[: X[0].size].reshape(X.shape[1:])

    def null_vectors(self, degree: int, rtol: float) -> tuple[NDArray[np.float64], RankDecision]:
        """Return all solutions of at most a degree as coordinates, shape (count, degree + 1, rows of reduced)."""
        space = pencil_null_vectors(self.reduced, degree, rtol=rtol)
        return space.vectors, copied(space.decision)

    def at(self, point: complex) -> NDArray[np.complex128]:
        """Return the pencil at a point."""
        return self.reduced.P0 + point * self.reduced.P1


def directional_pencil(
    plant: Plant,
    ignored: NDArray[np.float64],
    directions: Directions,
    basis: PolynomialBasis,
    *,
    rtol: float = PENCIL_RTOL,
) -> DirectionalPencil:
    """Return the equations of relations that ignore constant columns and keep faults to directions."""
    chosen = [plant.faults.index(name) for name in directions.faults]
    faults = np.vstack([plant.Bf, plant.Df])[:, chosen]
    one = state_pencil(plant, np.hstack([ignored, faults]), basis)  # units from all that the equations meet
    n, r, s = plant.n_states, directions.count, len(chosen)
    d = directions.vectors / np.linalg.norm(directions.vectors, axis=0)
    level = _levels(directions)
    P0, P1 = one.rows[:, None] * one.P0 * one.columns, one.rows[:, None] * one.P1 * one.columns
    N, q = len(P0), ignored.shape[1]
    K = np.zeros((r * N + s, r * (q + s)))
    for i in range(r):
        block = slice(i * N, (i + 1) * N)
        K[block, i * q : (i + 1) * q] = P0[:, n : n + q]
        K[block, r * q + i * s : r * q + (i + 1) * s] = P0[:, n + q :]
        K[r * N :, r * q + i * s : r * q + (i + 1) * s] = -np.diag(d[i] / level[i])
    L, decision = left_null_basis(K[:, np.any(K != 0, axis=0)], rtol=rtol)
    blocks = [L[i * N : (i + 1) * N].T for i in range(r)]
    R0 = np.hstack([block @ P0[:, :n] for block in blocks])
    R1 = np.hstack([block @ P1[:, :n] for block in blocks])
    units = np.concatenate([np.outer(level, one.rows).ravel(), 1 / one.columns[n + q :]])
    reduced = Pencil(R0, R1, basis, np.ones(len(R0)), np.ones(r * n))
    return DirectionalPencil(reduced, L, units, decision, r, N, plant.n_outputs)


def changed_together(
    rows: Sequence[Relation], basis: PolynomialBasis, plant: Plant, directions: Directions
) -> list[Relation]:
    """Return relations of one order in another basis, made exact there with their directions.

    They are refined in units of their own basis: with sizes of one, as on the poles of a filter,
    coefficients of a fast plant are far from each other.
    """
    n, k = plant.n_states, rows[0].order
    size = float(np.exp(np.mean(np.log(rows[0].basis.sizes[:k])))) if k else 1.0
    even = replace(basis, sizes=np.full(basis.count, size))  # the same elements, over powers of the size
    X = np.stack([row.basis.changed_to(even, np.hstack([row.p, row.q])) for row in rows], axis=1)
    joint = directional_pencil(plant, rows[0].ignored, directions, even)
    chosen = [plant.faults.index(name) for name in directions.faults]
    faults = np.vstack([plant.Bf, plant.Df])[:, chosen]
    weights = directions.vectors / (directions.vectors**2).sum(axis=0)
    gammas = np.einsum("kif,if->kf", X @ faults, weights)
    gammas = gammas * np.linalg.norm(directions.vectors, axis=0)
    y = (np.hstack([X.reshape(k + 1, -1), gammas]) / joint.rows) @ joint.constant
    X = joint.relations(refined(joint.reduced, y)) * size ** -np.arange(k + 1.0)[:, None, None]
    if plant.E is None:  # p (zI - A) = q C leaves no room for one more power
        X[-1, :, :n] = 0.0
    return [replace(row, p=X[:, i, :n], q=X[:, i, n:], basis=basis) for i, row in enumerate(rows)]


def _levels(directions: Directions) -> NDArray[np.float64]:
    """Return the units of the residuals, in which directions have entries of one size."""
    d = directions.vectors / np.linalg.norm(directions.vectors, axis=0)
    level = np.abs(d).max(axis=1, initial=0.0)
    return np.where(level > 0, level, 1.0)


def check_directions(made: ResidualGenerator, directions: Directions) -> float:
    """Return how far responses to faults are from their directions at most, relative to their peaks, or raise.

    Raises
    ------
    AccuracyError
        If the response to a fault leaves its direction, or is lost.
    """
    form = made.internal_form()
    chosen = [made.faults.index(name) for name in directions.faults]
    level = _levels(directions)[:, None]
    unit = directions.vectors / level
    unit = unit / np.linalg.norm(unit, axis=0)
    response = form.frequency_response(frequency_grid(form))[:, :, chosen] / level
    along = np.einsum("wij,ij->wj", response, unit)
    off = np.linalg.norm(response - along[:, None] * unit, axis=1).max(axis=0)
    peak = np.linalg.norm(response, axis=1).max(axis=0)
    missed = off / np.where(peak > 0, peak, 1.0)
    for name, share, size in zip(directions.faults, missed, peak, strict=True):
        if not share <= _OFF or not size > 0 or made.subspaces[name].shape[1] != 1:
            raise AccuracyError(
                f"the response to {name!r} misses its direction by {share:.2g} of its peak, {size:.2g} "
                f"(limit {_OFF:.0e}): the relations are too ill-conditioned with these poles; choose poles near those "
                "of the plant, or ask for fewer directions"
            )
    return float(missed.max())
