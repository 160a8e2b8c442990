"""The orders of equations, one for each output, by an information criterion, beside the error on held-out data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from residua.identify.equations import Shape, columns_of, determined, terms_of
from residua.identify.hankel_factor import HankelFactor, count_windows
from residua.identify.horizon import NOISE_FREE
from residua.identify.segments import Gathered
from residua.tolerances import DATA_ROUNDING
from residua.words import counted

Matrix = NDArray[np.float64]
#: Held-out rows on which orders are compared.
_ROWS = 50_000
#: Orders that are compared at most, unless the caller says otherwise; and columns of the Hankel matrix for them.
_MOST_ORDERS, _MOST_COLUMNS = 20, 400
#: Rows for each column from which on an order is compared.
_LEAST_ROWS = 4
#: Held-out windows at a time.
_BLOCK = 2048
#: An order is compared if at least this part of the rows has as many before it.
_LEAST_SHARE = 0.5


@dataclass(frozen=True, eq=False)
class EquationChoice:
    """The shape of one equation and what it was compared with.

    Attributes
    ----------
    shape : Shape
    reason : str
    orders : tuple of int
    criterion : ndarray, shape (2, orders)
        Schwarz's, by the own past and by that of all outputs; the smallest is zero, those that the data do not
        determine, or that were not asked for, are infinite.
    held_out_errors : ndarray, shape (2, orders)
        Prediction error on the held-out part, relative to the output's standard deviation; NaN where there is none.
    """

    shape: Shape
    reason: str
    orders: tuple[int, ...]
    criterion: Matrix
    held_out_errors: Matrix


def most_orders(gathered: Gathered) -> int:
    """Return the largest order that is compared by default: one that most rows have before them."""
    n = len(gathered.channels)
    most = max(min(_MOST_ORDERS, _MOST_COLUMNS // n), 1)
    enough = _LEAST_SHARE * count_windows(gathered, 2)
    while most > 1 and count_windows(gathered, most + 1) < max(enough, _LEAST_ROWS * (1 + n * (most + 1))):
        most -= 1
    return most


def choose_equations(
    factor: HankelFactor,
    held_out: Gathered,
    orders: Mapping[str, int] | Literal["auto"],
    past_of: str,
    *,
    feedthrough: bool,
) -> tuple[EquationChoice, ...]:
    """Return the shape of the equation of each output, by Schwarz's criterion where no order is asked for."""
    m, p, most = factor.n_inputs, factor.n_outputs, factor.length - 1
    criterion = np.full((p, 2, most + 1), np.inf)
    share = np.full((p, 2, most + 1), np.nan)
    targets = factor.outputs(most)
    short = held_out.shortened(_ROWS, 2 * factor.length)
    kinds = [coupled for coupled in (False, True) if past_of in ("auto", "all" if coupled else "own")]
    kinds = [False] if p == 1 else kinds
    for coupled in kinds:
        solutions = []
        for group in [range(p)] if coupled else [[i] for i in range(p)]:
            terms = terms_of(Shape(most, coupled), group[0], m, p, feedthrough=feedthrough)
            columns = columns_of(factor, terms)
            T = np.asarray(np.linalg.qr(factor.R[:, [*columns, *(targets[i] for i in group)]], mode="r"))
            per_row = m + (p if coupled else 1)
            solutions.append((group, columns, _nested(T, len(columns), per_row, most, factor.windows)))
        for group, columns, (values, thetas) in solutions:
            criterion[group, int(coupled)] = values
            share[group, int(coupled)] = _held_out(thetas, columns, group, factor, short)
    wanted = {} if orders == "auto" else orders
    return tuple(
        _choice(criterion[i], share[i], wanted.get(name), p, richest=kinds[-1])
        for i, name in enumerate(held_out.outputs)
    )


def _nested(
    T: Matrix, columns: int, per_row: int, most: int, windows: int
) -> tuple[Matrix, list[tuple[int, Matrix] | None]]:
    """Return Schwarz's criterion of each order, shape (targets, orders), and the solutions with their sizes."""
    left = determined(T[:columns, :columns])
    values, solutions = np.full((T.shape[1] - columns, most + 1), np.inf), []
    for order in range(most + 1):
        k = columns - (most - order) * per_row
        if left[:k].min() <= DATA_ROUNDING:
            solutions.append(None)
            continue
        error = np.linalg.norm(T[k:, columns:], axis=0) / np.sqrt(windows)
        values[:, order] = 2 * windows * np.log(np.maximum(error, NOISE_FREE)) + k * np.log(windows)
        solutions.append((k, np.asarray(solve_triangular(T[:k, :k], T[:k, columns:]), dtype=float)))
    return values, solutions


def _held_out(
    solutions: Sequence[tuple[int, Matrix] | None],
    columns: Sequence[int],
    group: Sequence[int],
    factor: HankelFactor,
    held_out: Gathered,
) -> Matrix:
    """Return the errors on the held-out part relative to the standard deviations, shape (targets, orders)."""
    count, last = len(group), factor.length - 1
    Theta = np.zeros((len(columns), len(solutions), count))
    for order, one in enumerate(solutions):
        if one is not None:
            Theta[: one[0], order] = one[1]
    targets = [factor.outputs(last)[i] for i in group]
    rows, total, squares = 0, np.zeros(count), np.zeros(count)
    errors = np.zeros((len(solutions), count))
    for segment in held_out.segments:
        for start in range(0, len(segment) - last, _BLOCK):
            Z = segment.rows(start, min(start + _BLOCK + last, len(segment)))
            Z = (Z - factor.reference) / factor.units
            H = np.lib.stride_tricks.sliding_window_view(Z, factor.length, axis=0).transpose(0, 2, 1)
            H = np.hstack([np.ones((len(H), 1)), H.reshape(len(H), -1)])
            y = H[:, targets]
            rows += len(y)
            total += y.sum(axis=0)
            squares += (y**2).sum(axis=0)
            errors += ((y[:, None] - np.tensordot(H[:, columns], Theta, axes=1)) ** 2).sum(axis=0)
    missing = np.array([one is None for one in solutions])
    variance = squares - total**2 / max(rows, 1)
    out = np.sqrt(errors / np.where(variance > 0, variance, 1.0)).T if rows else np.full(errors.T.shape, np.nan)
    out[:, missing] = np.nan
    return out


def _choice(criterion: Matrix, share: Matrix, wanted: int | None, n_outputs: int, *, richest: bool) -> EquationChoice:
    """Return the choice for one output; ``richest``: whether the past of all outputs was among what was compared."""
    orders = tuple(range(criterion.shape[1]))
    compared = criterion if wanted is None else criterion[:, [wanted]]
    if np.isfinite(compared).any():
        kind, place = np.unravel_index(int(compared.argmin()), compared.shape)
        best = int(place) if wanted is None else wanted
    else:  # the fit says which signal the others determine
        kind, best = int(richest), wanted or 0
    coupled = bool(kind)
    reason = "as asked for" if wanted is not None else "the smallest information criterion"
    finite = np.isfinite(criterion).any(axis=0)
    last = int(np.flatnonzero(finite)[-1]) if finite.any() else 0
    if wanted is None and best == last == orders[-1] and best:
        reason += ", which is still falling at the largest order that was compared (max_order)"
    elif last < orders[-1]:
        reason += f"; the data do not determine more than {counted(last, 'row')} of the past"
    if np.isfinite(share).any():
        lowest = int(np.nanargmin(np.where(np.isnan(share[int(coupled)]), np.inf, share[int(coupled)])))
        reason += f"; the held-out error is smallest at order {lowest}"
    other = criterion[1 - int(coupled)]
    if n_outputs > 1 and np.isfinite(other).any() and np.isfinite(compared).any():
        more = float((other if wanted is None else other[[wanted]]).min() - compared.min())
        what = "its own past alone" if coupled else "the past of the other outputs too"
        if np.isfinite(more):
            reason += f"; with {what} the criterion is {more:.1f} higher"
    least = float(compared.min()) if np.isfinite(compared).any() else 0.0
    least = float(criterion.min()) if np.isfinite(criterion).any() else least
    return EquationChoice(Shape(best, coupled), reason, orders, criterion - least, share)
