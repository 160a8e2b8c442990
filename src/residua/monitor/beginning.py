"""Interval for the time at which the change behind an alarm began."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from residua.decide.alarm import Alarm, Beginning
from residua.decide.change_time import CONFIDENCE, LEAST_BEFORE, ChangeTime, change_time
from residua.decide.statement import SHOWN_ALARMS, longest_alarms
from residua.tolerances import DATA_ROUNDING

#: Alarms less than this many samples apart are dated together: the cause of the last one may precede them all.
APART = 200
#: Samples of an alarm from which the direction of the change is taken at most.
_MOST_ALARM = 2000
#: Judged samples that are looked at before the crossing at most, and of the alarm: bounds time and memory.
MOST_ROWS = 10_000
#: Samples that are looked through at once.
_PIECE = 1 << 17
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
