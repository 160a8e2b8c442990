"""The relations that ignore a set of signals, the shortest of them, and the shortest that see another set."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from residua.analysis.fault_space import fault_space
from residua.design.parity.relation import Relation
from residua.design.parity.relation_model import RelationModel, basis_for, state_pencil
from residua.errors import AccuracyError, DesignError
from residua.linear.polynomials.degree_search import at_smallest_degree
from residua.linear.polynomials.pencil_null_space import (
    Pencil,
    PencilNullVectors,
    pencil,
    pencil_null_vectors,
    shortest_pencil_null_vectors,
)
from residua.linear.polynomials.polynomial_basis import PolynomialBasis
from residua.linear.subspaces.rank import RankDecision
from residua.linear.systems.array_cache import copied
from residua.tolerances import POLYNOMIAL_LEAKAGE
from residua.words import used_up

#: A fault is seen by a relation when more than this of the largest response that its size allows is left.
_SEEN = 1e-9
#: What rounding in the numbers of a model may make of a singular value that would be zero: relations that hold to this,
#: and answer to their faults far more strongly, hold for the plant. In exact numbers, what is zero is so to 1e-16.
_OF_DATA = 1e-10
#: Those that count as zero must be this far below the others then, ...
_GAP = 1e3
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
    def clear(self) -> bool:
        """Whether nothing lies between the singular values that count as zero and those that do not."""
        return self.decision.smallest_kept > _GAP * self.decision.largest_dropped

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
    vectors = shortest_pencil_null_vectors(search.pencil, most=model.most, rtol=rtol)
    return None if vectors is None else search.space(vectors)


def shortest_relation(
    model: RelationModel, ignored: Sequence[str], seen: Sequence[str], rtol: float
) -> tuple[NDArray[np.float64], RelationSpace]:
    """Return the shortest relation that ignores some faults and all disturbances and answers to others.

    Raises
    ------
    DesignError
        If there is none: which of the faults no relation sees, or that there is no relation at all.
    AccuracyError
        If there is one by the ranks of the pencil, but the search has no result.
    """
    faults = [model.plant.faults.index(name) for name in seen]
    search = _search(model, ignored)
    exact = _shortest_seeing(search, faults, model.most, rtol)
    most = model.most if exact is None else exact.order - 1
    near = _shortest_seeing(search, faults, most, max(rtol, _OF_DATA)) if most >= 0 else None
    space = exact if near is None or not near.clear else near
    if space is not None:
        return space.best_combination(faults), space
    raise _refusal(model, search, ignored, seen, rtol)


def _shortest_seeing(search: _Search, faults: Sequence[int], most: int, rtol: float) -> RelationSpace | None:
    """Return the relations of the smallest order that answer to some faults; ``None`` when there are none."""
    vectors = shortest_pencil_null_vectors(search.pencil, most=most, rtol=rtol)
    if vectors is None:
        return None
    first = search.space(vectors)
    if first.seen[faults].all():
        return first

    def seeing_all(order: int) -> RelationSpace | None:
        tried = search.space(pencil_null_vectors(search.pencil, order, rtol=rtol))
        return tried if tried.seen[faults].all() else None

    longest = seeing_all(most)
    return None if longest is None else at_smallest_degree(seeing_all, first.order + 1, most, longest)


def _refusal(
    model: RelationModel, search: _Search, ignored: Sequence[str], seen: Sequence[str], rtol: float
) -> DesignError | AccuracyError:
    """Return what to raise when the search has no result: why there is no relation, or that rounding hides it."""
    what = ", ".join(f"'{name}'" for name in (*model.plant.disturbances, *ignored)) or "nothing"
    longest = search.space(pencil_null_vectors(search.pencil, model.most, rtol=rtol))
    space = fault_space(model.plant)
    hidden = space.closure(space.basis([model.plant.faults.index(name) for name in ignored]))
    if longest.count == 0 and not space.leaves(ignored):
        return DesignError(
            f"no parity relation ignores {what}: the {used_up(model.plant.n_outputs)}; add a sensor or ignore less"
        )
    blind = [name for name in seen if hidden[model.plant.faults.index(name)]]
    if blind:
        return DesignError(
            f"a parity relation that ignores {what} cannot see {', '.join(blind)}: of up to order {model.most}, "
            "there is none that answers"
        )
    return AccuracyError(
        f"a parity relation that ignores {what} and answers to {', '.join(seen)} exists, but none of an order up to "
        f"{model.most} is found to working precision: structured_bank needs no polynomials"
    )


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

    def space(self, null: PencilNullVectors) -> RelationSpace:
        """Return null vectors as relations, in the units of the model, with their responses to the faults."""
        vectors = np.zeros((len(null.vectors), null.degree + 1, len(self.faults)))
        vectors[:, :, self.used] = null.vectors
        level = np.sqrt(((null.units[:, :, None] * self.faults[self.used]) ** 2).sum(axis=1))
        responses = vectors @ self.faults / np.where(level > 0, level, 1.0)
        s = null.decision.singular_values
        smallest = null.decision.smallest_kept / s[0] if len(s) and null.decision.rank else 1.0
        dropped = null.decision.largest_dropped / s[0] if len(s) and s[0] else 0.0
        floor = max(_SEEN, 100 * np.finfo(float).eps / smallest, dropped / POLYNOMIAL_LEAKAGE)
        return RelationSpace(vectors * self.units, self.pencil.basis, copied(null.decision), responses, floor)


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
    part = pencil(whole.P0[used], whole.P1[used], own.basis, canonical=True)
    return _Search(part, used, own.faults, height)
