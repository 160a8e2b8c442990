"""The combinations of rows that answer most to one group of signals for what they answer to another."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from residua.linear.subspaces.parts import row_parts


def best_ratios(
    wanted: NDArray[np.float64], unwanted: NDArray[np.float64], rank: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    r"""Return the stationary values of :math:`|c^T F| / |c^T D|`, the largest first, and the combinations ``c``.

    The generalised eigenproblem :math:`F F^T c = \lambda D D^T c`, by singular values alone, nothing is squared: with
    :math:`D = U S V^T` of that rank, those of :math:`S^{-1} U^T F`. Combinations that ``D`` annihilates are
    left out; they must annihilate ``F`` too, or the ratio has no largest value. Rows that share no signal are not
    combined: where their ratios are equal, rounding would choose the combination.

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
    pairs = [_singular_rows(unwanted, part) for part in row_parts(np.hstack([wanted, unwanted]))]
    sizes = np.concatenate([s for _, s in pairs])
    kept = np.zeros(len(sizes), dtype=bool)
    kept[np.argsort(-sizes, kind="stable")[:rank]] = True
    ratios, combinations, at = [], [], 0
    for U, s in pairs:
        chosen = kept[at : at + len(s)]
        at += len(s)
        scaled = U[:, chosen] / s[chosen]
        left, values, _ = np.linalg.svd(scaled.T @ wanted, full_matrices=True)
        ratios += [*values, *np.zeros(len(left) - len(values))]
        combinations += list((scaled @ left).T)
    order = np.argsort([-float(f"{x:.9e}") for x in ratios], kind="stable")
    return np.array(ratios)[order], np.array(combinations).reshape(len(ratios), len(wanted))[order]


def _singular_rows(M: NDArray[np.float64], part: NDArray[np.int_]) -> tuple[NDArray, NDArray]:
    """Return the left singular vectors of some rows of a matrix, as combinations of all, and the singular values."""
    U, s, _ = np.linalg.svd(M[part], full_matrices=False)
    out = np.zeros((len(M), len(s)))
    out[part] = U
    return out, s
