"""Moving sums that come out the same to the last bit however the data are cut."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def moving_sum(
    values: NDArray[np.float64], previous: NDArray[np.float64], current: NDArray[np.float64], filled: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], int]:
    """Return the sum over the last ``window`` samples at every sample.

    Time is cut into blocks of one window length, counted from the very first sample. A window is the end of
    one block, summed backwards, and the beginning of the next, summed forwards: two additions per sample,
    no drift, and the same order of operations for any cutting of the data.

    Parameters
    ----------
    values : ndarray, shape (plants, time, k)
    previous, current : ndarray, shape (plants, window, k)
        The last complete block, and the block being filled.
    filled : int
        How many samples of the current block are there.

    Returns
    -------
    sums : ndarray, shape (plants, time, k)
    previous, current, filled
        To go on with.
    """
    plants, time, k = values.shape
    window = previous.shape[1]
    if window == 1:
        return values, previous, current, 0
    total = filled + time
    n_blocks = -(-total // window) or 1
    padded = np.zeros((plants, n_blocks * window, k))
    padded[:, :filled] = current[:, :filled]
    padded[:, filled:total] = values
    blocks = padded.reshape(plants, n_blocks, window, k)
    before = np.concatenate([previous[:, None], blocks[:, :-1]], axis=1)
    ends = np.zeros_like(before)  # sum of the samples of the block before that are still in the window
    ends[:, :, :-1] = np.cumsum(before[:, :, :0:-1], axis=2)[:, :, ::-1]
    sums = (ends + np.cumsum(blocks, axis=2)).reshape(plants, -1, k)[:, filled:total]
    if total % window == 0 and total:
        return sums, blocks[:, -1].copy(), np.zeros_like(current), 0
    return sums, before[:, -1].copy(), blocks[:, -1].copy(), total % window
