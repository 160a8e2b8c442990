"""The largest output of every member of an uncertain system, with a proof that is checked."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.errors import AccuracyError, ModelError, NoCertificateError, SettingError
from residua.linear.norms import lmi
from residua.linear.norms.peak_norm import peak_norm
from residua.linear.subspaces.rank import spectral_norm
from residua.robust.bounds.centred import centred_bound
from residua.robust.bounds.inequalities import METHODS, Certificate, Inequalities
from residua.robust.bounds.star import common_ellipsoid, scaled_problem, verified_star
from residua.robust.sets.uncertain_system import MOST_CORNERS, REMEDY, UncertainSystem, check_modes, corner_points

Matrix = NDArray[np.float64]
_NEED_CONSTANT = ("lifted", "popov-tsypkin")
#: Parts that the set is cut into at most where nothing is asked for, and how far from what is attained is far then.
_BOXES, _FAR = 32, 1.1
#: States and twice the channels up to which matrix inequalities take minutes at most.
_PRACTICAL = 50
_WITHOUT = "without the extra 'lmi'"
#: Where a rate with a bound is looked for on the scale, one after the other.
_SHIFTS = (0.0, -1.5, -3.0, 1.5, -5.0)
#: Width of the search of a rate on its scale, how near it comes, and what stands for the logarithm of no bound.
_SPAN, _SETTLED, _TOO_LARGE = 6.0, 3e-2, 1e3
#: A bound around the centre that is this many times what is attained asks for an ellipsoid as well.
_LOOSE = 2.0
#: Numbers of impulse responses that are held at a time, and how many of their terms there are at most.
_CHUNK, _TERMS = 4_000_000, 4000
_ELLIPSOID = "responses around the centre are too long, or gains too large: the bound is that of an ellipsoid ('star')"


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
        The largest output of a visited member, ``worst``: no bound can be smaller.
    worst : dict of str to float
        Its parameters.
    visited : int
        Members visited.
    all_corners : bool
        Whether all corners of the set are among them.
    rate : float
        Decay rate of the ellipsoid per sample; NaN for ``"star"`` and ``"centred"``.
    certificate : dict of str to ndarray
        What proves it. ``"centred"``: the parts of the bound, ``linear``, ``second`` and ``rest``. ``"star"``: the
        ellipsoid ``Q`` and the ``shares`` of its terms. Else the matrices of the inequalities, in scaled coordinates;
        ``"T"`` leads back, ``x = T x_scaled``. For ``"quadratic"``, ``V``, ``g1`` and ``g2`` prove it without the rest.
    unit : float
        What outputs are divided by in scaled coordinates: ``bound = unit * sqrt(g1 + g2)``.
    eigenvalues : dict of str to float
        Numbers that have to be positive, computed after solving: the smallest eigenvalue of each matrix that has to be
        definite, scaled to a unit diagonal; ``"centred"``: one less the spectral radius of the gains.
    boxes : int
        Parts that the set was cut into, each with a certificate; those here are of the part with the largest
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
    rate: float = np.nan
    certificate: Mapping[str, Matrix] = field(default_factory=dict)
    eigenvalues: Mapping[str, float] = field(default_factory=dict)
    unit: float = 1.0
    boxes: int = 1
    note: str = ""

    @property
    def ratio(self) -> float:
        """The bound relative to the attained output: at least 1, and 1 if the bound cannot be improved."""
        return self.bound / self.attained if self.attained else 1.0

    def __float__(self) -> float:
        return self.bound


def robust_peak_norm(
    system: UncertainSystem,
    *,
    method: str | None = None,
    boxes: int | None = None,
    rtol: float = 1e-2,
    atol: float = 0.0,
    rate: float | None = None,
    searches: int = 12,
    samples: int = 256,
    seed: int = 0,
) -> RobustPeakNorm:
    r"""Bound the output of every member of an uncertain system, for inputs with ``|w(k)| <= 1`` at every sample.

    Around the centre of the set the parameters are :math:`F = F_c + \Phi`, and ``T_zw`` and so on lead from inputs
    ``w`` and parameters ``p`` to the output ``z`` and to what the parameters see, ``q``:

    - ``"centred"``: the norm of :math:`T_{zw} + T_{zp} \Phi T_{qw}`, exact at the corners of the set, where it is
      largest; the norms of all products of two parameters; and gains from peak to peak for the rest, which is of third
      order. Needs no solver. Milliseconds to a second; the smallest bound of all, unless the set is so large that these
      gains reach 1. Where it is more than twice what is attained, that of ``"star"`` if it is smaller.

    The others hold by a function :math:`V_F(x)` of the state, a quadratic form that may depend on the parameters, such
    that :math:`V_F(x_+) \le (1-\lambda) V_F(x) + \lambda g_1 |w|^2` and :math:`|z|^2 \le V_F(x) + g_2 |w|^2` for all
    members; then :math:`|z| \le \sqrt{g_1 + g_2}`. From the smallest bound to the largest:

    - ``"lifted"``: any quadratic form of ``x`` and ``p = F C_q x``, so that :math:`V_F` is quadratic in ``F``;
      :math:`p_+` is a variable of its own, with full multipliers over both samples.
    - ``"popov-tsypkin"``: :math:`V_F = x^T P x + q^T N F q`, with multipliers of Popov and Tsypkin.
    - ``"quadratic"``: :math:`V = x^T P x`; also holds for parameters that vary in time.
    - ``"star"``: one ellipsoid from a linear equation with weights; also for parameters that vary in time. Needs no
      solver. Milliseconds.

    These are all at least the star norm of the worst member, which may be some ten per cent above its exact norm; and
    one that is smaller in theory may have no solution that holds in double precision where ``"star"`` has.

    ``boxes`` cuts the set into parts, always that with the largest bound along the parameter that matters most; the
    largest bound of all parts holds for the set. With ``"centred"`` it comes down to the exact worst case, with the
    cube of the width of the parts.

    Every inequality is checked after solving, :math:`g_1` and :math:`g_2` are computed anew from the other matrices, so
    that the bound holds whatever the solver did; an ellipsoid is checked with the original system, and with what
    rounding may do to the check. For all methods, the exact norm of the corners (up to 12 parameters; beyond,
    of many at random, and of their neighbours) and of points inside must not exceed it.

    Parameters
    ----------
    system : UncertainSystem
        Sampled.
    method : {"lifted", "popov-tsypkin", "quadratic", "star", "centred"}, optional
        When omitted, ``"centred"``, of a set that is cut into up to 32 parts; where that leaves more than 10 per cent
        to what is attained the smaller of it and ``"lifted"``, if the extra ``lmi`` is there (else ``note`` tells) and
        the system is not too large.
    boxes : int, optional
        Most parts that the set is cut into; when omitted, 1 if ``method`` is set. Bounds of a set that is cut are for
        parameters that are constant in time.
    rtol, atol : float
        The set is not cut further once the bound is within ``rtol`` times what is attained, plus ``atol``, of it.
    rate : float, optional
        ``lambda``; searched when omitted. Every rate gives a bound that holds.
    searches : int
        How many rates are tried for each inequality.
    samples : int
        Members drawn inside of the set for the check, and corners if there are too many.
    seed : int
        Seed of the draw of these members.

    Returns
    -------
    RobustPeakNorm

    Raises
    ------
    ModelError
        If the system is continuous.
    DesignError
        If a member is not stable (it is named); a NoCertificateError if the method has no certificate for this set.
    AccuracyError
        If the check finds a member above the bound, or no solution could be verified.
    MissingExtraError
        If ``"lifted"`` or ``"popov-tsypkin"`` is asked for and the extra ``lmi`` is absent. ``"quadratic"`` then gives
        the bound of ``"star"``, which is larger, and ``note`` tells.

    Notes
    -----
    Assumes
        Parameters are constant in time (``"centred"``, ``"lifted"``, ``"popov-tsypkin"``); rest at the start.

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
    >>> norm = robust_peak_norm(lag, method="star")
    >>> round(norm.bound, 4), round(norm.attained, 4), norm.worst
    (5.0, 5.0, {'f1': 0.3})
    """
    if not isinstance(system, UncertainSystem):
        raise ModelError(
            f"the robust peak norm takes an UncertainSystem, got {type(system).__name__}: an uncertain plant makes one "
            "with in_closed_loop(controller).estimator_residual(gain, projection)"
        )
    if not system.dt:
        raise ModelError(
            "the robust peak norm is that of a sampled system, and this one is continuous: sample the plant first, "
            "UncertainPlant.discretize(dt), and see there what that leaves out"
        )
    check_method(method)
    used, note = method or "centred", ""
    if method in _NEED_CONSTANT:
        lmi.require_solver()
    if method == "quadratic" and not lmi.has_solver():
        used, note = "star", f"{_WITHOUT}: an ellipsoid by weights instead of {method!r}; pip install 'residua[lmi]'"
    if rate is not None and not 0 < rate < 1:
        raise SettingError(f"rate must lie in (0, 1), got {rate!r}")
    most = (1 if method else _BOXES) if boxes is None else boxes
    if min(most, searches, samples) < 1 or not (rtol >= 0 and atol >= 0):
        raise SettingError("boxes, searches and samples must be at least 1, rtol and atol 0 or more")
    worst = worst_member(system, samples=samples, seed=seed)
    search = {"worst": worst, "rate": rate, "searches": searches}
    parts = _cut(system, used, most, worst.attained * (1 + rtol) + atol, **search)
    if method is None and parts[0].bound > _FAR * worst.attained + atol:
        if system.n_states + 2 * len(system.channels) > _PRACTICAL:
            note = "'lifted' was not tried: it would take many minutes; method='lifted' does"
        elif not lmi.has_solver():
            note = f"{_WITHOUT}: 'lifted' was not tried; pip install 'residua[lmi]'"
        else:
            lifted = _box_bound(system, "lifted", **search)
            parts = [lifted] if lifted.bound < parts[0].bound else parts
    top = parts[0]
    if not np.isfinite(top.bound):
        others = [name for name in ("centred", "star", "lifted") if name != (method or "centred")]
        more = f"cut it into more parts, boxes={4 * most}, " if len(parts) >= most else ""
        raise NoCertificateError(
            f"method {method or used!r} found no certificate for this set in {len(parts)} "
            f"part{'s' if len(parts) > 1 else ''} (largest spectral radius visited {worst.radius:.6g}"
            f"{'' if rate is None else f', rate {rate:g}'}): {more}narrow it, or use another method "
            f"({', '.join(map(repr, others))})"
        )
    if used == "centred" and top.proof["method"] == "star":
        note = "; ".join(filter(None, (_ELLIPSOID, note)))
    if worst.attained > top.bound * (1 + 1e-9):
        raise AccuracyError(
            f"a member has a peak norm of at least {worst.attained:.9g}, above the bound {top.bound:.9g} of method "
            f"{top.proof['method']!r}: the certificate is wrong in double precision; use another method"
        )
    values = dict(zip(system.parameters, (float(v) for v in worst.values), strict=True))
    return RobustPeakNorm(
        bound=top.bound,
        attained=worst.attained,
        worst=values,
        visited=worst.visited,
        all_corners=worst.all_corners,
        boxes=len(parts),
        note=note,
        **top.proof,
    )


def check_method(method: str | None) -> None:
    """Raise unless it is a method, or none is asked for."""
    known = (*METHODS, "star", "centred")
    if method is not None and method not in known:
        raise SettingError(f"method must be one of {', '.join(map(repr, known))}, got {method!r}")


@dataclass(frozen=True, eq=False)
class _Box:
    """One box of parameters, the one along which to cut it, its bound, infinite without one, and what proves it."""

    system: UncertainSystem
    widest: float = np.nan
    bound: float = np.inf
    proof: dict[str, Any] = field(default_factory=dict)


def _cut(system: UncertainSystem, method: str, boxes: int, enough: float, **search: Any) -> list[_Box]:
    """Bound the set, cut in two where the bound is largest until it is small enough; the largest bound comes first."""
    parts = [_box_bound(system, method, **search)]
    while len(parts) < boxes and parts[0].bound > enough and np.isfinite(parts[0].widest):
        first = parts.pop(0)
        whole, i = first.system, int(first.widest)
        low, high = whole.low.copy(), whole.high.copy()
        low[i] = high[i] = (whole.low[i] + whole.high[i]) / 2
        halves = whole.within(whole.low, high), whole.within(low, whole.high)
        parts += [_box_bound(half, method, **search) for half in halves]
        parts.sort(key=lambda part: -part.bound)
    return parts


def _box_bound(system: UncertainSystem, method: str, *, worst: WorstMember, rate: float | None, searches: int) -> _Box:
    """Bound the output of all members of one box; infinite where the method has no certificate."""
    if not np.any(system.Bw) or not (np.any(system.Cz) or np.any(system.Dzp)):
        return _Box(system, bound=spectral_norm(system.Dzw), proof={"method": method})
    centred = other = _Box(system)
    # where it is too slow, or too far from normal, for its equations to be solved, a method has no bound
    with suppress(AccuracyError):
        found = centred_bound(system) if method == "centred" else None
        if found is not None:
            terms = {"linear": found.linear, "second": found.second, "rest": found.rest}
            certificate = {name: np.array(value) for name, value in terms.items()}
            proof = {"method": method, "certificate": certificate, "eigenvalues": {"small gain": 1 - found.gain}}
            widest = int(np.argmax(found.blame)) if np.any(found.blame) else np.nan
            centred = _Box(system, widest, found.value, proof)
    if centred.bound <= _LOOSE * worst.attained:
        return centred
    with suppress(AccuracyError):
        problem = scaled_problem(system)
        other = replace(other, widest=problem.widest())
        if method not in ("star", "centred"):
            return _by_inequalities(other, Inequalities(problem, method), worst.radius, rate, searches)
        ellipsoid = common_ellipsoid(problem)
        sure = None if ellipsoid is None else verified_star(system, problem, ellipsoid)
        if sure is not None:
            proof = {"method": "star", "certificate": {"Q": sure.Q, "shares": sure.shares}}
            other = replace(other, bound=sure.bound, proof=proof | {"eigenvalues": {"decrease": sure.least}})
    return other if other.bound < centred.bound or np.isnan(centred.widest) else centred


def _by_inequalities(box: _Box, inequalities: Inequalities, radius: float, rate: float | None, searches: int) -> _Box:
    """Bound one box by matrix inequalities, at the rate that is asked for or the best, on a logistic scale."""
    found: list[Certificate] = []

    def size(t: float) -> float:
        certificate = inequalities.solve(rate or room / (1 + np.exp(-t)))
        found.extend([] if certificate is None else [certificate])
        return _TOO_LARGE if certificate is None else float(np.log(certificate.bound))

    system, problem = box.system, inequalities.problem
    room = 1 - radius**2
    if rate is not None:
        size(0.0)
    else:
        from scipy.optimize import minimize_scalar  # slow to import, and not needed to run a monitor

        start = peak_norm(system.member((system.low + system.high) / 2), kind="star").rate
        share = float(np.clip(start / room, 0.05, 0.8))
        t = float(np.log(share / (1 - share)))
        guesses = [t + shift for shift in _SHIFTS[:searches]]
        tried = next((k for k, guess in enumerate(guesses, 1) if size(guess) < _TOO_LARGE), searches)
        if tried < searches:
            # the search looks at 0.38 of its span first
            span = (guesses[tried - 1] - 0.381966 * _SPAN, guesses[tried - 1] + 0.618034 * _SPAN)
            options = {"xatol": _SETTLED, "maxiter": searches - tried}
            minimize_scalar(size, bounds=span, method="bounded", options=options)
    if not found:
        return box
    best = min(found, key=lambda one: one.bound)
    proof = {
        "method": inequalities.method,
        "rate": best.rate,
        "certificate": best.matrices | {"T": problem.T},
        "eigenvalues": best.eigenvalues,
        "unit": problem.unit,
    }
    return replace(box, bound=best.bound * problem.unit, proof=proof)


@dataclass(frozen=True, eq=False)
class WorstMember:
    """The largest peak norm among the members that were visited.

    Attributes
    ----------
    attained : float
        Attained by an input of unit size.
    values : ndarray, shape (parameters,)
    radius : float
        Largest spectral radius of all members visited.
    visited : int
    all_corners : bool
    """

    attained: float
    values: NDArray[np.float64]
    radius: float
    visited: int
    all_corners: bool


def worst_member(system: UncertainSystem, *, samples: int, seed: int) -> WorstMember:
    """Visit the corners of the set, or as many at random, and points inside; then climb by single parameters."""
    rng = np.random.default_rng(seed)
    moving = np.flatnonzero(system.high > system.low)
    every = len(moving) <= MOST_CORNERS
    points = corner_points(system.low, system.high, samples, rng)
    points = np.vstack([points, system.sample(rng, samples)]) if len(moving) else points
    sizes, radius = _visit(system, points)
    visited = len(points)
    best = points[int(np.argmax(sizes))]
    if not every:
        for _ in range(5):
            near = np.repeat(best[None], len(moving), axis=0)
            row = np.arange(len(moving))
            near[row, moving] = system.low[moving] + system.high[moving] - near[row, moving]
            nearby, r = _visit(system, near)
            radius, visited = max(radius, r), visited + len(near)
            if nearby.max() <= sizes.max():
                break
            sizes, best = nearby, near[int(np.argmax(nearby))]
    candidates = np.vstack([best[None], points[np.argsort(-sizes)[:3]]]) if len(sizes) == len(points) else best[None]
    attained = []
    for v in candidates:
        try:
            attained.append(peak_norm(system.member(v), rtol=1e-4).attained)
        except AccuracyError:  # slow, or many outputs: a lower bound is all that is wanted
            attained.append(float(_visit(system, v[None])[0][0]))
    k = int(np.argmax(attained))
    return WorstMember(attained[k], candidates[k], radius, visited, every)


def _visit(system: UncertainSystem, points: Matrix) -> tuple[NDArray[np.float64], float]:
    """Return an output that some unit input attains, for every member, and the largest spectral radius."""
    p, m = system.Dzw.shape
    T = system.balanced_states()
    channels = list(system.channels)
    A0, Bp, Cq = system.A / T[:, None] * T, system.Bp / T[:, None], system.Cq * T
    Bw, Cz = system.Bw / T[:, None], system.Cz * T
    n = len(A0)
    radius, sizes = 0.0, []
    step = max(1, _CHUNK // max(_TERMS // 8 * p * m, 64 * n * n, 1))
    for start in range(0, len(points), step):
        part = points[start : start + step]
        F = part[:, channels][:, :, None] * Cq
        A, C = A0 + Bp @ F, Cz + system.Dzp @ F
        modes = np.linalg.eigvals(A) if n else np.zeros((len(part), 1))
        rho = np.abs(modes).max(axis=1)
        check_modes(modes, part, system.parameters, system.dt, f"no bound exists: {REMEDY}")
        radius = max(radius, float(rho.max()))
        count = int(np.clip(np.ceil(np.log(1e-4) / np.log(max(rho.max(), 1e-3))), 8, _TERMS))
        sizes.append(_sizes(A, Bw, C, system.Dzw, count))
    return np.concatenate(sizes), radius


def _sizes(A: Matrix, B: Matrix, C: Matrix, D: Matrix, count: int) -> NDArray[np.float64]:
    """Return the outputs that a few steps of ascent attain with the first terms of each impulse response."""
    p, m = D.shape
    if not p or not m:
        return np.zeros(len(A))
    H = np.empty((len(A), count, p, m))
    H[:, 0] = D
    X = np.broadcast_to(B, (len(A), *B.shape))
    for k in range(1, count):
        H[:, k] = C @ X
        X = A @ X
    rows = np.linalg.norm(H, axis=3).sum(axis=1)
    g = np.eye(p)[np.argmax(rows, axis=1)]
    best = rows.max(axis=1)
    for _ in range(8 if p > 1 else 0):
        parts = np.einsum("vkpm,vp->vkm", H, g)
        length = np.linalg.norm(parts, axis=2, keepdims=True)
        best = np.maximum(best, length.sum(axis=(1, 2)))
        unit = parts / np.maximum(length, np.finfo(float).tiny)
        gradient = np.einsum("vkpm,vkm->vp", H, unit)
        g = gradient / np.maximum(np.linalg.norm(gradient, axis=1, keepdims=True), np.finfo(float).tiny)
    return best
