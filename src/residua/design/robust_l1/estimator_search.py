"""The search of one robust estimator: cheap norms over a few members, the worst members added, and the proof last."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from residua.design.robust_l1.certified_threshold import certified_threshold
from residua.design.robust_l1.differential_evolution import DifferentialEvolution
from residua.design.robust_l1.estimator_family import EstimatorFamily, estimator_family
from residua.design.robust_l1.genetic_search import GeneticSearch
from residua.design.robust_l1.robust_estimator import RobustEstimator
from residua.design.robust_l1.sampled_cost import PENALTY, SampledCost, Weights, sampled_cost
from residua.design.robust_l1.search_result import SearchResult
from residua.design.robust_l1.starting_gains import starting_gains
from residua.errors import DesignError
from residua.linear import smallest_gain
from residua.linear.robust_norm.worst_member import worst_member
from residua.plant import UncertainPlant, residual_over_set
from residua.progress import Progress

Matrix = NDArray[np.float64]
Search = DifferentialEvolution | GeneticSearch
#: How far the worst member may exceed those that the search has looked at before it is taken among them.
_MISSED = 1.002
_ROUNDS = 4
#: How much farther than the starting gains the search looks.
_REACH = 3.0


@dataclass(frozen=True, eq=False)
class Task:
    """What every estimator of the bank is designed with."""

    loop: UncertainPlant
    decouple: tuple[str, ...]
    sizes: Mapping[str, float]
    weights: Weights
    band: float
    radius: float
    search: Search
    method: str | None
    checkpoint: Path | None
    rtol: float
    seed: int


def search_estimator(task: Task, target: str, tell: Progress) -> RobustEstimator:
    """Search one estimator, take the worst members among those looked at, and certify what was found."""
    plant = task.loop.nominal
    decoupled = tuple(name for name in task.decouple if name != target)
    family = estimator_family(plant, target, decoupled, rtol=task.rtol)
    values = [task.loop.nominal_values, (task.loop.low + task.loop.high) / 2]
    points = _starts(family, task.radius)
    first = _cost(task, family, values)
    unit = _unit(first, np.array(points))
    # what is worst for the best start is mostly worst for the best estimator too
    values += _worse_members(task, first, points[int(np.argmin(first(np.array(points))))])
    for k in range(_ROUNDS):
        cost = replace(_cost(task, family, values), unit=unit)
        found = _searched(task, cost, np.array(points), f"{plant.faults.index(target) + 1}-{k + 1}", target, tell)
        fresh = _worse_members(task, cost, found.x)
        if not fresh:
            break
        values += fresh
        points.append(found.x)
    tell(f"{target}: certificate", 0, 1)
    return _certified(task, cost, found, target, decoupled, values)


def _starts(family: EstimatorFamily, radius: float) -> list[Matrix]:
    return [family.point(Z, g) for Z in starting_gains(family, radius) for g in np.eye(family.rows)]


def _unit(cost: SampledCost, starts: Matrix) -> float:
    """Return the cost of the best start, or say why there is none."""
    found = cost.norms(starts)
    target, ignored = cost.family.target, ", ".join(cost.family.decoupled) or "nothing"
    if not np.isfinite(found.disturbance).any():
        slow = float(found.radius.min())
        raise DesignError(
            f"no estimator for {target!r} that ignores {ignored} settles in time: its slowest pole stays "
            f"at {slow:.6g} from the origin, allowed are {cost.radius:.6g}; give a longer settling=, or decouple fewer "
            "faults (decouple=) and give the others a size (sizes=)"
        )
    costs = cost.weights.cost(found.disturbance, found.fault)
    if not np.isfinite(costs).any():
        raise DesignError(
            f"no estimator that ignores {ignored} sees {target!r} while it lasts: such faults leave no trace in the "
            "outputs once they have settled; decouple fewer faults, or add a sensor"
        )
    return float(np.nanmin(np.where(np.isfinite(costs), costs, np.nan)))


def _cost(task: Task, family: EstimatorFamily, values: list[Matrix]) -> SampledCost:
    members = [task.loop.member(v) for v in values]
    return sampled_cost(family, members, task.weights, radius=task.radius, band=task.band, bounded=task.sizes)


def _searched(task: Task, cost: SampledCost, starts: Matrix, label: str, target: str, tell: Progress) -> SearchResult:
    """Search a box around the starting gains, and a larger one where the best lies at its rim."""
    family = cost.family
    count = family.order * family.rows
    half = np.full(family.size, _REACH)
    half[:count] = _REACH * max(float(np.abs(starts[:, :count]).max(initial=0.0)), 0.1)
    for attempt in range(3):
        options = {}
        if task.checkpoint is not None:
            task.checkpoint.mkdir(parents=True, exist_ok=True)
            options["checkpoint"] = task.checkpoint / f"estimator-{label}-{attempt + 1}.json"
        found = task.search.minimise(
            cost,
            -half,
            half,
            start=starts,
            progress=lambda done, total, best: tell(f"{target}: search, cost {best:.5g}", done, total),
            **options,
        )
        if found.cost >= PENALTY:
            raise DesignError(
                f"no estimator was found that settles in time and sees {target!r} in every member of the set: for some "
                "the response to a lasting fault is zero; narrow the set, or decouple fewer faults (decouple=)"
            )
        if np.abs(found.x[:count]).max(initial=0.0) < 0.99 * half[:count].max(initial=1.0):
            break
        starts = np.vstack([starts, found.x])
        half[:count] *= _REACH
    return found


def _worse_members(task: Task, cost: SampledCost, point: Matrix) -> list[Matrix]:
    """Return members that are worse for an estimator than those that its search has looked at."""
    one, T = cost.family.estimator(point)
    known = cost.norms(point[None])
    nominal, out = task.loop.nominal_values, []
    if task.loop.nominal.disturbances:
        worst = worst_member(residual_over_set(task.loop, one, T), samples=64, seed=task.seed)
        if worst.attained > _MISSED * known.alone[0]:
            out.append(worst.values + nominal)
    answer = smallest_gain(residual_over_set(task.loop, one, T, signals=(cost.family.target,)), band=task.band)
    if answer.attained < known.fault[0] / _MISSED:
        out.append(np.array([answer.values[name] for name in task.loop.names]) + nominal)
    return out


def _certified(
    task: Task,
    cost: SampledCost,
    found: SearchResult,
    target: str,
    decoupled: tuple[str, ...],
    values: list[Matrix],
) -> RobustEstimator:
    """Give the residual its size, and certify threshold and response."""
    known = cost.norms(found.x[None])
    disturbance, fault = float(known.disturbance[0]), float(known.fault[0])
    scale = task.weights.scale(disturbance, fault)
    one, T = cost.family.estimator(found.x, scale)
    others = tuple(name for name in task.loop.nominal.faults if name != target)
    sized = {name: task.sizes[name] for name in others if task.sizes[name]}
    certificate = certified_threshold(task.loop, one, T, faults=others, sizes=sized, method=task.method)
    response = smallest_gain(residual_over_set(task.loop, one, T, signals=(target,)), band=task.band)
    if not response.bound > 0:
        raise DesignError(
            f"the response to {target!r} was not shown to be other than zero over the set (smallest found "
            f"{response.attained:.3g}): {response.note or 'narrow the set, or look at another band of frequencies'}"
        )
    members = tuple(dict(zip(task.loop.names, map(float, v), strict=True)) for v in values)
    return RobustEstimator(
        target,
        decoupled,
        one,
        T,
        certificate,
        response,
        float(task.weights.cost(np.array(disturbance), np.array(fault))),
        scale * disturbance,
        found,
        members,
    )
