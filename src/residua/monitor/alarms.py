"""Alarms of a recording: merged by event, with the intervals in which they began, and the words for them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.decide.alarm import Alarm, Beginning, Candidate
from residua.decide.change_time import CONFIDENCE, LEAST_BEFORE, ChangeTime, change_time
from residua.decide.explanation import BEFORE, FINAL, Explainer, Whitening
from residua.decide.isolation import Isolation, Named, Naming, Seen, last_over, longest
from residua.decide.statement import SHOWN_ALARMS, longest_alarms
from residua.decide.word import EITHER, GOOD, TOO_EARLY, Word
from residua.design import ResidualGenerator
from residua.monitor.fit_check import FitCheck
from residua.monitor.specification import Specification
from residua.tolerances import DATA_ROUNDING

#: Samples that are looked through at once.
_PIECE = 1 << 17


def alarms_of(seen: Seen, isolation: Isolation) -> tuple[Alarm, ...]:
    """Return the alarms of a recording, merged by event, without the intervals of their beginnings."""

    def name(start: int, stop: int, last: int) -> Named:
        return isolation.name(seen, start, stop, last)

    apart = max(isolation.samples, seen.test.samples)
    events = _events(_alarms(seen, name), apart, isolation)
    return tuple(_one_alarm(parts, isolation, seen.tested.exceeded, name) for parts in events)


def _alarms(seen: Seen, name: Naming) -> tuple[Alarm, ...]:
    """Return the alarms one by one, each with its attribution."""
    tested, time = seen.tested, seen.time
    out = []
    for start, stop in _runs(tested.alarm):
        first = _usable_before(tested.usable, start, int(tested.up[start]))
        fields = name(start, stop, last_over(tested.exceeded, start, stop)).of_alarm()
        ended = float(time[stop]) if stop < len(time) else None
        values: dict[str, Any] = {"onset": float(time[first])} | fields
        out.append(Alarm(raised=float(time[start]), ended=ended, start=start, stop=stop, **values))
    return tuple(out)


def _runs(flags: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return the runs of set flags: the first sample of each, and the one after its last."""
    edges, before = [], False
    for begin in range(0, len(flags), _PIECE):  # the recording may be larger than memory
        part = np.asarray(flags[begin : begin + _PIECE])
        edges += (begin + np.flatnonzero(np.diff(part, prepend=before))).tolist()
        before = bool(part[-1])
    if before:
        edges.append(len(flags))
    return list(zip(edges[::2], edges[1::2], strict=True))


def _usable_before(usable: NDArray[np.bool_], last: int, count: int) -> int:
    """Return the first of so many usable samples, the last of which is no later than ``last``."""
    if count < 1:  # a test that does not count: the sample after
        return last + 1 + int(np.argmax(usable[last + 1 :]))
    stop, width = last + 1, 2 * count
    while stop > 0:
        begin = max(0, stop - width)
        width = min(2 * width, _PIECE)
        rows = np.flatnonzero(usable[begin:stop])
        if len(rows) >= count:
            return begin + int(rows[len(rows) - count])
        count, stop = count - len(rows), begin
    return int(np.argmax(usable))


def _events(alarms: Sequence[Alarm], apart: int, isolation: Isolation) -> list[list[Alarm]]:
    """Return the alarms, merged if less than ``apart`` samples apart and about the same event.

    A small fault takes the statistic over the threshold and back many times; that is one event.
    """
    joined: list[list[Alarm]] = []
    for alarm in alarms:
        before = joined[-1][-1] if joined else None
        if before is None or alarm.start - before.stop >= apart or not isolation.same_event(before, alarm):
            joined.append([alarm])
        else:
            joined[-1].append(alarm)
    return joined


def _one_alarm(parts: Sequence[Alarm], isolation: Isolation, exceeded: NDArray[np.bool_], name: Naming) -> Alarm:
    """Return several alarms of one event as one: its onset is that of the first.

    The candidates, reading and sizes are those of the longest part (the later one of two that are equally long), or
    what the isolation says of all parts together.
    """
    if len(parts) == 1:
        return parts[0]
    first, last = parts[0], parts[-1]
    anew = isolation.name_of_several(parts, exceeded, name)
    fields = {"onset": first.onset} | ({} if anew is None else anew.of_alarm())
    return replace(longest(parts), raised=first.raised, ended=last.ended, start=first.start, stop=last.stop, **fields)


#: Alarms less than this many samples apart are dated together: the cause of the last one may precede them all.
APART = 200
#: Samples of an alarm from which the direction of the change is taken at most.
_MOST_ALARM = 2000
#: Judged samples that are looked at before the crossing at most, and of the alarm: bounds time and memory.
MOST_ROWS = 10_000
#: Least squared move of the residual, in units of that by noise alone, from which its direction is known.
CLEAR_DIRECTION = 10.0


def with_beginnings(
    alarms: Sequence[Alarm],
    residuals: NDArray[np.float64],
    usable: NDArray[np.bool_],
    time: NDArray[np.float64],
    since: float = -np.inf,
) -> tuple[Alarm, ...]:
    """Return the alarms, the longest of them with the interval in which they began, if the data show it.

    Parameters
    ----------
    alarms : sequence of Alarm
        In order.
    residuals : ndarray, shape (time, residuals)
    usable : ndarray of bool, shape (time,)
    time : ndarray, shape (time,)
    since : float
        Only those that were raised from then on.
    """
    out = list(alarms)
    for number, _ in longest_alarms(alarms, SHOWN_ALARMS):
        k = number - 1
        if alarms[k].raised < since:
            continue
        first = k
        while first and alarms[first].start - alarms[first - 1].stop < APART:
            first -= 1
        crossed = min(alarms[first].start, int(np.searchsorted(time, alarms[first].onset)))
        begin = alarms[first - 1].stop if first else 0
        before = _judged(residuals, usable, begin, crossed, last=True)
        rows = np.concatenate([before, _judged(residuals, usable, max(crossed, begin), alarms[k].stop, last=False)])
        out[k] = replace(alarms[k], began=_beginning(alarms[k].start, crossed, residuals, rows, time))
    return tuple(out)


def _judged(
    residuals: NDArray[np.float64], usable: NDArray[np.bool_], start: int, stop: int, *, last: bool
) -> NDArray[np.int64]:
    """Return the samples of a stretch that are judged: the first ones, or the last ones, if there are many."""
    parts: list[NDArray[np.int64]] = []
    there = 0
    while start < stop and there < MOST_ROWS:
        low = max(start, stop - _PIECE) if last else start
        high = stop if last else min(stop, start + _PIECE)
        rows = low + np.flatnonzero(usable[low:high] & np.isfinite(residuals[low:high]).all(axis=1))
        parts.append(rows)
        there += len(rows)
        start, stop = (start, low) if last else (high, stop)
    if not parts:
        return np.zeros(0, dtype=np.int64)
    return np.concatenate(parts[::-1])[-MOST_ROWS:] if last else np.concatenate(parts)[:MOST_ROWS]


def _beginning(
    raised: int, crossed: int, residuals: NDArray[np.float64], rows: NDArray[np.int64], time: NDArray[np.float64]
) -> Beginning | None:
    """Return the interval in which the change behind an alarm began; nothing was over before ``crossed``."""
    quiet, last = int(np.searchsorted(rows, crossed)), int(np.searchsorted(rows, raised))
    if quiet < LEAST_BEFORE or last >= len(rows):
        return None
    signal = _along_change(residuals[rows], quiet, last)
    moment = None if signal is None else change_time(signal, quiet, last)
    return None if moment is None else _timed(moment, rows, time)


def _timed(moment: ChangeTime, rows: NDArray[np.int64], time: NDArray[np.float64]) -> Beginning:
    """Return an interval of samples as times: a change first seen in a sample began after the one before."""
    earliest = None if moment.earliest is None else float(time[rows[moment.earliest - 1]])
    return Beginning(earliest, float(time[rows[moment.estimate]]), float(time[rows[moment.latest]]), CONFIDENCE)


def _along_change(residuals: NDArray[np.float64], quiet: int, last: int) -> NDArray[np.float64] | None:
    """Return the residual along the direction in which it has moved, up to the samples that show the direction.

    The direction is taken from the second half of the alarm, as noise would otherwise point along itself where the
    alarm begins; from all of it if it is clear beyond that. ``None`` if it is not known well. Of one residual it is a
    sign, which all of the alarm always tells, unless it does not move at all.
    """
    before = residuals[:quiet]
    level = before.mean(axis=0)
    scale = np.maximum(before.std(axis=0), DATA_ROUNDING * np.abs(residuals).max(axis=0))
    z = (residuals - level) / np.where(scale > 0, scale, 1.0)
    k = z.shape[1]
    shrunk = min(1.0, k / quiet)  # few samples know a covariance badly
    steps = np.diff(z[:quiet], axis=0)  # in which the beginning of a drift does not count
    size = np.mean(steps**2) / 2
    noise = (1 - shrunk) * (steps.T @ steps) / (2 * len(steps)) + (shrunk * size + DATA_ROUNDING) * np.eye(k)
    noise /= size if size > 0 else 1.0
    slow = float(np.clip(np.mean(z[1:quiet] * z[: quiet - 1]), 0.0, 0.99))  # noise that lasts counts for less
    half = last + (len(z) - last) // 2
    for start, stop, enough in ((half, half, CLEAR_DIRECTION * k), (last, len(z), CLEAR_DIRECTION * k * max(1, k / 3))):
        weights, moved = _direction(z[start : start + _MOST_ALARM], noise)
        clear = moved * (1 - slow) / (1 + slow) >= enough
        if k == 1 and (clear or (stop == len(z) and moved > 0)):
            return z[:, 0] * np.sign(weights[0])
        if k > 1 and clear:
            return z[:stop] @ weights
    return None


def _direction(after: NDArray[np.float64], noise: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Return the weights that best show a move of the residual, over as many of its first samples as show it best."""
    counts = np.arange(1, len(after) + 1)
    means = np.cumsum(after, axis=0) / counts[:, None]
    weights = np.linalg.solve(noise, means.T).T
    moved = counts * np.einsum("ij,ij->i", means, weights)
    best = int(np.argmax(moved))
    return weights[best], float(moved[best])


def explainer_of(spec: Specification, generator: ResidualGenerator, check: FitCheck | None) -> Explainer | None:
    """Return the explainer of alarms, made once for a specification; ``None`` if faults are named in another way."""
    known = spec.__dict__.get("_explainer", False)
    if known is False:
        whitening = Whitening.of(spec.test) if spec.isolation.has_words else None
        known = None
        if whitening is not None:
            known = Explainer(generator, whitening, () if check is None else check.colour)
        object.__setattr__(spec, "_explainer", known)
    return known


def word_of(
    alarm: Alarm,
    residuals: NDArray[np.float64],
    usable: NDArray[np.bool_],
    explainer: Explainer,
    after: int = FINAL,
) -> Word:
    """Return the word for an alarm by so many of its samples, and those before it."""
    begin, stop = max(0, alarm.start - BEFORE), min(alarm.start + after, alarm.stop)
    return explainer.word(residuals[begin:stop], usable[begin:stop], alarm.start - begin)


def with_words(
    alarms: Sequence[Alarm],
    residuals: NDArray[np.float64],
    usable: NDArray[np.bool_],
    explainer: Explainer | None,
    spec: Specification,
    since: float = -np.inf,
) -> tuple[Alarm, ...]:
    """Return the alarms with their words; faults named by a fit come before other candidates.

    Parameters
    ----------
    alarms : sequence of Alarm
        In order.
    residuals : ndarray, shape (time, residuals)
    usable : ndarray of bool, shape (time,)
    explainer : Explainer or None
        Fits faults to the longest ones; all others have the word of the isolation.
    spec : Specification
    since : float
        Only those that were raised from then on.
    """
    window = spec.isolation.samples_to_be_sure(spec.test)
    earlier = [alarm for alarm in alarms if alarm.raised < since]
    out = [alarm for alarm in alarms if alarm.raised >= since]
    if explainer is not None:
        for number, alarm in longest_alarms(out, SHOWN_ALARMS):
            word = spec.isolation.agreed(alarm, word_of(alarm, residuals, usable, explainer))
            if word.kind != TOO_EARLY or not spec.isolation.names_early:
                out[number - 1] = _worded(alarm, word)
    out = [alarm if alarm.word else replace(alarm, word=spec.isolation.word(alarm, window)) for alarm in out]
    return (*earlier, *out)


def _worded(alarm: Alarm, word: Word) -> Alarm:
    """Return an alarm with a word, and the groups in the word as the first candidates, in its order."""
    first, rest = [], list(alarm.candidates)
    for group in word.faults:
        same = [one for one in rest if set(one.faults) & set(group)]
        rest = [one for one in rest if one not in same]
        if word.kind in (GOOD, EITHER):
            best = same[0] if same else Candidate(group, math.sqrt(word.share), math.sqrt(1.0 - word.share))
            first.append(replace(best, faults=group))
        else:
            first += same
    candidates = (*first, *rest)
    arrival = candidates[0].arrival if candidates else None
    onset = alarm.onset if arrival is None else arrival
    return replace(alarm, word=word, candidates=candidates, arrival=arrival, onset=onset)


__all__ = ["explainer_of", "with_words", "word_of"]
