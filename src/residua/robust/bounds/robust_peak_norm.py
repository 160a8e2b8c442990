"""The largest output of every member of an uncertain system, with a proof that is checked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from residua.errors import AccuracyError, NoCertificateError, SettingError
from residua.linear.norms import lmi
from residua.robust.bounds.box_bound import BoxBound, Task, box_bound, check_method
from residua.robust.bounds.scaled_problem import check_sampled
from residua.robust.bounds.worst_member import worst_member
from residua.robust.sets.uncertain_system import UncertainSystem

Matrix = NDArray[np.float64]
_NEED_CONSTANT = ("lifted", "popov-tsypkin")
#: Parts that the set is cut into at most where nothing is asked for, and how far from what is attained is far then.
_BOXES, _FAR = 32, 1.1
#: States and twice the channels up to which matrix inequalities take minutes at most.
_PRACTICAL = 50
_WITHOUT = "without the extra 'lmi'"
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
    rate: float
    certificate: Mapping[str, Matrix]
    eigenvalues: Mapping[str, float]
    unit: float = 1.0
    boxes: int = 1
    note: str = ""

    @property
    def ratio(self) -> float:
        """The bound over what is attained: at least 1, and 1 if the bound cannot be improved."""
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
    check_sampled(system)
    used, note = _chosen(method)
    if rate is not None and not 0 < rate < 1:
        raise SettingError(f"rate must lie in (0, 1), got {rate!r}")
    most = (1 if method else _BOXES) if boxes is None else boxes
    if min(most, searches, samples) < 1 or not (rtol >= 0 and atol >= 0):
        raise SettingError("boxes, searches and samples must be at least 1, rtol and atol 0 or more")
    worst = worst_member(system, samples=samples, seed=seed)
    task = Task(used, worst, rate, searches)
    parts = _cut(system, task, most, worst.attained * (1 + rtol) + atol)
    if method is None and parts[0].bound > _FAR * worst.attained + atol:
        lifted, note = _by_inequalities(system, replace(task, method="lifted"))
        parts = [lifted] if lifted.bound < parts[0].bound else parts
    top = parts[0]
    if not np.isfinite(top.bound):
        raise _none(task, method, len(parts), most)
    if used == "centred" and top.method == "star":
        note = "; ".join(filter(None, (_ELLIPSOID, note)))
    if worst.attained > top.bound * (1 + 1e-9):
        raise AccuracyError(
            f"a member has a peak norm of at least {worst.attained:.9g}, above the bound {top.bound:.9g} of method "
            f"{top.method!r}: the certificate is wrong in double precision; use another method"
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


def _chosen(method: str | None) -> tuple[str, str]:
    """Return the method to use, and what the reader should know."""
    check_method(method)
    if method in _NEED_CONSTANT:
        lmi.require_solver()
    if method == "quadratic" and not lmi.has_solver():
        return "star", f"{_WITHOUT}: an ellipsoid by weights instead of 'quadratic'; pip install 'residua[lmi]'"
    return method or "centred", ""


def _cut(system: UncertainSystem, task: Task, boxes: int, enough: float) -> list[BoxBound]:
    """Bound the set, cut in two where the bound is largest until it is small enough; the largest bound comes first."""
    parts = [box_bound(system, task)]
    while len(parts) < boxes and parts[0].bound > enough and np.isfinite(parts[0].widest):
        first = parts.pop(0)
        parts += [box_bound(half, task) for half in _halves(first.system, int(first.widest))]
        parts.sort(key=lambda part: -part.bound)
    return parts


def _by_inequalities(system: UncertainSystem, task: Task) -> tuple[BoxBound, str]:
    """Return the bound of the whole by the lifted inequalities, where it takes minutes at most; and what to note."""
    if system.n_states + 2 * len(system.channels) > _PRACTICAL:
        return BoxBound(system), "'lifted' was not tried: it would take many minutes; method='lifted' does"
    if not lmi.has_solver():
        return BoxBound(system), f"{_WITHOUT}: 'lifted' was not tried; pip install 'residua[lmi]'"
    return box_bound(system, task), ""


def _halves(system: UncertainSystem, i: int) -> tuple[UncertainSystem, UncertainSystem]:
    middle = (system.low[i] + system.high[i]) / 2
    low, high = system.low.copy(), system.high.copy()
    low[i] = high[i] = middle
    return system.within(system.low, high), system.within(low, system.high)


def _none(task: Task, method: str | None, made: int, most: int) -> NoCertificateError:
    others = [name for name in ("centred", "star", "lifted") if name != (method or "centred")]
    more = f"cut it into more parts, boxes={4 * most}, " if made >= most else ""
    return NoCertificateError(
        f"method {method or task.method!r} found no certificate for this set in {made} part{'s' if made > 1 else ''} "
        f"(largest spectral radius visited {task.worst.radius:.6g}"
        f"{'' if task.rate is None else f', rate {task.rate:g}'}): {more}narrow it, or use another method "
        f"({', '.join(map(repr, others))})"
    )
