"""The smallest gain of all members of an uncertain system, with proof: the certain effect of a fault on a residual."""

from __future__ import annotations

import heapq
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import count

import numpy as np
from numpy.typing import NDArray

from residua.decide.checks import is_number
from residua.errors import ModelError, SettingError
from residua.robust.bounds.response_expansion import MemberResponse, expand, member_response
from residua.robust.sets.uncertain_system import REMEDY, UncertainSystem, check_modes, corner_points
from residua.tolerances import SAME

Points = NDArray[np.float64]
#: Boxes bounded at a time, and about the numbers held for them.
_BATCH = 24
_CHUNK = 2_000_000
#: Boxes are not cut below this fraction of the set.
_NARROWEST = 1e-10
#: Frequencies at which points inside are visited, corners whose poles are computed, and steps of a descent.
_FREQUENCIES, _CHECKED, _STEPS = 9, 128, 12


@dataclass(frozen=True, eq=False)
class SmallestGain:
    """A lower bound of the gain of every member of an uncertain system, at every frequency of a band.

    Attributes
    ----------
    bound : float
        No member has a smaller gain. 0 if no positive bound was proved.
    attained : float
        The smallest gain of a visited member: no bound can be larger.
    values : dict of str to float
        The parameters of the member that has it.
    frequency : float
        Where it has it, in rad/s.
    band : float
        Frequencies up to this one, in rad/s, were looked at.
    boxes : int
        Parts of the set, in parameters and frequency, that were bounded.
    note : str
        What the reader should know; empty when there is nothing.
    """

    bound: float
    attained: float
    values: Mapping[str, float]
    frequency: float
    band: float
    boxes: int
    note: str = ""

    @property
    def ratio(self) -> float:
        """The bound relative to the attained gain: at most 1, and 1 if the bound cannot be improved."""
        return self.bound / self.attained if self.attained else 1.0

    def __float__(self) -> float:
        return self.bound


def smallest_gain(
    system: UncertainSystem,
    *,
    band: float = 0.0,
    rtol: float = 1e-2,
    most_boxes: int = 2000,
    samples: int = 64,
    seed: int = 0,
) -> SmallestGain:
    r"""Bound the gain of every member of an uncertain system from below, for constant or slow inputs.

    .. math:: \min_{F} \min_{|\omega| \le \omega_b} \sigma_{min}(T_F(e^{j \omega \Delta t})), \qquad
       T_F(z) = (C_z + D_{zp} F C_q) (z I - A - B_p F C_q)^{-1} B_w + D_{zw}

    and :math:`T_F(j \omega)` in continuous time. With faults as inputs and a residual as output: a constant fault of
    size ``f`` leaves a residual of at least ``f`` times the bound in the end, whichever member the plant is; with
    several faults, ``f`` is the length of their vector.

    The set is cut into boxes of parameters and frequencies. Around the centre of each, the squared gain is a
    polynomial of second order in the deviations, and a rest, which is bounded by absolute values. A coordinate along
    which the gain can only rise, or only fall, is set to one end. The box with the smallest bound is cut first, until
    the bound is within ``rtol`` of a gain that some member has.

    Parameters
    ----------
    system : UncertainSystem
        From the faults to the residual, sampled or continuous.
    band : float
        The largest frequency of the inputs, in rad/s; 0 for constant inputs. At most ``pi / dt`` for sampled systems.
    rtol : float
        How far the bound may stay below what is attained, relatively.
    most_boxes : int
        How many boxes are bounded; the bound also holds if these are not enough, and ``note`` says so.
    samples : int
        Members drawn inside of the set, besides its corners (up to 12 parameters; beyond, some of them at random).
    seed : int
        Seed of the draw of these members.

    Returns
    -------
    SmallestGain
        With a bound of 0 where a member, or a combination of the inputs, leaves no output, and where no more could be
        proved.

    Raises
    ------
    ModelError
        If it is not an uncertain system, or has no inputs.
    SettingError
        If the band is negative or exceeds ``pi / dt``, or another option makes no sense.
    DesignError
        If a member that is visited is not stable (it is named): its output does not settle.

    Notes
    -----
    Assumes
        Parameters are constant in time; every member is stable. It is proved that no member has a pole at a frequency
        of the band wherever the bound is positive; poles are computed of the members inside, of up to 128 corners and
        of those where that proof fails at first.

    Sizes that cancel are taken to be off by 1e-12: a gain below that is zero. Of sampled systems, ``A - I`` and
    ``z - 1`` are such sizes, so that slow poles cancel nothing.

    The time grows fast with the number of parameters of a large set: a dozen are settled in tens of milliseconds,
    dozens only where together they change the gain by less than about a half; else the bound may stay at 0.

    References
    ----------
    Robust l1 fault detection, eqs. (39)-(40), where the sensitivity to the fault is bounded from above, which promises
    nothing. Moore, Interval Analysis (1966): bounds by boxes and slopes of one sign. Zhou, Doyle and Glover, Robust and
    Optimal Control (1996), chapter 10: linear-fractional forms.

    Examples
    --------
    >>> from residua.linear import UncertainSystem, smallest_gain
    >>> lag = UncertainSystem([[0.5]], [[1.0]], [[1.0]], [[1.0]], [[1.0]], low=[-0.1], high=[0.3], dt=1.0)
    >>> gain = smallest_gain(lag)  # 1 / (1 - pole)
    >>> round(gain.bound, 4), round(gain.attained, 4), gain.values
    (1.6667, 1.6667, {'f1': -0.1})
    """
    if not isinstance(system, UncertainSystem):
        raise ModelError(
            f"the smallest gain is that of an UncertainSystem from faults to residuals, got {type(system).__name__}"
        )
    outputs, inputs = system.Dzw.shape
    if not inputs:
        raise ModelError("the system has no inputs, and so no gain: Bw must have a column for each fault")
    if not is_number(band) or not band >= 0:
        raise SettingError(f"band must be a frequency in rad/s, or 0 for constant inputs, got {band!r}")
    if band * system.dt > np.pi * (1 + SAME):
        raise SettingError(
            f"band = {band:g} rad/s lies beyond pi / dt = {np.pi / system.dt:g}, the fastest of a sampled system"
        )
    if not 0 < rtol < 1:
        raise SettingError(f"rtol must lie in (0, 1), got {rtol!r}")
    if min(most_boxes, samples) < 1:
        raise SettingError(f"most_boxes and samples must be at least 1, got {most_boxes!r} and {samples!r}")
    last = min(band * system.dt, np.pi) if system.dt else float(band)  # in rad/sample for sampled systems
    low, high = np.append(system.low, 0.0), np.append(system.high, last)
    response = member_response(system, constant=last == 0)
    if outputs < inputs:
        _check_stable(response, (low + high)[None, :-1] / 2)
        note = f"more inputs ({inputs}) than outputs ({outputs}): some combination of the inputs leaves no output"
        bound, attained, worst, boxes = 0.0, 0.0, (low + high) / 2, 0
    else:
        lowest = _lowest_gain(response, low, high, samples=samples, seed=seed)
        bound, attained, worst, boxes, note = _branch_and_bound(response, low, high, rtol, most_boxes, *lowest)
    values = dict(zip(system.parameters, (float(v) for v in worst[:-1]), strict=True))
    frequency = min(float(worst[-1]) / (system.dt or 1.0), float(band))
    return SmallestGain(bound, attained, values, frequency, float(band), boxes, note)


def _branch_and_bound(
    response: MemberResponse, low: Points, high: Points, rtol: float, most: int, attained: float, worst: Points
) -> tuple[float, float, Points, int, str]:
    """Cut the box with the smallest bound until that is close to the smallest gain of a visited member.

    Returns
    -------
    tuple
        The bound, the smallest gain and its point, how many boxes were bounded, and a note.
    """
    number = count()
    waiting: list[tuple[float, int, Points, Points]] = [(0.0, next(number), low, high)]
    settled, boxes, unresolved = np.inf, 0, False  # the smallest bound of those that are not cut further
    outputs, inputs = response.Dzw.shape
    channels = len(response.owners) + len(response.A)
    size = (outputs * inputs * len(low) + channels) * (len(low) + channels)
    batch = int(np.clip(_CHUNK // size, 1, _BATCH))

    def is_open() -> bool:
        """Tell whether the bound is still too small, and not because of a box that cannot be cut."""
        return bool(waiting) and waiting[0][0] < min((1 - rtol) * attained, settled)

    while boxes < most and is_open():
        parts = [heapq.heappop(waiting)]
        while is_open() and len(parts) < min(batch, most - boxes):
            parts.append(heapq.heappop(waiting))
        lower, upper = np.array([part[2] for part in parts]), np.array([part[3] for part in parts])
        expansion, centres = expand(response, lower, upper), (lower + upper) / 2
        boxes, unresolved = boxes + len(parts), not expansion.resolved.all()
        if unresolved:
            _check_stable(response, centres[~expansion.resolved, :-1])
        gains = np.where(expansion.resolved, expansion.gain, np.inf)
        best = int(np.argmin(gains))
        if gains[best] < attained * (1 - 0.1 * rtol):
            attained, worst = _descended(response, low, high, centres[best], gains[best])
        for (before, *_), bound, a, b, end, share in zip(
            parts, expansion.bound.tolist(), lower, upper, expansion.end, expansion.share, strict=True
        ):
            bound, end = max(before, bound), end * (b > a)
            share = np.where(b - a > _NARROWEST * (high - low), share, 0.0)
            widest = int(np.argmax(share))
            if bound >= (1 - rtol) * attained or not (end.any() or share[widest] > 0):
                settled = min(settled, bound)  # enough; or too narrow, or exact but for rounding
            elif end.any():
                heapq.heappush(waiting, (bound, next(number), np.where(end > 0, b, a), np.where(end < 0, a, b)))
            else:
                middle, first, second = (a[widest] + b[widest]) / 2, b.copy(), a.copy()
                first[widest] = second[widest] = middle
                for half in ((a, first), (second, b)):
                    heapq.heappush(waiting, (bound, next(number), *half))
    bound = min(settled, waiting[0][0] if waiting else np.inf, attained)
    note = ""
    if not attained:
        note = "the gain of a member is zero but for rounding"
    elif bound < (1 - rtol) * attained and not waiting:
        note = f"rounding keeps the bound at {bound / attained:.3g} of what is attained"
    elif bound < (1 - rtol) * attained:
        poles = "; that no member has a pole in the band was not proved" if unresolved and not bound else ""
        note = (
            f"the bound is {bound / attained:.3g} of what is attained after {boxes} boxes: raise most_boxes, or narrow "
            f"the set{poles}"
        )
    return bound, attained, worst, boxes, note


def _lowest_gain(
    response: MemberResponse, low: Points, high: Points, *, samples: int, seed: int
) -> tuple[float, Points]:
    """Visit points inside, all corners of the parameters or many, then descend; return the gain and its point.

    Raises
    ------
    DesignError
        If a member is not stable: of those inside, and of some corners.
    """
    rng = np.random.default_rng(seed)
    inside = np.vstack([(low + high) / 2, rng.uniform(low, high, (samples, len(low)))])
    corner = corner_points(low[:-1], high[:-1], samples, rng)
    corner = np.hstack([corner, np.full((len(corner), 1), low[-1])])
    some = corner[rng.permutation(len(corner))[:_CHECKED]]
    _check_stable(response, np.vstack([inside, some])[:, :-1])
    step = max(1, _CHUNK // max(len(response.A) ** 2, 1))

    def lowest(points: Points) -> tuple[float, Points]:
        gains = np.concatenate([response.gains(points[i : i + step]) for i in range(0, len(points), step)])
        best = int(np.argmin(gains))
        return gains[best], points[best]

    if low[-1] < high[-1]:
        moved = np.repeat(inside, _FREQUENCIES, axis=0)
        moved[:, -1] = np.tile(np.linspace(low[-1], high[-1], _FREQUENCIES), len(inside))
        inside = np.vstack([inside, moved])
    starts = [lowest(inside)]
    corner[:, -1] = starts[0][1][-1]
    starts.append(lowest(corner))
    least = min((_descended(response, low, high, point, gain) for gain, point in starts), key=lambda one: one[0])
    _check_stable(response, least[1][None, :-1])
    return least


def _descended(response: MemberResponse, low: Points, high: Points, point: Points, gain: float) -> tuple[float, Points]:
    """Descend by Gauss-Newton steps within the box, halved until the gain falls; zero where rounding is all of it."""
    from scipy.optimize import lsq_linear  # slow to import

    moving = np.flatnonzero(high > low)
    width = (high - low)[moving]
    T, slopes, rounding = response.slopes(point)
    for _ in range(_STEPS):
        J = np.vstack([np.real(slopes), np.imag(slopes)])[:, moving] * width
        size = float(np.abs(J).max(initial=0.0))
        if gain <= rounding or size == 0:
            break
        span = (low - point)[moving] / width, (high - point)[moving] / width
        target = -np.concatenate([np.real(T), np.imag(T)]) / size
        step = np.zeros(len(point))
        step[moving] = lsq_linear(J / size, target, span, method="bvls").x * width
        tries = np.clip(point + step * 0.5 ** np.arange(12)[:, None], low, high)
        gains = response.gains(tries)
        best = int(np.argmin(gains))
        if gains[best] >= gain * (1 - 1e-6):
            break
        point, gain = tries[best], gains[best]
        T, slopes, rounding = response.slopes(point)
    return 0.0 if gain <= rounding else float(gain), point


def _check_stable(response: MemberResponse, values: Points) -> None:
    """Raise unless members are stable; the message names the least stable."""
    A = response.members(values)[0]
    consequence = f"its output does not settle, so that it has no gain: {REMEDY}"
    modes = np.linalg.eigvals(A + response.origin * np.eye(A.shape[1])) if A.shape[1] else np.zeros(0)
    check_modes(modes, values, response.parameters, response.dt, consequence)
