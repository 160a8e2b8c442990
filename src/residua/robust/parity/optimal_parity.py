"""Frank and Wuennenberg's parity relations: exact, and most of the faults for the least of the disturbances."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from residua import arrays
from residua.design.core.generator import ResidualGenerator
from residua.design.core.method import method
from residua.design.core.needs import FAULTS
from residua.design.core.own_time import has_rates, in_own_time
from residua.design.parity.relation import Relation, plant_rate
from residua.design.parity.relation_model import RelationModel, relation_model
from residua.design.parity.relations import ParityRelations, Poles, relations_of
from residua.design.parity.shortest import RelationSpace, relation_space
from residua.errors import DesignError, ModelError
from residua.linear.polynomials.pencil_null_space import PENCIL_RTOL
from residua.linear.polynomials.polynomial_basis import PolynomialBasis
from residua.linear.subspaces.parts import part_numbers
from residua.linear.systems.balancing import descriptor_units
from residua.plant import Plant
from residua.plant.comparable_units import PlantUnits, own_units
from residua.plant.input_output_model import InputOutputModel
from residua.robust.parity.best_ratios import best_ratios
from residua.robust.parity.expected_signals import ExpectedSignals, Sizes, size_factor
from residua.shown import Shown

_METHOD = "optimal parity relations"
_REFERENCE = "Gertler (1991), eq. (6-6); Frank and Wuennenberg (1989)"
#: What a perfectly decoupled relation leaves of a fault that it counts as blind to, relative to what it sees most.
_BLIND = 1e-9


@has_rates()
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
        """Whether the disturbances are decoupled exactly."""
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
    """The plant with everything that is unwanted among its disturbances, in expected sizes."""

    plant: Plant
    sizes: NDArray[np.float64]  # of its faults, then of its disturbances
    aim: Plant
    unwanted: NDArray[np.float64]
    wanted: NDArray[np.float64]
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
@in_own_time()
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
    rtol: float = PENCIL_RTOL,
) -> OptimalParity:
    r"""Design the parity relations that see most of the faults for what they see of the disturbances.

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
    rtol : float
        Relative tolerance of rank decisions, in balanced units.

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
    others, written = list(variants), model
    units = own_units(model.plant).units
    if not others:  # which come in the units of the caller
        model, units = model.in_own_units()
    extra = [variant_columns(model.plant, others, inputs, states, correlation_time)] if others else []
    extra += [np.vstack([model.plant.Bw, model.plant.Dw])] if noise else []
    task = _task(model.plant, faults, disturbances, insensitive_to, sizes, extra, units)
    task = replace(task, constant=bool(constant))
    aim = replace(model, plant=task.aim)
    free = replace(model, plant=task.aim.without_disturbances())
    if order != int(order) or order < 0:
        raise DesignError(f"order must be a whole number of past samples, got {order!r}")
    everything = relation_space(free, (), int(order), rtol)
    if not everything.count:
        raise DesignError(f"there is no relation of order {order}: take a higher one, see parity_orders")
    decoupled = relation_space(aim, (), int(order), rtol)
    rows, indices, gains = _perfect(task, aim, decoupled)
    if not len(indices):
        rows, indices = _best(task, free, everything, decoupled.count)
    if not len(indices) or not indices[0] > 0:
        raise DesignError(
            f"no relation of order {order} sees {', '.join(task.names)}"
            + (" while constant" if constant else "")
            + ": take a higher order"
        )
    if relations != int(relations) or not 1 <= relations <= len(rows):
        raise DesignError(f"relations must be 1 to {len(rows)}, as many as there are here, got {relations!r}")
    chosen = [row.in_units_of_the_plant(units) for row in rows[: int(relations)]]
    return _made(written, task, chosen, indices, gains, poles)


def _task(
    plant: Plant,
    faults: Iterable[str | int] | str | None,
    disturbances: Iterable[str | int] | str | None,
    insensitive_to: Iterable[str | int] | str,
    sizes: Mapping[str, float] | None,
    extra: list[NDArray[np.float64]],
    units: PlantUnits,
) -> _Task:
    """Return what is wanted and unwanted, scaled."""
    ignored = [plant.faults[i] for i in arrays.positions(insensitive_to, plant.faults, "fault")]
    left = [name for name in plant.faults if name not in ignored]
    names = left if faults is None else [plant.faults[i] for i in arrays.positions(faults, plant.faults, "fault")]
    both = [name for name in names if name in ignored]
    if both or not names:
        raise DesignError(f"'{both[0]}' is to be seen and to be ignored" if both else "there is no fault to see")
    counted = arrays.positions(disturbances, plant.disturbances, "disturbance")
    # one size each, and none for a name that is neither a fault nor a disturbance
    by_name = dict(sizes or {})
    size = np.diag(size_factor(by_name, (*plant.faults, *plant.disturbances), "fault or disturbance"))
    size = size / np.concatenate([units.faults, units.disturbances])
    f = [plant.faults.index(name) for name in names]
    g = [plant.faults.index(name) for name in ignored]
    Bf, Bd = np.vstack([plant.Bf, plant.Df]), np.vstack([plant.Bd, plant.Dd])
    nf = len(plant.faults)
    wanted = Bf[:, f] * size[f]
    unwanted = np.hstack([Bd[:, counted] * size[nf:][counted], Bf[:, g] * size[g], *extra])
    aim = _disturbed_by(plant.without_faults([x for x in plant.faults if x not in names]), unwanted)
    return _Task(plant, size, aim, unwanted, wanted, tuple(names), constant=False)


def _disturbed_by(plant: Plant, columns: NDArray[np.float64]) -> Plant:
    """Return the plant with other disturbances than its own."""
    plant = plant.without_disturbances()
    kept = columns[:, np.abs(columns).max(axis=0, initial=0.0) > 0]
    if not kept.shape[1]:
        return plant
    n = plant.n_states
    return plant.with_disturbances({f"unwanted {i}": (c[:n], c[n:]) for i, c in enumerate(kept.T)})


def _perfect(
    task: _Task, aim: RelationModel, space: RelationSpace
) -> tuple[list[Relation], NDArray[np.float64], NDArray[np.float64]]:
    """Return the relations that decouple exactly and see a fault, by their response for their size."""
    nothing = np.zeros(0)
    if not space.count:
        return [], nothing, nothing
    order = [task.aim.faults.index(name) for name in task.names]
    if not space.seen[order].any():
        return [], nothing, nothing
    seen = np.where(space.sizes.max(axis=0, initial=0.0) > space.floor, 1.0, 0.0)[order]
    p, q = _in_powers(task.plant, space)
    F = _responses(p, q, task.wanted * seen, task)
    N = _size_of(task, p, q)
    gains, combinations = best_ratios(F, N, space.count)
    terms, _ = best_ratios(_responses(np.abs(p), np.abs(q), np.abs(task.wanted * seen)), N, space.count)
    kept = gains > _BLIND * terms[0]  # less is rounding of what cancels
    rows = [space.relation(aim, (), np.einsum("n,nkj->kj", c, space.vectors)) for c in combinations[kept]]
    return rows, np.full(int(kept.sum()), np.inf), gains[kept]


def _best(
    task: _Task, free: RelationModel, space: RelationSpace, blind: int
) -> tuple[list[Relation], NDArray[np.float64]]:
    """Return all relations by their index, without those that see neither faults nor disturbances."""
    p, q = _in_powers(task.plant, space)
    F = _responses(p, q, task.wanted, task)
    indices, combinations = best_ratios(F, _responses(p, q, task.unwanted), space.count - blind)
    every = (np.abs(np.concatenate([p, q], axis=2)) @ np.abs(task.wanted)).sum(axis=1)
    terms = np.linalg.norm(np.abs(combinations) @ every, axis=1)
    indices = np.where(np.linalg.norm(combinations @ F, axis=1) > _BLIND * terms, indices, 0.0)  # or it is rounding
    return [space.relation(free, (), np.einsum("n,nkj->kj", c, space.vectors)) for c in combinations], indices


def _in_powers(plant: Plant, space: RelationSpace) -> tuple[NDArray, NDArray]:
    """Return the polynomials of relations in powers of the shift, or of the derivative at the rate of the plant."""
    size = 1.0 if plant.is_discrete else plant_rate(plant)
    powers = PolynomialBasis.powers(space.order + 1, size)
    changed = space.basis.changed_to(powers, space.vectors.transpose(1, 0, 2)).transpose(1, 0, 2)
    return changed[:, :, : plant.n_states], changed[:, :, plant.n_states :]


def _responses(p: NDArray, q: NDArray, columns: NDArray[np.float64], task: _Task | None = None) -> NDArray[np.float64]:
    """Return the responses to signals, all samples of each in one row, shape (relations, samples x signals).

    For a task that counts constant faults: what they settle to, shape (relations, signals).
    """
    every = np.concatenate([p, q], axis=2) @ columns
    if task is not None and task.constant:
        return every.sum(axis=1) if task.plant.is_discrete else every[:, 0]
    return every.reshape(len(p), -1)


def _size_of(task: _Task, p: NDArray, q: NDArray) -> NDArray[np.float64]:
    """Return what the size of a relation is: its response to the noise, or its weights in units of the outputs."""
    plant = task.plant
    if plant.Bw.shape[1]:
        noise = _responses(p, q, np.vstack([plant.Bw, plant.Dw]))
        if np.linalg.matrix_rank(noise) == len(p):
            return noise
    return (q / _output_units(task)).reshape(len(q), -1)


def _output_units(task: _Task) -> NDArray[np.float64]:
    """Return the units of the outputs for faults and disturbances of their expected sizes.

    The outputs of a part of the plant that nothing connects with another have no common unit with those of the other
    but by what is expected there. Even units leave that open: each part takes that of its own faults and disturbances.
    """
    s = task.plant.system(("fault", "disturbance", "control"))
    k = len(task.sizes)
    size = np.concatenate([task.sizes, np.ones(s.n_inputs - k)])
    B, D = s.B * size, s.D * size
    u = descriptor_units(s.A, s.E, B, s.C, D)
    n = s.n_states
    coupled = np.block([[s.A, B], [s.C, D]]) != 0
    coupled[:n, :n] |= np.eye(n, dtype=bool) if s.E is None else s.E != 0
    of_rows, of_columns = part_numbers(coupled)
    of_outputs, of_signals = of_rows[n:], of_columns[n:][:k]
    common = [_mean_power(u.inputs[:k][of_signals == i]) if i in of_signals else 1.0 for i in of_outputs]
    return u.outputs * np.array(common)


def _mean_power(powers: NDArray[np.float64]) -> float:
    """Return the geometric mean of powers of two: of such that are a power of two as large, exactly so much larger."""
    whole, rest = divmod(int(np.rint(np.log2(powers)).sum()), len(powers))
    return float(np.ldexp(np.exp2(rest / len(powers)), whole))


def _made(
    model: RelationModel,
    task: _Task,
    rows: list[Relation],
    indices: NDArray[np.float64],
    gains: NDArray[np.float64],
    poles: Poles | None,
) -> OptimalParity:
    """Return the relations as a generator of the plant, with what they do not see."""
    perfect = bool(np.isinf(indices[0]))
    made = relations_of(model.plant, rows).with_poles(poles, method=_METHOD, notes=model.notes)
    seen = {name for name in task.names if made.structure[:, made.faults.index(name)].any()}
    blind = tuple(name for name in task.names if name not in seen)
    notes = ("what counts as disturbance is decoupled exactly",) if perfect else ()
    conditions = {} if perfect else {"faults for disturbances (index)": float(indices[0])}
    evidence = made.evidence.extended(
        conditions=conditions, notes=notes, references=(*made.evidence.references, _REFERENCE)
    )
    return OptimalParity(replace(made, evidence=evidence), indices, gains, blind)


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
