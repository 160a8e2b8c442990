"""The smallest gain of all members of an uncertain system, with proof: what a fault is sure to leave in a residual."""

from __future__ import annotations

import heapq
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import count

import numpy as np
from numpy.typing import NDArray

from residua.errors import ModelError, SettingError
from residua.robust.bounds.lowest_gain import LowestGain, check_stable, descended, lowest_gain
from residua.robust.bounds.member_response import MemberResponse, member_response
from residua.robust.bounds.response_expansion import Expansion, expand
from residua.robust.sets.uncertain_system import UncertainSystem
from residua.tolerances import SAME

Points = NDArray[np.float64]
#: Boxes bounded at a time, and about the numbers held for them.
_BATCH = 24
_CHUNK = 2_000_000
#: Boxes are not cut below this fraction of the set.
_NARROWEST = 1e-10


@dataclass(frozen=True, eq=False)
class SmallestGain:
    """What the gain of no member of an uncertain system, at no frequency of a band, falls below.

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
        """The bound over what is attained: at most 1, and 1 if the bound cannot be improved."""
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
    last = _last_frequency(system, band)
    _check_settings(rtol, most_boxes, samples)
    low, high = np.append(system.low, 0.0), np.append(system.high, last)
    response = member_response(system, constant=last == 0)
    outputs, inputs = system.Dzw.shape
    if outputs < inputs:
        check_stable(response, (low + high)[None, :-1] / 2)
        note = f"more inputs ({inputs}) than outputs ({outputs}): some combination of the inputs leaves no output"
        return _result(system, band, 0.0, 0.0, (low + high) / 2, 0, note)
    search = _Search(response, low, high, rtol, samples, seed)
    note = search.run(most_boxes)
    return _result(system, band, search.bound, search.attained, search.worst, search.boxes, note)


def _last_frequency(system: UncertainSystem, band: float) -> float:
    """Return the largest frequency in rad/s, or in rad/sample for sampled systems."""
    if not isinstance(system, UncertainSystem):
        raise ModelError(
            f"the smallest gain is that of an UncertainSystem from faults to residuals, got {type(system).__name__}"
        )
    if not system.Dzw.shape[1]:
        raise ModelError("the system has no inputs, and so no gain: Bw must have a column for each fault")
    try:
        last = float(band)
    except (TypeError, ValueError):
        last = np.nan
    if isinstance(band, bool) or not 0 <= last < np.inf:
        raise SettingError(f"band must be a frequency in rad/s, or 0 for constant inputs, got {band!r}")
    if last * system.dt > np.pi * (1 + SAME):
        raise SettingError(
            f"band = {last:g} rad/s lies beyond pi / dt = {np.pi / system.dt:g}, the fastest of a sampled system"
        )
    return min(last * system.dt, np.pi) if system.dt else last


def _check_settings(rtol: float, most_boxes: int, samples: int) -> None:
    if not 0 < rtol < 1:
        raise SettingError(f"rtol must lie in (0, 1), got {rtol!r}")
    if min(most_boxes, samples) < 1:
        raise SettingError(f"most_boxes and samples must be at least 1, got {most_boxes!r} and {samples!r}")


def _result(
    system: UncertainSystem, band: float, bound: float, attained: float, worst: Points, boxes: int, note: str
) -> SmallestGain:
    values = dict(zip(system.parameters, (float(v) for v in worst[:-1]), strict=True))
    frequency = min(float(worst[-1]) / (system.dt or 1.0), float(band))
    return SmallestGain(bound, attained, values, frequency, float(band), boxes, note)


class _Search:
    """Branch and bound, best first: the box with the smallest bound is always among the next to be cut."""

    def __init__(
        self, response: MemberResponse, low: Points, high: Points, rtol: float, samples: int, seed: int
    ) -> None:
        self.response, self.low, self.high, self.rtol = response, low, high, rtol
        self._lower(lowest_gain(response, low, high, samples=samples, seed=seed))
        self.open: list[tuple[float, int, Points, Points]] = []
        self.number = count()
        self.closed, self.boxes, self.unresolved = np.inf, 0, False
        outputs, inputs = response.Dzw.shape
        channels = len(response.owners) + len(response.A)
        size = (outputs * inputs * len(low) + channels) * (len(low) + channels)
        self.batch = int(np.clip(_CHUNK // size, 1, _BATCH))
        self._add(0.0, low, high)

    @property
    def bound(self) -> float:
        """What holds for the set by now."""
        return min(self.closed, self.open[0][0] if self.open else np.inf, self.attained)

    @property
    def target(self) -> float:
        """The bound that is enough."""
        return (1 - self.rtol) * self.attained

    def run(self, most: int) -> str:
        """Bound boxes until it is enough; return what there is to note."""
        while self.boxes < most and self._more():
            parts = [heapq.heappop(self.open)]
            while self._more() and len(parts) < min(self.batch, most - self.boxes):
                parts.append(heapq.heappop(self.open))
            self._bound(parts)
        if not self.attained:
            return "the gain of a member is zero but for rounding"
        if self.bound >= self.target:
            return ""
        if not self.open:
            return f"rounding keeps the bound at {self.bound / self.attained:.3g} of what is attained"
        poles = "; that no member has a pole in the band was not proved" if self.unresolved and not self.bound else ""
        return (
            f"the bound is {self.bound / self.attained:.3g} of what is attained after {self.boxes} boxes: raise "
            f"most_boxes, or narrow the set{poles}"
        )

    def _more(self) -> bool:
        """Tell whether the bound is still too small, and not because of a box that cannot be cut."""
        return bool(self.open) and self.open[0][0] < min(self.target, self.closed)

    def _lower(self, lowest: LowestGain) -> None:
        zero = lowest.gain <= lowest.rounding
        self.attained, self.worst = 0.0 if zero else lowest.gain, lowest.point

    def _add(self, bound: float, low: Points, high: Points) -> None:
        heapq.heappush(self.open, (bound, next(self.number), low, high))

    def _bound(self, parts: list[tuple[float, int, Points, Points]]) -> None:
        low, high = np.array([part[2] for part in parts]), np.array([part[3] for part in parts])
        expansion = expand(self.response, low, high)
        self.boxes += len(parts)
        self._visit((low + high) / 2, expansion)
        for i, part in enumerate(parts):
            bound = max(part[0], float(expansion.bound[i]))
            end = expansion.end[i] * (high[i] > low[i])
            if bound >= self.target:
                self.closed = min(self.closed, bound)
            elif end.any():
                self._add(bound, np.where(end > 0, high[i], low[i]), np.where(end < 0, low[i], high[i]))
            else:
                self._cut(bound, low[i], high[i], expansion.share[i])

    def _visit(self, centres: Points, expansion: Expansion) -> None:
        """Descend from the best centre if it is better than the known ones."""
        self.unresolved = not expansion.resolved.all()
        if self.unresolved:
            check_stable(self.response, centres[~expansion.resolved, :-1])
        gains = np.where(expansion.resolved, expansion.gain, np.inf)
        best = int(np.argmin(gains))
        if gains[best] < self.attained * (1 - 0.1 * self.rtol):
            self._lower(descended(self.response, self.low, self.high, centres[best], float(gains[best])))

    def _cut(self, bound: float, low: Points, high: Points, share: Points) -> None:
        """Halve a box along the coordinate that matters most; one too narrow, or exact but for rounding, is left."""
        share = np.where(high - low > _NARROWEST * (self.high - self.low), share, 0.0)
        widest = int(np.argmax(share))
        if share[widest] <= 0:
            self.closed = min(self.closed, bound)
            return
        upper, lower = high.copy(), low.copy()
        upper[widest] = lower[widest] = (low[widest] + high[widest]) / 2
        self._add(bound, low, upper)
        self._add(bound, lower, high)
