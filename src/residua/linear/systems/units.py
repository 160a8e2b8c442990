"""Units that are the same whatever units a model was written in, so that no answer depends on them.

A model in other units has entries ``rho_i a_ij gamma_j``. The scaling that brings the logarithms of all entries
nearest to one level, in least squares, takes these factors out again: the fitted logarithms are a projection, which
does not depend on them. Rounded to powers of two from a fixed origin, the scaled entries of a model are the same *to
the last bit* for all units that are powers of two, and so is everything that is computed from them.

References
----------
A. R. Curtis and J. K. Reid, On the automatic scaling of matrices for Gaussian elimination, J. Inst. Maths. Applics. 10
(1972) 118-124.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from residua.linear.subspaces.parts import connected_parts
from residua.linear.systems.array_cache import cached_by_entries
from residua.tolerances import RESIDUE

#: Logarithms are rounded as if they were larger by this: averages of few whole numbers, of which the logarithms of
#: simple models are made, are never halfway between two powers of two then.
_OFF_TIES = 0.01371
_ROUNDS = 3
#: Where the largest entry is left this far above the one in the middle, the entries are no data of one model in other
#: units: residue, which linearised models have in many places. What is residue in the units that the model was written
#: in is left out of the fit then.
_FAR = 2.0**26
_WIDE = 1e-11
#: Edges up to which parts of a graph are joined faster one by one.
_FEW = 128
#: What of a unit of time is left beside those of the signals, of the entries that have it, where it is rounding alone.
_NO_RATE = 1e-9


@dataclass(frozen=True, eq=False)
class Units:
    """Factors, powers of two, for a system whose states are scaled on both sides: ``T^-1 A T, T^-1 B U, Y C T, Y D U``.

    Attributes
    ----------
    states, inputs, outputs : ndarray
        The diagonals of ``T``, ``U`` and ``Y``.
    """

    states: NDArray[np.float64]
    inputs: NDArray[np.float64]
    outputs: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PencilUnits:
    """Factors, powers of two, for ``E x' = A x + B v``, ``y = C x + D v``: ``R A S``, ``unit R E S``, ``R B V``, ...

    Attributes
    ----------
    rows, columns : ndarray
        The diagonals of ``R`` and ``S``, further rows and columns of the bordered pencil along with them.
    unit : float
        The unit of ``s``: ``unit E`` is as large as ``A``.
    has_rate : bool
        Whether there is one; otherwise units of rows and columns imitate any, and it is one.
    """

    rows: NDArray[np.float64]
    columns: NDArray[np.float64]
    unit: float
    has_rate: bool = True


def powers_of_two(logarithms: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the powers of two nearest to numbers with these binary logarithms, off the ties."""
    return np.exp2(np.floor(logarithms + 0.5 + _OFF_TIES))


def system_units(A: NDArray, B: NDArray, C: NDArray, D: NDArray) -> Units:
    """Return the units, powers of two, in which the entries of an ordinary system are nearest to one level.

    See :func:`system_level`.
    """
    n, q = len(A), np.shape(B)[1]
    return _rounded(_system_potentials(A, B, C, D)[0], n, q)


def system_level(A: NDArray, B: NDArray, C: NDArray, D: NDArray) -> float:
    """Return the level that entries of a system are brought to: what no units of states and signals change.

    The largest diagonal entry of ``A``, or the rate of the system where that is more: it is what entries around loops
    have in common. One where there are neither.
    """
    return float(np.exp2(_system_potentials(A, B, C, D)[1]))


@cached_by_entries
def system_rate(A: NDArray, B: NDArray, C: NDArray, D: NDArray) -> float:
    """Return the rate, a power of two, that entries of ``A`` and ``B`` have beside those of ``C`` and ``D``; or zero.

    In least squares over units of states, inputs and outputs: what of a unit of time no such units can imitate, as the
    product of entries around a loop. Of chains of integrators nothing is left, and there is no rate: they are the same
    plant in all units of time, but for those of their signals.
    """
    _, rate = _rated_potentials(np.abs(bordered(A, B, C, D)), len(A))
    return 0.0 if rate is None else float(powers_of_two(np.array(rate)))


def state_units_and_rate(A: NDArray) -> tuple[NDArray[np.float64], float]:
    """Return the units of the states, and the rate, by which ``T^-1 A T / rate`` has entries nearest to one.

    Powers of two, the same for all units of states and of time; the rate is one of a matrix without loops.
    """
    W, n = np.abs(A), len(A)
    v, rate = _rated_potentials(W, n)
    T = powers_of_two(v)
    if _is_far(W, 1 / T, T):
        v, rate = _rated_potentials(_without_wide_residue(W), n)
        T = powers_of_two(v)
    return T, float(powers_of_two(np.array(rate or 0.0)))


def _rated_potentials(
    W: NDArray[np.float64], n: int, least: float = -np.inf
) -> tuple[NDArray[np.float64], float | None]:
    """Return the potentials for the sizes of the entries of ``[A B; C D]`` and the logarithm of its rate, if any.

    A rate of less than ``least`` is that.
    """
    q, p = W.shape[1] - n, W.shape[0] - n
    row_node = np.concatenate([np.arange(n), n + q + np.arange(p)])
    v, rate = np.zeros(n + q + p), None
    column_node = np.arange(n + q)
    dynamic = np.arange(len(W)) < n
    for _ in range(_ROUNDS):
        v, rate = _with_rate(W, row_node, column_node, dynamic, n + q + p, least)
        if rate is None:
            break
        scaled = W * np.exp2(v[: n + q] - v[row_node][:, None])
        scaled[:n] /= 2.0**rate
        keep = _real(scaled, scaled)
        if np.array_equal(keep, W > 0):
            break
        W = np.where(keep, W, 0.0)
    return v, rate


def output_weights(A: NDArray, B: NDArray, C: NDArray, D: NDArray) -> NDArray[np.float64]:
    """Return the units of the outputs as they come out of the least squares, not rounded.

    For least squares over outputs, whose result is the same in all units then, be they powers of two or not.
    """
    return np.exp2(-_system_potentials(A, B, C, D)[0][len(A) + np.shape(B)[1] :])


def row_levels(M: NDArray[np.float64], part_of_row: NDArray[np.int_], parts: int) -> NDArray[np.float64]:
    """Return a factor, a power of two, for each part of the rows of a matrix: divided by them, its entries are nearest.

    Nearest to one size in each column, whatever factors the columns have; one for the first of parts that columns join.
    """
    columns = np.arange(M.shape[1])
    v = _potentials(np.abs(M), part_of_row, parts + columns, parts + len(columns))
    return powers_of_two(v[:parts])


def _rounded(v: NDArray[np.float64], n: int, q: int) -> Units:
    """Return potentials of ``n`` states, ``q`` inputs and the outputs as powers of two."""
    T = powers_of_two(v)
    return Units(T[:n], T[n : n + q], 1.0 / T[n + q :])


@cached_by_entries
def _system_potentials(A: NDArray, B: NDArray, C: NDArray, D: NDArray) -> tuple[NDArray[np.float64], float]:
    """Return the potentials of states, inputs and outputs, and the logarithm of the level they bring entries to."""
    n = len(A)
    W = np.abs(bordered(A, B, C, D))
    v, level = _potentials_at_level(W, n)
    u = _rounded(v, n, W.shape[1] - n)
    if _is_far(W, np.concatenate([1 / u.states, u.outputs]), np.concatenate([u.states, u.inputs])):
        return _potentials_at_level(_without_wide_residue(W), n)
    return v, level


def _potentials_at_level(W: NDArray[np.float64], n: int) -> tuple[NDArray[np.float64], float]:
    """Return the same for the sizes of the entries of ``[A B; C D]`` with ``n`` states."""
    diagonal = W.diagonal()[:n]
    v, level = _rated_potentials(W, n, float(np.log2(diagonal.max())) if np.any(diagonal) else -np.inf)
    level = level or 0.0
    v[W.shape[1] :] -= level  # what enters outputs has no rate, but they have units of their own
    return v, level


@cached_by_entries
def matrix_units(M: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the factors of rows and of columns with which the entries of a matrix are nearest to one."""
    W = np.abs(np.asarray(M, dtype=float))
    rows, columns = _matrix_units(W)
    return _matrix_units(_without_wide_residue(W)) if _is_far(W, rows, columns) else (rows, columns)


def _matrix_units(W: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    p, q = W.shape
    v = _potentials(W, np.arange(p), p + np.arange(q), p + q)
    T = powers_of_two(v)
    return 1.0 / T[:p], T[p:]


@cached_by_entries
def pencil_units(A: NDArray, E: NDArray) -> PencilUnits:
    """Return the factors of rows and columns, and the unit of ``s``, that bring the entries of a pencil nearest to one.

    A bordered pencil has further rows and columns in ``A``; those of ``E`` are zero there.
    """
    a, e = np.abs(np.asarray(A, dtype=float)), np.abs(np.asarray(E, dtype=float))
    found = _pencil_units(a, e)
    if _is_far(np.maximum(a, found.unit * e), found.rows, found.columns):
        found = _pencil_units(_without_wide_residue(a), _without_wide_residue(e))
    return found


def _pencil_units(a: NDArray[np.float64], e: NDArray[np.float64]) -> PencilUnits:
    """Return the same for the sizes of the entries."""
    unit: float | None = None
    p = len(a)
    for _ in range(_ROUNDS):
        v, unit = _pencil_potentials(a, e)
        factor = 2.0 ** (unit or 0.0)
        rows, columns = np.exp2(-v[:p]), np.exp2(v[p:])
        scaled_a, scaled_e = rows[:, None] * a * columns, factor * rows[:, None] * e * columns
        largest = np.maximum(scaled_a, scaled_e)
        keep_a, keep_e = _real(scaled_a, largest), _real(scaled_e, largest)
        if np.array_equal(keep_a, a > 0) and np.array_equal(keep_e, e > 0):
            break
        a, e = np.where(keep_a, a, 0.0), np.where(keep_e, e, 0.0)
    T = powers_of_two(v)
    return PencilUnits(1.0 / T[:p], T[p:], float(powers_of_two(np.array(unit or 0.0))), unit is not None)


def bordered(A: NDArray, B: NDArray, C: NDArray, D: NDArray) -> NDArray[np.float64]:
    """Return ``[A B; C D]``; called so often that the checks of ``numpy.block`` would take longer."""
    n, q = len(A), np.shape(B)[1]
    M = np.empty((n + len(C), n + q))
    M[:n, :n], M[:n, n:], M[n:, :n], M[n:, n:] = A, B, C, D
    return M


def _is_far(W: NDArray[np.float64], rows: NDArray[np.float64], columns: NDArray[np.float64]) -> bool:
    """Tell whether residue has drawn a fit off: the largest entry is left far above the one in the middle."""
    scaled = rows[:, None] * W * columns
    present = scaled[scaled > 0]
    count = present.size
    if not count or present.max() <= _FAR * present.min():
        return False
    present.sort()
    return bool(present[-1] > _FAR * (0.5 * (present[(count - 1) // 2] + present[count // 2])))


def _without_wide_residue(W: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return entries without those that linearisation or identification leaves of nothing, in the units at hand."""
    if not W.size:
        return W
    floor = _WIDE * np.minimum(W.max(axis=1, keepdims=True), W.max(axis=0, keepdims=True))
    return np.where(floor < W, W, 0.0)


def without_residue(M: NDArray[np.float64], rows: NDArray | None = None, columns: NDArray | None = None) -> NDArray:
    """Return ``abs(M)`` with the entries set to zero that can only be residue, in units of rows and columns."""
    M = np.abs(M)
    if not M.size:
        return M
    scaled = M if rows is None or columns is None else rows[:, None] * M * columns
    return np.where(_real(scaled, scaled), M, 0.0)


def pencil_without_residue(A: NDArray, E: NDArray, units: PencilUnits) -> tuple[NDArray, NDArray]:
    """Return ``abs(A)`` and ``abs(E)`` with the entries set to zero that can only be rounding residue."""
    factors = units.rows[:, None] * units.columns
    a, e = np.abs(A), np.abs(E)
    largest = factors * np.maximum(a, units.unit * e)
    return (
        np.where(_real(factors * a, largest), a, 0.0),
        np.where(_real(factors * units.unit * e, largest), e, 0.0),
    )


def _real(W: NDArray[np.float64], largest: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Tell which entries are more than residue against the largest of their row or of their column."""
    if not W.size:
        return W > 0
    floor = RESIDUE * np.minimum(largest.max(axis=1, keepdims=True), largest.max(axis=0, keepdims=True))
    return floor < W


def _potentials(W: NDArray[np.float64], row_node: NDArray, column_node: NDArray, count: int) -> NDArray[np.float64]:
    """Return ``v`` such that the logarithms of ``W_ij 2^(v_j - v_i)`` are nearest to zero, residue left out."""
    W = W.copy()
    v = np.zeros(count)
    for _ in range(_ROUNDS):
        present, logarithms = _logarithms(W)
        v = _least_squares(present, row_node, column_node, [logarithms], count)[:, 0]
        scaled = W * np.exp2(v[column_node][None, :] - v[row_node][:, None])
        keep = _real(scaled, scaled)
        if np.array_equal(keep, W > 0):
            break
        W = np.where(keep, W, 0.0)
    return v


def _logarithms(W: NDArray[np.float64]) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Return where there are entries, and their binary logarithms, zero elsewhere."""
    present = W != 0
    return present, np.log2(np.where(present, W, 1.0))


def _least_squares(
    present: NDArray[np.bool_],
    row_node: NDArray,
    column_node: NDArray,
    values: list[NDArray[np.float64]],
    count: int,
) -> NDArray[np.float64]:
    """Minimise the sum of squares of ``values + v[column] - v[row]``, the first node of each part at zero.

    Every entry that is present is an edge from the node of its row to that of its column. Of each connected part only
    the differences of ``v`` matter; with the first at zero they are whole numbers apart for units that are powers of
    two. For each of ``values``, zero where there is no entry, there is a column of ``v``. No entry is looked at by
    itself: the normal equations are made of sums over rows and over columns.
    """
    places = (row_node[:, None] * count + column_node).ravel()
    edges = np.bincount(places, weights=present.ravel(), minlength=count * count).reshape(count, count)
    origins = _origins(edges)
    v = np.zeros((count, len(values)))
    if len(origins) < count:
        L = -edges - edges.T  # the Laplacian of the graph
        L.ravel()[:: count + 1] -= L.sum(axis=1)
        b = [
            np.bincount(row_node, weights=one.sum(axis=1), minlength=count)
            - np.bincount(column_node, weights=one.sum(axis=0), minlength=count)
            for one in values
        ]
        # one after the first of each part is free; the factor of what is left, positive definite, needs no pivots
        free = slice(1, None) if len(origins) == 1 else np.delete(np.arange(count), origins)
        v[free] = lapack.dposv(L[free][:, free], np.array(b).T[free])[1]
    return v


def _with_rate(
    W: NDArray[np.float64],
    row_node: NDArray,
    column_node: NDArray,
    dynamic: NDArray[np.bool_],
    count: int,
    least: float = -np.inf,
) -> tuple[NDArray[np.float64], float | None]:
    """Minimise the same with one unknown more, by which the logarithms in dynamic rows are larger; if it matters.

    It is no smaller than ``least``.
    """
    present, logarithms = _logarithms(W)
    shared = (present & dynamic[:, None]).astype(float)
    v, through = _least_squares(present, row_node, column_node, [logarithms, shared], count).T
    # minus what the potentials make of either
    left = shared + present * (through[column_node] - through[row_node][:, None])
    own = float(np.vdot(left, left))
    if own <= _NO_RATE * max(float(shared.sum()), 1.0):
        return v, None
    rate = max(float(np.vdot(left, logarithms + v[column_node] - v[row_node][:, None])) / own, least)
    return v - rate * through, rate


def _origins(edges: NDArray) -> NDArray[np.int_]:
    """Return the first node of each connected part of a graph, by how many edges lead from one node to another."""
    if np.count_nonzero(edges) <= _FEW:  # faster in lists
        first = list(range(len(edges)))
        row, column = np.nonzero(edges)
        for i, j in zip(row.tolist(), column.tolist(), strict=True):
            while first[i] != i:
                i = first[i]
            while first[j] != j:
                j = first[j]
            first[max(i, j)] = min(i, j)
        return np.array([i for i, origin in enumerate(first) if origin == i], dtype=int)
    return np.array([part[0] for part in connected_parts(edges != 0)], dtype=int)


def _pencil_potentials(a: NDArray[np.float64], e: NDArray[np.float64]) -> tuple[NDArray[np.float64], float | None]:
    """Return the potentials of rows and columns of a pencil, and the logarithm of the unit of ``s``, if it has one."""
    p, q = a.shape
    rows = np.concatenate([np.arange(p), np.arange(p)])
    v, rate = _with_rate(np.vstack([a, e]), rows, p + np.arange(q), np.arange(2 * p) >= p, p + q)
    return v, None if rate is None else -rate
