"""Residuals that point in a direction of each fault's own, from parity equations."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua import arrays
from residua.design.core.generator import ResidualGenerator
from residua.design.core.method import FAULTS, method
from residua.design.parity.directions import Directions
from residua.design.parity.relation import Relation
from residua.design.parity.relation_model import RelationModel, relation_model
from residua.design.parity.relations import Poles, relations_of
from residua.design.parity.shortest import (
    SEEN,
    RelationSpace,
    combinations_to_try,
    relation_space,
    simplest_of_the_best,
    with_rank,
)
from residua.errors import AccuracyError, DesignError
from residua.linear.polynomials.common_factor import without_common_factor
from residua.plant import Plant
from residua.plant.input_output_model import InputOutputModel
from residua.tolerances import BALANCED_ANSWER, TINY
from residua.words import counted

Matrix = NDArray[np.float64]
#: Points of the plane, in units of the rate of the plant, at which residuals are compared.
_POINTS = 1.3 * np.exp(1j * np.array([0.4, 1.3, 2.3]))


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
def directional_parity(
    plant: Plant | InputOutputModel,
    *,
    directions: Mapping[str, ArrayLike],
    insensitive_to: Iterable[str | int] | str = (),
    poles: Poles | None = None,
    order: int | None = None,
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
    responses can be kept from vanishing is decided by ranks of the balanced plant, whatever the degree.

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
    if order is not None and (order != int(order) or order < 0):
        raise DesignError(f"order must be a whole number of past samples, got {order!r}")
    wanted = wanted.kept_by(model, ignored)
    space, one, rank = _solution(model, wanted, ignored, order)
    p, q, roots = one.p, one.q, one.divided
    if order is not None:  # in those of the smallest order there is no factor that all share
        both, roots, _ = without_common_factor(np.hstack([p, q]), one.basis)
        p, q = both[:, : p.shape[1]], both[:, p.shape[1] :]
    rows = [replace(row, divided=roots) for row in wanted.apart(p, q, one.basis, one.equations)]
    relations = relations_of(model.plant, rows, directions=wanted)
    free = [name for name in model.plant.faults if name not in (*wanted.faults, *ignored)]
    notes = (*model.notes, *((f"ignores {', '.join(ignored)}",) if ignored else ()))
    notes += (f"{', '.join(free)}: no direction was asked for",) if free else ()
    try:
        generator = relations.with_poles(poles, method="directional parity relations", notes=notes)
    except AccuracyError as error:
        k = relations.orders[0]
        raise AccuracyError(
            f"as relations of order {k} with these poles, {error}; give {counted(k, 'pole')} near those of "
            "the plant, or ask for fewer directions"
        ) from error
    generator, r = with_rank(generator, space), generator.n_residuals
    short = (f"only {rank} of the {r} residuals are independent",) if rank < r else ()
    references = (*generator.evidence.references, "Gertler (1991), section 5.2, eqs. (5-9) to (5-18)")
    return replace(generator, evidence=generator.evidence.extended(references=references, notes=short))


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


def _solution(
    model: RelationModel, wanted: Directions, ignored: Sequence[str], order: int | None
) -> tuple[RelationSpace, Relation, int]:
    """Return the relations of an order, or the smallest that serves, the best of them and its independent residuals.

    Of combinations that are tried it is the one of which the weakest response, or residual, is strongest.
    """
    _check_attainable(model, wanted, ignored)
    equations = wanted.equations
    assert equations is not None
    assert equations.orders is not None
    columns, (smallest, longest) = wanted.responses(model), equations.orders
    whole = relation_space(equations, longest, columns)
    mixed = np.random.default_rng(21).standard_normal((5, whole.count))
    rank = int((_read(whole, wanted, mixed) > SEEN).sum(axis=2).max())

    def best(order: int) -> tuple[RelationSpace, Relation, int] | None:
        space = relation_space(equations, order, columns)
        if not space.count:
            return None
        tries = combinations_to_try(space.responses)
        response = np.linalg.norm(np.einsum("tn,nkf->tkf", tries, space.responses), axis=1).min(axis=1, initial=np.inf)
        reading = np.median(_read(space, wanted, tries)[..., rank - 1], axis=1) if rank else np.ones(len(tries))
        if not np.any((response > SEEN) & (reading > SEEN)):
            return None
        scores = np.minimum(response / response.max(), reading / reading.max())
        return space, space.combined(tries[simplest_of_the_best(scores)]), rank

    found = None if order is None else best(int(order))
    if found is not None:
        return found
    least = next((one for one in map(best, range(smallest, longest + 1)) if one is not None), None)
    if order is not None:
        smallest = longest if least is None else least[0].order
        raise DesignError(f"no relations of order {order} have these directions: the smallest order is {smallest}")
    if least is None:
        raise AccuracyError(
            f"solutions exist, but none of a degree up to {longest} is found to working precision: ask for fewer "
            "directions, or give the plant in better units"
        )
    return least


def _read(space: RelationSpace, wanted: Directions, tries: Matrix) -> Matrix:
    """Return singular values of what combinations of the relations read at some points, relative to their sizes."""
    values = space.basis.values(_POINTS, space.order)
    values = values / np.maximum(np.linalg.norm(values, axis=1, keepdims=True), TINY)
    q = np.einsum("tn,pk,nkj->tpj", tries, values, space.q)
    s = np.linalg.svd(q.reshape(len(tries), len(_POINTS), wanted.count, -1), compute_uv=False)
    return np.asarray(s, dtype=np.float64)


def _check_attainable(model: RelationModel, wanted: Directions, ignored: Sequence[str]) -> None:
    """Raise when no residuals keep to the directions, or none that answer."""
    equations = wanted.equations
    assert equations is not None
    free = len(model.equations(ignored).quotient.H)
    r, s = wanted.vectors.shape
    terms = (
        f"{s} direction{'s' * (s > 1)} of {r} residual{'s' * (r > 1)} are {s * (r - 1)} conditions; "
        f"{free} independent relation{'s' * (free != 1)} leave {max(r * free - 1, 0)} free polynomials"
    )
    ask = f"at most {(r * free - 1) // (r - 1)} directions" if r > 1 and free else "directions of fewer residuals"
    if equations.orders is None:
        raise DesignError(
            f"no residuals keep {', '.join(wanted.faults)} to their directions: {terms}; ask for {ask}, decouple less "
            "or add a sensor"
        )
    drive = np.linalg.norm(equations.quotient.drive(*wanted.responses(model)), axis=0)
    blind = [f"{name} ({x:.1e})" for name, x in zip(wanted.faults, drive, strict=True) if not x > BALANCED_ANSWER]
    if blind:
        why = (
            f"ask for {ask}"
            if s * (r - 1) > r * free - 1
            else "its direction or its response depends on those of other faults"
        )
        raise DesignError(
            f"where residuals keep {', '.join(wanted.faults)} to their directions, the response to {', '.join(blind)} "
            f"vanishes: {terms}; {why}: choose other directions, decouple less or add a sensor"
        )
