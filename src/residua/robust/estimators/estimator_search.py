"""The search of one robust estimator: cheap norms over a few members, the worst members added, and the proof last."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from hashlib import sha256
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from residua.errors import DesignError, NoCertificateError
from residua.progress import Progress
from residua.robust.bounds import smallest_gain
from residua.robust.bounds.worst_member import worst_member
from residua.robust.estimators.certified_threshold import certified_threshold
from residua.robust.estimators.differential_evolution import DifferentialEvolution
from residua.robust.estimators.estimator_family import EstimatorFamily
from residua.robust.estimators.genetic_checkpoint import settings_of
from residua.robust.estimators.genetic_search import GeneticSearch
from residua.robust.estimators.robust_estimator import RobustEstimator
from residua.robust.estimators.sampled_cost import PENALTY, Norms, SampledCost, Weights, sampled_cost
from residua.robust.estimators.search_result import SearchResult
from residua.robust.estimators.starting_gains import starting_gains
from residua.robust.sets.uncertain_loop import loop_parameters, residual_over_set
from residua.robust.sets.uncertain_plant import UncertainPlant

Matrix = NDArray[np.float64]
Search = DifferentialEvolution | GeneticSearch
#: How far the worst member may exceed those that the search has looked at before it is taken among them.
_MISSED = 1.002
_ROUNDS = 4
#: How much farther than the starting gains the search looks.
_REACH = 3.0
#: The unit of costs is chosen anew where further members make all of them dearer than this.
_DEAR = 10.0


@dataclass(frozen=True, eq=False)
class Task:
    """What every estimator of the bank is designed with.

    ``radii`` are largest spectral radii, in the order in which they are tried until a threshold is certified.
    """

    loop: UncertainPlant
    sizes: Mapping[str, float]
    weights: Weights
    band: float
    radii: tuple[float, ...]
    search: Search
    method: str | None
    checkpoint: Path | None
    seed: int

    def bounded(self, target: str) -> dict[str, float]:
        """Return the sizes of faults other than the target that estimators for it have to stand."""
        return {name: size for name, size in self.sizes.items() if name != target}


@dataclass(frozen=True, eq=False)
class _Sought:
    """The best estimator of a search, as a point, and the members of that search."""

    cost: SampledCost
    result: SearchResult
    values: list[Matrix]


def search_estimator(task: Task, family: EstimatorFamily, tell: Progress) -> tuple[RobustEstimator, str]:
    """Search one estimator, take the worst members among those looked at, and certify the result.

    Where no threshold is certified for one as slow as it may be, a faster one is searched; a note tells of that.
    """
    failure: NoCertificateError | None = None
    tried: list[float] = []
    for radius in task.radii:
        try:
            candidate = _sought(task, family, radius, tell)
        except DesignError:
            if failure is None:
                raise
            break  # none is as fast: what counts is why the slower ones have failed
        tried.append(_settling(task, radius))
        tell(f"{family.target}: certificate", 0, 1)
        try:
            made = _certified(task, candidate)
        except NoCertificateError as error:
            failure = failure or error
            continue
        return made, "" if failure is None else (
            f"settles in {tried[-1]:.3g} s: no threshold was certified for one that may take {tried[0]:.3g} s, the "
            "default; settling= sets it"
        )
    raise NoCertificateError(
        f"no threshold for {family.target!r} was certified over the set, for estimators that settle within "
        f"{', '.join(f'{t:.3g}' for t in tried)} s ({str(failure).partition(': ')[0]}): narrow the set, give a shorter "
        "or longer settling=, or decouple fewer faults (decouple=)"
    ) from failure


def _settling(task: Task, radius: float) -> float:
    """Return the seconds in which an estimator of a spectral radius settles to 2 per cent."""
    return float(task.loop.nominal.dt * np.log(0.02) / np.log(radius))


def _sought(task: Task, family: EstimatorFamily, radius: float, tell: Progress) -> _Sought:
    """Search over few members, and again with those among them that are worse for the result."""
    values = [task.loop.nominal_values, (task.loop.low + task.loop.high) / 2]
    points = [family.point(Z, g) for Z in starting_gains(family, radius) for g in np.eye(family.rows)]
    first = _cost(task, family, radius, values)
    norms = first.norms(np.array(points))
    unit = _least(task, first, norms, points, values)
    # what is worst for the best start is mostly worst for the best estimator too
    values += _worse_members(task, first, points[int(np.argmin(first.ranked(norms)))])
    for k in range(_ROUNDS):
        cost = _in_unit(_cost(task, family, radius, values), np.array(points), unit)
        best = _searched(task, cost, np.array(points), f"{k + 1}", tell)
        if best.cost >= PENALTY:
            raise DesignError(_blind(task, cost, best.x, values))
        fresh = _worse_members(task, cost, best.x)
        if not fresh:
            break
        values += fresh
        points.append(best.x)
    return _Sought(cost, best, values)


def _least(task: Task, cost: SampledCost, norms: Norms, starts: list[Matrix], values: list[Matrix]) -> float:
    """Return the cost of the best start, or say why there is none."""
    target, ignored = cost.family.target, ", ".join(cost.family.decoupled) or "nothing"
    if not np.isfinite(norms.disturbance).any():
        raise DesignError(
            f"no estimator for {target!r} that ignores {ignored} settles in time: its slowest pole stays at "
            f"{norms.radius.min():.6g} from the origin, allowed are {cost.radius:.6g}; give a longer settling=, or "
            "decouple fewer faults (decouple=) and give the others a size (sizes=)"
        )
    costs = cost.weights.cost(norms.disturbance, norms.fault)
    if not np.isfinite(costs).any():
        raise DesignError(_blind(task, cost, starts[int(np.nanargmin(norms.disturbance))], values))
    return float(costs[np.isfinite(costs)].min())


def _in_unit(cost: SampledCost, starts: Matrix, unit: float) -> SampledCost:
    """Return the cost in a unit in which that of the best start is not far from one."""
    norms = cost.norms(starts)
    costs = cost.weights.cost(norms.disturbance, norms.fault)
    least = float(np.min(costs[np.isfinite(costs)], initial=np.inf))
    # disturbances may reach the residual by way of the uncertainty only: then the first members have cost nothing
    return replace(cost, unit=least if unit * _DEAR < least < np.inf else unit or 1.0)


def _cost(task: Task, family: EstimatorFamily, radius: float, values: list[Matrix]) -> SampledCost:
    members = [task.loop.member(v) for v in values]
    bounded = task.bounded(family.target)
    cost = sampled_cost(family, members, task.weights, radius=radius, band=task.band, bounded=bounded)
    for part, v in zip(cost.parts, values, strict=True):
        if not part.radius < 1:
            raise DesignError(
                f"a member of the set is not stable: spectral radius {part.radius:.6g}{_at(task, v)}; nothing is "
                "bounded in it: narrow the set, or change the controller"
            )
    return cost


def _blind(task: Task, cost: SampledCost, point: Matrix, values: list[Matrix]) -> str:
    """Return why an estimator is of no use, the best of all as it is."""
    target, ignored = cost.family.target, ", ".join(cost.family.decoupled) or "nothing"
    for part, v in zip(cost.parts, values, strict=True):
        if not replace(cost, parts=(part,)).norms(point[None]).fault[0] > 0:
            return (
                f"no estimator was found that ignores {ignored} and sees {target!r} while it lasts in every member of "
                f"the set: its response is zero{_at(task, v)}; narrow the set, decouple fewer faults (decouple=), or "
                "add a sensor"
            )
    return (
        f"no estimator was found that ignores {ignored}, sees {target!r} and settles in time: give a longer settling="
    )


def _at(task: Task, values: Matrix) -> str:
    """Return where in the set a member is, as a part of a sentence."""
    named = ", ".join(f"{name} = {v:g}" for name, v in zip(task.loop.names, values, strict=True))
    return f" at {named}" if named else ""


def _searched(task: Task, cost: SampledCost, starts: Matrix, label: str, tell: Progress) -> SearchResult:
    """Search a box around the starting gains, and a larger one where the best lies at its rim."""
    family = cost.family
    count = family.order * family.rows
    half = np.full(family.size, _REACH)
    half[:count] = _REACH * max(float(np.abs(starts[:, :count]).max(initial=0.0)), 0.1)
    number = family.plant.faults.index(family.target) + 1
    for attempt in range(3):
        options = {}
        if task.checkpoint is not None:
            stage = f"estimator-{number}-{label}-{attempt + 1}-{_digest(task, cost, half, starts)}.json"
            options["checkpoint"] = task.checkpoint / stage
        result = task.search.minimise(
            cost,
            -half,
            half,
            start=starts,
            progress=lambda done, total, best: tell(f"{family.target}: search, cost {best:.5g}", done, total),
            **options,
        )
        if result.cost >= PENALTY or np.abs(result.x[:count]).max(initial=0.0) < 0.99 * half[:count].max(initial=1.0):
            break
        starts = np.vstack([starts, result.x])
        half[:count] *= _REACH
    return result


def _digest(task: Task, cost: SampledCost, half: Matrix, starts: Matrix) -> str:
    """Return what tells the stages of searches apart: settings that may differ between runs of one are no part of it.

    The starts of a later stage are the results of an earlier one, and so differ if that one goes on for longer.
    """
    whole = sha256(json.dumps([settings_of(task.search), *map(repr, (cost.weights, cost.radius, cost.unit))]).encode())
    q, parts = cost.family, (value for part in cost.parts for value in asdict(part).values())
    for value in (half, starts, q.A, q.C, cost.frequencies, cost.disturbances, *parts):
        whole.update(np.ascontiguousarray(value).tobytes())
    return whole.hexdigest()[:12]


def _worse_members(task: Task, cost: SampledCost, point: Matrix) -> list[Matrix]:
    """Return members that are worse for an estimator than those that its search has looked at."""
    one, T = cost.family.estimator(point)
    known = cost.norms(point[None])
    out = []
    if task.loop.nominal.disturbances:
        worst = worst_member(residual_over_set(task.loop, one, T), samples=64, seed=task.seed)
        if worst.attained > _MISSED * known.alone[0]:
            out.append(worst.values)
    answer = smallest_gain(residual_over_set(task.loop, one, T, signals=(cost.family.target,)), band=task.band)
    if answer.attained < known.fault[0] / _MISSED:
        out.append(answer.values)
    return [np.array(list(loop_parameters(task.loop, v).values())) for v in out]


def _certified(task: Task, sought: _Sought) -> RobustEstimator:
    """Give the residual its size, and certify threshold and response."""
    cost, best = sought.cost, sought.result
    known, target = cost.norms(best.x[None]), cost.family.target
    disturbance, fault = float(known.disturbance[0]), float(known.fault[0])
    scale = task.weights.scale(disturbance, fault)
    one, T = cost.family.estimator(best.x, scale)
    others = tuple(name for name in task.loop.nominal.faults if name != target)
    sizes = task.bounded(target)
    certificate = certified_threshold(task.loop, one, T, faults=others, sizes=sizes, method=task.method)
    response = smallest_gain(residual_over_set(task.loop, one, T, signals=(target,)), band=task.band)
    if not response.bound > 0:
        raise NoCertificateError(
            f"the response to {target!r} was not shown to be other than zero over the set (smallest found "
            f"{response.attained:.3g}): {response.note or 'narrow the set, or look at another band of frequencies'}"
        )
    return RobustEstimator(
        target,
        cost.family.decoupled,
        one,
        T,
        certificate,
        replace(response, values=loop_parameters(task.loop, response.values)),
        float(task.weights.cost(np.array(disturbance), np.array(fault))),
        scale * disturbance,
        best,
        tuple(dict(zip(task.loop.names, map(float, v), strict=True)) for v in sought.values),
    )
