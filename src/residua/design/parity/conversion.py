"""From any residual generator to its parity relations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.design.core.generator import ResidualGenerator
from residua.design.core.own_time import in_own_time
from residua.design.parity.relation import Relation, divided, states_missed, synthetic_division
from residua.design.parity.relations import ParityRelations, relations_of
from residua.errors import AccuracyError, DesignError
from residua.linear import StateSpace
from residua.linear.polynomials.common_factor import without_common_factor
from residua.linear.polynomials.pencil_null_space import PENCIL_RTOL, pencil, shortest_pencil_null_vectors
from residua.linear.polynomials.polynomial_basis import PolynomialBasis
from residua.linear.subspaces.reachability import without_unobservable
from residua.tolerances import LEAKAGE

#: What a division may leave, relative to the terms that have to cancel.
_DIVIDED = 1e-10


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


@in_own_time()
def to_parity(generator: ResidualGenerator, *, rtol: float = PENCIL_RTOL) -> ParityRelations:
    """Return the parity relations of a generator: the polynomials without its poles and common zeros.

    See :meth:`ResidualGenerator.to_parity`.
    """
    if generator.relations is not None:
        return generator.relations
    rows = row_fractions(generator, rtol=rtol)
    if not rows:
        raise DesignError("the generator has no residuals")
    return relations_of(generator.plant, [row.relation for row in rows], generator.residuals)


def row_fractions(generator: ResidualGenerator, *, rtol: float = PENCIL_RTOL) -> list[RowFraction]:
    r"""Return each residual of a generator as a relation and the filter that it goes through.

    For :math:`\dot\xi = M \xi + N v, r = L \xi + D v`, the shortest polynomials with :math:`a (zI - M) = d L` give
    :math:`d\, r = (a N + d D)\, v`; with the state map ``T`` of the generator the states of the plant drop out as
    ``p (zE - A) = q C`` with ``p = d V - a T``. They are written in the basis on the poles of the generator.
    """
    if generator.plant.E is not None and generator.state_map is None:
        raise DesignError("the relations of a generator without a state map are found for plants without E only")
    return [_row(generator, i, rtol) for i in range(generator.n_residuals)]


def _row(generator: ResidualGenerator, i: int, rtol: float) -> RowFraction:
    system, plant = generator.system, generator.plant
    poles = without_unobservable(system.select(outputs=[i])).poles()
    if generator.relations is not None:
        return RowFraction(generator.relations.rows[i], np.zeros(0, dtype=np.complex128), poles)
    basis = PolynomialBasis.on(poles).with_room()
    a, d = _denominator(system, i, basis, rtol)
    n_u = len(plant.inputs)
    q = a @ system.B[:, n_u:] + d @ system.D[i : i + 1, n_u:]
    if not np.any(q):
        raise DesignError(f"residual {generator.residuals[i]!r} reads no output")
    T, V = generator.state_map, generator.static_map
    if T is None:
        p = synthetic_division(plant, q, basis)
    else:
        p = -a @ T + (0.0 if V is None else d @ V[i : i + 1])
    n = plant.n_states
    x, zeros, _ = without_common_factor(np.hstack([p, q]), basis)
    relation = Relation(x[:, :n], x[:, n:], basis, np.zeros((n + plant.n_outputs, 0)), zeros)
    missed = states_missed([relation], plant)
    if not missed <= LEAKAGE:
        why = "it only approximates one, as a sampled continuous design does" if T is None else "too ill-conditioned"
        raise AccuracyError(
            f"residual {generator.residuals[i]!r} is no exact parity relation "
            f"(off by {missed:.2g} > {LEAKAGE:.0e}): {why}"
        )
    return RowFraction(relation, zeros, poles)


def _denominator(
    system: StateSpace, i: int, basis: PolynomialBasis, rtol: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the shortest ``a``, ``d`` with ``a (zI - M) = d L`` for one output of a filter, in a basis."""
    n = system.n_states
    L = system.C[i : i + 1]
    if not n or not np.any(L):
        return np.zeros((1, n)), np.ones((1, 1))
    whole = np.zeros((basis.count, 1))  # the basis has one node more than the filter has poles
    whole[-1] = 1.0
    a, left = divided(system.A, L, whole, basis)
    if left < _DIVIDED:  # unlike singular values, exact in the highest coefficients too, however small they are
        return a, whole
    extended = pencil(np.vstack([-system.A, -L]), np.vstack([np.eye(n), np.zeros((1, n))]), basis)
    solution = shortest_pencil_null_vectors(extended, most=basis.count - 1, rtol=rtol)
    if solution is None:
        raise AccuracyError("the poles of a residual are too ill-conditioned to write it as a fraction")
    x = solution.vectors[0] / solution.vectors[0][-1, n]
    return x[:, :n], x[:, n:]
