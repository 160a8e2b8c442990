"""The norm of every row, and its square, with the same order of operations everywhere."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def row_norms(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the norm of each row, its squares added in order: equal to the last bit for any split into blocks."""
    return np.sqrt(row_squares(rows))


def row_squares(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the sum of the squares of each row, added in order."""
    total = np.zeros(rows.shape[:-1])
    for j in range(rows.shape[-1]):
        total = total + rows[..., j] * rows[..., j]
    return total
