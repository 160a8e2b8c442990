"""Parts of a matrix that nothing connects: what is computed of one must not mix with what is computed of another."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def row_parts(present: NDArray[np.bool_]) -> list[NDArray[np.int_]]:
    """Return the rows of a matrix in groups that share no column, each with the first of its rows first.

    Parameters
    ----------
    present : ndarray of bool, shape (rows, columns)
        Where the entries are that are not zero.
    """
    left = np.arange(len(present))
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
