"""The rows of the past and the order of a model, by information criteria and the error on held-out data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from residua.errors import DataError
from residua.identify.channel_facts import ChannelFacts
from residua.identify.hankel_factor import NOISE_FREE, HankelFactor, count_windows, hankel_factor
from residua.identify.prediction import predictions
from residua.identify.realisation import Innovations, realise
from residua.identify.segments import Gathered
from residua.identify.subspace_methods import StateMap
from residua.progress import Progress
from residua.words import counted

#: Rows from which the past is chosen: that choice need not be exact.
_ROWS_FOR_PAST = 100_000
#: Columns of the Hankel matrix of the longest past that is tried, and rows for each of its columns.
_MOST_COLUMNS, _LEAST_ROWS = 400, 4
#: The longest past that is tried.
_LONGEST = 60
#: Rows on which orders are compared, of those that the model is from and of those held out.
_ROWS = 50_000
#: Orders below one that is asked for that it is compared with, where it is larger than those that are compared anyway.
_BELOW = 3


def choose_past(gathered: Gathered, facts: ChannelFacts, *, feedthrough: bool) -> int:
    """Return the rows of the past that predict the outputs best by Akaike's criterion, corrected for few samples.

    Raises
    ------
    DataError
        If the data are too few for a single row of the past.
    """
    data = gathered.shortened(_ROWS_FOR_PAST)
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
    outputs = len(gathered.outputs)

    def akaike(past: int) -> float:
        regressors = len(fixed) + past * n
        left = windows - regressors - outputs - 1
        if left <= 0:
            return np.inf
        return windows * log_determinant(T[regressors:, -outputs:], windows) + 2 * outputs * regressors * windows / left

    return min(range(1, most + 1), key=akaike)


def past_of_order(gathered: Gathered, order: int, least: int) -> int:
    """Return the rows of the past, ``least`` or more, in which so many states show, and one more for their shift.

    Where the data are too few for the one more, and the least will do without it, it is the least.

    Raises
    ------
    DataError
        If the data have fewer than four windows for each column of that Hankel matrix.
    """
    n, p = len(gathered.channels), len(gathered.outputs)

    def enough(past: int) -> int:
        return _LEAST_ROWS * (1 + n * (past + 1))

    past = max(-(-order // p) + 1, least)
    windows = count_windows(gathered, past + 1)
    if windows >= enough(past):
        return past
    if order <= least * p:
        return least
    smaller = ((k, -(-k // p) + 1) for k in range(order - 1, least * p, -1))
    largest = next((k for k, rows in smaller if count_windows(gathered, rows + 1) >= enough(rows)), least * p)
    raise DataError(
        f"too few data for a model of order {order}: it needs {past} rows of the past of "
        f"{counted(n, 'channel')}, and there are {windows} such windows where {enough(past)} are the "
        f"least; the data are enough for order {largest}; choose a smaller order, or give the past yourself"
    )


def log_determinant(residual: NDArray, samples: int) -> float:
    """Return the logarithm of the determinant of a covariance, from columns whose products over ``samples`` it is."""
    s = np.linalg.svd(residual, compute_uv=False) / np.sqrt(samples)
    return 2 * float(np.log(np.maximum(s, NOISE_FREE)).sum())


@dataclass(frozen=True, eq=False)
class OrderChoice:
    """The order of a model and what it was compared with.

    Attributes
    ----------
    order : int
    reason : str
    orders : tuple of int
    criterion : ndarray
        Schwarz's; the smallest is zero.
    held_out_errors : ndarray
        The geometric mean over the outputs of the prediction error, relative to the outputs' standard deviations; NaN
        where nothing is held out or no stable predictor exists.
    """

    order: int
    reason: str
    orders: tuple[int, ...]
    criterion: NDArray[np.float64]
    held_out_errors: NDArray[np.float64]


def choose_order(
    factor: HankelFactor,
    states: StateMap,
    most: int,
    fitted: Gathered,
    held_out: Gathered,
    wanted: int | Literal["auto"],
    *,
    feedthrough: bool,
    progress: Progress,
) -> OrderChoice:
    """Return the order by Schwarz's criterion, or the one that is wanted, compared with the others.

    Raises
    ------
    DataError
        If the data have fewer candidates for states than the order that is wanted.
    """
    orders = tuple(range(most + 1))
    if wanted != "auto":
        orders = tuple(sorted({*orders, *range(max(int(wanted) - _BELOW, 0), int(wanted) + 1)}))
    if orders[-1] > len(states.T):
        raise DataError(
            f"the data support {len(states.T)} states at most with {states.past} rows of the past, {orders[-1]} are "
            "asked for: give a longer past, or a smaller order"
        )
    enough = 2 * states.past + 1  # rows of a part: fewer than the past foretell none
    seen, unseen = fitted.shortened(_ROWS, enough), held_out.shortened(_ROWS, enough)
    values, errors = np.full(len(orders), np.inf), np.full(len(orders), np.nan)
    for k, order in enumerate(orders):
        progress("orders", k, len(orders))
        try:
            model = realise(factor, states, order, feedthrough=feedthrough)
        except DataError:  # no stable predictor has its covariances
            continue
        values[k] = criterion(model, seen, factor, feedthrough=feedthrough)
        pieces = list(predictions(model, unseen, factor.reference, factor.units))
        if pieces:
            y, predicted = (np.vstack([piece[i] for piece in pieces]) for i in (1, 2))
            spread = np.sum((y - y.mean(axis=0)) ** 2, axis=0)
            share = np.sum((y - predicted) ** 2, axis=0) / np.where(spread > 0, spread, 1.0)
            errors[k] = np.exp(np.log(np.maximum(share, np.finfo(float).tiny)).mean() / 2)
    progress("orders", len(orders), len(orders))
    values -= values.min()
    if wanted != "auto":
        return OrderChoice(int(wanted), "as asked for", orders, values, errors)
    best = int(values.argmin())
    reason = "the smallest information criterion"
    if best == most and best:
        reason += ", which is still falling at the largest order that was compared (max_order)"
    if np.isfinite(errors).any():
        lowest = int(np.nanargmin(errors))
        reason += f"; the held-out error is smallest at order {lowest}"
    return OrderChoice(best, reason, orders, values, errors)


def criterion(model: Innovations, fitted: Gathered, factor: HankelFactor, *, feedthrough: bool) -> float:
    r"""Return Schwarz's criterion of a model, by the errors of its own predictor on rows that it is from.

    .. math:: N \log \det \hat V_n + n (2 p + m) \log N

    The predictor runs on from row to row. Errors of the outputs given states that are taken anew from the past of each
    row would not do: the leading combination of the past alone says nearly all of the next row of a slow output, and
    nothing of the row after.
    """
    errors = np.vstack(
        [y - predicted for _, y, predicted in predictions(model, fitted, factor.reference, factor.units)]
    )
    (rows, p), m = errors.shape, factor.n_inputs
    parameters = model.order * (2 * p + m) + (p * m if feedthrough else 0)
    root = np.asarray(np.linalg.qr(errors, mode="r"))
    return rows * log_determinant(root, rows) + parameters * float(np.log(rows))
