"""How many rows of the past a predictor needs: the order of an autoregression with inputs, by Akaike's criterion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from residua.errors import DataError
from residua.identify.channel_facts import ChannelFacts
from residua.identify.hankel_factor import count_windows, hankel_factor
from residua.identify.segments import Gathered
from residua.words import counted

#: Rows from which the horizon is chosen: that choice need not be exact.
_ROWS = 100_000
#: Columns of the Hankel matrix of the longest past that is tried, and rows for each of its columns.
_MOST_COLUMNS, _LEAST_ROWS = 400, 4
#: The longest past that is tried.
_LONGEST = 60
#: A prediction error below this part of an output's standard deviation counts as none.
NOISE_FREE = 1e-7


def choose_past(gathered: Gathered, facts: ChannelFacts, *, feedthrough: bool) -> int:
    """Return the rows of the past that predict the outputs best by Akaike's criterion, corrected for few samples.

    Raises
    ------
    DataError
        If the data are too few for a single row of the past.
    """
    data = gathered.shortened(_ROWS)
    n = len(gathered.channels)
    most = min(_LONGEST, _MOST_COLUMNS // n)
    while most > 1 and count_windows(data, most + 1) < _LEAST_ROWS * (1 + n * (most + 1)):
        most -= 1
    windows = count_windows(data, most + 1)
    if windows < 2 * (1 + 2 * n):
        rows = max((len(one) for one in data.segments), default=0)
        raise DataError(
            f"too few data for a model of {n} channels: the longest segment without a missing value has {rows} rows, "
            f"{2 * (1 + 2 * n) + 1} in a row are the least; take fewer channels, or a longer recording"
        )
    factor = hankel_factor(data, most + 1, facts)
    newest_first = [column for time in reversed(range(most)) for column in factor.signals([time])]
    fixed = [0, *(factor.inputs(most) if feedthrough else [])]
    T = np.asarray(np.linalg.qr(factor.R[:, [*fixed, *newest_first, *factor.outputs(most)]], mode="r"))
    return min(range(1, most + 1), key=lambda past: _akaike(T, len(fixed) + past * n, gathered, windows))


def past_of_order(gathered: Gathered, order: int, least: int) -> int:
    """Return the rows of the past, ``least`` or more, in which so many states show, and one more for their shift.

    Where the data are too few for the one more, and the least will do without it, it is the least.

    Raises
    ------
    DataError
        If the data have fewer than four windows for each column of that Hankel matrix.
    """

    def rows_of(states: int) -> int:
        return -(-states // len(gathered.outputs)) + 1

    def excess(past: int) -> int:
        return count_windows(gathered, past + 1) - _LEAST_ROWS * (1 + len(gathered.channels) * (past + 1))

    past = max(rows_of(order), least)
    if excess(past) < 0 and order <= least * len(gathered.outputs):
        return least
    if excess(past) < 0:
        n, windows = len(gathered.channels), count_windows(gathered, past + 1)
        without = least * len(gathered.outputs)
        largest = next((k for k in range(order - 1, without, -1) if excess(rows_of(k)) >= 0), without)
        raise DataError(
            f"too few data for a model of order {order}: it needs {past} rows of the past of "
            f"{counted(n, 'channel')}, and there are {windows} such windows where {windows - excess(past)} are the "
            f"least; the data are enough for order {largest}; choose a smaller order, or give the past yourself"
        )
    return past


def log_determinant(residual: NDArray, samples: int) -> float:
    """Return the logarithm of the determinant of a covariance, from columns whose products over ``samples`` it is."""
    s = np.linalg.svd(residual, compute_uv=False) / np.sqrt(samples)
    return 2 * float(np.log(np.maximum(s, NOISE_FREE)).sum())


def _akaike(T: NDArray, regressors: int, gathered: Gathered, windows: int) -> float:
    outputs = len(gathered.outputs)
    left = windows - regressors - outputs - 1
    if left <= 0:
        return np.inf
    return windows * log_determinant(T[regressors:, -outputs:], windows) + 2 * outputs * regressors * windows / left
