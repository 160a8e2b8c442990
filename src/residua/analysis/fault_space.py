"""Which sets of faults hide which others from every residual: the faults as columns over the rational functions."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.analysis.rational_visibility import (
    RationalColumns,
    are_rational,
    rational_columns,
    rational_limit_columns,
)
from residua.analysis.visibility import (
    Visible,
    check_regular,
    generic_points,
    in_canonical_units,
    limit_columns,
    visible_columns,
)
from residua.errors import DesignError
from residua.linear.subspaces.rank import check_rtol
from residua.linear.systems.array_cache import cached_by_contents
from residua.plant import Plant
from residua.tolerances import TINY

#: Two columns closer than this are the same, as for diagnosability.
LEAST_SINE = 1e-7
#: The least distance, over its limit, of a column that is outside a span in rational numbers.
_OUTSIDE = 2.0
#: Columns whose smallest angle is known to better than this are projected off one another as they are.
_WELL_APART = 1e-4


@dataclass(frozen=True, eq=False)
class _Directions:
    """The columns at some points, of unit length, and what rounding may have done to them.

    Attributes
    ----------
    unit : ndarray, shape (points, residual dimension, faults)
    doubt : ndarray, shape (points, faults)
        Infinite where a column is not visible.
    size : ndarray, shape (points, faults)
        Lengths of the columns before, as fractions of what the faults put into the equations.
    """

    unit: NDArray[np.complex128]
    doubt: NDArray[np.float64]
    size: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class FaultSpace:
    """What the disturbances leave of each fault, and what is left of it when other faults are ignored too.

    A residual that ignores some faults ignores all in their *closure*: those whose columns, over the rational
    functions, are combinations of theirs. The closed sets are the flats of a matroid.

    Attributes
    ----------
    faults : tuple of str
    visible : ndarray of bool, shape (faults,)
        Seen by some residual that ignores the disturbances.
    dimension : int
        How many independent residuals there are.
    """

    faults: tuple[str, ...]
    visible: NDArray[np.bool_]
    dimension: int
    generic: _Directions
    limit: _Directions  # at s = 0 (z = 1), as a limit where the plant has a zero there
    model: Plant  # in units of its own
    rank: int  # of its pencil with the disturbances
    rtol: float
    rational: RationalColumns | None = None  # where the numbers of the plant are exact: the answer

    def distances(self, basis: Sequence[int]) -> NDArray[np.float64]:
        """Return how far each column is outside the span of independent ones: the sine of the angle over its limit."""
        sines, limits = _outside(self.generic, basis)
        ratio = np.where(np.isfinite(limits), sines / np.maximum(limits, TINY), 0.0).max(axis=0, initial=0.0)
        if self.rational is not None:
            ratio = np.where(self.rational.inside(basis), 0.0, np.maximum(ratio, _OUTSIDE))
        return np.where(self.visible, ratio, 0.0)

    def basis(self, chosen: Iterable[int]) -> list[int]:
        """Return a largest independent subset of some faults; the one that is farthest from those taken comes next."""
        left, taken = [j for j in chosen if self.visible[j]], []
        while left:
            ratio = self.distances(taken)[left]
            best = int(ratio.argmax())
            if ratio[best] <= 1:
                break
            taken.append(left.pop(best))
        return taken

    def leaves(self, ignored: Iterable[str]) -> bool:
        """Tell whether any residual is left that ignores some faults and the disturbances."""
        return len(self.basis([self.faults.index(name) for name in ignored])) < self.dimension

    def closure(self, basis: Sequence[int]) -> NDArray[np.bool_]:
        """Return which faults a residual ignores that ignores these, which must be independent."""
        closed = self.distances(basis) <= 1
        closed[list(basis)] = True
        return closed

    def lasting(self, basis: Sequence[int]) -> NDArray[np.bool_]:
        """Return which faults leave a lasting trace while constant, in some residual that ignores the basis.

        The limit of what the disturbances leave is projected off the basis; where the basis loses rank there, the limit
        is taken with the basis among the disturbances. What that does not see is asked for in rational numbers.
        """
        left = self.visible & ~self.closure(basis)
        sines, limits = _outside(self.limit, basis)
        if np.isfinite(limits[0, list(basis)]).all() and limits[0].min(initial=np.inf) <= _WELL_APART:
            seen = sines[0] > limits[0]
            if self.rational is None or seen[left].all():
                return np.asarray(left & seen)
        ignored = self.model.faults_as_disturbances([self.faults[j] for j in basis])
        if self.rational is not None:
            there = rational_limit_columns(ignored).present
        else:
            after = limit_columns(ignored, self.rtol, self.rank + len(basis))
            there = np.isfinite(_directions(after, self.rtol).doubt[0])
        out = np.zeros(len(self.faults), dtype=bool)
        out[[j for j in range(len(self.faults)) if j not in basis]] = there
        return np.asarray(left & out)

    def hiders(self, fault: int, basis: Sequence[int]) -> list[int]:
        """Return a smallest part of a basis that hides a fault of its closure; empty for one that is not visible."""
        needed = list(basis)
        for j in basis:
            fewer = [i for i in needed if i != j]
            if self.distances(fewer)[fault] <= 1:
                needed = fewer
        return needed

    def flats(self, most: int) -> list[tuple[NDArray[np.bool_], list[int]]]:
        """Return every closed set but the whole, with a basis, those of fewest dimensions first.

        Raises DesignError when there are more than ``most``.
        """
        visible = np.flatnonzero(self.visible)
        whole = len(self.basis(visible))
        if not whole:
            return []
        known = [(~self.visible, [])]
        level: list[tuple[NDArray[np.bool_], list[int]]] = list(known)
        for _ in range(whole - 1):
            above: dict[bytes, tuple[NDArray[np.bool_], list[int]]] = {}
            for flat, basis in level:
                covered = flat.copy()
                for j in visible:
                    if covered[j]:
                        continue
                    larger = [*basis, int(j)]
                    closed = self.closure(larger) | flat
                    covered |= closed
                    if not closed.all():
                        above.setdefault(closed.tobytes(), (closed, larger))
                if len(known) + len(above) > most:
                    raise DesignError(
                        f"more than {most} rows are attainable with {len(visible)} faults and {whole} independent "
                        "residuals: ask about the rows you mean (structure=...), watch fewer faults at a time "
                        "(plant.without_faults), or allow more with most="
                    )
            level = list(above.values())
            known += level
        return known


def fault_space(plant: Plant, *, rtol: float) -> FaultSpace:
    """Return what the disturbances leave of each fault of a plant, at a few generic points and near the limit."""
    if not plant.faults:
        raise DesignError("the plant has no faults: add some with with_sensor_faults or with_faults")
    check_rtol(rtol)
    return _fault_space(in_canonical_units(plant), rtol)


@cached_by_contents
def _fault_space(model: Plant, rtol: float) -> FaultSpace:
    """Return the same of a plant in units of its own."""
    points = generic_points(model)
    check_regular(model, points)
    columns = visible_columns(model, points, rtol)
    generic = _directions(columns, rtol)
    limit = _directions(limit_columns(model, rtol, columns.rank), rtol)
    visible, dimension = np.asarray(np.isfinite(generic.doubt).any(axis=0)), columns.columns.shape[1]
    rational = rational_columns(model) if are_rational(model, rtol) else None
    if rational is not None:
        visible, dimension = rational.present, len(rational.rows)
    return FaultSpace(model.faults, visible, dimension, generic, limit, model, columns.rank, rtol, rational)


def _directions(visible: Visible, rtol: float) -> _Directions:
    """Return the columns with unit length, and the doubt that rounding leaves about each."""
    size = np.linalg.norm(visible.columns, axis=1)
    floor = np.maximum(visible.rounding, 10 * rtol)[:, None]
    unit = visible.columns / np.maximum(size, TINY)[:, None]
    doubt = np.clip(10 * floor / np.maximum(size, TINY), LEAST_SINE, 1e-2)
    return _Directions(unit, np.where(size > floor, doubt, np.inf), size)


def _outside(columns: _Directions, basis: Sequence[int]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return at each point the sine of each column to the span of some, and the limit below which it is inside."""
    chosen = list(basis)
    if not chosen:
        return np.linalg.norm(columns.unit, axis=1), columns.doubt
    U, s, _ = np.linalg.svd(columns.unit[:, :, chosen], full_matrices=False)
    left = columns.unit
    for _ in range(2):
        left = left - U @ (U.conj().transpose(0, 2, 1) @ left)
    doubt = np.maximum(columns.doubt, columns.doubt[:, chosen].max(axis=1, keepdims=True))
    least = s[:, -1:] if len(chosen) <= columns.unit.shape[1] else np.zeros((len(s), 1))
    return np.linalg.norm(left, axis=1), doubt / np.maximum(least, TINY)
