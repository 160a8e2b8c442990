"""Statistics of recent samples: gaps do not count, and results do not depend on how time is split into blocks."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

#: Sums over the last 1, 2, 3, ... samples, for each sample of a block.
Sums = Iterator[NDArray[np.float64]]


def over_recent(
    last: NDArray[np.float64],
    values: NDArray[np.float64],
    seen: NDArray[np.bool_],
    statistic: Callable[[Sums], NDArray[np.float64]],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return a statistic of sums over the last samples that were seen, and the next state.

    Parameters
    ----------
    last : ndarray, shape (plants, window - 1, k)
        The samples before the block, the oldest first.
    values : ndarray, shape (plants, time, k)
    seen : ndarray of bool, shape (plants, time)
    statistic : callable
        Makes the statistic, shape (plants, time), from an iterator over the sums of the last 1, 2, ... samples.
    """
    if seen.all():
        rows = np.concatenate([last, values], axis=1)
        return statistic(_sums(rows, last.shape[1] + 1, values.shape[1])), rows[:, values.shape[1] :].copy()
    out, later = np.zeros(seen.shape), last.copy()
    for plant in range(len(seen)):
        kept = values[[plant], :][:, seen[plant]]
        made, later[[plant]] = over_recent(last[[plant]], kept, np.ones(kept.shape[:2], dtype=bool), statistic)
        out[plant, seen[plant]] = made[0]
    return out, later


def _sums(rows: NDArray[np.float64], window: int, time: int) -> Sums:
    """Yield the sums, each one sample longer: always added from the newest sample to the oldest."""
    total = np.zeros((len(rows), time, rows.shape[2]))
    for back in range(window):
        start = window - 1 - back
        total = total + rows[:, start : start + time]
        yield total


__all__ = ["Sums", "over_recent"]
