"""Parts of a matrix that nothing connects: what is computed of one must not mix with what is computed of another.

References
----------
A. L. Dulmage and N. S. Mendelsohn, Coverings of bipartite graphs, Canad. J. Math. 10 (1958) 517-534. A. Pothen and
C.-J. Fan, Computing the block triangular form of a sparse matrix, ACM Trans. Math. Software 16 (1990) 303-324.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Indices = NDArray[np.intp]

#: Nodes up to which a graph is walked faster in lists than in arrays.
_FEW = 16


def row_parts(M: NDArray) -> list[NDArray[np.int_]]:
    """Return the rows of a matrix in groups that share no column, each with the first of its rows first.

    Parameters
    ----------
    M : ndarray, shape (rows, columns)
        What counts is where the entries are that are not zero.
    """
    present = M != 0
    left = np.arange(len(M))
    parts = []
    while left.size:
        inside = np.zeros(len(left), dtype=bool)
        inside[0] = True
        while True:
            reached = present[left][:, present[left[inside]].any(axis=0)].any(axis=1) | inside
            if np.array_equal(reached, inside):
                break
            inside = reached
        parts.append(left[inside])
        left = left[~inside]
    return parts


def rows_by_parts(
    M: NDArray[np.float64], basis: Callable[[NDArray[np.float64]], NDArray[np.float64]]
) -> NDArray[np.float64]:
    """Return rows that combine those of a matrix, such as annihilate it, without mixing what has no column in common.

    Parameters
    ----------
    M : ndarray, shape (rows, columns)
    basis : callable
        From some rows of ``M`` to the combinations of these, as columns.
    """
    out = [np.zeros((0, len(M)))]
    for part in row_parts(M):
        combinations = basis(M[part])
        out.append(np.zeros((combinations.shape[1], len(M))))
        out[-1][:, part] = combinations.T
    return np.vstack(out)


def connected_parts(coupled: NDArray[np.bool_]) -> list[NDArray[np.int_]]:
    """Return the nodes of a graph in groups that nothing connects, each in order, that with the lowest node first.

    Parameters
    ----------
    coupled : ndarray of bool, shape (nodes, nodes)
        Whether an edge leads from one node to another; its direction does not count.
    """
    either = coupled | coupled.T
    return _by_lists(either) if len(either) <= _FEW else _by_rows(either)


def _by_lists(either: NDArray[np.bool_]) -> list[NDArray[np.int_]]:
    """Return the parts of a graph of few nodes, one node after the other."""
    neighbours = [np.flatnonzero(row).tolist() for row in either]
    new = [True] * len(neighbours)
    parts = []
    for first in range(len(new)):
        if not new[first]:
            continue
        part, new[first] = [first], False
        for node in part:  # grows on the way
            for other in neighbours[node]:
                if new[other]:
                    new[other] = False
                    part.append(other)
        parts.append(np.array(sorted(part)))
    return parts


def _by_rows(either: NDArray[np.bool_]) -> list[NDArray[np.int_]]:
    """Return the parts of a graph of many nodes, by all that a step reaches at once."""
    left = np.ones(len(either), dtype=bool)
    parts = []
    while left.any():
        inside = np.zeros(len(either), dtype=bool)
        inside[int(left.argmax())] = True
        reached = inside
        while reached.any():
            reached = either[reached].any(axis=0) & ~inside
            inside |= reached
        parts.append(np.flatnonzero(inside))
        left &= ~inside
    return parts


def part_of_each(coupled: NDArray[np.bool_]) -> NDArray[np.int_]:
    """Return for each node of a graph the number of its part, counted as :func:`connected_parts` returns them."""
    part = np.empty(len(coupled), dtype=int)
    for number, nodes in enumerate(connected_parts(coupled)):
        part[nodes] = number
    return part


def part_numbers(present: NDArray[np.bool_]) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
    """Return for each row and each column of a matrix the number, from zero, of the part that it belongs to.

    Parameters
    ----------
    present : ndarray of bool, shape (rows, columns)
        Where the entries are that are not zero.
    """
    rows, columns = present.shape
    nodes = np.zeros((rows + columns, rows + columns), dtype=bool)
    nodes[:rows, rows:] = present
    numbers = part_of_each(nodes)
    return numbers[:rows], numbers[rows:]


def strong_parts(A: NDArray) -> list[NDArray[np.intp]]:
    """Return the states in groups that act on one another, however far round: each has modes of its own."""
    present = A != 0
    # leading states that no others act on, and all the others one part: to find that is slower than to see it
    alone = next((i for i, row in enumerate(present) if row[:i].any() or row[i + 1 :].any()), len(A))
    if present[alone:, alone:].all():
        parts = [np.array([i]) for i in range(alone)]
        return [*parts, np.arange(alone, len(A))] if alone < len(A) else parts
    return _strongly_connected([np.flatnonzero(row).tolist() for row in present])


def _strongly_connected(after: list[list[int]]) -> list[Indices]:
    """Return the strongly connected parts of a graph, given where edges lead to from each node.

    By Tarjan's search, depth first, and of the nodes that an edge leads to the last one first: the parts come in the
    order in which ``scipy.sparse.csgraph.connected_components`` counts them, which takes longer to import than this.
    """
    count = len(after)
    lowest = [-1] * count  # of each node the number of the earliest that it leads to; of one in a part the largest
    left = [False] * count
    waiting: list[int] = []  # nodes that were left, in no part yet
    parts, number = [], 0
    for first in range(count):
        ways = [first] if lowest[first] < 0 else []
        while ways:
            node = ways[-1]
            if lowest[node] < 0:
                lowest[node], number = number, number + 1
                ways += [other for other in after[node] if lowest[other] < 0]
                continue
            ways.pop()
            if left[node]:  # another edge led there
                continue
            left[node] = True
            earliest = min([lowest[other] for other in after[node]], default=count)
            if earliest < lowest[node]:
                lowest[node] = earliest
                waiting.append(node)
                continue
            part = [node]
            while waiting and lowest[node] <= lowest[waiting[-1]]:
                part.append(waiting.pop())
            for other in part:
                lowest[other] = count
            number -= len(part)
            parts.append(np.array(sorted(part)))
    return parts


def triangular_parts(present: NDArray[np.bool_]) -> list[tuple[Indices, Indices]]:
    """Return the rows and columns of each diagonal block of the block triangular form of a matrix.

    Blocks with more columns than rows come first, then square ones that have no such form themselves, then those with
    more rows than columns. Each has full rank unless entries cancel; if each has, that of the whole is their sum.

    Parameters
    ----------
    present : ndarray of bool, shape (rows, columns)
        Where the entries are that are not zero.
    """
    column_of = _matching(present)
    row_of = np.full(present.shape[1], -1)
    row_of[column_of[column_of >= 0]] = np.flatnonzero(column_of >= 0)
    wide_columns, wide_rows = _reached(present, row_of < 0, column_of)
    tall_rows, tall_columns = _reached(present.T, column_of < 0, row_of)
    wide = _connected(present, wide_rows, wide_columns)
    tall = _connected(present, tall_rows, tall_columns)
    square = np.flatnonzero(~wide_rows & ~tall_rows)
    return [*wide, *_irreducible(present, square, column_of[square]), *tall]


def _matching(present: NDArray[np.bool_]) -> Indices:
    """Return for each row the column that a largest matching gives it, or -1."""
    from scipy.sparse import csr_array  # slow to import
    from scipy.sparse.csgraph import maximum_bipartite_matching

    return np.asarray(maximum_bipartite_matching(csr_array(present), perm_type="column"), dtype=np.intp)


def _reached(
    present: NDArray[np.bool_], start: NDArray[np.bool_], partner: Indices
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return columns and rows on ways from some columns to rows, and from these to the columns matched with them."""
    columns = start.copy()
    while True:
        rows = np.asarray(present[:, columns].any(axis=1))
        more = columns.copy()
        more[partner[rows]] = True
        if np.array_equal(more, columns):
            return columns, rows
        columns = more


def _connected(
    present: NDArray[np.bool_], rows: NDArray[np.bool_], columns: NDArray[np.bool_]
) -> list[tuple[Indices, Indices]]:
    """Return the rows and columns of each part of a block that nothing connects with the others."""
    i, j = np.flatnonzero(rows), np.flatnonzero(columns)
    of_rows, of_columns = part_numbers(present[np.ix_(i, j)])
    count = int(max(of_rows.max(initial=-1), of_columns.max(initial=-1))) + 1
    return [(i[of_rows == part], j[of_columns == part]) for part in range(count)]


def _irreducible(present: NDArray[np.bool_], rows: Indices, columns: Indices) -> list[tuple[Indices, Indices]]:
    """Return the parts of a square block, its rows and columns matched in order, that ways connect both ways."""
    return [(rows[part], columns[part]) for part in strong_parts(present[np.ix_(rows, columns)])]
