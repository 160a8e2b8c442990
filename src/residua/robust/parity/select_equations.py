"""The least sensitive equations that still isolate the faults."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.analysis.codes import equal_codes
from residua.analysis.coding_choice import TIME_LIMIT, ChoiceTask, check_choice
from residua.analysis.coding_sets import CodingSet
from residua.analysis.cover import Cover, integer_program
from residua.design.banks.bank import Bank
from residua.design.core.generator import ResidualGenerator
from residua.design.core.internal_form import internal_form
from residua.design.core.signatures import steady_responses
from residua.design.parity.relation_model import relation_model
from residua.errors import AccuracyError, DesignError, ModelError, SettingError
from residua.plant import Plant
from residua.robust.parity.model_sensitivity import Model, checked_parameters
from residua.shown import Shown
from residua.tolerances import TINY

Respond = Callable[[Plant], NDArray[np.float64]]
#: Thresholds that are taken from the noise of the plant, in standard deviations.
_DEVIATIONS = 3.0


@dataclass(frozen=True, eq=False, repr=False)
class EquationChoice(Shown):
    r"""Equations chosen for isolation, with what errors of the parameters do to each.

    Attributes
    ----------
    residuals : tuple of str
        The names of all equations that there were to choose from.
    chosen : tuple of str
        Those chosen.
    parameters : tuple of str
    measures : ndarray, shape (residuals, parameters)
        :math:`\mu_{ik}`: the residual that the expected error of parameter ``k`` makes, for the threshold.
    costs : ndarray, shape (residuals,)
        The largest of these for each equation.
    coding_set : CodingSet
        Of the chosen equations: how well they isolate.
    notes : tuple of str
    """

    residuals: tuple[str, ...]
    chosen: tuple[str, ...]
    parameters: tuple[str, ...]
    measures: NDArray[np.float64] = field(repr=False)
    costs: NDArray[np.float64] = field(repr=False)
    coding_set: CodingSet = field(repr=False)
    notes: tuple[str, ...] = ()

    @property
    def worst(self) -> float:
        """The largest measure of a chosen equation: below one no expected error of one parameter raises an alarm."""
        return float(max(self.costs[self.residuals.index(name)] for name in self.chosen))

    def __str__(self) -> str:
        width = max(len(name) for name in self.residuals)
        head = " ".join(f"{name:>9}" for name in self.parameters)
        lines = [
            f"{len(self.chosen)} of {len(self.residuals)} equations, {self.coding_set.quality_of_groups} isolating"
        ]
        lines.append(f"  {'':{width}}   {head}")
        for name, row in zip(self.residuals, self.measures, strict=True):
            mark = "*" if name in self.chosen else " "
            lines.append(f"{mark} {name:{width}}   {' '.join(f'{x:9.3g}' for x in row)}")
        return "\n".join([*lines, *self.notes])


def select_equations(
    relations: ResidualGenerator | Bank,
    model: Model,
    parameters: Mapping[str, float],
    *,
    changes: Mapping[str, float] | None = None,
    inputs: ArrayLike | Mapping[str, float] | None = None,
    recording: ArrayLike | None = None,
    thresholds: ArrayLike | None = None,
    quality: str = "strong",
    criterion: str = "worst",
    time_limit: float = TIME_LIMIT,
) -> EquationChoice:
    r"""Choose, of many residuals with a structure, the set least sensitive to parameters that still isolates.

    The measure of residual ``i`` against the nominal uncertainty :math:`\Delta\theta_k^0` of parameter ``k`` is

    .. math:: \mu_{ik} = |r_i(\Delta\theta_k^0)| / \eta_i

    with what the residual settles to for ``inputs``, or its root mean square over a recording, for its threshold
    :math:`\eta_i`; of an increase and a decrease the larger. The cost of an equation is its largest measure.

    Guaranteed: no other choice that isolates as well has a smaller largest cost (``"worst"``) and, of those, a smaller
    sum; or a smaller sum (``"sum"``). Exact, by integer programming (HiGHS), unless ``notes`` say that time ran out.

    Parameters
    ----------
    relations : ResidualGenerator or Bank
        The equations to choose from, one per residual; what each answers to is its ``structure``. A bank for all rows
        that are attainable makes them: ``structured_parity(plant, rs.coding.attainable(...))``.
    model : function of the parameters, by name
        Returns a Plant or InputOutputModel with the inputs, outputs and step of the relations.
    parameters : mapping of str to float
        Names and nominal values.
    changes : mapping of str to float, optional
        The uncertainties :math:`\Delta\theta_k^0`; a tenth of the nominal value when omitted.
    inputs : array_like or mapping of str to float
        The constant inputs of the operating point, in the units of the model. Or:
    recording : array_like, shape (time, inputs)
        Inputs over which the root mean square is taken, from rest.
    thresholds : array_like, shape (residuals,), optional
        Three standard deviations from the noise of the plant when omitted.
    quality : {"strong", "weak"}
        How the chosen equations must isolate; where no equations of these can, weaker, as ``notes`` say.
    criterion : {"worst", "sum"}
    time_limit : float
        Seconds that the search may take.

    Returns
    -------
    EquationChoice

    Raises
    ------
    DesignError
        If a residual does not settle on a changed model, or no fault is seen.
    SettingError
        If neither or both of ``inputs`` and ``recording`` are there, or thresholds are missing.
    ModelError
        If the model has other signals.

    Notes
    -----
    Assumes: one parameter is off at a time, by no more than expected, and one fault is there at a time.

    Faults that all equations treat alike share a code, and are not isolated from each other.

    References
    ----------
    Gertler and Luo (1989); Gertler (1991), eq. (6-14).

    Examples
    --------
    >>> import residua as rs
    >>> def tanks(a, b):
    ...     A = [[-a, 0, 0], [a, -b, 0], [0, b, -0.2]]
    ...     plant = rs.Plant(A, [[1], [0], [0]], [[1, 0, 0], [0, 1, 0], [0, 0, 1]]).discretize(1.0)
    ...     return plant.with_sensor_faults().with_noise(measurement=1e-4)
    >>> plant = tanks(0.3, 0.25)
    >>> bank = rs.design.structured_parity(plant, ["110", "101", "011", "111"])
    >>> choice = rs.design.select_equations(bank, tanks, {"a": 0.3, "b": 0.25}, inputs=[1.0])
    >>> choice.chosen
    ('r1', 'r2', 'r3')
    """
    generator = relations.generator if isinstance(relations, Bank) else relations
    check_choice(quality, None, time_limit)
    if criterion not in ("worst", "sum"):
        raise SettingError(f"criterion must be 'worst' or 'sum', got {criterion!r}")
    if (inputs is None) == (recording is None):
        raise SettingError("give inputs, the operating point, or recording, the inputs over time; one of them")
    values, sizes = checked_parameters(parameters, changes)
    n = generator.n_residuals
    if thresholds is None:
        if generator.covariance is None:
            raise SettingError("give thresholds, one per residual, or the plant noise, plant.with_noise(...)")
        thresholds = _DEVIATIONS * np.sqrt(np.diag(generator.covariance))
    eta = np.asarray(thresholds, dtype=float)
    if eta.shape not in ((), (n,)) or not np.isfinite(eta).all() or np.any(eta <= 0):
        raise SettingError(f"thresholds must be {n} positive numbers, one per residual, got {thresholds!r}")
    respond = _steady(generator, inputs) if recording is None else _over(generator, recording)
    reference = generator.plant

    def response(changed: Mapping[str, float]) -> NDArray[np.float64]:
        plant = relation_model(model(**{**values, **changed})).plant
        if (plant.inputs, plant.outputs, plant.dt) != (reference.inputs, reference.outputs, generator.dt):
            raise ModelError(
                f"the model has the signals {', '.join((*plant.inputs, *plant.outputs))} and dt={plant.dt:g}, the "
                f"relations {', '.join((*reference.inputs, *reference.outputs))} and dt={generator.dt:g}"
            )
        return respond(plant)

    nominal, measures = response({}), np.zeros((n, len(values)))
    for k, (name, value) in enumerate(values.items()):
        for changed in (value + sizes[name], value - sizes[name]):
            off = np.atleast_2d(response({name: changed}) - nominal)  # one value, or over time
            measures[:, k] = np.maximum(measures[:, k], np.sqrt((off**2).mean(axis=0)) / eta)
    costs = measures.max(axis=1)
    chosen, notes = _chosen(generator, costs, quality, criterion, time_limit)
    names = tuple(generator.residuals[i] for i in chosen)
    rows = {generator.residuals[i]: [f for f, on in zip(generator.faults, generator.structure[i], strict=True) if on]
            for i in chosen}  # fmt: skip
    code = CodingSet.of(rows, generator.faults)
    return EquationChoice(generator.residuals, names, tuple(values), measures, costs, code, notes)


def _steady(generator: ResidualGenerator, inputs: ArrayLike | Mapping[str, float] | None) -> Respond:
    """Return the function from a plant to the steady residuals under constant inputs."""
    names = generator.plant.inputs
    if isinstance(inputs, Mapping):
        unknown = sorted(set(inputs) - set(names))
        if unknown:
            raise SettingError(f"there is no input {unknown[0]!r}; there are {', '.join(names) or 'none'}")
        inputs = [inputs.get(name, 0.0) for name in names]
    u = np.atleast_1d(np.asarray(inputs, dtype=float))
    if u.shape != (len(names),) or not np.isfinite(u).all():
        raise SettingError(f"inputs must be {len(names)} numbers, for {', '.join(names)}")

    def respond(plant: Plant) -> NDArray[np.float64]:
        form = internal_form(generator.system, plant, with_controls=True)
        form = form.select(inputs=range(form.n_inputs - len(names), form.n_inputs))
        if not form.is_stable():
            raise DesignError(
                "a residual does not settle on the changed model, which is not stable: give recording=..."
            )
        return steady_responses(form) @ u

    return respond


def _over(generator: ResidualGenerator, recording: ArrayLike | None) -> Respond:
    """Return the function from a plant to the residuals over a recording of the inputs."""
    u = np.asarray(recording, dtype=float)
    u = u[:, None] if u.ndim == 1 else u
    if u.ndim != 2 or u.shape[1] != len(generator.plant.inputs) or not len(u) or not np.isfinite(u).all():
        raise SettingError(f"recording must be (time, {len(generator.plant.inputs)}), got shape {u.shape}")
    if not generator.dt:
        raise SettingError("a recording needs sampled relations: sample the plant first, plant.discretize(dt)")
    return lambda plant: generator.run(u, plant.system(("control",)).simulate(u))


def _chosen(
    generator: ResidualGenerator, costs: NDArray[np.float64], quality: str, criterion: str, time_limit: float
) -> tuple[NDArray[np.int64], tuple[str, ...]]:
    """Return the cheapest equations that isolate."""
    structure = generator.structure
    groups = [group for group in equal_codes(structure) if structure[:, group[0]].any()]
    unseen = [name for name, code in zip(generator.faults, structure.T, strict=True) if not code.any()]
    if not groups:
        raise DesignError("no equation answers to any fault: there is nothing to isolate")
    notes = [f"no equation answers to {', '.join(unseen)}"] if unseen else []
    names = [tuple(generator.faults[j] for j in group) for group in groups]
    task = ChoiceTask(structure[:, [group[0] for group in groups]], names, set(range(len(groups))))
    cover, stuck = task.cover(quality == "strong")
    for j, k in stuck:
        notes.append(
            f"weakly isolating only: no equation answers to {' or '.join(names[k])} and ignores {' or '.join(names[j])}"
        )
    # with all equations up to the smallest largest cost every demand can be met
    least = max(float(costs[demand].min()) for demand in cover.demands)
    allowed = costs <= (least if criterion == "worst" else np.inf)
    chosen, proved = _cheapest(cover, costs, allowed, time_limit)
    if not proved:
        notes.append(f"the time limit of {time_limit:g} s was reached before it was proved that no choice is cheaper")
    return chosen, tuple(notes)


def _cheapest(
    cover: Cover, costs: NDArray[np.float64], allowed: NDArray[np.bool_], time_limit: float
) -> tuple[NDArray[np.int64], bool]:
    """Return the rows with the smallest sum of costs that meet all demands; of equal sums few rows."""
    few = 1e-6 * float(costs.max(initial=0.0)) + TINY
    aim = (costs + few) / (costs.max(initial=0.0) + few)
    constraints = [(cover.demands.astype(float), 1.0, np.inf)]
    result = integer_program(aim, constraints, allowed.astype(float), time_limit)
    if result.x is None:
        chosen = np.flatnonzero(allowed)
    else:
        chosen = np.flatnonzero(np.round(result.x[: len(costs)]))
    if not cover.met(chosen):
        raise AccuracyError("the integer program returned equations that do not isolate: report this plant")
    return chosen, result.status == 0
