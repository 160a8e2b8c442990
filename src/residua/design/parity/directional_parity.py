"""Residuals that point in a direction of each fault's own, from parity equations."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua import arrays
from residua.design.core.generator import ResidualGenerator
from residua.design.core.method import method
from residua.design.core.needs import FAULTS
from residua.design.core.own_time import in_own_time
from residua.design.parity.directional_pencil import DirectionalPencil, Directions, directional_pencil
from residua.design.parity.relation import Relation
from residua.design.parity.relation_model import RelationModel, basis_for, relation_model, state_pencil
from residua.design.parity.relations import Poles, relations_of
from residua.design.parity.shortest import combinations_to_try, simplest_of_the_best
from residua.errors import AccuracyError, DesignError
from residua.linear.polynomials.common_factor import without_common_factor
from residua.linear.polynomials.degree_search import at_smallest_degree
from residua.linear.polynomials.pencil_null_space import PENCIL_RTOL
from residua.linear.polynomials.polynomial_basis import PolynomialBasis
from residua.linear.subspaces.rank import RankDecision, decide_rank, left_null_basis
from residua.plant import Plant
from residua.plant.comparable_units import canonical_units
from residua.plant.input_output_model import InputOutputModel
from residua.tolerances import TINY
from residua.words import counted

#: A response, or a singular value of what is read, below this fraction of the largest possible counts as none.
_SEEN = 1e-9


@method(
    needs=[FAULTS, "a direction for each"],
    exists_when="in general: s (r - 1) < r (p - q), for s directions of r components and q signals ignored",
    order="r times the order of the relations",
    source="Gertler (1991), section 5.2, eqs. (5-9) to (5-18)",
    faults="by direction, whatever its time course",
    decouples=True,
    singular=True,
    noise="moving average",
)
@in_own_time()
def directional_parity(
    plant: Plant | InputOutputModel,
    *,
    directions: Mapping[str, ArrayLike],
    insensitive_to: Iterable[str | int] | str = (),
    poles: Poles | None = None,
    order: int | None = None,
    rtol: float = PENCIL_RTOL,
) -> ResidualGenerator:
    r"""Design parity relations whose residual points in the direction of each fault, also in transients.

    .. math:: r^* = W(z)\, e^*, \qquad r^*(t \mid f_j) = d_j\, \gamma_j(z)\, f_j

    With the states as unknowns, and :math:`F_j` what a fault of any kind adds to the equations of states and outputs,
    all relations and the polynomials ``gamma`` are one left null vector,

    .. math:: x_i(z) \begin{bmatrix} zE - A \\ -C \end{bmatrix} = 0, \qquad x_i(z) F_j = d_{ij}\, \gamma_j(z),

    which solves (5-15) and (5-16) in one. Of the solutions of the smallest degree with all :math:`\gamma_j \neq 0` and
    independent residuals, that combination of a seeded choice is taken of which the weakest response is largest.

    Guaranteed (and checked): zero while nothing fails, for any state, input and disturbance; a fault of whatever time
    course keeps the residual on its line.

    Parameters
    ----------
    plant : Plant or InputOutputModel
        Continuous or sampled; ``E`` may be singular.
    directions : mapping of str to array_like, shape (residuals,)
        For each fault that shall have a direction; its length decides the number of residuals. The others are free:
        they move the residual anywhere.
    insensitive_to : sequence of str
        Faults to ignore, besides all disturbances.
    poles : sequence of complex, optional
        The same for all residuals, as many as the order: others would bend the directions. See
        :meth:`ParityRelations.with_poles`.
    order : int, optional
        The highest order; the smallest at which there is a solution when omitted.
    rtol : float
        Relative tolerance of rank decisions, in balanced units.

    Returns
    -------
    ResidualGenerator
        With the requested ``directions``, of unit length and up to sign.

    Raises
    ------
    DesignError
        If the directions are too many, or do not go with this plant: with the numbers of conditions and unknowns, or
        the fault whose response must vanish; if the order is too low; if poles differ between the residuals.
    AccuracyError
        If the polynomials lose so many digits that directions are missed.

    See Also
    --------
    detection_filter : The directions that the plant has.
    structured_parity : Names by code.
    robust_detection_filter : A filter, with disturbances decoupled.

    Notes
    -----
    Assumes: the model is exact, linear and time-invariant, and one fault is there at a time.

    Counting: of ``m`` outputs and ``q`` decoupled signals, ``r (m - q)`` polynomials are free, of which one sets the
    scale; ``s`` directions are ``s (r - 1)`` conditions. For directions in general position there is a solution when
    ``s (r - 1) <= r (m - q) - 1``: at most ``m + 1`` directions for ``m`` residuals without disturbances. Which
    responses can be kept from vanishing, and how many residuals are independent, is decided at points of the plane,
    whatever the degree; the search at a bounded degree starts only when there are any. The minimal indices of the
    pencil add up to at most the rank of what ``z`` multiplies, ``r rank E``: no higher degree is needed.

    References
    ----------
    Gertler (1991), section 5.2, eqs. (5-9) to (5-18), Example 3 B.

    Examples
    --------
    >>> import residua as rs
    >>> flt = rs.design.directional_parity(rs.library.gertler(), directions={"p1": [2, 1], "p2": [1, 2]})
    >>> flt.relations.orders
    (2, 2)
    >>> {name: (direction / direction[0]).round(6).tolist() for name, direction in flt.directions.items()}
    {'p1': [1.0, 0.5], 'p2': [1.0, 2.0]}
    """
    model = relation_model(plant)
    wanted = _checked(directions, model.plant)
    ignored = [model.plant.faults[i] for i in arrays.positions(insensitive_to, model.plant.faults, "fault")]
    both = [name for name in wanted.faults if name in ignored]
    if both:
        raise DesignError(f"fault {both[0]!r} can have a direction or be ignored, not both")
    units = canonical_units(model.plant)  # parts that nothing connects are not combined in units of the caller
    even = replace(relation_model(units.applied(model.plant)), notes=model.notes)
    most = _highest_degree(even, wanted, order)
    basis = basis_for(even.plant, most + 1)
    joint = directional_pencil(even.plant, even.ignored_columns(ignored), wanted, basis, rtol=rtol)
    generic = _attainable(even, joint, wanted, ignored, rtol)
    solutions = _shortest(joint, generic, most, rtol) if order is None else _of_order(joint, generic, order, most, rtol)
    X = joint.relations(solutions.best_combination())
    rows = [
        replace(row, p=units.equations * row.p, q=units.outputs * row.q, ignored=model.ignored_columns(ignored))
        for row in _relations(even, X, basis, ignored, divide=order is not None)
    ]
    relations = relations_of(model.plant, rows, directions=wanted)
    notes = (*model.notes, *((f"ignores {', '.join(ignored)}",) if ignored else ()), *_free(model, wanted, ignored))
    try:
        made = relations.with_poles(poles, method="directional parity relations", notes=notes)
    except AccuracyError as error:
        k = relations.orders[0]
        raise AccuracyError(
            f"as relations of order {k} with these poles, {error}; give {counted(k, 'pole')} near those of "
            "the plant, or ask for fewer directions"
        ) from error
    ranks = {**made.evidence.ranks, "directions and ignored signals": joint.decision, "states": solutions.decision}
    references = (*made.evidence.references, "Gertler (1991), section 5.2, eqs. (5-9) to (5-18)")
    r = made.n_residuals
    short = (f"only {generic.rank} of the {r} residuals are independent",) if generic.rank < r else ()
    return replace(made, evidence=made.evidence.extended(ranks=ranks, references=references, notes=short))


@dataclass(frozen=True, eq=False)
class _Generic:
    """What solutions of any degree can do: seen from points of the plane.

    Attributes
    ----------
    points : ndarray
    rank : int
        How many residuals can be independent.
    """

    points: NDArray[np.complex128]
    rank: int


@dataclass(frozen=True, eq=False)
class _Solutions:
    """All solutions of at most a degree, with what decides between them.

    Attributes
    ----------
    vectors : ndarray, shape (count, degree + 1, rows)
        Coordinates, orthonormal in balanced units.
    responses : ndarray, shape (count, degree + 1, faults)
        ``gamma`` in balanced units.
    read : ndarray, shape (count, points, residuals, outputs)
        ``W`` at some points, in balanced units.
    rank : int
        Of ``W`` that is attainable.
    decision : RankDecision
    """

    vectors: NDArray[np.float64]
    responses: NDArray[np.float64]
    read: NDArray[np.complex128]
    rank: int
    decision: RankDecision

    def quality(self, tries: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return for combinations the size of the weakest response, and what the weakest residual reads of its own."""
        response = np.linalg.norm(np.einsum("tn,nkf->tkf", tries, self.responses), axis=1).min(axis=1, initial=np.inf)
        W = np.einsum("tn,npij->tpij", tries, self.read)
        s = np.linalg.svd(W, compute_uv=False)
        own = s[..., self.rank - 1] if self.rank <= s.shape[-1] else np.zeros(s.shape[:-1])
        return response, np.asarray(np.median(own, axis=1), dtype=np.float64)

    @property
    def serves(self) -> bool:
        """Whether some combination answers to all faults, with as many independent residuals as are attainable."""
        if not len(self.vectors):
            return False
        response, own = self.quality(combinations_to_try(self.responses))
        return bool(np.any((response > _SEEN) & (own > _SEEN)))

    def best_combination(self) -> NDArray[np.float64]:
        """Return the combination of which the weakest response, or residual, is strongest."""
        tries = combinations_to_try(self.responses)
        response, own = self.quality(tries)
        score = np.minimum(response / response.max(), own / own.max())
        return np.einsum("n,nkj->kj", tries[simplest_of_the_best(score)], self.vectors)


def _checked(directions: Mapping[str, ArrayLike], plant: Plant) -> Directions:
    """Return directions as columns of one matrix."""
    if not isinstance(directions, Mapping) or not directions:
        raise DesignError("directions must map names of faults to vectors, and name one fault at least")
    faults = tuple(plant.faults[arrays.index_of(name, plant.faults, "fault")] for name in directions)
    if len(set(faults)) < len(faults):
        raise DesignError("directions name a fault twice")
    columns = []
    for name, value in directions.items():
        try:
            vector = np.asarray(value, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise DesignError(f"the direction of {name!r} must be a list of numbers: {error}") from error
        if vector.ndim != 1 or not vector.size or not np.isfinite(vector).all():
            raise DesignError(f"the direction of {name!r} must be a list of finite numbers, one per residual")
        if not np.any(vector):
            raise DesignError(f"the direction of {name!r} is zero: name the fault in insensitive_to to ignore it")
        columns.append(vector)
    lengths = sorted({len(column) for column in columns})
    if len(lengths) > 1:
        raise DesignError(f"directions must have one entry per residual, all the same number: got {lengths}")
    return Directions(faults, np.column_stack(columns))


def _highest_degree(model: RelationModel, wanted: Directions, order: int | None) -> int:
    """Return the degree up to which solutions are looked for."""
    E = model.plant.E
    dynamic = model.plant.n_states if E is None else decide_rank(E).rank
    if order is None:
        return wanted.count * dynamic
    if order != int(order) or order < 0:
        raise DesignError(f"order must be a whole number of past samples, got {order!r}")
    return max(int(order), wanted.count * dynamic)


def _attainable(
    model: RelationModel, joint: DirectionalPencil, wanted: Directions, ignored: Sequence[str], rtol: float
) -> _Generic:
    """Return what solutions can do, or say why there are none."""
    points = _points(joint)
    spaces = [left_null_basis(_balanced_at(joint, z), rtol=max(rtol, 1e-11))[0].T for z in points]
    count = min(len(Y) for Y in spaces)
    free = _independent_relations(model, ignored, points, rtol)
    r, s = wanted.vectors.shape
    said = (
        f"{s} direction{'s' * (s > 1)} of {r} residual{'s' * (r > 1)} are {s * (r - 1)} conditions; "
        f"{free} independent relation{'s' * (free != 1)} leave {max(r * free - 1, 0)} free polynomials"
    )
    ask = f"at most {(r * free - 1) // (r - 1)} directions" if r > 1 and free else "directions of fewer residuals"
    if not count:
        raise DesignError(
            f"no residuals keep {', '.join(wanted.faults)} to their directions: {said}; ask for {ask}, decouple less "
            "or add a sensor"
        )
    response = np.max(
        [np.linalg.norm(joint.balanced(Y)[1], axis=0) for Y in spaces if len(Y) == count], axis=0, initial=0.0
    )
    blind = [f"{name} ({size:.1e})" for name, size in zip(wanted.faults, response, strict=True) if size <= _SEEN]
    if blind:
        why = (
            f"ask for {ask}"
            if s * (r - 1) > r * free - 1
            else "its direction or its response depends on those of other faults"
        )
        raise DesignError(
            f"where residuals keep {', '.join(wanted.faults)} to their directions, the response to {', '.join(blind)} "
            f"vanishes: {said}; {why}: choose other directions, decouple less or add a sensor"
        )
    rng = np.random.default_rng(21)
    n = model.plant.n_states
    ranks = [0]
    for Y in spaces:
        mixed = rng.standard_normal((5, len(Y))) @ Y
        ranks += [decide_rank(W, rtol=_SEEN).rank for W in joint.balanced(mixed)[0][..., n:]]
    return _Generic(points, max(ranks))


def _points(joint: DirectionalPencil) -> NDArray[np.complex128]:
    """Return points around the poles of the plant, off the real axis."""
    basis = joint.reduced.basis
    center = float(basis.real.mean())
    radius = float(np.max(np.hypot(basis.real - center, basis.imaginary), initial=0.0))
    radius = max(radius, float(np.median(basis.sizes)))
    turned = np.exp(1j * np.array([0.4, 1.3, 2.3]))
    return np.asarray(center + radius * np.array([1.3, 1.1, 1.7]) * turned, dtype=np.complex128)


def _balanced_at(joint: DirectionalPencil, point: complex) -> NDArray[np.complex128]:
    """Return the pencil at a point, in columns of one size."""
    M = joint.at(point)
    size = np.linalg.norm(M, axis=0)
    return np.asarray(M / np.where(size > 0, size, 1.0), dtype=np.complex128)


def _independent_relations(
    model: RelationModel, ignored: Sequence[str], points: NDArray[np.complex128], rtol: float
) -> int:
    """Return how many relations ignore what is to be ignored, that are independent over polynomials."""
    one = state_pencil(model.plant, model.ignored_columns(ignored), model.basis)
    ranks = []
    for z in points:
        M = one.rows[:, None] * (one.P0 + z * one.P1) * one.columns
        size = np.linalg.norm(M, axis=0)
        ranks.append(decide_rank(M / np.where(size > 0, size, 1.0), rtol=max(rtol, 1e-11)).rank)
    return len(one.P0) - max(ranks)


def _solutions(joint: DirectionalPencil, generic: _Generic, degree: int, rtol: float) -> _Solutions:
    """Return all solutions of at most a degree."""
    y, decision = joint.null_vectors(degree, rtol)
    X, gammas = joint.balanced(y)
    n = joint.equations - joint.outputs
    elements = joint.reduced.basis.values(generic.points, degree)
    elements = elements / np.maximum(np.linalg.norm(elements, axis=1, keepdims=True), TINY)
    read = np.einsum("pk,nkij->npij", elements, X[..., n:])
    return _Solutions(y, gammas, read, generic.rank, decision)


def _shortest(joint: DirectionalPencil, generic: _Generic, most: int, rtol: float) -> _Solutions:
    """Return the solutions of the smallest degree that serve: doubled until some do, then halved."""
    low, degree = 0, min(1, most)
    while True:
        solutions = _solutions(joint, generic, degree, rtol)
        if solutions.serves:
            break
        if degree >= most:
            raise AccuracyError(
                f"solutions exist, but none of a degree up to {most} is found to working precision: ask for fewer "
                "directions, or give the plant in better units"
            )
        low, degree = degree + 1, min(2 * degree, most)

    def serving(middle: int) -> _Solutions | None:
        tried = _solutions(joint, generic, middle, rtol)
        return tried if tried.serves else None

    return at_smallest_degree(serving, low, degree, solutions)


def _of_order(joint: DirectionalPencil, generic: _Generic, order: int, most: int, rtol: float) -> _Solutions:
    """Return the solutions of an order, or say which is the smallest."""
    solutions = _solutions(joint, generic, int(order), rtol)
    if not solutions.serves:
        smallest = _shortest(joint, generic, most, rtol).vectors.shape[1] - 1
        raise DesignError(f"no relations of order {order} have these directions: the smallest order is {smallest}")
    return solutions


def _relations(
    model: RelationModel, X: NDArray[np.float64], basis: PolynomialBasis, ignored: Sequence[str], *, divide: bool
) -> list[Relation]:
    """Return coefficients as relations, without a factor that all of them share.

    There is none in those of the smallest degree: what is left without it would be shorter.
    """
    n, shape = model.plant.n_states, X.shape
    roots = np.zeros(0, dtype=np.complex128)
    if divide:
        flat, roots, _ = without_common_factor(X.reshape(len(X), -1), basis)
        X = flat.reshape(len(flat), *shape[1:])
    columns = model.ignored_columns(ignored)
    return [Relation(X[:, i, :n], X[:, i, n:], basis, columns, roots) for i in range(shape[1])]


def _free(model: RelationModel, wanted: Directions, ignored: Sequence[str]) -> tuple[str, ...]:
    """Return a note on the faults that may move the residual anywhere."""
    others = [name for name in model.plant.faults if name not in (*wanted.faults, *ignored)]
    return (f"{', '.join(others)}: no direction was asked for",) if others else ()
