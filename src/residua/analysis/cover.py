"""Fewest rows that meet demands, the most even of these, and those whose columns differ the most: integer programs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from math import ceil, floor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.errors import AccuracyError

#: Seconds, and more of them per entry of the demands, that a program takes beside the search: to set it up, to
#: simplify it, and until it looks at the clock.
_SETUP, _SETUP_PER_ENTRY = 0.1, 1e-6


@dataclass(frozen=True, eq=False)
class Cover:
    """Rows to choose from, and the demands on the chosen ones.

    Attributes
    ----------
    rows : ndarray of bool, shape (rows, columns)
    demands : ndarray of bool, shape (demands, rows)
        Each demand is met by any of the rows marked; the first ones are that every column has a one.
    pairs : list of pairs of int
        Columns that must differ.
    strong : bool
        Whether they must differ both ways.
    least : int
        A number of rows below which it cannot be done.
    """

    rows: NDArray[np.bool_]
    demands: NDArray[np.bool_]
    pairs: list[tuple[int, int]]
    strong: bool
    least: int

    @cached_property
    def differences(self) -> NDArray[np.bool_]:
        """Rows in which the columns of each pair differ."""
        first, second = [j for j, _ in self.pairs], [k for _, k in self.pairs]
        return (self.rows[:, first] != self.rows[:, second]).T

    @property
    def setup(self) -> float:
        """Seconds that a program takes beside the search."""
        return _SETUP + _SETUP_PER_ENTRY * self.demands.size

    def met(self, chosen: NDArray) -> bool:
        """True if chosen rows meet every demand."""
        return bool(self.demands[:, chosen].any(axis=1).all())


@dataclass(frozen=True, eq=False)
class Found:
    """Chosen rows; ``bound`` is what the aim might still reach, ``None`` if it was proved to be reached."""

    chosen: NDArray[np.int64]
    bound: int | None


def fewest(cover: Cover, limit: float) -> Found:
    """Return a smallest choice of rows that meets all demands."""
    n = len(cover.rows)
    cuts, weights = _cuts(cover)
    constraints = [
        (cover.demands, 1.0, np.inf),
        (weights, cuts, np.inf),
        (np.ones((1, n)), float(cover.least), np.inf),
    ]
    result = integer_program(np.ones(n), constraints, np.ones(n), limit - cover.setup)
    chosen = _greedy(cover.demands)
    if result.x is not None:
        better = np.flatnonzero(np.round(result.x[:n]))
        if not cover.met(better):
            raise AccuracyError("the integer program returned rows that do not meet the demands: report this plant")
        chosen = better if len(better) < len(chosen) else chosen
    bound = max(cover.least, _up(result.mip_dual_bound))
    return Found(chosen, None if result.status == 0 or bound >= len(chosen) else bound)


def even_cover(cover: Cover, chosen: NDArray[np.int64], limit: float) -> Found:
    """Return as many rows that meet the demands and have the most even numbers of ones and zeros."""
    if not _unevenness(cover.rows[chosen]) or limit < 2 * cover.setup:
        return Found(chosen, 0 if _unevenness(cover.rows[chosen]) else None)
    result = integer_program(*_even_program(cover, len(chosen)), limit - cover.setup)
    chosen = _better(cover, chosen, result, lambda rows: _unevenness(cover.rows[rows]))
    bound = max(0, _up(result.mip_dual_bound))
    return Found(chosen, None if result.status == 0 or bound >= _unevenness(cover.rows[chosen]) else bound)


def far_cover(cover: Cover, chosen: NDArray[np.int64], limit: float) -> Found:
    """Return as many rows, no less even, whose columns differ in as many places as possible."""
    if not cover.pairs or limit < 2 * cover.setup:
        return Found(chosen, len(chosen) if cover.pairs else None)
    n, most = len(cover.rows), _unevenness(cover.rows[chosen])
    _, constraints, upper = _even_program(cover, len(chosen))
    constraints = [(np.pad(M, ((0, 0), (0, 1))), low, high) for M, low, high in constraints]
    constraints.append((np.array([[*np.zeros(n), -1.0, 1.0, -1.0, 1.0, 0.0]]), 0.0, float(most)))
    fewest_differences = -np.ones((len(cover.pairs), 1))
    constraints.append((np.hstack([np.pad(cover.differences, ((0, 0), (0, 4))), fewest_differences]), 0.0, np.inf))
    aim = np.append(np.zeros(n + 4), -1.0)
    result = integer_program(aim, constraints, np.append(upper, len(chosen)), limit - cover.setup)

    def alike(rows: NDArray[np.int64]) -> int:
        fine = _unevenness(cover.rows[rows]) <= most
        return -int(cover.differences[:, rows].sum(axis=1).min()) if fine else 0

    chosen, dual = _better(cover, chosen, result, alike), result.mip_dual_bound
    bound = len(chosen) if dual is None or not np.isfinite(dual) else min(len(chosen), floor(-dual + 1e-6))
    return Found(chosen, None if result.status == 0 or bound <= -alike(chosen) else bound)


def _better(
    cover: Cover, chosen: NDArray[np.int64], result: Any, aim: Callable[[NDArray[np.int64]], int]
) -> NDArray[np.int64]:
    """Return the rows that a program found, where they are as many, meet the demands and have the smaller aim."""
    if result.x is not None:
        other = np.flatnonzero(np.round(result.x[: len(cover.rows)]))
        if len(other) == len(chosen) and cover.met(other) and aim(other) < aim(chosen):
            return other
    return chosen


def _even_program(cover: Cover, count: int) -> tuple[NDArray, list[tuple[NDArray, Any, Any]], NDArray]:
    """Return aim, constraints and upper bounds of the most even choice of ``count`` rows.

    After the rows come the fewest and most ones of a column, and the fewest and most zeros of a chosen row.
    """
    n, columns = cover.rows.shape
    zeros = (~cover.rows).sum(axis=1).astype(float)
    few, many = zeros.min(), zeros.max()

    def beside(M: NDArray, extra: int = 0, sign: float = 0.0) -> NDArray:
        side = np.zeros((len(M), 4))
        side[:, extra] = sign
        return np.hstack([M, side])

    constraints: list[tuple[NDArray, Any, Any]] = [
        (beside(cover.demands), 1.0, np.inf),
        (beside(np.ones((1, n))), float(count), float(count)),
        (beside(cover.rows.T, 0, -1.0), 0.0, np.inf),
        (beside(cover.rows.T, 1, -1.0), -np.inf, 0.0),
        (beside(np.diag(many - zeros), 2, 1.0), -np.inf, many),  # fewest <= zeros of a chosen row
        (beside(np.diag(few - zeros), 3, 1.0), few, np.inf),  # most >= zeros of a chosen row
    ]
    aim = np.array([*np.zeros(n), -1.0, 1.0, -1.0, 1.0])
    return aim, constraints, np.array([*np.ones(n), count, count, columns, columns], dtype=float)


def _unevenness(rows: NDArray[np.bool_]) -> int:
    """Return the range of the ones of columns plus the range of the zeros of rows."""
    return int(np.ptp(rows.sum(axis=0)) + np.ptp((~rows).sum(axis=1)))


def _cuts(cover: Cover) -> tuple[NDArray, NDArray]:
    """Return inequalities that all choices meet and fractions of rows do not: right-hand sides and weights.

    A column that zeros (or ones) must separate from several others needs one row that does it for all of
    them, or two rows. Without these inequalities the fractional problem lets one row do half of both.
    """
    R = cover.rows
    sides, weights = [], []
    if cover.strong:
        for k in range(R.shape[1]):
            others = [j for pair in cover.pairs if k in pair for j in pair if j != k]
            for rows in (R, ~R):
                cut = rows[:, [k]] & ~rows[:, others]
                cut = cut[:, cut.any(axis=0)]
                if cut.shape[1] > 1:
                    sides.append(2.0)
                    weights.append(cut.any(axis=1).astype(float) + cut.all(axis=1))
    return np.array(sides), np.array(weights).reshape(len(sides), len(R))


def _greedy(demands: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return rows that meet the demands: the one that meets most of those left comes next."""
    left, chosen = demands.copy(), []
    while left.shape[0]:
        best = int(left.sum(axis=0).argmax())
        if not left[:, best].any():
            raise AccuracyError("a demand that no row meets reached the search: report this plant")
        chosen.append(best)
        left = left[~left[:, best]]
    return np.array(sorted(chosen), dtype=np.int64)


def integer_program(aim: NDArray, constraints: list, upper: NDArray, limit: float) -> Any:
    """Run HiGHS on sparse constraints of whole numbers from zero up."""
    from scipy.optimize import Bounds, LinearConstraint, milp  # slow to import, and needed only here
    from scipy.sparse import csr_array

    linear = [
        LinearConstraint(csr_array(M.astype(float)), low, high)  # pyright: ignore
        for M, low, high in constraints
        if len(M)
    ]
    return milp(
        aim,
        constraints=linear,
        bounds=Bounds(np.zeros(len(aim)), upper),  # pyright: ignore
        integrality=np.ones(len(aim)),
        options={"time_limit": max(limit, 0.05)},
    )


def _up(bound: float | None) -> int:
    return 0 if bound is None or not np.isfinite(bound) else ceil(bound - 1e-6)
