"""The order of a model: by singular values, an information criterion and the error on held-out data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from residua.errors import DataError
from residua.identify.hankel_factor import HankelFactor
from residua.identify.prediction import ErrorSums, predictions
from residua.identify.realisation import criterion, realise
from residua.identify.segments import Gathered
from residua.identify.state_map import StateMap
from residua.progress import Progress

#: Held-out rows on which orders are compared.
_ROWS = 50_000


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
    most = most if wanted == "auto" else max(most, int(wanted))
    if most > len(states.T):
        raise DataError(
            f"the data support {len(states.T)} states at most with {states.past} rows of the past, {most} are asked "
            "for: give a longer past, or a smaller order"
        )
    orders = tuple(range(most + 1))
    values = criterion(factor, states, most, feedthrough=feedthrough)
    short = held_out.shortened(_ROWS)
    errors = np.full(len(orders), np.nan)
    for order in orders:
        errors[order] = _error(factor, states, order, short, feedthrough)
        progress("orders", order + 1, len(orders))
    if wanted != "auto":
        return OrderChoice(int(wanted), "as asked for", orders, values, errors)
    best = int(values.argmin())
    reason = "the smallest information criterion"
    if best == most and most == len(orders) - 1 and best:
        reason += ", which is still falling at the largest order that was compared (max_order)"
    if np.isfinite(errors).any():
        lowest = int(np.nanargmin(errors))
        reason += f"; the held-out error is smallest at order {lowest}"
    return OrderChoice(best, reason, orders, values, errors)


def _error(factor: HankelFactor, states: StateMap, order: int, held_out: Gathered, feedthrough: bool) -> float:
    """Return the prediction error of an order on the held-out part."""
    try:
        model = realise(factor, states, order, feedthrough=feedthrough)
    except DataError:  # no stable predictor of this order
        return np.nan
    sums = ErrorSums(factor.n_outputs)
    for _, y, predicted in predictions(model, held_out, factor.reference, factor.units):
        sums.add(y, y - predicted)
    if not sums.rows:
        return np.nan
    return float(np.exp(np.log(np.maximum(sums.share, np.finfo(float).tiny)).mean() / 2))
