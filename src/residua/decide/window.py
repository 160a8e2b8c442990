"""Moving sums that come out the same to the last bit however the data are cut."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.errors import FileFormatError


@dataclass(frozen=True, eq=False)
class WindowState:
    """What a moving sum remembers; every array has one row per plant.

    Time is cut into blocks of one window length, counted from the very first sample.

    Attributes
    ----------
    ends : ndarray, shape (plants, window, k)
        Of the last complete block: for each position the sum of the samples after it, added backwards.
    block : ndarray, shape (plants, window, k)
        The block being filled.
    begun : ndarray, shape (plants, k)
        Sum of what is in it, added forwards.
    filled : int
        How many samples are in it.
    """

    ends: NDArray[np.float64]
    block: NDArray[np.float64]
    begun: NDArray[np.float64]
    filled: int

    def check(self, where: str) -> None:
        """Raise where a window from a file cannot be one."""
        length = self.block.shape[1]
        if not 0 <= self.filled < max(length, 2):
            raise FileFormatError(f"{where}.filled must be below the window of {length}")


def empty_window(plants: int, window: int, k: int) -> WindowState:
    """Return the state before the first sample."""
    block = np.zeros((plants, window, k))
    return WindowState(block, block, np.zeros((plants, k)), 0)


def moving_sum(values: NDArray[np.float64], state: WindowState) -> tuple[NDArray[np.float64], WindowState]:
    """Return the sum over the last ``window`` samples at every sample.

    A window is the end of one block, summed backwards, and the beginning of the next, summed forwards: two
    additions per sample, no drift, and the same order of operations for any cutting of the data.

    Parameters
    ----------
    values : ndarray, shape (plants, time, k)
    state : WindowState

    Returns
    -------
    sums : ndarray, shape (plants, time, k)
    state : WindowState
        To go on with.
    """
    time, window = values.shape[1], state.block.shape[1]
    if window == 1 or time == 0:
        return values, state
    total = state.filled + time
    if total < window:  # stays within the block: no more is copied than must change
        if state.filled:
            begun = np.cumsum(np.concatenate([state.begun[:, None], values], axis=1), axis=1)[:, 1:]
        else:
            begun = np.cumsum(values, axis=1)
        block = state.block.copy()
        block[:, state.filled : total] = values
        sums = state.ends[:, state.filled : total] + begun
        return sums, WindowState(state.ends, block, begun[:, -1].copy(), total)
    return _across_blocks(values, state, total)


def _across_blocks(
    values: NDArray[np.float64], state: WindowState, total: int
) -> tuple[NDArray[np.float64], WindowState]:
    plants, window, k = state.block.shape
    n_blocks = -(-total // window)
    padded = np.zeros((plants, n_blocks * window, k))
    padded[:, : state.filled] = state.block[:, : state.filled]
    padded[:, state.filled : total] = values
    blocks = padded.reshape(plants, n_blocks, window, k)
    ends = np.concatenate([state.ends[:, None], _ends(blocks)], axis=1)
    begun = np.cumsum(blocks, axis=2)
    sums = (ends[:, :-1] + begun).reshape(plants, -1, k)[:, state.filled : total]
    left = total % window
    if left == 0:
        fresh = empty_window(plants, window, k)
        return sums, WindowState(ends[:, -1].copy(), fresh.block, fresh.begun, 0)
    return sums, WindowState(ends[:, -2].copy(), blocks[:, -1].copy(), begun[:, -1, left - 1].copy(), left)


def _ends(blocks: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return for each position the sum of the samples after it in its block, added backwards."""
    out = np.zeros_like(blocks)
    out[:, :, :-1] = np.cumsum(blocks[:, :, :0:-1], axis=2)[:, :, ::-1]
    return out
