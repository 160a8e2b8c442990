"""The largest output of every member of an uncertain system, with a proof that is checked."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.errors import AccuracyError, DesignError, SettingError
from residua.linear import lmi
from residua.linear.peak_norm import peak_norm
from residua.linear.robust_norm.centred import difference_system
from residua.linear.robust_norm.inequalities import METHODS, Certificate, Inequalities
from residua.linear.robust_norm.scaled_problem import ScaledProblem, check_sampled, scaled_problem
from residua.linear.robust_norm.weighted_star import common_ellipsoid
from residua.linear.robust_norm.worst_member import WorstMember, worst_member
from residua.linear.uncertain_system import UncertainSystem

Matrix = NDArray[np.float64]
_NEED_CONSTANT = ("lifted", "popov-tsypkin")
#: Relative improvement below which the search of the rate ends.
_SETTLED = 3e-4
_NOTE = "without the extra 'lmi': ellipsoids by weights; pip install 'residua[lmi]' for smaller bounds"


@dataclass(frozen=True, eq=False)
class RobustPeakNorm:
    """A bound of the output of every member of an uncertain system, for inputs of unit size, from rest.

    Attributes
    ----------
    bound : float
        No member, and no input of unit size, causes a larger output.
    method : {"lifted", "popov-tsypkin", "quadratic", "star", "centred"}
        What proved it.
    attained : float
        The largest output found, of the member ``worst``: no bound can be smaller.
    worst : dict of str to float
        Its parameters.
    visited : int
        Members visited.
    all_corners : bool
        Whether all corners of the set are among them.
    rate : float
        Decay rate of the ellipsoid per sample; NaN for ``"star"``.
    certificate : dict of str to ndarray
        The matrices of the proof, in scaled coordinates; ``"T"`` leads back, ``x = T x_scaled``. For ``"quadratic"``,
        ``V`` and ``g1``, ``g2`` prove it without the others.
    unit : float
        What outputs are divided by in scaled coordinates: ``bound = unit * sqrt(g1 + g2)``.
    eigenvalues : dict of str to float
        The smallest eigenvalue of each matrix that has to be definite, as computed after solving, scaled to a unit
        diagonal.
    boxes : int
        Parts that the set was cut into, each with a certificate; those given here are of the part with the largest
        bound.
    note : str
        What the reader should know; empty when there is nothing.
    """

    bound: float
    method: str
    attained: float
    worst: Mapping[str, float]
    visited: int
    all_corners: bool
    rate: float
    certificate: Mapping[str, Matrix]
    eigenvalues: Mapping[str, float]
    unit: float = 1.0
    boxes: int = 1
    note: str = ""

    @property
    def ratio(self) -> float:
        """The bound over what is attained: at least 1, and 1 where the bound cannot be improved."""
        return self.bound / self.attained if self.attained else 1.0

    def __float__(self) -> float:
        return self.bound


def robust_peak_norm(
    system: UncertainSystem,
    *,
    method: str | None = None,
    boxes: int = 1,
    rate: float | None = None,
    searches: int = 12,
    samples: int = 256,
    seed: int = 0,
) -> RobustPeakNorm:
    r"""Bound the output of every member of an uncertain system, for inputs with ``|w(k)| <= 1`` at every sample.

    A function :math:`V_F(x)` of the state, a quadratic form that may depend on the parameters, is sought such that
    :math:`V_F(x_+) \le (1-\lambda) V_F(x) + \lambda g_1 |w|^2` and :math:`|z|^2 \le V_F(x) + g_2 |w|^2` for all
    members; then :math:`|z| \le \sqrt{g_1 + g_2}`. Methods, from the smallest bound to the largest:

    - ``"lifted"``: any quadratic form of ``x`` and ``p = F C_q x``, so that :math:`V_F` is quadratic in ``F``;
      :math:`p_+` is a variable of its own, with full multipliers over both samples.
    - ``"popov-tsypkin"``: :math:`V_F = x^T P x + q^T N F q`, with multipliers of Popov and Tsypkin.
    - ``"quadratic"``: :math:`V = x^T P x`; also holds for parameters that vary in time.
    - ``"star"``: one ellipsoid from a linear equation with weights; also for parameters that vary in time. Needs no
      solver. Milliseconds.

    These are all at least the star norm of the worst member, which may be some ten per cent above its exact norm.

    - ``"centred"``: the exact norm of the centre of the set, plus the bound of ``"star"`` for what members differ from
      it by, which is small for a small set: there it is the smallest of all. That of ``"star"`` where it is less. Needs
      no solver.

    ``boxes`` cuts the set into parts, always that with the largest bound along the parameter that matters most; the
    largest bound of all parts holds for the set. With ``"centred"`` it comes down to the exact worst case.

    Every inequality is checked after solving, :math:`g_1` and :math:`g_2` are computed anew from the other matrices, so
    that the bound holds whatever the solver did; and the exact norm of the corners (up to 12 parameters; beyond,
    of many at random, and of their neighbours) and of points inside must not exceed it.

    Parameters
    ----------
    system : UncertainSystem
        Sampled.
    method : {"lifted", "popov-tsypkin", "quadratic", "star", "centred"}, optional
        When omitted, the smaller of ``"lifted"`` and ``"centred"``; without the extra ``lmi``, ``"centred"``, which
        ``note`` tells.
    boxes : int
        Most parts that the set is cut into. For parameters that are constant in time only.
    rate : float, optional
        ``lambda``; searched when omitted. Every rate gives a bound that holds.
    searches : int
        How many rates are tried for each inequality.
    samples : int
        Members drawn inside of the set for the check, and corners where there are too many.
    seed : int
        Of these.

    Returns
    -------
    RobustPeakNorm

    Raises
    ------
    ModelError
        If the system is continuous.
    DesignError
        If a member is not stable (it is named), or the method has no certificate for this set.
    AccuracyError
        If the check finds a member above the bound, or no solution could be verified.
    MissingExtraError
        If ``"lifted"`` or ``"popov-tsypkin"`` is asked for and the extra ``lmi`` is absent. ``"quadratic"`` then gives
        the bound of ``"star"``, which is larger, and ``note`` tells.

    Notes
    -----
    Assumes
        Parameters are constant in time (``"lifted"``, ``"popov-tsypkin"``); rest at the start.

    Parameters that stand in several places are one parameter with several channels; the multipliers are full over them.

    References
    ----------
    Haddad and Bernstein (1994), Automatica 30(6), 1015-1021: parameter-dependent Lyapunov functions in sampled time;
    Collins and Song (1999), Proc. American Control Conference; robust l1 fault detection, eqs. (38), (46)-(48), of
    which the last hold for the nominal plant only.

    Examples
    --------
    >>> from residua.linear import UncertainSystem, robust_peak_norm
    >>> lag = UncertainSystem([[0.5]], [[1.0]], [[1.0]], [[1.0]], [[1.0]], low=[0.0], high=[0.3], dt=1.0)
    >>> found = robust_peak_norm(lag, method="star")
    >>> round(found.bound, 4), round(found.attained, 4), found.worst
    (5.0, 5.0, {'f1': 0.3})
    """
    used, note = _chosen(method)
    check_sampled(system)
    if rate is not None and not 0 < rate < 1:
        raise SettingError(f"rate must lie in (0, 1), got {rate!r}")
    if min(boxes, searches, samples) < 1:
        raise SettingError("boxes, searches and samples must be at least 1")
    worst = worst_member(system, samples=samples, seed=seed)
    task = _Task(used, worst, rate, searches)
    parts = [_bound(system, task)]
    while len(parts) < boxes and np.isfinite(parts[0].widest):
        if parts[0].bound <= worst.attained * (1 + _SETTLED):
            break
        first = parts.pop(0)
        parts += [_bound(half, task) for half in _halves(first.system, int(first.widest))]
        parts.sort(key=lambda part: -part.bound)
    top = parts[0]
    if not np.isfinite(top.bound):
        raise _none(task, method, boxes)
    if worst.attained > top.bound * (1 + 1e-9):
        raise AccuracyError(
            f"a member has a peak norm of at least {worst.attained:.9g}, above the bound {top.bound:.9g} of method "
            f"{top.method!r}: the certificate is wrong in double precision; use method='star'"
        )
    values = dict(zip(system.parameters, (float(v) for v in worst.values), strict=True))
    return RobustPeakNorm(
        top.bound,
        top.method,
        worst.attained,
        values,
        worst.visited,
        worst.all_corners,
        top.rate,
        top.certificate,
        top.eigenvalues,
        top.unit,
        len(parts),
        note,
    )


def _chosen(method: str | None) -> tuple[tuple[str, ...], str]:
    """Return the methods to use, the smallest bound of which counts, and what the reader should know."""
    known = (*METHODS, "star", "centred")
    if method is not None and method not in known:
        raise SettingError(f"method must be one of {', '.join(map(repr, known))}, got {method!r}")
    if lmi.has_solver() or method == "star":
        return ((method,) if method else ("lifted", "centred")), ""
    if method in _NEED_CONSTANT:
        lmi.require_solver()
    return {None: ("centred",), "quadratic": ("star",), "centred": ("centred",)}[method], _NOTE


@dataclass(frozen=True, eq=False)
class _Task:
    """What is asked of every part of the set."""

    methods: tuple[str, ...]
    worst: WorstMember
    rate: float | None
    searches: int


@dataclass(frozen=True, eq=False)
class _Part:
    """The bound of one box of parameters."""

    system: UncertainSystem
    widest: float = np.nan
    bound: float = np.inf
    method: str = ""
    rate: float = np.nan
    certificate: Mapping[str, Matrix] = field(default_factory=dict)
    eigenvalues: Mapping[str, float] = field(default_factory=dict)
    unit: float = 1.0


def _halves(system: UncertainSystem, i: int) -> tuple[UncertainSystem, UncertainSystem]:
    middle = (system.low[i] + system.high[i]) / 2
    low, high = system.low.copy(), system.high.copy()
    low[i] = high[i] = middle
    return system.within(system.low, high), system.within(low, system.high)


def _bound(system: UncertainSystem, task: _Task) -> _Part:
    """Return the smallest bound of all methods over one box; infinite where none has a certificate."""
    if not (np.any(system.Cz) or np.any(system.Dzp) or np.any(system.Dzw)):
        return _Part(system, bound=0.0, method=task.methods[0])
    problem = scaled_problem(system)
    empty = _Part(system, problem.widest() if problem.groups else np.nan)
    found = [_by(method, system, problem, task) for method in task.methods]
    return min((replace(empty, **part) for part in found if part), key=lambda part: part.bound, default=empty)


def _by(method: str, system: UncertainSystem, problem: ScaledProblem, task: _Task) -> dict[str, Any]:
    if method == "centred":  # what holds by one ellipsoid holds here too
        found = _by_difference(system), _by_weights(problem)
        return min((one for one in found if one), key=lambda one: one["bound"], default={})
    if method == "star":
        return _by_weights(problem)
    return _by_inequalities(problem, system, method, task)


def _by_weights(problem: ScaledProblem) -> dict[str, Any]:
    found = common_ellipsoid(problem)
    if found is None:
        return {}
    return {
        "bound": found.bound * problem.unit,
        "method": "star",
        "certificate": {"Q": found.Q, "shares": found.shares, "T": problem.T},
        "eigenvalues": {"ellipsoid": float(np.linalg.eigvalsh(found.Q)[0]) if found.Q.size else np.inf},
        "unit": problem.unit,
    }


def _by_difference(system: UncertainSystem) -> dict[str, Any]:
    """Add the exact norm of the centre and the bound of what members differ from it by."""
    try:
        centre = peak_norm(system.member((system.low + system.high) / 2), rtol=1e-4).value
    except AccuracyError:  # too slow, or too many outputs
        return {}
    problem = scaled_problem(difference_system(system))
    if not problem.groups:
        return {"bound": centre, "method": "centred"}
    found = _by_weights(problem)
    return found | {"bound": centre + found["bound"], "method": "centred"} if found else {}


def _by_inequalities(problem: ScaledProblem, system: UncertainSystem, method: str, task: _Task) -> dict[str, Any]:
    inequalities = Inequalities(problem, method)
    if task.rate is not None:
        found = inequalities.solve(task.rate)
    else:
        room = 1 - task.worst.radius**2
        start = peak_norm(system.member((system.low + system.high) / 2), kind="star").rate
        found = _search(inequalities.solve, float(np.clip(start / room, 0.05, 0.8)), room, task.searches)
    if found is None:
        return {}
    return {
        "bound": found.bound * problem.unit,
        "method": method,
        "rate": found.rate,
        "certificate": found.matrices | {"T": problem.T},
        "eigenvalues": found.eigenvalues,
        "unit": problem.unit,
    }


def _none(task: _Task, method: str | None, boxes: int) -> DesignError:
    return DesignError(
        f"method {method or task.methods[0]!r} found no certificate for this set (largest spectral radius visited "
        f"{task.worst.radius:.6g}{'' if task.rate is None else f', rate {task.rate:g}'}): cut it into parts with "
        f"boxes={4 * boxes} or more, narrow it, or use a method with smaller bounds ('lifted', extra 'lmi')"
    )


def _search(
    solve: Callable[[float], Certificate | None], start: float, room: float, searches: int
) -> Certificate | None:
    """Search the rate, on a logistic scale of ``(0, room)``: a walk downhill, then parabolas through three points."""
    found: dict[float, float] = {}
    best: Certificate | None = None

    def value(t: float) -> float:
        nonlocal best
        if t not in found:
            made = solve(room / (1 + np.exp(-t)))
            found[t] = np.inf if made is None else made.bound
            if made is not None and (best is None or made.bound < best.bound):
                best = made
        return found[t]

    t, step = float(np.log(start / (1 - start))), 0.6
    for guess in (t, t - 1.5, t - 3.0, t + 1.5, t - 5.0):
        if len(found) < searches and np.isfinite(value(guess)):
            t = guess
            break
    while len(found) < searches and best is not None:
        left, right = value(t - step), value(t + step) if len(found) < searches else np.inf
        if min(left, right) < found[t]:
            t = t - step if left < right else t + step
            continue
        curve = left + right - 2 * found[t]
        shift = 0.5 * (left - right) / curve if np.isfinite(curve) and curve > 0 else 0.0
        # What a parabola through the three points promises; a bound is flat around its best rate.
        if len(found) >= searches or (0.5 * shift**2 * curve <= _SETTLED * found[t] and curve <= 0.03 * found[t]):
            break
        if shift and value(t + shift * step) < found[t]:
            t = t + shift * step
        step *= 0.3
    return best
