"""Frank and Wuennenberg's parity relations: exact, and most of the faults for the least of the disturbances."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from residua import arrays
from residua.design.core.generator import ResidualGenerator
from residua.design.core.method import FAULTS, method
from residua.design.parity.relation import Relation, plant_rate
from residua.design.parity.relation_model import RelationModel, relation_model
from residua.design.parity.relations import ParityRelations, Poles, relations_of
from residua.design.parity.shortest import SEEN, RelationSpace, relation_space
from residua.errors import DesignError, ModelError
from residua.linear.polynomials.pair_relations import PairRelations
from residua.linear.polynomials.polynomial_basis import PolynomialBasis
from residua.linear.subspaces.parts import part_numbers
from residua.plant import Plant
from residua.plant.input_output_model import InputOutputModel
from residua.robust.parity.best_ratios import best_ratios
from residua.robust.parity.expected_signals import ExpectedSignals, Sizes, size_factor
from residua.shown import Shown

Columns = tuple[NDArray[np.float64], NDArray[np.float64]]
_METHOD = "optimal parity relations"
_REFERENCE = "Gertler (1991), eq. (6-6); Frank and Wuennenberg (1989)"
#: What a perfectly decoupled relation leaves of a fault that it counts as blind to, relative to what it sees most.
_BLIND = 1e-9


@dataclass(frozen=True, eq=False, repr=False)
class OptimalParity(Shown):
    r"""Exact relations in the order of their index :math:`|w^T Q_f| / |w^T Q_d|`.

    Attributes
    ----------
    generator : ResidualGenerator
        The relations chosen, the best first: zero while nothing fails and no disturbance acts.
    indices : ndarray
        Of all relations of this order, the largest first; infinite where the disturbances are decoupled exactly, with
        as many entries as there are such relations that see a fault.
    gains : ndarray
        Where the index is infinite: :math:`|w^T Q_f| / |w|`, in balanced units of the outputs or, where the plant has
        noise, by the noise; empty otherwise.
    blind : tuple of str
        Faults that the relations chosen do not see.
    """

    generator: ResidualGenerator
    indices: NDArray[np.float64]
    gains: NDArray[np.float64] = field(repr=False)
    blind: tuple[str, ...] = ()

    @property
    def index(self) -> float:
        """The index of the best relation."""
        return float(self.indices[0])

    @property
    def perfect(self) -> bool:
        """True if the disturbances are decoupled exactly."""
        return bool(np.isinf(self.index))

    @property
    def relations(self) -> ParityRelations:
        """The equations."""
        assert self.generator.relations is not None
        return self.generator.relations

    def __str__(self) -> str:
        listed = ", ".join(f"{x:.4g}" for x in self.indices)
        lines = [f"{_METHOD}: index {self.index:.4g} of {listed}", str(self.relations)]
        if self.blind:
            lines.append(f"does not see {', '.join(self.blind)}")
        return "\n".join(lines)


@dataclass(frozen=True, eq=False)
class _Task:
    """Faults and disturbances in expected sizes, as ``B`` and ``D`` of the balanced plant."""

    model: RelationModel
    wanted: Columns
    unwanted: Columns
    noise: Columns
    outputs: NDArray[np.float64]  # the sizes of what is expected in the part of each, balanced
    names: tuple[str, ...]
    constant: bool


@method(
    needs=[FAULTS, "an order"],
    exists_when="relations of this order that see a fault",
    order="r times the order of the relations",
    source="Frank and Wuennenberg (1989); Gertler (1991), eq. (6-6)",
    singular=True,
    noise="moving average",
)
def optimal_parity(
    plant: Plant | InputOutputModel,
    *,
    order: int,
    faults: Iterable[str | int] | str | None = None,
    disturbances: Iterable[str | int] | str | None = None,
    insensitive_to: Iterable[str | int] | str = (),
    sizes: Mapping[str, float] | None = None,
    constant: bool = False,
    noise: bool = False,
    variants: Iterable[Plant | InputOutputModel] = (),
    inputs: Sizes | None = None,
    states: Sizes | None = None,
    correlation_time: float = 0.0,
    relations: int = 1,
    poles: Poles | None = None,
) -> OptimalParity:
    r"""Design the parity relations with the largest response to faults, relative to that to disturbances.

    Of all vectors with :math:`w^T R = 0`, eq. (3-10), those that maximise

    .. math:: P = \frac{\lVert w^T Q_f \rVert}{\lVert w^T Q_d \rVert}

    one after the other: a generalised eigenproblem on a basis of the relations of this order. Where relations exist
    with :math:`w^T Q_d = 0` that see a fault, the index is infinite, and of those the ones with the largest
    :math:`\lVert w^T Q_f \rVert / \lVert w \rVert` are returned.

    Guaranteed (and checked): zero for the plant as modelled, for any state and any input, without faults and
    disturbances; no relation of this order has a larger index.

    Parameters
    ----------
    plant : Plant or InputOutputModel
        Continuous or sampled; ``E`` may be singular.
    order : int
        Relations of at most this order.
    faults : sequence of str, optional
        Those to see; all but ``insensitive_to`` when omitted.
    disturbances : sequence of str, optional
        The disturbances that count; all when omitted. None of the others is held back.
    insensitive_to : sequence of str
        Faults that count as disturbances.
    sizes : mapping of str to float, optional
        Expected sizes of faults and disturbances; one when omitted.
    constant : bool
        Whether faults count by what is left of them once they are constant, :math:`w^T Q_f (1, \dots, 1)^T`, and not as
        independent at every sample: the paper's index likes differences, which answer to a step for a moment.
    noise : bool
        Whether the noise of the plant counts among the disturbances; nothing is perfect then.
    variants : sequence of Plant or InputOutputModel
        Other models of the plant with the same signals and states: what they do otherwise than ``plant``,
        :math:`\Delta A\, x + \Delta B\, v` in the states and :math:`\Delta C\, x + \Delta D\, v` in the outputs, counts
        as disturbances.
    inputs, states, correlation_time
        Expected signals that multiply these differences, as for :func:`multi_model_parity`.
    relations : int
        How many relations are returned.
    poles : sequence of complex, or mapping of str to sequence, optional
        See :meth:`ParityRelations.with_poles`. The index is that of the relation itself.

    Returns
    -------
    OptimalParity

    Raises
    ------
    DesignError
        If there is no relation of this order, none sees a fault, or there are fewer than the requested number.
    ModelError
        If variants have other signals or other states.

    See Also
    --------
    parity_relations : Where disturbances can be decoupled.
    multi_model_parity : For a list of models.
    insensitive_parity : For parameters that drift.

    Notes
    -----
    Assumes: the model is exact, linear and time-invariant; faults and disturbances of different samples are taken as
    independent and of these sizes, as :math:`Q_f` and :math:`Q_d` do. In continuous time samples are derivatives,
    in units of the rate of the plant.

    With variants, states of different samples count as independent too, and as large as those of ``plant``:
    :func:`multi_model_parity` needs neither, but its relations are exact for no model. The differences are not proper
    disturbances, for what multiplies them is known: a perfect index against them often does not exist.

    References
    ----------
    Frank and Wuennenberg (1989), in: Patton, Frank, Clark, Fault Diagnosis in Dynamic Systems; Gertler (1991),
    eq. (6-6).

    Examples
    --------
    >>> import residua as rs
    >>> plant = rs.library.gertler().with_disturbances({"gust": [1, 0, 1]})
    >>> parity = rs.design.optimal_parity(plant, order=1, faults="p2")
    >>> parity.indices.round(4), parity.perfect
    (array([1.2]), False)
    >>> rs.design.optimal_parity(plant, order=2, faults="p2").perfect
    True
    """
    model = relation_model(plant)
    others, plant = list(variants), model.plant
    extra = [variant_columns(plant, others, inputs, states, correlation_time)] if others else []
    extra += [np.vstack([plant.Bw, plant.Dw])] if noise else []
    task = replace(_task(model, faults, disturbances, insensitive_to, sizes, extra), constant=bool(constant))
    if order != int(order) or order < 0:
        raise DesignError(f"order must be a whole number of past samples, got {order!r}")
    free = replace(model, decouples=False).equations()
    if not free.count(int(order)):
        raise DesignError(f"there is no relation of order {order}: take a higher one, see parity_orders")
    rows, indices, gains = _perfect(task, _decoupled(task), int(order))
    if not len(indices):
        rows, indices = _best(task, relation_space(free, int(order), task.wanted), _decoupled(task).count(int(order)))
    if not len(indices) or not indices[0] > 0:
        raise DesignError(
            f"no relation of order {order} sees {', '.join(task.names)}"
            + (" while constant" if constant else "")
            + ": take a higher order"
        )
    if relations != int(relations) or not 1 <= relations <= len(rows):
        raise DesignError(f"relations must be 1 to {len(rows)}, as many as there are here, got {relations!r}")
    return _made(task, rows[: int(relations)], indices, gains, poles)


def _task(
    model: RelationModel,
    faults: Iterable[str | int] | str | None,
    disturbances: Iterable[str | int] | str | None,
    insensitive_to: Iterable[str | int] | str,
    sizes: Mapping[str, float] | None,
    extra: list[NDArray[np.float64]],
) -> _Task:
    """Return the task: wanted and unwanted signals, scaled."""
    plant = model.plant
    ignored = [plant.faults[i] for i in arrays.positions(insensitive_to, plant.faults, "fault")]
    left = [name for name in plant.faults if name not in ignored]
    names = left if faults is None else [plant.faults[i] for i in arrays.positions(faults, plant.faults, "fault")]
    both = [name for name in names if name in ignored]
    if both or not names:
        raise DesignError(f"'{both[0]}' is to be seen and to be ignored" if both else "there is no fault to see")
    counted = arrays.positions(disturbances, plant.disturbances, "disturbance")
    # one size each, and none for a name that is neither a fault nor a disturbance
    size = np.diag(size_factor(dict(sizes or {}), (*plant.faults, *plant.disturbances), "fault or disturbance"))
    f = [plant.faults.index(name) for name in names]
    g = [plant.faults.index(name) for name in ignored]
    Bf, Bd, nf = np.vstack([plant.Bf, plant.Df]), np.vstack([plant.Bd, plant.Dd]), len(plant.faults)
    unwanted = np.hstack([Bd[:, counted] * size[nf:][counted], Bf[:, g] * size[g], *extra])
    noise = np.vstack([plant.Bw, plant.Dw])
    wanted, unwanted, noise = (_balanced(model, one) for one in (Bf[:, f] * size[f], unwanted, noise))
    return _Task(model, wanted, unwanted, noise, _output_sizes(model, size), tuple(names), constant=False)


def _output_sizes(model: RelationModel, sizes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the sizes of the balanced outputs for faults and disturbances of their expected sizes.

    The outputs of a part of the plant that nothing connects with another have no common unit with those of the other
    but by what is expected there: each part takes that of its own faults and disturbances.
    """
    plant, balanced = model.plant, model.balanced
    n, nd = len(balanced.A), len(plant.disturbances)
    B, D = (
        np.hstack([role[k] for role in (balanced.free, balanced.faults, balanced.disturbances, balanced.controls)])
        for k in (0, 1)
    )
    coupled = np.block([[np.eye(n) + np.abs(balanced.A), B], [balanced.C, D]]) != 0
    of_rows, of_columns = part_numbers(coupled)
    of_outputs = of_rows[n : n + plant.n_outputs]
    of_signals = of_columns[n + balanced.free[0].shape[1] :][: len(sizes)]
    units = balanced.units.inputs[len(plant.inputs) :]
    expected = np.log(sizes / np.concatenate([units[nd:], units[:nd]]))
    return np.exp([expected[of_signals == i].mean() if i in of_signals else 0.0 for i in of_outputs])


def _balanced(model: RelationModel, columns: NDArray[np.float64]) -> Columns:
    """Return what enters the equations and the outputs of the plant as ``B`` and ``D`` of the balanced one."""
    balanced, n = model.balanced, model.plant.n_states
    units = balanced.units
    B, D = units.equations[:, None] * columns[:n] / units.rate, units.outputs[:, None] * columns[n:]
    return balanced.derivative @ B, np.vstack([D, balanced.algebra @ B])


def _decoupled(task: _Task) -> PairRelations:
    """Return the relations that nothing unwanted reaches."""
    model = task.model.balanced
    sizes = np.maximum(*(np.abs(part).max(axis=0, initial=0.0) for part in task.unwanted))
    B, D = (part[:, sizes > 0] / sizes[sizes > 0] for part in task.unwanted)
    return PairRelations.of(model.A, np.hstack([model.free[0], B]), model.C, np.hstack([model.free[1], D]))


def _perfect(
    task: _Task, equations: PairRelations, order: int
) -> tuple[list[Relation], NDArray[np.float64], NDArray[np.float64]]:
    """Return the relations that decouple exactly and see a fault, by their response for their size."""
    space = relation_space(equations, order, task.wanted)
    largest = np.maximum(*(np.abs(part).max(axis=0, initial=0.0) for part in task.wanted))
    seen = np.linalg.norm(space.responses, axis=(0, 1)) > SEEN * largest
    if not space.count or not seen.any():
        return [], np.zeros(0), np.zeros(0)
    p, q = _in_powers(task, space)
    wanted = task.wanted[0] * seen, task.wanted[1] * seen
    N = _size_of(task, p, q)
    gains, combinations = best_ratios(_responses(p, q, wanted, task), N, space.count)
    terms, _ = best_ratios(_responses(np.abs(p), np.abs(q), (np.abs(wanted[0]), np.abs(wanted[1]))), N, space.count)
    kept = gains > _BLIND * terms[0]  # less is rounding of what cancels
    return [space.combined(c) for c in combinations[kept]], np.full(int(kept.sum()), np.inf), gains[kept]


def _best(task: _Task, space: RelationSpace, blind: int) -> tuple[list[Relation], NDArray[np.float64]]:
    """Return all relations by their index, without those that see neither faults nor disturbances."""
    p, q = _in_powers(task, space)
    F = _responses(p, q, task.wanted, task)
    indices, combinations = best_ratios(F, _responses(p, q, task.unwanted), space.count - blind)
    every = (np.abs(p) @ np.abs(task.wanted[0]) + np.abs(q) @ np.abs(task.wanted[1])).sum(axis=1)
    terms = np.linalg.norm(np.abs(combinations) @ every, axis=1)
    indices = np.where(np.linalg.norm(combinations @ F, axis=1) > _BLIND * terms, indices, 0.0)  # or it is rounding
    return [space.combined(c) for c in combinations], indices


def _in_powers(task: _Task, space: RelationSpace) -> tuple[NDArray, NDArray]:
    """Return the polynomials of relations in powers of the shift, or of the derivative at the rate of the plant."""
    plant = task.model.plant
    size = 1.0 if plant.is_discrete else plant_rate(plant) / plant.balanced.units.rate
    powers = PolynomialBasis.powers(space.order + 1, size)
    p, q = (space.basis.changed_to(powers, part.transpose(1, 0, 2)).transpose(1, 0, 2) for part in (space.p, space.q))
    return p, q


def _responses(p: NDArray, q: NDArray, columns: Columns, task: _Task | None = None) -> NDArray[np.float64]:
    """Return the responses to signals, all samples of each in one row, shape (relations, samples x signals).

    For a task that counts constant faults: what they settle to, shape (relations, signals).
    """
    every = p @ columns[0] + q @ columns[1]
    if task is not None and task.constant:
        return every.sum(axis=1) if task.model.plant.is_discrete else every[:, 0]
    return every.reshape(len(p), -1)


def _size_of(task: _Task, p: NDArray, q: NDArray) -> NDArray[np.float64]:
    """Return the size of a relation: its response to the noise, or its weights in units of the outputs."""
    if task.noise[0].shape[1]:
        noise = _responses(p, q, task.noise)
        if np.linalg.matrix_rank(noise) == len(p):
            return noise
    return (q[:, :, : task.model.plant.n_outputs] * task.outputs).reshape(len(q), -1)


def _made(
    task: _Task,
    rows: list[Relation],
    indices: NDArray[np.float64],
    gains: NDArray[np.float64],
    poles: Poles | None,
) -> OptimalParity:
    """Return the relations as a generator of the plant, with the faults that they do not see."""
    perfect = bool(np.isinf(indices[0]))
    model = task.model
    relations = relations_of(model.plant, rows).with_poles(poles, method=_METHOD, notes=model.notes)
    seen = {name for name in task.names if relations.structure[:, relations.faults.index(name)].any()}
    blind = tuple(name for name in task.names if name not in seen)
    notes = ("what counts as disturbance is decoupled exactly",) if perfect else ()
    conditions = {} if perfect else {"faults for disturbances (index)": float(indices[0])}
    evidence = relations.evidence.extended(
        conditions=conditions, notes=notes, references=(*relations.evidence.references, _REFERENCE)
    )
    return OptimalParity(replace(relations, evidence=evidence), indices, gains, blind)


def variant_columns(
    plant: Plant, variants: Sequence[Plant | InputOutputModel], inputs: Sizes | None, states: Sizes | None, time: float
) -> NDArray[np.float64]:
    r"""Return the columns :math:`[\Delta A\; \Delta B;\, \Delta C\; \Delta D]\, S` of variants, as few as they can be.

    ``S`` is a factor of the covariance of states, inputs and disturbances.

    Raises
    ------
    ModelError
        If signals, states or steps differ, or a plant has an ``E``.
    DesignError
        If sizes of states are missing for a continuous plant.
    """
    plants = [relation_model(one).plant for one in variants]
    for i, one in enumerate(plants):
        for what in ("inputs", "outputs", "disturbances", "n_states", "dt"):
            if getattr(one, what) != getattr(plant, what):
                raise ModelError(
                    f"variant {i} has other {what} than the plant: {getattr(one, what)} instead of "
                    f"{getattr(plant, what)}; differences of matrices need the same signals and states"
                )
    if any(one.E is not None for one in (plant, *plants)):
        raise ModelError("variants are compared by their matrices: write them without E first, plant.explicit()")
    if not plant.is_discrete and states is None:
        raise DesignError(
            "a continuous plant has no stationary states under white inputs: give their sizes, states=..."
        )
    driven = ExpectedSignals(inputs, None, states, time).driven(plant)
    S = driven.begin("the plant")
    whole = np.block([[plant.A, plant.B, plant.Bd], [plant.C, plant.D, plant.Dd]])
    differences = [
        (np.block([[one.A, one.B, one.Bd], [one.C, one.D, one.Dd]]) - whole) @ S / np.sqrt(len(plants))
        for one in plants
    ]
    columns = np.hstack(differences)
    size = np.abs(columns).max(axis=1, initial=0.0)
    units = np.where(size > 0, size, 1.0)[:, None]  # states and outputs have their own
    U, s, _ = np.linalg.svd(columns / units, full_matrices=False)
    kept = s > 1e-14 * s.max(initial=0.0)
    return units * U[:, kept] * s[kept]
