"""Parity relations of any residual generator."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.design.core.generator import ResidualGenerator
from residua.design.parity.relation import Relation, filter_basis
from residua.design.parity.relation_model import RelationModel
from residua.design.parity.relations import ParityRelations, relations_of
from residua.errors import AccuracyError, DesignError
from residua.linear.polynomials.common_factor import without_common_factor
from residua.linear.polynomials.pair_relations import PairRelations
from residua.tolerances import LEAKAGE


@dataclass(frozen=True, eq=False)
class RowFraction:
    """One residual as relation and filter, :math:`r = r^* c(z) / d(z)`.

    Attributes
    ----------
    relation : Relation
        Without common factors.
    zeros, poles : ndarray
        Roots of ``c`` and of ``d``: what the residual is filtered by.
    """

    relation: Relation
    zeros: NDArray[np.complex128]
    poles: NDArray[np.complex128]


def to_parity(generator: ResidualGenerator) -> ParityRelations:
    """Return the parity relations of a generator: the polynomials without its poles and common zeros.

    See :meth:`ResidualGenerator.to_parity`.
    """
    if generator.relations is not None:
        return generator.relations
    rows = row_fractions(generator)
    if not rows:
        raise DesignError("the generator has no residuals")
    return relations_of(generator.plant, [row.relation for row in rows], generator.residuals)


def row_fractions(generator: ResidualGenerator) -> list[RowFraction]:
    r"""Return each residual of a generator as a relation and the filter that it goes through.

    For :math:`\dot\xi = M \xi + N v, r = L \xi + D v`, the shortest polynomials with :math:`a (zI - M) = d L` give
    :math:`d\, r = (a N + d D)\, v`. They are written in the basis on the poles of the generator.
    """
    if generator.plant.E is not None and generator.state_map is None:
        raise DesignError("the relations of a generator without a state map are found for plants without E only")
    return [_row(generator, i) for i in range(generator.n_residuals)]


def _row(generator: ResidualGenerator, i: int) -> RowFraction:
    system, plant = generator.system, generator.plant
    model, n_u, none = plant.balanced, len(plant.inputs), np.zeros(0, dtype=np.complex128)
    units, n = model.units, system.n_states
    N, D = (M[:, n_u:] / units.outputs for M in (system.B / units.rate, system.D[[i]]))
    T = np.zeros((n, plant.n_states)) if generator.state_map is None else generator.state_map / units.equations
    size = np.abs(np.hstack([T, N])).max(axis=1, initial=0.0)[:, None]
    size = np.where(size > 0, size, 1.0)
    L = system.C[[i]] * size[:, 0]
    height = float(np.abs(L).max(initial=0.0)) or 1.0
    of_filter = PairRelations.of(
        system.A * size[:, 0] / size / units.rate, np.zeros((n, 0)), L / height, np.zeros((1, 0))
    )
    poles = units.rate * np.linalg.eigvals(of_filter.pair[0]).astype(np.complex128)
    if generator.relations is not None:
        return RowFraction(generator.relations.rows[i], none, poles)
    basis = filter_basis(plant, poles)
    (a,), (d,), _ = of_filter.rows(len(poles), basis)
    q = a @ (N / size) + d @ D / height
    if not np.any(q):
        raise DesignError(f"residual {generator.residuals[i]!r} reads no output")
    if len(model.algebra):
        V = 0.0 if generator.static_map is None else generator.static_map[[i]] / units.equations * units.rate / height
        q = np.hstack([q, (d * V - a @ (T / size)) @ model.algebra.T])
    equations = RelationModel(plant, decouples=False).equations()
    both, zeros, _ = without_common_factor(np.hstack([equations.completed(q, basis)[0], q]), basis)
    q = both[:, len(model.A) :]
    p, missed = equations.completed(q, basis)
    nearest = equations.moved(p, q, basis, basis)[1]
    if np.abs(nearest - q).max() <= LEAKAGE * np.abs(q).max():
        q, (p, missed) = min((q, (p, missed)), (nearest, equations.completed(nearest, basis)), key=lambda x: x[1][1])
    if not missed <= LEAKAGE:
        why = "too ill-conditioned"
        if generator.state_map is None:
            why = "it only approximates one, as a sampled continuous design does"
        raise AccuracyError(
            f"residual {generator.residuals[i]!r} is no exact parity relation "
            f"(off by {missed:.2g} > {LEAKAGE:.0e}): {why}"
        )
    return RowFraction(Relation(equations, p, q, basis, units.rate * zeros), units.rate * zeros, poles)
