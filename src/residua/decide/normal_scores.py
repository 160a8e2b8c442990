"""Normal scores of residuals with heavy tails: each value becomes the Gaussian one of equal rarity."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from residua.tolerances import DATA_ROUNDING

#: Scores at which the map has its knots, and samples beyond the outermost of those that are read off the data.
_SCORES, _BEYOND = np.linspace(-8.0, 8.0, 65), 10.0
#: Share of the samples by which the tail on each side is known.
_TAIL = 0.02
#: Knots are this far apart at least, in parts of themselves: scores in between are still told from one another.
_CLOSEST = 4 * float(np.finfo(float).eps)
#: Fourth moments this far above a Gaussian's, in deviations of chance and as they are, are heavy tails.
_DEVIATIONS, _NOTABLE = 4.0, 0.2


def is_heavy_tailed(e: NDArray[np.float64]) -> bool:
    """Tell whether white samples, in rows, have heavier tails than Gaussian ones: by the fourth moments of columns."""
    n = len(e)
    if n < 100:
        return False
    excess = np.mean(e**4, axis=0) / np.maximum(np.mean(e**2, axis=0) ** 2, np.finfo(float).tiny) - 3
    return bool((excess > max(_NOTABLE, _DEVIATIONS * np.sqrt(24 / n))).any())


def knots_of(e: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the values of each column of samples at which its scores are known, shape (k, m), and the scores.

    Equal values, as of a coarse sensor, have the score in the middle of those that they stand for.
    """
    from scipy.special import ndtr

    share = ndtr(_SCORES)
    inside = np.minimum(share, 1 - share) * len(e) >= _BEYOND
    ordered = np.array([_apart(column) for column in np.sort(e, axis=0).T]).T
    values = np.empty((e.shape[1], len(_SCORES)))
    values[:, inside] = np.quantile(ordered, share[inside], axis=0).T
    upper = np.flatnonzero(_SCORES[inside][-1] < _SCORES)
    rarer = ndtr(-_SCORES[upper]) / ndtr(-_SCORES[upper[0] - 1])
    middle = np.median(ordered, axis=0)
    above, below = ordered - middle, (middle - ordered)[::-1]
    values[:, upper] = middle[:, None] + _beyond(above, values[:, upper[0] - 1] - middle, rarer)
    lower = len(_SCORES) - 1 - upper
    values[:, lower] = middle[:, None] - _beyond(below, middle - values[:, lower[0] + 1], rarer)
    least = _CLOSEST * np.abs(values[:, inside]).max(axis=1)
    for j in range(1, len(_SCORES)):  # a tail may be so heavy that its ends say nothing of how near others may be
        before = values[:, j - 1]
        values[:, j] = np.maximum(values[:, j], before + np.maximum(least, _CLOSEST * np.abs(before)))
    return values, _SCORES


def _apart(ordered: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return sorted values with those that are equal spread evenly, halfway to their neighbours on either side."""
    new = np.concatenate([[True], np.diff(ordered) > DATA_ROUNDING * np.abs(ordered[1:])])
    first = np.flatnonzero(new)
    count = np.diff(np.append(first, len(ordered)))
    if len(first) in (1, len(ordered)):  # there is nothing between, or all differ
        return ordered
    gaps = np.diff(ordered[first])
    down, up = np.append(gaps[:1], gaps) / 2, np.append(gaps, gaps[-1:]) / 2
    block = np.cumsum(new) - 1
    place = 2 * (np.arange(len(ordered)) - first[block] + 0.5) / count[block] - 1  # from -1 to 1, of a single one 0
    return ordered[first][block] + place * np.where(place < 0, down[block], up[block])


def _beyond(above: NDArray[np.float64], last: NDArray[np.float64], rarer: NDArray[np.float64]) -> NDArray[np.float64]:
    r"""Return the values so much rarer than the last ones of each column, by a power-law tail.

    .. math:: P(e > x) = P(e > x_0)\,(x / x_0)^{-\alpha}

    with Hill's estimate of the power (1975). ``above`` are the samples less their median, sorted.
    """
    rows = above[-max(int(_TAIL * len(above)), int(2 * _BEYOND)) :]
    start = np.maximum(rows[0], np.finfo(float).tiny)
    power = 1 / np.maximum(np.mean(np.log(np.maximum(rows, start) / start), axis=0), np.finfo(float).eps)
    return last[:, None] * rarer[None, :] ** (-1 / power[:, None])


def normal_scores(
    e: NDArray[np.float64], knots: NDArray[np.float64], scores: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the scores of samples, shape (..., k): linear between the knots, and extrapolated beyond."""
    if not scores.size:
        return e
    out = np.empty_like(e)
    for j, x in enumerate(knots):
        place = np.clip(np.searchsorted(x, e[..., j]), 1, len(x) - 1)
        slope = (scores[place] - scores[place - 1]) / (x[place] - x[place - 1])
        out[..., j] = scores[place - 1] + slope * (e[..., j] - x[place - 1])
    return out


def raw_values(
    values: NDArray[np.float64], knots: NDArray[np.float64], scores: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the samples that have these scores, shape (..., k): the inverse of :func:`normal_scores`."""
    if not scores.size:
        return values
    out = np.empty_like(values)
    place = np.clip(np.searchsorted(scores, values), 1, len(scores) - 1)
    for j, x in enumerate(knots):
        at = place[..., j]
        slope = (x[at] - x[at - 1]) / (scores[at] - scores[at - 1])
        out[..., j] = x[at - 1] + slope * (values[..., j] - scores[at - 1])
    return out


__all__ = ["is_heavy_tailed", "knots_of", "normal_scores", "raw_values"]
