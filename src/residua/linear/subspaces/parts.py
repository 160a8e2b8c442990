"""Parts of a matrix that nothing connects: what is computed of one must not mix with what is computed of another."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Indices = NDArray[np.intp]


def connected_parts(coupled: NDArray[np.bool_]) -> list[Indices]:
    """Return the nodes of a graph in groups that nothing connects, each in order, that with the lowest node first.

    Parameters
    ----------
    coupled : ndarray of bool, shape (nodes, nodes)
        Whether an edge leads from one node to another; its direction does not count.
    """
    either = coupled | coupled.T
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


def part_of_each(coupled: NDArray[np.bool_]) -> Indices:
    """Return for each node of a graph the number of its part, counted as :func:`connected_parts` returns them."""
    part = np.empty(len(coupled), dtype=int)
    for number, nodes in enumerate(connected_parts(coupled)):
        part[nodes] = number
    return part


def part_numbers(present: NDArray[np.bool_]) -> tuple[Indices, Indices]:
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


def row_parts(M: NDArray) -> list[Indices]:
    """Return the rows of a matrix in groups that share no column, each with the first of its rows first."""
    of_rows = part_numbers(M != 0)[0]
    return [np.flatnonzero(of_rows == part) for part in np.unique(of_rows)]


def strong_parts(A: NDArray) -> list[Indices]:
    """Return the states in groups that act on one another, however far round: each has modes of its own."""
    n = len(A)
    reached = np.eye(n) + (A != 0)
    for _ in range(n.bit_length()):  # ways of twice the length each time
        reached = np.minimum(reached @ reached, 1.0)
    return connected_parts((reached > 0) & (reached.T > 0))
