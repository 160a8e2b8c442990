"""The combinations of rows that answer most to one group of signals for what they answer to another."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def best_ratios(
    wanted: NDArray[np.float64], unwanted: NDArray[np.float64], rank: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    r"""Return the stationary values of :math:`|c^T F| / |c^T D|`, the largest first, and the combinations ``c``.

    The generalised eigenproblem :math:`F F^T c = \lambda D D^T c`, by singular values alone, nothing is squared: with
    :math:`D = U S V^T` of the given rank, those of :math:`S^{-1} U^T F`. Combinations that ``D`` annihilates are
    left out; they must annihilate ``F`` too, or the ratio has no largest value.

    Parameters
    ----------
    wanted : ndarray, shape (rows, p)
        ``F``.
    unwanted : ndarray, shape (rows, q)
        ``D``.
    rank : int
        Of ``D``.

    Returns
    -------
    ratios : ndarray, shape (rank,)
    combinations : ndarray, shape (rank, rows)
        With :math:`|c^T D| = 1`.
    """
    U, s, _ = np.linalg.svd(unwanted, full_matrices=False)
    scaled = U[:, :rank] / s[:rank]
    left, ratios, _ = np.linalg.svd(scaled.T @ wanted, full_matrices=True)
    return np.concatenate([ratios, np.zeros(rank)])[:rank], (scaled @ left).T
