"""From samples over a threshold to alarms that last: persistence with release."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class AlarmRuns:
    """What the alarm logic remembers; a row per plant, or a row and a column for each part.

    Attributes
    ----------
    up, down : ndarray of int
        Usable samples in a row above and below the threshold so far.
    alarm : ndarray of bool
        Whether the alarm is on.
    """

    up: NDArray[np.int64]
    down: NDArray[np.int64]
    alarm: NDArray[np.bool_]

    def arrays(self) -> tuple[NDArray, ...]:
        """Return what the fused loop reads and writes, in its order."""
        return self.up, self.down, self.alarm

    @staticmethod
    def empty(plants: int, *parts: int) -> AlarmRuns:
        """Return the runs before the first sample."""
        none = np.zeros((plants, *parts), dtype=np.int64)
        return AlarmRuns(none, none, np.zeros((plants, *parts), dtype=bool))


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
    return alarm, up, AlarmRuns(up[:, -1].copy(), down[:, -1].copy(), alarm[:, -1].copy())


def alarm_logic(
    exceeded: NDArray[np.bool_],
    usable: NDArray[np.bool_],
    up: NDArray[np.int64],
    down: NDArray[np.int64],
    alarm: NDArray[np.bool_],
    persistence: int,
    release: int,
) -> tuple[NDArray[np.bool_], NDArray[np.int64], NDArray[np.int64]]:
    """Run the alarm logic over a block of samples; the same for any cutting into blocks.

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
        The run lengths after each sample.
    """
    over, under = usable & exceeded, usable & ~exceeded
    count = np.cumsum(usable, axis=1)
    up_now = count - np.maximum.accumulate(np.where(under, count, -up[:, None]), axis=1)
    down_now = count - np.maximum.accumulate(np.where(over, count, -down[:, None]), axis=1)
    raised, ended = over & (up_now >= persistence), under & (down_now >= release)
    return held(raised, ended, alarm), up_now, down_now


def held(raised: NDArray[np.bool_], ended: NDArray[np.bool_], alarm: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return for each sample whether an alarm is on that some samples raise, others end, and the rest let be.

    Parameters
    ----------
    raised, ended : ndarray of bool, shape (plants, time)
    alarm : ndarray of bool, shape (plants,)
        Whether it was on before.
    """
    samples = np.arange(raised.shape[1])
    latest = np.maximum.accumulate(np.where(raised | ended, samples, -1), axis=1)
    return np.where(latest >= 0, np.take_along_axis(raised, np.maximum(latest, 0), axis=1), alarm[:, None])
