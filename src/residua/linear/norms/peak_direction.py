r"""The largest value of :math:`f(v) = \sum_k \|h_k^T v\|_2` over unit vectors ``v``, and a proof of that.

``f`` is a norm, so that it is convex and may have many local maxima on the sphere. Ascent finds one; two upper bounds
tell whether it is the largest: a relaxation that is exact at most systems, and a search over cones that always closes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[np.float64]
#: Multiplications that the search over cones may take.
_BUDGET = 4e9
_STARTS = 24
_TINY = float(np.finfo(float).tiny)


@dataclass(frozen=True, eq=False)
class LargestSum:
    """The largest value of a search, its direction, and an upper bound of all values."""

    attained: float
    direction: NDArray[np.float64]
    upper: float


class _Terms:
    """The terms ``h_k`` with no more columns than rows: ``h_k' v`` keeps its length."""

    def __init__(self, H: Matrix) -> None:
        _, p, m = H.shape
        if m > p:
            R = np.asarray(np.linalg.qr(H.transpose(0, 2, 1), mode="r"))
            H = R.transpose(0, 2, 1)
        size = float(np.abs(H).max(initial=0.0))
        self.unit = size or 1.0
        self.H = H / self.unit
        self.p = p
        self.flat = np.ascontiguousarray(self.H.transpose(0, 2, 1)).reshape(-1, p)
        self.columns = self.H.shape[2]

    def lengths(self, V: Matrix) -> Matrix:
        """Return ``|h_k' v|``, shape (terms, directions)."""
        return np.linalg.norm((self.flat @ V).reshape(-1, self.columns, V.shape[1]), axis=1)

    def values(self, V: Matrix) -> NDArray[np.float64]:
        return self.lengths(V).sum(axis=0)

    def step(self, V: Matrix) -> tuple[Matrix, NDArray[np.float64]]:
        """Return ``sum_k h_k h_k' v / |h_k' v|``, the gradient, of each direction, and the values."""
        products = (self.flat @ V).reshape(-1, self.columns, V.shape[1])
        length = np.linalg.norm(products, axis=1)
        unit = products / np.maximum(length, _TINY)[:, None]
        return self.flat.T @ unit.reshape(-1, V.shape[1]), length.sum(axis=0)

    def weighted(self, weights: NDArray[np.float64]) -> Matrix:
        """Return ``sum_k weights_k h_k h_k'``."""
        return self.flat.T @ (np.repeat(weights, self.columns)[:, None] * self.flat)


def largest_sum(H: Matrix, *, rtol: float) -> LargestSum:
    """Maximise the sum of lengths over unit vectors.

    Parameters
    ----------
    H : ndarray, shape (terms, p, m)
    rtol : float
        The search stops once the upper bound is within this fraction of the value that is attained.
    """
    terms = _Terms(H)
    if not np.any(terms.H):
        return LargestSum(0.0, np.eye(terms.p)[0], 0.0)
    upper, guess = _relaxation(terms, rtol)
    best, direction = _ascend(terms, guess)
    upper = min(upper, _weighted_bound(terms, terms.lengths(direction[:, None])[:, 0])[0])
    if upper > best * (1 + rtol) and terms.p > 1:
        axes = np.linalg.eigh(terms.weighted(np.ones(len(terms.H))))[1]
        chance = np.random.default_rng(0).standard_normal((terms.p, _STARTS if terms.flat.size < 1e5 else 4))
        starts = np.column_stack([np.eye(terms.p), axes, chance / np.linalg.norm(chance, axis=0)])
        best, direction = max(_ascend(terms, starts), (best, direction), key=lambda pair: pair[0])
        upper = min(upper, _weighted_bound(terms, terms.lengths(direction[:, None])[:, 0])[0])
    if upper > best * (1 + rtol) and terms.p > 1:
        best, direction, upper = _search_cones(terms, best, direction, upper, rtol)
    return LargestSum(best * terms.unit, direction, max(upper, best) * terms.unit)


def _ascend(terms: _Terms, V: Matrix, *, most: int = 500) -> tuple[float, NDArray[np.float64]]:
    """Climb from every column; the gradient of a convex function points to where it is no smaller."""
    before = np.zeros(V.shape[1])
    for _ in range(most):
        gradient, values = terms.step(V)
        V = gradient / np.maximum(np.linalg.norm(gradient, axis=0), _TINY)
        moving = values > before * (1 + 1e-12)
        if not moving.any():
            break
        # What has come to rest below the best, and what climbs so slowly that it will, is let go.
        keep = (values >= values.max() * (1 - 1e-12)) | (moving & (values - before > 1e-3 * (values.max() - values)))
        V, before = V[:, keep], values[keep]
    values = terms.values(V)
    i = int(np.argmax(values))
    return float(values[i]), V[:, i]


def _relaxation(terms: _Terms, rtol: float, *, most: int = 200) -> tuple[float, NDArray[np.float64]]:
    r"""Bound ``f`` by the concave ``sum_k sqrt(tr(h_k h_k' V))`` over all ``V >= 0`` of unit trace.

    Every choice of weights gives a bound, :math:`f^2 \le \lambda_{max}(\sum_k h_k h_k^T / \mu_k) \sum_k \mu_k` by
    Cauchy and Schwarz; the iteration only looks for good ones. It is tight where the best ``V`` has rank one.
    """
    V = np.eye(terms.p) / terms.p
    upper, axis = np.inf, np.eye(terms.p)[:, :1]
    for _ in range(most):
        mu = np.sqrt(np.maximum(np.sum((terms.flat @ V) * terms.flat, axis=1).reshape(-1, terms.columns).sum(1), 0.0))
        bound, S = _weighted_bound(terms, mu)
        upper = min(upper, bound)
        attained = float(np.sum(S * V))
        axis = np.linalg.eigh(V)[1][:, -1:]
        if upper <= attained * (1 + 0.1 * rtol):
            break
        V = S @ V @ S
        V = V / np.trace(V)
    return upper, axis


def _weighted_bound(terms: _Terms, mu: NDArray[np.float64]) -> tuple[float, Matrix]:
    """Return the bound of some weights, and ``sum_k h_k h_k' / mu_k``."""
    # A term that a direction does not see gets a small weight of its own: any positive one keeps the bound valid.
    mu = np.maximum(mu, 1e-12 * mu.max())
    S = terms.weighted(1 / mu)
    return float(np.sqrt(np.linalg.eigvalsh(S)[-1] * mu.sum())) * (1 + 1e-13), S


def _search_cones(
    terms: _Terms, best: float, direction: NDArray[np.float64], upper: float, rtol: float
) -> tuple[float, NDArray[np.float64], float]:
    """Halve cones until none can hold a larger value; each is spanned by ``p`` unit vectors.

    In a cone ``f(sum c_i v_i) <= sum c_i f(v_i)`` with ``c_i >= 0``: a linear function of the direction, the largest
    value of which over unit vectors is its length; and the sum of the ``c_i`` has a largest value likewise.
    """
    p = terms.p
    signs = np.array(np.meshgrid(*[[1.0, -1.0]] * (p - 1), indexing="ij")).reshape(p - 1, -1).T
    cones = np.stack([np.diag([1.0, *row]) for row in signs])  # rows span a cone; v and -v count once
    values = terms.values(cones.reshape(-1, p).T).reshape(-1, p)
    left = _BUDGET / max(terms.flat.size, 1)
    settled = best
    while len(cones):
        linear = np.linalg.solve(cones, values[..., None])[..., 0]
        spread = np.linalg.solve(cones, np.ones((*values.shape, 1)))[..., 0]
        by_size = values.max(axis=1) * np.linalg.norm(spread, axis=1)
        bounds = np.minimum(np.linalg.norm(linear, axis=1), by_size) * (1 + 1e-12)
        open_ = bounds > best * (1 + rtol)
        settled = max(settled, float(bounds[~open_].max(initial=0.0)))
        cones, values, bounds = cones[open_], values[open_], bounds[open_]
        left -= len(cones)
        if not len(cones) or left < 0:
            upper = min(upper, max(settled, float(bounds.max(initial=0.0)), best))
            break
        # cut at the middle of the widest pair of edges
        cosine = cones @ cones.transpose(0, 2, 1) + 4 * np.eye(p)
        i, j = np.unravel_index(np.argmin(cosine.reshape(len(cones), -1), axis=1), (p, p))
        row = np.arange(len(cones))
        middle = cones[row, i] + cones[row, j]
        middle /= np.linalg.norm(middle, axis=1, keepdims=True)
        height = np.concatenate([terms.values(part.T) for part in np.array_split(middle, max(1, len(cones) // 512))])
        cones, values = np.concatenate([cones, cones]), np.concatenate([values, values])
        cones[row, i], cones[row + len(row), j] = middle, middle
        values[row, i], values[row + len(row), j] = height, height
        if values.max() > best:
            top = np.unravel_index(int(np.argmax(values)), values.shape)
            climbed, where = _ascend(terms, cones[top][:, None])
            if climbed > best:
                best, direction = climbed, where
    return best, direction, upper
