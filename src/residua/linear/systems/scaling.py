"""Balanced units of a system: one linear least-squares problem on the logarithms of its entries."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from residua.linear.subspaces.parts import part_of_each

#: Entries this far below the largest both of their row and of their column count as none when the units are chosen:
#: what a linearisation leaves of zeros would move all units far away.
_NO_ENTRY = 1e-10
#: Rounds in which faint entries are left out and the units chosen anew.
_ROUNDS = 2
#: Weight of ``r_i + x_i = 0`` where there is no ``E``: the equation of a state has the units of that state.
_TIED = 1e4
#: Added before a factor is rounded down: no half of a whole number, where other units would round another way.
_OFF_TIES = 0.513


@dataclass(frozen=True, eq=False)
class Scaling:
    r"""Factors, powers of two, that make the entries of a system comparable, in whatever units it is written.

    .. math:: A_b = R A X / t, \quad E_b = R E X, \quad B_b = R B U / t, \quad C_b = Y C X, \quad D_b = Y D U

    Attributes
    ----------
    equations, states, inputs, outputs : ndarray
        The diagonals of ``R``, ``X``, ``U``, ``Y``; without ``E``, ``R`` is ``1 / X``.
    rate : float
        ``t`` in 1/s; 1 for a sampled system.
    exact : tuple of ndarray and float
        The same factors of ``R``, ``X``, ``Y`` and ``t`` before they were rounded to powers of two.
    """

    equations: NDArray[np.float64]
    states: NDArray[np.float64]
    inputs: NDArray[np.float64]
    outputs: NDArray[np.float64]
    rate: float
    exact: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], float]

    @cached_property
    def process_weight(self) -> NDArray[np.float64]:
        """Variances of the noise of the balanced equations by default: equal ones, were the factors not rounded."""
        equations, _, _, rate = self.exact
        return (self.equations / equations * (rate / self.rate)) ** 2

    @cached_property
    def measurement_weight(self) -> NDArray[np.float64]:
        """Variances of the noise of the balanced outputs by default: equal ones, were the factors not rounded."""
        return (self.outputs / self.exact[2]) ** 2


def scaling(A: NDArray, B: NDArray, C: NDArray, D: NDArray, E: NDArray | None = None, *, sampled: bool) -> Scaling:
    r"""Return the balanced units of a system.

    They bring the logarithms of all entries of :math:`[A - sE, B; C, D]` as near to zero as they can be:

    .. math:: \min \sum (\log_2 |m_{ij}| + f_i + f_j - t)^2

    with ``t`` in the rows of a continuous ``A`` and ``B`` only. The same system in other units, powers of two, has the
    same balanced matrices, to the last bit, as long as no factor is a tie.

    Parameters
    ----------
    A, B, C, D : ndarray
    E : ndarray, optional
    sampled : bool
        Whether the system has no unit of time.
    """
    n, m, p = len(A), B.shape[1], len(C)
    whole = np.block([[A, B], [C, D]])
    timed = np.zeros(whole.shape, dtype=bool)
    timed[:n] = not sampled
    rows, columns = np.nonzero(whole)
    entries = [(rows, columns, timed[rows, columns], np.log2(np.abs(whole[rows, columns])), np.ones(len(rows)))]
    tied = np.arange(n)
    if E is None:
        entries.append((tied, tied, np.zeros(n, dtype=bool), np.zeros(n), np.full(n, _TIED)))
    else:
        i, j = np.nonzero(E)
        entries.append((i, j, np.zeros(len(i), dtype=bool), np.log2(np.abs(E[i, j])), np.ones(len(i))))
    i, j, t, logs, weight = (np.concatenate(part) for part in zip(*entries, strict=True))
    keep = np.ones(len(i), dtype=bool)
    row = column = np.zeros(0)
    rate = 0.0
    for _ in range(_ROUNDS + 1):
        row, column, rate = _least_squares(n + p, n + m, i[keep], j[keep], t[keep], logs[keep], weight[keep])
        size = logs + row[i] + column[j] - rate * t
        of_row, of_column = np.full(n + p, -np.inf), np.full(n + m, -np.inf)
        np.maximum.at(of_row, i, size)
        np.maximum.at(of_column, j, size)
        faint = size < np.log2(_NO_ENTRY) + np.minimum(of_row[i], of_column[j])
        before, keep = keep, ~faint | (weight > 1)
        if (keep == before).all():
            break
    row, column = _whole_in_each_part(row, column, i[keep], j[keep])
    if E is None:
        row[:n] = -column[:n]
    R, X = np.exp2(np.floor(row + _OFF_TIES)), np.exp2(np.floor(column + _OFF_TIES))
    if E is None:
        R[:n] = 1 / X[:n]
    rate, inputs, outputs = _levels(A, B, C, D, R, X, sampled)
    rate, inputs, outputs = _power_below(rate), 1 / _power_below(inputs), 1 / _power_below(outputs)
    exact_rate, _, heights = _levels(A, B, C, D, np.exp2(row), np.exp2(column), sampled)
    exact = np.exp2(row[:n]), np.exp2(column[:n]), np.exp2(row[n:]) / heights, exact_rate
    return Scaling(R[:n], X[:n], X[n:] * inputs, R[n:] * outputs, float(rate), exact)


def even_units(M: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the factors of rows and of columns with which the entries of a matrix are nearest to one."""
    rows, columns = M.shape
    static = scaling(np.zeros((0, 0)), np.zeros((0, columns)), np.zeros((rows, 0)), M, sampled=True)
    return static.outputs, static.inputs


def power_near(size: float | NDArray) -> NDArray[np.float64]:
    """Return powers of two near sizes; 1 for zero."""
    return np.exp2(np.round(np.log2(np.where(np.greater(size, 0), size, 1.0))))


def _least_squares(
    rows: int, columns: int, i: NDArray, j: NDArray, t: NDArray, logs: NDArray, weight: NDArray
) -> tuple[NDArray, NDArray, float]:
    """Return the factors of rows and columns and the rate, as logarithms: the smallest of the best ones."""
    N, k = rows + columns + 1, j + rows
    normal, right = np.zeros((N, N)), np.zeros(N)
    w, wt = weight, weight * t
    np.add.at(normal, (i, i), w)
    np.add.at(normal, (k, k), w)
    np.add.at(normal, (i, k), w)
    np.add.at(normal, (k, i), w)
    np.add.at(normal[-1], i, -wt)
    np.add.at(normal[-1], k, -wt)
    normal[:-1, -1] = normal[-1, :-1]
    normal[-1, -1] = wt.sum()
    np.add.at(right, i, -w * logs)
    np.add.at(right, k, -w * logs)
    right[-1] = (wt * logs).sum()
    found = np.linalg.lstsq(normal, right, rcond=1e-12)[0]
    return found[:rows], found[rows:-1], float(found[-1])


def _whole_in_each_part(row: NDArray, column: NDArray, i: NDArray, j: NDArray) -> tuple[NDArray, NDArray]:
    """Shift each connected part along what leaves its entries alone, so that its first factor is whole.

    Other units then move all factors by whole numbers, and rounding does not depend on them.
    """
    rows, columns = len(row), len(column)
    graph = np.zeros((rows + columns, rows + columns), dtype=bool)
    graph[i, rows + j] = True
    part = part_of_each(graph)
    _, first = np.unique(part, return_index=True)
    both = np.concatenate([row, column])
    shift = both[first] - np.round(both[first])
    shift = np.where(first < rows, shift, -shift)[part]
    return row - shift[:rows], column + shift[rows:]


def _levels(
    A: NDArray, B: NDArray, C: NDArray, D: NDArray, R: NDArray, X: NDArray, sampled: bool
) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
    """Return the largest entry of ``A``, of each column of ``[B; D]`` and of each row of ``[C, D]``; 1 for none."""
    n = len(A)
    rate = 1.0 if sampled else float(np.abs(R[:n, None] * A * X[:n]).max(initial=0.0)) or 1.0
    entering = np.vstack([R[:n, None] * B / rate, R[n:, None] * D]) * X[n:]
    inputs = np.abs(entering).max(axis=0, initial=0.0)
    inputs = np.where(inputs > 0, inputs, 1.0)
    read = R[n:, None] * np.hstack([C * X[:n], D * X[n:] / inputs])
    outputs = np.abs(read).max(axis=1, initial=0.0)
    return rate, inputs, np.where(outputs > 0, outputs, 1.0)


def _power_below(values: float | NDArray) -> NDArray[np.float64]:
    """Return the largest powers of two that are not above positive numbers."""
    return np.exp2(np.floor(np.log2(values)))
