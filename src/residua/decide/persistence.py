"""Alarm logic: persistence with release."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

#: Where counters of 32 bits stop. They are compared with lengths alone, never subtracted: a count that has stopped is
#: over any length below it as one that goes on would be, and a length beyond is never reached.
LAST_COUNT = 2**31 - 1


def stopped(count: NDArray[np.int64]) -> NDArray[np.int32]:
    """Return counts as 32-bit counters that saturate."""
    return np.minimum(count, LAST_COUNT).astype(np.int32)


@dataclass(frozen=True, eq=False)
class AlarmRuns:
    """State of the alarm logic; a row per plant, or a row and a column for each part.

    Attributes
    ----------
    up, down : ndarray of int32
        Usable samples in a row above and below the threshold so far; both stop at :data:`LAST_COUNT`. ``down`` is zero,
        and takes no memory, of a test whose alarm is ended by a level (:meth:`without_down`).
    alarm : ndarray of bool
        Whether the alarm is on.
    """

    up: NDArray[np.int32]
    down: NDArray[np.int32]
    alarm: NDArray[np.bool_]

    def arrays(self) -> tuple[NDArray, ...]:
        """Return the arrays that the fused loop reads and writes, in its order."""
        return self.up, self.down, self.alarm

    @staticmethod
    def empty(plants: int, *parts: int) -> AlarmRuns:
        """Return the runs before the first sample."""
        none = np.zeros((plants, *parts), dtype=np.int32)
        return AlarmRuns(none, none, np.zeros((plants, *parts), dtype=bool))

    @staticmethod
    def after(up: NDArray[np.int64], down: NDArray[np.int64], alarm: NDArray[np.bool_]) -> AlarmRuns:
        """Return the runs after the last sample of a block; (plants, time), or (plants, time, parts)."""
        return AlarmRuns(stopped(up[:, -1]), stopped(down[:, -1]), alarm[:, -1].copy())

    def without_down(self) -> AlarmRuns:
        """Return the runs of a test that does not need the count of samples below the threshold."""
        return replace(self, down=np.broadcast_to(np.int32(0), self.up.shape))


def run_alarm(
    exceeded: NDArray[np.bool_], usable: NDArray[np.bool_], runs: AlarmRuns, persistence: int, release: int
) -> tuple[NDArray[np.bool_], NDArray[np.int64], AlarmRuns]:
    """Run the alarm logic over a block of samples, as :func:`alarm_logic`.

    Returns
    -------
    alarm : ndarray of bool, shape (plants, time)
    up : ndarray of int, shape (plants, time)
        Samples in a row over the threshold.
    runs : AlarmRuns
        To go on with.
    """
    alarm, up, down = alarm_logic(exceeded, usable, runs.up, runs.down, runs.alarm, persistence, release)
    if not exceeded.shape[1]:
        return alarm, up, runs
    return alarm, up, AlarmRuns.after(up, down, alarm)


def alarm_logic(
    exceeded: NDArray[np.bool_],
    usable: NDArray[np.bool_],
    up: NDArray[np.integer],
    down: NDArray[np.integer],
    alarm: NDArray[np.bool_],
    persistence: int,
    release: int,
) -> tuple[NDArray[np.bool_], NDArray[np.int64], NDArray[np.int64]]:
    """Run the alarm logic over a block of samples; the same for any split into blocks.

    An alarm is raised by ``persistence`` usable samples in a row over the threshold and goes away after
    ``release`` usable samples in a row below it. Samples that are not usable change nothing.

    Parameters
    ----------
    exceeded, usable : ndarray of bool, shape (plants, time)
    up, down : ndarray of int, shape (plants,)
        Usable samples in a row above and below the threshold so far.
    alarm : ndarray of bool, shape (plants,)
        Whether the alarm was on.
    persistence, release : int

    Returns
    -------
    alarm : ndarray of bool, shape (plants, time)
    up, down : ndarray of int, shape (plants, time)
        The run lengths after each sample, up to :data:`LAST_COUNT`.
    """
    over, under = usable & exceeded, usable & ~exceeded
    count = np.cumsum(usable, axis=1)
    up_now = count - np.maximum.accumulate(np.where(under, count, -up[:, None]), axis=1)
    down_now = count - np.maximum.accumulate(np.where(over, count, -down[:, None]), axis=1)
    if max(up.max(initial=0), down.max(initial=0)) > LAST_COUNT - usable.shape[1]:
        up_now, down_now = np.minimum(up_now, LAST_COUNT), np.minimum(down_now, LAST_COUNT)
    raised, ended = over & (up_now >= persistence), under & (down_now >= release)
    return held(raised, ended, alarm), up_now, down_now


def held(raised: NDArray[np.bool_], ended: NDArray[np.bool_], alarm: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the alarm at each sample, given samples that raise it, end it or leave it unchanged.

    Parameters
    ----------
    raised, ended : ndarray of bool, shape (plants, time)
    alarm : ndarray of bool, shape (plants,)
        Whether it was on before.
    """
    samples = np.arange(raised.shape[1])
    latest = np.maximum.accumulate(np.where(raised | ended, samples, -1), axis=1)
    return np.where(latest >= 0, np.take_along_axis(raised, np.maximum(latest, 0), axis=1), alarm[:, None])
