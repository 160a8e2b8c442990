"""Pairs of rows and columns of a table of costs with the least sum."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_NONE = -1


def least_cost_columns(costs: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return for each row of a table of finite costs a column of its own, so that the sum of the costs is least.

    By shortest augmenting paths, row after row. Among equal sums it chooses as ``scipy.optimize.linear_sum_assignment``
    does, step by step: to import that takes longer than a table of a hundred rows.

    Parameters
    ----------
    costs : ndarray, shape (k, n)
        With at least as many columns as rows.

    Returns
    -------
    ndarray of int, shape (k,)

    References
    ----------
    D. F. Crouse, On implementing 2D rectangular assignment algorithms, IEEE Trans. Aerosp. Electron. Syst. 52 (2016)
    1679-1696.
    """
    rows, columns = costs.shape
    of_row, of_column = np.full(rows, _NONE), np.full(columns, _NONE)
    row_prices, column_prices = np.zeros(rows), np.zeros(columns)
    for first in range(rows):
        before, lengths, used, ends, total = _shortest_path(costs, first, row_prices, column_prices, of_column)
        row_prices[first] += total
        row_prices[used[1:]] += total - lengths[of_row[used[1:]]]
        column_prices[ends] -= total - lengths[ends]
        column = ends[-1]
        while True:
            row = before[column]
            of_column[column] = row
            of_row[row], column = column, of_row[row]
            if row == first:
                break
    return of_row


def _shortest_path(
    costs: NDArray[np.float64],
    row: int,
    row_prices: NDArray[np.float64],
    column_prices: NDArray[np.float64],
    of_column: NDArray[np.intp],
) -> tuple[NDArray[np.intp], NDArray[np.float64], list[int], list[int], float]:
    """Return the shortest path from a row to a column that no row has.

    For each column the row before it and its distance; then the rows and the columns on the way in their order, the
    free one last, and its distance.
    """
    columns = costs.shape[1]
    before, lengths = np.full(columns, _NONE), np.full(columns, np.inf)
    left = np.arange(columns)[::-1].copy()  # of equal costs alone the diagonal is chosen
    used, ends, total = [row], [], 0.0
    while True:
        found = total + costs[row, left] - row_prices[row] - column_prices[left]
        shorter = found < lengths[left]
        lengths[left[shorter]], before[left[shorter]] = found[shorter], row
        total = float(lengths[left].min())
        equal = np.flatnonzero(lengths[left] == total)
        free = equal[of_column[left[equal]] == _NONE]
        at = free[-1] if free.size else equal[0]
        column = int(left[at])
        ends.append(column)
        if of_column[column] == _NONE:
            return before, lengths, used, ends, total
        row = int(of_column[column])
        used.append(row)
        left[at] = left[-1]
        left = left[:-1]
