"""Linear matrix inequalities: their unknowns as one vector, and the solver behind the extra ``lmi``."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from residua.errors import missing_extra

if TYPE_CHECKING:
    import scipy.sparse

Matrix = NDArray[np.float64]
#: Of the solver; what it returns is corrected afterwards, so that more digits would be lost on it.
_ACCURACY = {"tol_gap_rel": 1e-6, "tol_gap_abs": 1e-7, "tol_feas": 1e-8}


def has_solver() -> bool:
    """Tell whether the package of the extra ``lmi`` is there."""
    try:
        return find_spec("clarabel") is not None
    except ValueError:  # a module that is blocked by a None in sys.modules
        return False


def require_solver() -> Any:
    """Return the package of the solver, or raise with the name of the extra."""
    try:
        import clarabel  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise missing_extra("clarabel", "lmi") from error
    return clarabel


@dataclass(frozen=True, eq=False)
class Unknown:
    """A matrix of unknowns: its name, and one matrix for each unknown, shape (unknowns, size, size)."""

    name: str
    basis: Matrix


def scalar(name: str) -> Unknown:
    """Return one unknown number."""
    return Unknown(name, np.ones((1, 1, 1)))


def symmetric(name: str, size: int, sets: Sequence[Sequence[int]] | None = None) -> Unknown:
    """Return an unknown symmetric matrix, zero but within each of these index sets (one of all, when omitted)."""
    return _within(name, size, [range(size)] if sets is None else sets, 0, 1.0)


def skew(name: str, size: int, sets: Sequence[Sequence[int]]) -> Unknown:
    """Return an unknown skew-symmetric matrix, zero but within each of these index sets."""
    return _within(name, size, sets, 1, -1.0)


def _within(name: str, size: int, sets: Sequence[Sequence[int]], above: int, mirror: float) -> Unknown:
    pairs = [(s[i], s[j]) for s in sets for i in range(len(s)) for j in range(i + above, len(s))]
    basis = np.zeros((len(pairs), size, size))
    for one, (i, j) in zip(basis, pairs, strict=True):
        one[j, i] = mirror
        one[i, j] = 1.0
    return Unknown(name, basis)


Values = Mapping[str, Matrix]
#: An affine map from unknowns to a symmetric matrix that is to be positive semidefinite.
Inequality = Callable[[Values], Matrix]


@dataclass(frozen=True, eq=False)
class Unknowns:
    """Several unknowns behind one another in one vector."""

    parts: tuple[Unknown, ...]

    @cached_property
    def count(self) -> int:
        """Length of the vector."""
        return sum(len(part.basis) for part in self.parts)

    def values(self, x: NDArray[np.float64]) -> dict[str, Matrix]:
        """Return the matrices that a vector stands for."""
        out, start = {}, 0
        for part in self.parts:
            stop = start + len(part.basis)
            out[part.name] = np.tensordot(x[start:stop], part.basis, axes=1)
            start = stop
        return out

    def coefficients(self, inequality: Inequality) -> tuple[Matrix, scipy.sparse.csr_matrix]:
        """Return constant and coefficients of an affine map, entries row by row: ``constant + coefficients @ x``."""
        import scipy.sparse  # slow to import, and needed only here

        zero = np.zeros(self.count)
        constant = inequality(self.values(zero))
        columns = np.empty((constant.size, self.count))
        values = self.values(zero)
        j = 0
        for part in self.parts:
            before = values[part.name]
            for one in part.basis:
                values[part.name] = one
                columns[:, j] = (inequality(values) - constant).ravel()
                j += 1
            values[part.name] = before
        return constant, scipy.sparse.csr_matrix(columns)


def solve(
    unknowns: Unknowns,
    inequalities: list[tuple[Matrix, scipy.sparse.csr_matrix]],
    cost: NDArray[np.float64],
    *,
    margin: float,
) -> NDArray[np.float64] | None:
    """Minimise ``cost @ x`` subject to every inequality ``>= margin * I``; None if the solver has no solution.

    What comes back is a candidate: solvers call a point optimal that misses a little, so that whoever asked has to
    check it.
    """
    import scipy.sparse

    clarabel = require_solver()
    kinds = [[one for one in inequalities if (len(one[0]) == 1) == number] for number in (True, False)]
    rows, constants, cones = [], [], []
    for constant, coefficients in (*kinds[0], *kinds[1]):
        s = len(constant)
        W = _triangle(s)
        rows.append(W @ coefficients)
        constants.append(W @ (constant - margin * np.eye(s)).ravel())
        if s > 1:
            cones.append(clarabel.PSDTriangleConeT(s))
    if kinds[0]:
        cones.insert(0, clarabel.NonnegativeConeT(len(kinds[0])))
    A = -scipy.sparse.csc_array(scipy.sparse.vstack(rows))
    A.sort_indices()
    none = scipy.sparse.csc_array((unknowns.count, unknowns.count))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    for name, value in _ACCURACY.items():
        setattr(settings, name, value)
    solution = clarabel.DefaultSolver(none, cost, A, np.concatenate(constants), cones, settings).solve()
    x = np.array(solution.x, dtype=float)
    return x if str(solution.status) in ("Solved", "AlmostSolved") and np.isfinite(x).all() else None


@lru_cache(maxsize=64)
def _triangle(size: int) -> scipy.sparse.csr_array:
    """Return the map from a symmetric matrix to its upper triangle, column by column, in which norms are the same."""
    import scipy.sparse

    j, i = np.tril_indices(size)
    weights = np.where(i == j, 0.5, 0.5 * np.sqrt(2.0))
    count = np.arange(len(i))
    entries = (np.r_[weights, weights], (np.r_[count, count], np.r_[i * size + j, j * size + i]))
    return scipy.sparse.csr_array(entries, shape=(len(i), size * size))


def smallest_eigenvalue(M: Matrix) -> float:
    """Return the smallest eigenvalue of a symmetric matrix with its rows and columns brought to a unit diagonal.

    Definiteness does not depend on the units of rows and columns, and this number tells it from rounding. A diagonal
    entry that is not positive is returned as it is.
    """
    if not M.size:
        return np.inf
    diagonal = np.diagonal(M)
    if diagonal.min() <= 0:
        return float(min(diagonal.min(), -np.finfo(float).eps))
    scale = 1 / np.sqrt(diagonal)
    return float(np.linalg.eigvalsh(scale[:, None] * (M + M.T) / 2 * scale)[0])


def least_level(M: Matrix, kept: int) -> float:
    """Return the least ``g`` with ``M + diag(0, g I) >= 0``: the first ``kept`` rows must be positive definite.

    Infinity where they are not; the number is raised by a trifle, so that the inequality is strict.
    """
    head, cross, tail = M[:kept, :kept], M[:kept, kept:], M[kept:, kept:]
    if not tail.size:
        return 0.0
    rest = tail
    if kept:
        if not smallest_eigenvalue(head) > 1e-13 * kept:
            return np.inf
        L = np.linalg.cholesky((head + head.T) / 2)
        half = np.linalg.solve(L, cross)
        rest = tail - half.T @ half
    least = -float(np.linalg.eigvalsh((rest + rest.T) / 2)[0])
    size = float(np.abs(tail).max()) + float(np.abs(rest).max())
    return max(least + 1e-10 * size, 0.0)
