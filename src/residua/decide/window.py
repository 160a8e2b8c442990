"""Moving sums equal to the last bit for any split of the data into blocks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.errors import FileFormatError


@dataclass(frozen=True, eq=False)
class WindowState:
    """State of a moving sum; every array has one row per plant.

    Time is cut into blocks of one window length, counted from the very first sample of a plant. The sum after a place
    of the last complete block is read for the last time when the sample of that place comes in, which takes its room.

    Attributes
    ----------
    values : ndarray, shape (plants, window, k)
        The samples of the block being filled; behind them, of the last complete block, for each place the sum of the
        samples after it, added backwards.
    begun : ndarray, shape (plants, k)
        Sum of the samples of the block being filled, added forwards.
    filled : ndarray of int, shape (plants,)
        How many samples are in it.
    """

    values: NDArray[np.float64]
    begun: NDArray[np.float64]
    filled: NDArray[np.int64]

    def arrays(self) -> tuple[NDArray, ...]:
        """Return the arrays that the fused loop reads and writes, in its order."""
        return self.values, self.begun, self.filled

    def check(self, where: str) -> None:
        """Raise if a window from a file is invalid."""
        length = self.values.shape[1]
        if not ((self.filled >= 0) & (self.filled < max(length, 2))).all():
            raise FileFormatError(f"{where}.filled must be below the window of {length}")


def empty_window(plants: int, window: int, k: int) -> WindowState:
    """Return the state before the first sample; a window of one sample takes no memory."""
    if window == 1:
        zeros = (np.broadcast_to(0.0, (plants, 1, k)), np.broadcast_to(0.0, (plants, k)))
        return WindowState(*zeros, np.broadcast_to(np.int64(0), plants))
    return WindowState(np.zeros((plants, window, k)), np.zeros((plants, k)), np.zeros(plants, dtype=np.int64))


def moving_sum(
    values: NDArray[np.float64], state: WindowState, judged: NDArray[np.bool_] | None = None
) -> tuple[NDArray[np.float64], WindowState]:
    """Return the sum over the last ``window`` samples, of those that count, at every sample.

    A window is the end of one block, summed backwards, and the beginning of the next, summed forwards: two
    additions per sample, no drift, and the same order of operations for any cutting of the data.

    Parameters
    ----------
    values : ndarray, shape (plants, time, k)
    state : WindowState
    judged : ndarray of bool, shape (plants, time), optional
        The samples that count; at the others no window moves on. All, when omitted.

    Returns
    -------
    sums : ndarray, shape (plants, time, k)
        Zero at samples that do not count.
    state : WindowState
        To go on with.
    """
    if state.values.shape[1] == 1 or values.shape[1] == 0:
        return values, state
    if judged is not None and not judged.all():
        return _sums_of_judged(values, state, judged)
    places = np.unique(state.filled).tolist()
    if len(places) <= 1:
        sums, kept, begun, filled = _summed(values, state.values, state.begun, *(places or [0]))
        return sums, WindowState(kept, begun, np.full_like(state.filled, filled))
    sums, after = np.empty_like(values), WindowState(state.values.copy(), state.begun.copy(), state.filled.copy())
    for place in places:
        who = np.flatnonzero(state.filled == place)
        parts = _summed(values[who], state.values[who], state.begun[who], place)
        sums[who], after.values[who], after.begun[who], after.filled[who] = parts
    return sums, after


def _sums_of_judged(
    values: NDArray[np.float64], state: WindowState, judged: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], WindowState]:
    """Return the moving sum if samples are left out: separately for each such plant, for all others at once."""
    sums = np.zeros_like(values)
    after = WindowState(state.values.copy(), state.begun.copy(), state.filled.copy())
    whole = judged.all(axis=1)
    groups = [(np.flatnonzero(whole), np.arange(values.shape[1]))] if whole.any() else []
    groups += [(np.array([plant]), np.flatnonzero(judged[plant])) for plant in np.flatnonzero(~whole)]
    for who, rows in groups:
        own = WindowState(state.values[who], state.begun[who], state.filled[who])
        part, own = moving_sum(values[np.ix_(who, rows)], own)
        sums[np.ix_(who, rows)] = part
        after.values[who], after.begun[who], after.filled[who] = own.arrays()
    return sums, after


def _summed(
    values: NDArray[np.float64], kept: NDArray[np.float64], begun: NDArray[np.float64], filled: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], int]:
    """Return the sums of plants whose blocks are equally full, and the new state."""
    total = filled + values.shape[1]
    if total >= kept.shape[1]:
        return _across_blocks(values, kept, filled)
    if filled:  # stays within the block: no more is copied than must change
        forwards = np.cumsum(np.concatenate([begun[:, None], values], axis=1), axis=1)[:, 1:]
    else:
        forwards = np.cumsum(values, axis=1)
    sums = kept[:, filled:total] + forwards
    kept = kept.copy()
    kept[:, filled:total] = values
    return sums, kept, forwards[:, -1].copy(), total


def _across_blocks(
    values: NDArray[np.float64], kept: NDArray[np.float64], filled: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], int]:
    plants, window, k = kept.shape
    total = filled + values.shape[1]
    n_blocks = -(-total // window)
    padded = np.zeros((plants, n_blocks * window, k))
    padded[:, :filled] = kept[:, :filled]
    padded[:, filled:total] = values
    blocks = padded.reshape(plants, n_blocks, window, k)
    ends = np.concatenate([kept[:, None], _ends(blocks)], axis=1)
    forwards = np.cumsum(blocks, axis=2)
    sums = (ends[:, :-1] + forwards).reshape(plants, -1, k)[:, filled:total]
    left = total % window
    if left == 0:
        return sums, ends[:, -1].copy(), np.zeros((plants, k)), 0
    after = ends[:, -2].copy()
    after[:, :left] = blocks[:, -1, :left]
    return sums, after, forwards[:, -1, left - 1].copy(), left


def _ends(blocks: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return for each position the sum of the samples after it in its block, added backwards."""
    out = np.zeros_like(blocks)
    out[:, :, :-1] = np.cumsum(blocks[:, :, :0:-1], axis=2)[:, :, ::-1]
    return out
