"""Combinations of rows with the largest response to one group of signals, relative to that to another."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from residua.linear.subspaces.parts import row_parts
from residua.tolerances import DESIGN_ROUNDING, IDENTITY


def best_ratios(
    wanted: NDArray[np.float64], unwanted: NDArray[np.float64], rank: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    r"""Return the stationary values of :math:`|c^T F| / |c^T D|`, the largest first, and the combinations ``c``.

    The generalised eigenproblem :math:`F F^T c = \lambda D D^T c`, by singular values alone, nothing is squared: with
    :math:`D = U S V^T` of that rank, those of :math:`S^{-1} U^T F`. Combinations that ``D`` annihilates are
    left out; they must annihilate ``F`` too, or the ratio has no largest value. Rounding chooses nothing where ratios
    are equal: rows that share no signal are not combined then, and of those that do, the combination comes first that
    answers most to a single wanted signal.

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
        seen = scaled.T @ wanted
        left, values, _ = np.linalg.svd(seen, full_matrices=True)
        left = _without_choice(left, values, seen)
        ratios += [*values, *np.zeros(len(left) - len(values))]
        combinations += list((scaled @ left).T)
    order = np.argsort([-float(f"{x:.9e}") for x in ratios], kind="stable")
    return np.array(ratios)[order], np.array(combinations).reshape(len(ratios), len(wanted))[order]


def _without_choice(left: NDArray[np.float64], values: NDArray[np.float64], seen: NDArray[np.float64]) -> NDArray:
    """Return left singular vectors; of those with one value, the ones that answer most to one column, then the next."""
    left, start = left.copy(), 0
    for end in range(1, len(values) + 1):
        if end < len(values) and values[end] > (1 - DESIGN_ROUNDING) * values[start]:
            continue
        if end > start + 1 and values[start] > 0:
            rest = left[:, start:end]
            for k in range(start, end):
                answers = rest.T @ seen
                sizes = np.linalg.norm(answers, axis=0)
                first = answers[:, np.flatnonzero(sizes > (1 - IDENTITY) * sizes.max())[0]]
                turned = np.linalg.qr(first[:, None], mode="complete")[0]
                left[:, k], rest = rest @ (first / np.linalg.norm(first)), rest @ turned[:, 1:]
        start = end
    return left


def _singular_rows(M: NDArray[np.float64], part: NDArray[np.int_]) -> tuple[NDArray, NDArray]:
    """Return the left singular vectors of some rows of a matrix, as combinations of all, and the singular values."""
    U, s, _ = np.linalg.svd(M[part], full_matrices=False)
    out = np.zeros((len(M), len(s)))
    out[part] = U
    return out, s
