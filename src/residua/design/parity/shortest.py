"""The relations that ignore a set of signals, the shortest of them, and the shortest that see another set."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from residua.design.parity.relation import Relation
from residua.design.parity.relation_model import RelationModel, basis_for, state_pencil
from residua.errors import DesignError
from residua.linear.degree_search import at_smallest_degree
from residua.linear.pencil_null_space import (
    Pencil,
    PencilNullVectors,
    pencil,
    pencil_null_vectors,
    shortest_pencil_null_vectors,
)
from residua.linear.polynomial_basis import PolynomialBasis
from residua.linear.rank import RankDecision

#: A fault is seen by a relation when more than this of the largest response that its size allows is left.
_SEEN = 1e-9
#: Combinations of equally short relations that are tried for the best view of the faults.
_TRIES = 30


@dataclass(frozen=True, eq=False)
class RelationSpace:
    """All relations of at most an order that ignore a set, with what they see.

    Attributes
    ----------
    vectors : ndarray, shape (relations, order + 1, equations)
        Coefficients, orthonormal in balanced units.
    basis : PolynomialBasis
        What they are coefficients in.
    decision : RankDecision
        Behind their number.
    responses : ndarray, shape (relations, order + 1, faults)
        The coefficients of the response of each to each fault, in units of the fault's column in balanced units.
    floor : float
        A larger response is no rounding.
    """

    vectors: NDArray[np.float64]
    basis: PolynomialBasis
    decision: RankDecision
    responses: NDArray[np.float64]
    floor: float

    @property
    def count(self) -> int:
        """How many independent relations there are."""
        return len(self.vectors)

    @property
    def order(self) -> int:
        """The highest order."""
        return self.vectors.shape[1] - 1

    @property
    def sizes(self) -> NDArray[np.float64]:
        """The size of the response of each relation to each fault, shape (relations, faults)."""
        return np.linalg.norm(self.responses, axis=1)

    @property
    def seen(self) -> NDArray[np.bool_]:
        """The faults that some relation answers to, shape (faults,)."""
        return np.linalg.norm(self.sizes, axis=0) > self.floor

    def best_combination(self, faults: Sequence[int]) -> NDArray[np.float64]:
        """Return the combination whose weakest response to some faults is largest, of those that are tried.

        These are each relation alone, the directions of the singular vectors of the responses, and seeded random ones.
        """
        n = self.count
        if n == 1:
            return self.vectors[0]
        tries = combinations_to_try(self.responses[:, :, list(faults)])
        response = np.einsum("tn,nkf->tkf", tries, self.responses[:, :, list(faults)])
        weakest = np.linalg.norm(response, axis=1).min(axis=1, initial=1.0)
        return np.einsum("n,nkj->kj", tries[simplest_of_the_best(weakest)], self.vectors)

    def relation(self, model: RelationModel, ignored: Sequence[str | int], vector: NDArray[np.float64]) -> Relation:
        """Return a combination of the vectors as a relation."""
        n = model.plant.n_states
        none = np.zeros(0, dtype=np.complex128)
        return Relation(vector[:, :n], vector[:, n:], self.basis, model.ignored_columns(ignored), none)


def combinations_to_try(responses: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return each relation alone, the directions of the singular vectors of the responses, and seeded random ones."""
    n = len(responses)
    flat = responses.reshape(n, -1)
    directions = np.linalg.svd(flat)[0].T if flat.size else np.eye(n)
    random = np.random.default_rng(20).standard_normal((_TRIES, n))
    return np.vstack([np.eye(n), directions, random / np.linalg.norm(random, axis=1, keepdims=True)])


def simplest_of_the_best(scores: NDArray[np.float64]) -> int:
    """Return the first combination that is not much worse than the best: it is simpler than a mixture."""
    return int(np.flatnonzero(scores >= 0.2 * scores.max())[0])


def relation_space(model: RelationModel, ignored: Sequence[str | int], order: int, rtol: float) -> RelationSpace:
    """Return all relations of at most an order that ignore some faults and all disturbances."""
    if order >= model.basis.count:
        model = replace(model, basis=basis_for(model.plant, order + 1))
    search = _search(model, ignored)
    return search.space(pencil_null_vectors(search.pencil, order, rtol=rtol))


def shortest_relations(model: RelationModel, ignored: Sequence[str | int], rtol: float) -> RelationSpace | None:
    """Return the relations of the smallest order that ignore some faults and all disturbances, if there are any."""
    search = _search(model, ignored)
    found = shortest_pencil_null_vectors(search.pencil, most=model.most, rtol=rtol)
    return None if found is None else search.space(found)


def shortest_relation(
    model: RelationModel, ignored: Sequence[str], seen: Sequence[str], rtol: float
) -> tuple[NDArray[np.float64], RelationSpace]:
    """Return the shortest relation that ignores some faults and all disturbances and answers to others.

    Raises
    ------
    DesignError
        If there is none: which of the faults no relation sees, or that there is no relation at all.
    """
    faults = [model.plant.faults.index(name) for name in seen]
    first = shortest_relations(model, ignored, rtol)
    what = ", ".join(f"'{name}'" for name in (*model.plant.disturbances, *ignored)) or "nothing"
    if first is None:
        raise DesignError(
            f"no parity relation ignores {what}: the {model.plant.n_outputs} measurements are all used up; "
            "add a sensor or ignore less"
        )
    if first.seen[faults].all():
        return first.best_combination(faults), first
    longest = relation_space(model, ignored, model.most, rtol)
    blind = [name for name, j in zip(seen, faults, strict=True) if not longest.seen[j]]
    if blind:
        raise DesignError(
            f"a parity relation that ignores {what} cannot see {', '.join(blind)}: of up to order {model.most}, "
            "there is none that answers"
        )

    def seeing_all(order: int) -> RelationSpace | None:
        tried = relation_space(model, ignored, order, rtol)
        return tried if tried.seen[faults].all() else None

    space = at_smallest_degree(seeing_all, first.order + 1, model.most, longest)
    return space.best_combination(faults), space


@dataclass(frozen=True, eq=False)
class _Search:
    """What must be annihilated, in units of the plant's own: the equations that can take part.

    Attributes
    ----------
    pencil : Pencil
    used : ndarray of int
        Which equations are left.
    faults : ndarray, shape (equations, faults)
    units : ndarray, shape (equations,)
        What takes vectors to the units that the plant was written in.
    """

    pencil: Pencil
    used: NDArray[np.intp]
    faults: NDArray[np.float64]
    units: NDArray[np.float64]

    def space(self, found: PencilNullVectors) -> RelationSpace:
        """Return null vectors as relations, in the units of the model, with their responses to the faults."""
        vectors = np.zeros((len(found.vectors), found.degree + 1, len(self.faults)))
        vectors[:, :, self.used] = found.vectors
        level = np.sqrt(((found.units[:, :, None] * self.faults[self.used]) ** 2).sum(axis=1))
        responses = vectors @ self.faults / np.where(level > 0, level, 1.0)
        s = found.decision.singular_values
        smallest = found.decision.smallest_kept / s[0] if len(s) and found.decision.rank else 1.0
        floor = max(_SEEN, 100 * np.finfo(float).eps / smallest)
        return RelationSpace(vectors * self.units, self.pencil.basis, found.decision, responses, floor)


def _search(model: RelationModel, ignored: Sequence[str | int]) -> _Search:
    """Return what must be annihilated without the equations that cannot take part.

    A column with one entry only, such as that of a sensor fault, rules out its equation exactly.
    """
    own, units = model.in_own_units()
    whole = state_pencil(own.plant, own.ignored_columns(ignored), own.basis)
    present = (whole.P0 != 0) | (whole.P1 != 0)
    used = np.arange(len(present))
    while len(used):
        here = present[used]
        alone = here[:, here.sum(axis=0) == 1].any(axis=1)
        if not alone.any():
            break
        used = used[~alone]
    height = np.concatenate([units.equations, units.outputs])
    return _Search(pencil(whole.P0[used], whole.P1[used], own.basis), used, own.faults, height)
