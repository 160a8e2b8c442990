"""The relations that ignore a set of signals, the shortest of them, and the shortest that see another set."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from residua.design.core.generator import ResidualGenerator
from residua.design.parity.relation import Relation
from residua.design.parity.relation_model import RelationModel
from residua.errors import AccuracyError
from residua.linear.polynomials.pair_relations import PairRelations
from residua.linear.polynomials.polynomial_basis import PolynomialBasis
from residua.linear.subspaces.rank import RankDecision

Matrix = NDArray[np.float64]
#: A fault is seen by a relation when more than this of the largest response that its size allows is left.
SEEN = 1e-9
#: Combinations of equally short relations that are tried for the best view of the faults.
_TRIES = 30


@dataclass(frozen=True, eq=False)
class RelationSpace:
    """All relations of at most an order, with what they see.

    Attributes
    ----------
    equations : PairRelations
    p, q : ndarray, shape (relations, order + 1, states) and (relations, order + 1, outputs)
        Coefficients, orthonormal together.
    basis : PolynomialBasis
        What they are coefficients in.
    decision : RankDecision
        The singular values of the window that they annihilate.
    responses : ndarray, shape (relations, order + 1, faults)
        The coefficients of the response of each to each fault, balanced.
    """

    equations: PairRelations
    p: Matrix
    q: Matrix
    basis: PolynomialBasis
    decision: RankDecision
    responses: Matrix

    @property
    def count(self) -> int:
        """The number of independent relations."""
        return len(self.q)

    @property
    def order(self) -> int:
        """The highest order."""
        return self.q.shape[1] - 1

    @cached_property
    def seen(self) -> NDArray[np.bool_]:
        """The faults that some relation answers to, shape (faults,)."""
        return np.linalg.norm(self.responses, axis=(0, 1)) > SEEN

    @property
    def relations(self) -> list[Relation]:
        """Each relation."""
        return [self.combined(one) for one in np.eye(self.count)]

    def besides(self, shorter: RelationSpace, new: int, faults: tuple[Matrix, Matrix]) -> RelationSpace:
        """Return shorter relations, and those of this space that are no sums of multiples of them."""
        n, both = self.p.shape[2], np.moveaxis(np.concatenate([shorter.p, shorter.q], axis=2), 0, -1)
        multiples = [shorter.basis.changed_to(self.basis, both)]
        while len(multiples[-1]) <= self.order:
            multiples.append(self.basis.times_variable(multiples[-1]))
        padded = [np.pad(one, ((0, self.order + 1 - len(one)), (0, 0), (0, 0))) for one in multiples]
        rows = np.concatenate([one.reshape(-1, one.shape[2]) for one in padded], axis=1)
        M = np.linalg.qr(rows / np.linalg.norm(rows, axis=0))[0]
        rows_of_order = np.concatenate([self.p, self.q], axis=2)
        flat = rows_of_order.reshape(self.count, -1)
        weights = np.linalg.svd(flat - flat @ M @ M.T)[0][:, :new].T
        found = np.concatenate([np.moveaxis(padded[0], -1, 0), np.tensordot(weights, rows_of_order, 1)])
        p, q = found[:, :, :n], found[:, :, n:]
        return replace(self, p=p, q=q, responses=p @ faults[0] + q @ faults[1])

    def combined(self, weights: Matrix) -> Relation:
        """Return a combination of the relations."""
        p, q = (np.tensordot(weights, part, 1) for part in (self.p, self.q))
        return Relation(self.equations, p, q, self.basis)

    def best(self, faults: Sequence[int]) -> Relation:
        """Return the combination whose weakest response to some faults is largest, of those that are tried.

        These are each relation alone, the directions of the singular vectors of the responses, and seeded random ones.
        """
        tries = combinations_to_try(self.responses[:, :, list(faults)])
        response = np.einsum("tn,nkf->tkf", tries, self.responses[:, :, list(faults)])
        weakest = np.linalg.norm(response, axis=1).min(axis=1, initial=1.0)
        return self.combined(tries[simplest_of_the_best(weakest)])


def combinations_to_try(responses: Matrix) -> Matrix:
    """Return each relation alone, the directions of the singular vectors of the responses, and seeded random ones."""
    n = len(responses)
    if n == 1:
        return np.ones((1, 1))
    flat = responses.reshape(n, -1)
    directions = np.linalg.svd(flat)[0].T if flat.size else np.eye(n)
    random = np.random.default_rng(20).standard_normal((_TRIES, n))
    return np.vstack([np.eye(n), directions, random / np.linalg.norm(random, axis=1, keepdims=True)])


def simplest_of_the_best(scores: Matrix) -> int:
    """Return the first combination that is not much worse than the best: it is simpler than a mixture."""
    return int(np.flatnonzero(scores >= 0.2 * scores.max())[0])


def relation_space(equations: PairRelations, order: int, faults: tuple[Matrix, Matrix]) -> RelationSpace:
    """Return all relations of at most an order, with their responses to faults, ``B`` and ``D``."""
    basis = equations.basis(order)
    p, q, decision = equations.rows(order, basis)
    return RelationSpace(equations, p, q, basis, decision, p @ faults[0] + q @ faults[1])


def shortest_space(model: RelationModel, equations: PairRelations, seen: Sequence[int] = ()) -> RelationSpace:
    """Return the relations of the smallest order that answer to some faults."""
    assert equations.orders is not None
    longest, faults = equations.orders[1], model.balanced.faults
    space: RelationSpace | None = None
    for order, new in enumerate(equations.new):  # multiples of shorter relations see nothing that these do not see
        if new and (space is None or not space.seen[list(seen)].all()):
            found = relation_space(equations, order, faults)
            space = found if space is None else found.besides(space, new, faults)
    if space is None or not space.seen[list(seen)].all():
        raise AccuracyError(
            f"relations that answer exist, but none of an order up to {longest} is found to working precision: "
            "structured_bank needs no polynomials"
        )
    return space


def with_rank(
    generator: ResidualGenerator, space: RelationSpace, near: Sequence[RankDecision] | None = None
) -> ResidualGenerator:
    """Return a generator whose evidence holds the rank decisions behind its relations, and those that are near."""
    ranks = {**generator.evidence.ranks, "states and ignored signals": space.decision}
    near = space.equations.near if near is None else near
    notes = tuple(f"near: {one}; double precision hardly decides this rank" for one in near[:1])
    return replace(generator, evidence=generator.evidence.extended(ranks=ranks, notes=notes))
