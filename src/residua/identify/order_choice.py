"""The order of a model: by singular values, an information criterion and the error on held-out data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from residua.errors import DataError
from residua.identify.hankel_factor import HankelFactor
from residua.identify.horizon import log_determinant
from residua.identify.prediction import ErrorSums, predictions
from residua.identify.realisation import Innovations, realise
from residua.identify.segments import Gathered
from residua.identify.state_map import StateMap
from residua.progress import Progress

#: Rows on which orders are compared, of those that the model is from and of those held out.
_ROWS = 50_000
#: Orders below one that is asked for that it is compared with, where it is larger than those that are compared anyway.
_BELOW = 3


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
        model = _model(factor, states, order, feedthrough)
        if model is not None:
            values[k] = criterion(model, seen, factor, feedthrough=feedthrough)
            errors[k] = _error(model, unseen, factor)
        progress("orders", k + 1, len(orders))
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


def _model(factor: HankelFactor, states: StateMap, order: int, feedthrough: bool) -> Innovations | None:
    """Return the model of an order; ``None`` where no stable predictor has its covariances."""
    try:
        return realise(factor, states, order, feedthrough=feedthrough)
    except DataError:
        return None


def criterion(model: Innovations, fitted: Gathered, factor: HankelFactor, *, feedthrough: bool) -> float:
    r"""Return Schwarz's criterion of a model, by the errors of its own predictor on rows that it is from.

    .. math:: N \log \det \hat V_n + n (2 p + m) \log N

    The predictor runs on from row to row. Errors of the outputs given states that are taken anew from the past of each
    row would not do: the leading combination of the past alone says nearly all of the next row of a slow output, and
    nothing of the row after.
    """
    rows, m, p = 0, factor.n_inputs, factor.n_outputs
    root = np.zeros((0, p))
    for _, y, predicted in predictions(model, fitted, factor.reference, factor.units):
        rows += len(y)
        root = np.asarray(np.linalg.qr(np.vstack([root, y - predicted]), mode="r"))
    parameters = model.order * (2 * p + m) + (p * m if feedthrough else 0)
    return rows * log_determinant(root, rows) + parameters * float(np.log(rows))


def _error(model: Innovations, held_out: Gathered, factor: HankelFactor) -> float:
    """Return the prediction error of a model on the held-out part."""
    sums = ErrorSums(factor.n_outputs)
    for _, y, predicted in predictions(model, held_out, factor.reference, factor.units):
        sums.add(y, y - predicted)
    if not sums.rows:
        return np.nan
    return float(np.exp(np.log(np.maximum(sums.share, np.finfo(float).tiny)).mean() / 2))
