"""Parts of a matrix that nothing connects: what is computed of one must not mix with what is computed of another."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

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
