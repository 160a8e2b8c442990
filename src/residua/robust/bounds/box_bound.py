"""The bound of one box of parameters, by the method that is asked for."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from residua.errors import AccuracyError, SettingError
from residua.linear.norms.peak_norm import peak_norm
from residua.linear.subspaces.rank import spectral_norm
from residua.robust.bounds.centred import centred_bound
from residua.robust.bounds.inequalities import METHODS, Certificate, Inequalities
from residua.robust.bounds.scaled_problem import scaled_problem
from residua.robust.bounds.verified_star import verified_star
from residua.robust.bounds.weighted_star import common_ellipsoid
from residua.robust.bounds.worst_member import WorstMember
from residua.robust.sets.uncertain_system import UncertainSystem

Matrix = NDArray[np.float64]
#: Relative improvement below which the search of the rate ends.
_SETTLED = 3e-4
#: A bound around the centre that is this many times what is attained asks for an ellipsoid as well.
_LOOSE = 2.0


@dataclass(frozen=True, eq=False)
class Task:
    """The task for every box."""

    method: str
    worst: WorstMember
    rate: float | None
    searches: int


@dataclass(frozen=True, eq=False)
class BoxBound:
    """The bound of one box of parameters."""

    system: UncertainSystem
    widest: float = np.nan
    bound: float = np.inf
    method: str = ""
    rate: float = np.nan
    certificate: Mapping[str, Matrix] = field(default_factory=dict)
    eigenvalues: Mapping[str, float] = field(default_factory=dict)
    unit: float = 1.0


def check_method(method: str | None) -> None:
    """Raise unless it is a method, or none is asked for."""
    known = (*METHODS, "star", "centred")
    if method is not None and method not in known:
        raise SettingError(f"method must be one of {', '.join(map(repr, known))}, got {method!r}")


def box_bound(system: UncertainSystem, task: Task) -> BoxBound:
    """Bound the output of all members of one box; infinite where the method has no certificate."""
    if not np.any(system.Bw) or not (np.any(system.Cz) or np.any(system.Dzp)):
        direct = spectral_norm(system.Dzw)
        return BoxBound(system, bound=direct, method=task.method)
    if task.method == "centred":
        centred = _tried(_by_expansion, system)
        if centred.bound <= _LOOSE * task.worst.attained:
            return centred
        star = _tried(_by_weights, system)
        return star if star.bound < centred.bound or np.isnan(centred.widest) else centred
    return _tried(_by_weights if task.method == "star" else partial(_by_inequalities, task=task), system)


def _tried(method: Callable[[UncertainSystem], BoxBound], system: UncertainSystem) -> BoxBound:
    try:
        return method(system)
    except AccuracyError:  # too slow, or too far from normal, for its equations to be solved
        return BoxBound(system)


def _by_expansion(system: UncertainSystem) -> BoxBound:
    expansion = centred_bound(system)
    if expansion is None:
        return BoxBound(system)
    terms = {"linear": expansion.linear, "second": expansion.second, "rest": expansion.rest}
    return BoxBound(
        system,
        widest=int(np.argmax(expansion.blame)) if np.any(expansion.blame) else np.nan,
        bound=expansion.value,
        method="centred",
        certificate={name: np.array(value) for name, value in terms.items()},
        eigenvalues={"small gain": 1 - expansion.gain},
    )


def _by_weights(system: UncertainSystem) -> BoxBound:
    problem = scaled_problem(system)
    part = BoxBound(system, problem.widest())
    ellipsoid = common_ellipsoid(problem)
    sure = None if ellipsoid is None else verified_star(system, problem, ellipsoid)
    if ellipsoid is None or sure is None:
        return part
    return replace(
        part,
        bound=sure.bound,
        method="star",
        certificate={"Q": sure.Q, "shares": sure.shares},
        eigenvalues={"decrease": sure.least},
    )


def _by_inequalities(system: UncertainSystem, task: Task) -> BoxBound:
    problem = scaled_problem(system)
    part = BoxBound(system, problem.widest())
    inequalities = Inequalities(problem, task.method)
    if task.rate is not None:
        solution = inequalities.solve(task.rate)
    else:
        room = 1 - task.worst.radius**2
        start = peak_norm(system.member((system.low + system.high) / 2), kind="star").rate
        solution = _search(inequalities.solve, float(np.clip(start / room, 0.05, 0.8)), room, task.searches)
    if solution is None:
        return part
    return replace(
        part,
        bound=solution.bound * problem.unit,
        method=task.method,
        rate=solution.rate,
        certificate=solution.matrices | {"T": problem.T},
        eigenvalues=solution.eigenvalues,
        unit=problem.unit,
    )


def _search(
    solve: Callable[[float], Certificate | None], start: float, room: float, searches: int
) -> Certificate | None:
    """Search the rate, on a logistic scale of ``(0, room)``: a walk downhill, then parabolas through three points."""
    bounds: dict[float, float] = {}
    best: Certificate | None = None

    def value(t: float) -> float:
        nonlocal best
        if t not in bounds:
            made = solve(room / (1 + np.exp(-t)))
            bounds[t] = np.inf if made is None else made.bound
            if made is not None and (best is None or made.bound < best.bound):
                best = made
        return bounds[t]

    t, step = float(np.log(start / (1 - start))), 0.6
    for guess in (t, t - 1.5, t - 3.0, t + 1.5, t - 5.0):
        if len(bounds) < searches and np.isfinite(value(guess)):
            t = guess
            break
    while len(bounds) < searches and best is not None:
        left, right = value(t - step), value(t + step) if len(bounds) < searches else np.inf
        if min(left, right) < bounds[t]:
            t = t - step if left < right else t + step
            continue
        curve = left + right - 2 * bounds[t]
        shift = 0.5 * (left - right) / curve if np.isfinite(curve) and curve > 0 else 0.0
        # What a parabola through the three points promises; a bound is flat around its best rate.
        if len(bounds) >= searches or (0.5 * shift**2 * curve <= _SETTLED * bounds[t] and curve <= 0.03 * bounds[t]):
            break
        if shift and value(t + shift * step) < bounds[t]:
            t = t + shift * step
        step *= 0.3
    return best
