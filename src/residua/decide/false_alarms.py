"""Threshold for a rate of false alarms from fault-free statistics, and the rate that the data can promise."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from residua.decide.calibrate import persistent_levels
from residua.decide.dependence import correlation_times, effective_exceedances
from residua.decide.exceedance_runs import RunModel
from residua.decide.exceedance_tail import HIGHEST, Scale, Tail, quantile, scale_of, tail_of, without_steps
from residua.words import one_in

#: How sure a promise is.
CONFIDENCE = 0.95
#: Over this multiple of the target rate, the promised rate is stated beside it.
TOLERATED = 1.5
#: Where the data cannot tell, the threshold is set for at least this share of the rate.
_LEAST_AIM = 0.6
#: Independent exceedances from which a rate is read off the data as it is.
ENOUGH = 30.0
#: Groups of stretches of time that are left out in turn to see how well a rate is known.
_GROUPS = 20


def within_tolerance(promised: float, asked: float) -> bool:
    """Tell whether the promised rate is the requested one, within a factor of 1.5."""
    return promised <= TOLERATED * asked * (1 + 1e-6)


@dataclass(frozen=True)
class Promise:
    """A threshold, and the rate of alarms on other data that fault-free data promise.

    Attributes
    ----------
    threshold : float
    asked : float
        Fraction of samples in alarm that was asked for.
    aimed : float
        The fraction expected with this threshold.
    promised : float
        The fraction not exceeded, with 95 % confidence, on other data that are like these; normal operation on another
        day that is not in them is not covered. 1 if the data say nothing.
    extended : str
        Model by which the rate is extended if the data are too few to show it; else empty.
    """

    threshold: float
    asked: float
    aimed: float
    promised: float
    extended: str = ""

    @property
    def holds(self) -> bool:
        """True if the data promise the requested rate, within a factor of 1.5."""
        return within_tolerance(self.promised, self.asked)

    def __str__(self) -> str:
        text, asked = f"about {one_in(self.aimed)} of them in alarm", one_in(self.asked)
        if self.extended:
            text += f" (too few to see that: {self.extended})"
        if self.promised >= 1:
            return f"{text}; {asked} was requested; this log is too short to confirm a rate: use a longer one"
        if self.holds:
            return f"{text}, {asked} on other data like these, with 95 % confidence within a factor of {TOLERATED:g}"
        text += f", with 95 % confidence at most {one_in(self.promised)} on other data like these"
        return f"{text}; {asked} was requested"


@dataclass(frozen=True, eq=False)
class Observed:
    """A statistic on fault-free samples, as the alarm logic sees it.

    Attributes
    ----------
    statistic : ndarray, shape (n,)
        Of usable samples, one recording after the other.
    levels : ndarray, shape (n,)
        See :func:`residua.decide.calibrate.persistent_levels`.
    counted : ndarray of bool, shape (n,)
        Samples that tell the rate: those of full windows, in which an alarm could have been raised.
    blocks : ndarray of int, shape (n,)
        Number of the stretch of time, long enough to be independent of others, that each lies in.
    begins : ndarray of bool, shape (n,)
        The first sample of each recording.
    scale : Scale
    persistence, release : int
    own : ndarray, shape (n,)
        The levels by the mean and covariance of all samples, where those are other ones.
    own_statistic : ndarray, shape (n,)
        Likewise.
    """

    statistic: NDArray[np.float64]
    levels: NDArray[np.float64]
    counted: NDArray[np.bool_]
    blocks: NDArray[np.int64]
    begins: NDArray[np.bool_]
    scale: Scale
    persistence: int
    release: int
    own: NDArray[np.float64]
    own_statistic: NDArray[np.float64]


def observed(
    statistic: NDArray[np.float64],
    full: NDArray[np.bool_],
    usable: NDArray[np.bool_],
    parts: Sequence[slice],
    degrees: float,
    *,
    persistence: int,
    release: int,
    window: int,
    own: NDArray[np.float64] | None = None,
) -> Observed:
    """Return a statistic with its levels and independent stretches of time.

    Parameters
    ----------
    statistic : ndarray, shape (time,)
    full, usable : ndarray of bool, shape (time,)
        Samples of full windows, and all those that the alarm logic sees.
    parts : sequence of slice
        The recordings.
    degrees : float
        Most degrees of freedom of its square.
    persistence, release, window : int
    own : ndarray, shape (time,), optional
        The statistic by the mean and covariance of all samples, where ``statistic`` is cross-fitted.
    """
    counted = full.copy()
    for part in parts:
        counted[part] &= np.cumsum(usable[part]) >= persistence
    seen = statistic[counted]
    squares = np.where(counted, statistic**2 - np.mean(seen**2), 0.0)[:, None]
    length = int(max(2 * correlation_times(squares, parts)[0], window + persistence - 1))
    levels, levels_own, blocks, begins, first = [], [], [], [], 0
    for part in parts:
        mine = usable[part]
        levels.append(persistent_levels(statistic[part][mine], persistence, release))
        levels_own.append(levels[-1] if own is None else persistent_levels(own[part][mine], persistence, release))
        number = np.cumsum(counted[part][mine]) // length
        blocks.append(first + number)
        begins.append(np.arange(len(number)) == 0)
        first += int(number.max(initial=-1)) + 1
    return Observed(
        statistic[usable],
        np.concatenate(levels),
        counted[usable],
        np.concatenate(blocks),
        np.concatenate(begins),
        scale_of(seen, degrees),
        persistence,
        release,
        np.concatenate(levels_own),
        (statistic if own is None else own)[usable],
    )


def promise_of(seen: Observed, asked: float) -> Promise:
    """Return the threshold for a rate, and the rate that can be promised.

    Where thirty independent exceedances or more are seen at that rate, it is read off the levels. Elsewhere the
    fraction of samples over the threshold is extended by its tail (:class:`residua.decide.exceedance_tail.Tail`), and
    where an alarm needs several in a row, that of samples in alarm follows by a model of runs
    (:class:`residua.decide.exceedance_runs.RunModel`). How well the rate is known is seen by leaving out stretches of
    time in turn. Where that allows for more than 1.5 times the requested rate, the threshold is set for less, down to
    0.6 of it; if that does not suffice, the promise says so. A tail is smooth: where values come in steps, it is that
    of :func:`residua.decide.exceedance_tail.without_steps`, and the threshold is half a step higher.
    """
    direct = tail_of(seen.levels[seen.counted], lasting_blocks(seen, asked), seen.scale, asked, highest=asked)
    if direct.worth >= ENOUGH:
        least = quantile(np.sort(seen.own[seen.counted]), asked)  # nor more than that on these data themselves
        return _promise(lambda rate: max(direct.level(rate), least), lambda rate: _known(direct, rate), asked, "")
    statistic, half = without_steps(seen.own_statistic)
    if not half:
        statistic = seen.statistic  # by moments of others, which would scatter equal values
    plain = tail_of(statistic[seen.counted], seen.blocks[seen.counted], seen.scale, asked)
    if seen.persistence == seen.release == 1:
        origin = f"extended from {one_in(plain.rate)} by the tail of the data" if plain.rate > asked else ""
        promise = _promise(plain.level, lambda rate: _known(plain, rate), asked, origin)
    else:
        model = RunModel.of(statistic, seen.counted, seen.begins, _grouped(seen.blocks), plain,
                            seen.persistence, seen.release)  # fmt: skip
        origin = f"extended from {one_in(model.seen(asked))} by the tail of the data and a model of runs"
        promise = _promise(model.level, lambda rate: (model.spread(model.level(rate)), model.worth), asked, origin)
    return replace(promise, threshold=promise.threshold + half)


def lasting_blocks(seen: Observed, rate: float) -> NDArray[np.int64]:
    """Return stretches of time in which alarms, which may last long, are independent too."""
    level = quantile(np.sort(seen.levels[seen.counted]), rate)
    over = np.where(seen.counted, (seen.levels > level) - rate, 0.0)[:, None]
    edges = [*np.flatnonzero(seen.begins).tolist(), len(over)]
    parts = [slice(a, b) for a, b in pairwise(edges)]
    length = int(np.ceil(2 * correlation_times(over, parts)[0]))
    own = np.concatenate([np.arange(part.stop - part.start) // length for part in parts])
    first = np.cumsum(seen.begins | np.concatenate([[False], own[1:] != own[:-1]])) - 1
    longer = length > np.bincount(seen.blocks).mean()
    return (first if longer else seen.blocks)[seen.counted]


def _known(tail: Tail, rate: float) -> tuple[float, float]:
    return tail.spread(rate), tail.worth


def _promise(
    level: Callable[[float], float], known: Callable[[float], tuple[float, float]], asked: float, extended: str
) -> Promise:
    """Return the threshold for a rate, given the threshold for any rate and its uncertainty: spread and degrees."""
    from scipy.special import stdtrit

    aim, beyond = asked, np.inf
    for _ in range(30):  # a smaller aim is extended further
        spread, degrees = known(aim)
        beyond = float(stdtrit(max(degrees - 1, 1.0), CONFIDENCE)) * spread
        wanted = max(asked * min(1.0, TOLERATED * np.exp(-min(beyond, 700.0))), _LEAST_AIM * asked)
        if abs(wanted - aim) <= 1e-3 * asked:
            break
        aim = wanted
    promised = min(1.0, aim * float(np.exp(min(beyond, 700.0))))
    if aim > 1.01 * _LEAST_AIM * asked and promised > TOLERATED * asked:  # remainder of the iteration
        aim, promised = aim * TOLERATED * asked / promised, TOLERATED * asked
    return Promise(float(level(aim)), asked, float(aim), promised, extended)


def _grouped(blocks: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return stretches of time as at most twenty groups of neighbours."""
    number = int(blocks.max(initial=0)) + 1
    return blocks * min(_GROUPS, number) // number


def coincidence(members: Sequence[Observed], share: float) -> float:
    r"""Return the mean number of members in alarm at once while any is, for members with this rate; at least 1.

    It is seen at the smallest rate, that one or higher, at which the data show thirty independent alarms of any member.
    Towards smaller rates alarms coincide less often, if they do not always: the further it is extended, the less of it
    is used. Where the data do not show it, it is 1, and the rates of the members are added up (the union bound).

    Parameters
    ----------
    members : sequence of Observed
        The members' levels, of the same samples.
    share : float
        Rate of every member.
    """
    counted = np.logical_and.reduce([one.counted for one in members])
    levels = np.array([one.levels[counted] for one in members])
    ordered, longest = np.sort(levels, axis=1), max(members, key=lambda one: -int(one.blocks.max(initial=0)))
    blocks, best = longest.blocks[counted], 1.0
    for rate in np.geomspace(share, max(share, HIGHEST), 24):
        over = levels > np.array([quantile(row, float(rate)) for row in ordered])[:, None]
        union = over.any(axis=0)
        if effective_exceedances(np.bincount(blocks[union]).astype(float)) >= ENOUGH:
            at_once = float(over.sum() / union.sum())
            best = at_once ** (1 / (1 + 0.25 * np.log(rate / share)))
            break
    return best


__all__ = ["ENOUGH", "Observed", "Promise", "coincidence", "observed", "promise_of", "within_tolerance"]
