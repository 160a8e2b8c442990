"""Autoregression of fault-free residuals, and its innovations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.linear.subspaces.whitening import VARIANCE_FLOOR
from residua.linear.systems.recursion import ordered_product
from residua.tolerances import RANK

#: Orders that are compared; fewer where the data are few.
_ORDERS = (1, 2, 3, 4, 6, 8, 12, 16, 24)
#: Samples to each coefficient of an equation.
_SAMPLES = 20
#: Samples for each gap; with fewer, the products of the remaining samples differ from those of all.
_TO_EACH_GAP = 1000
#: Rows of lagged samples that are held at a time.
_PIECE = 10_000
#: Lags that a test of whiteness looks at.
LAGS = 20


@dataclass(frozen=True, eq=False)
class Autoregression:
    r"""Prediction of the next sample from the last ones.

    .. math:: e_k = q_k - \sum_{i=1}^{p} A_i q_{k-i}

    Attributes
    ----------
    coefficients : ndarray, shape (p, k, k)
        The transposes of :math:`A_i`: samples are rows.
    covariance : ndarray, shape (k, k)
        Of :math:`e`.
    """

    coefficients: NDArray[np.float64]
    covariance: NDArray[np.float64]

    @property
    def order(self) -> int:
        """Order of the autoregression; 0 for none."""
        return len(self.coefficients)


@dataclass(frozen=True, eq=False)
class Past:
    """The last samples of each plant.

    Attributes
    ----------
    samples : ndarray, shape (plants, p, k)
    usable : ndarray of bool, shape (plants, p)
    """

    samples: NDArray[np.float64]
    usable: NDArray[np.bool_]

    @staticmethod
    def empty(plants: int, coefficients: NDArray[np.float64]) -> Past:
        """Return the past before the first sample: all unknown."""
        order, k = coefficients.shape[:2]
        return Past(np.zeros((plants, order, k)), np.zeros((plants, order), dtype=bool))


def unforetold(
    coefficients: NDArray[np.float64], past: Past, q: NDArray[np.float64], usable: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.bool_], Past]:
    """Return the innovations of an autoregression, and a mask of samples whose past is complete.

    Parameters
    ----------
    coefficients : ndarray, shape (p, k, k)
    past : Past
    q : ndarray, shape (plants, time, k)
        Zero where not usable.
    usable : ndarray of bool, shape (plants, time)
    """
    order, time = len(coefficients), q.shape[1]
    if not order:
        return q, usable, past
    rows, known = np.concatenate([past.samples, q], axis=1), np.concatenate([past.usable, usable], axis=1)
    e, seen = q, usable
    for lag, A in enumerate(coefficients, 1):
        e = e - ordered_product(rows[:, order - lag : order - lag + time], A)
        seen = seen & known[:, order - lag : order - lag + time]
    return np.where(seen[..., None], e, 0.0), seen, Past(rows[:, time:].copy(), known[:, time:].copy())


def autoregression(
    rows: NDArray[np.float64], usable: NDArray[np.bool_], parts: Sequence[slice], *, most: int | None = None
) -> Autoregression:
    r"""Return the autoregression of fault-free samples, of the order that Akaike's corrected criterion prefers.

    By the equations of Yule and Walker, whose solution is stable; where samples are missing by least squares over those
    whose past is whole, on which orders are compared in pairs. Each residual by its own past, or all by the past of
    all, whichever the criterion prefers. What counts is that nothing predictable remains, not that the order is a
    true one: residuals of a filter have none, and Schwarz's criterion leaves more of their memory.

    Parameters
    ----------
    rows : ndarray, shape (time, k)
        Of mean zero, and zero where not usable.
    usable : ndarray of bool, shape (time,)
    parts : sequence of slice
        The recordings: no lag reaches from one into another.
    most : int, optional
        The largest order.
    """
    n, k = int(usable.sum()), rows.shape[1]
    orders = [p for p in _ORDERS if p * _SAMPLES <= n and (most is None or p <= most)]
    if _has_gaps(usable, parts):
        return _with_gaps(rows, usable, parts, orders)
    products = _products(rows, parts, max(orders, default=0)) / max(n, 1)
    means = np.array([[_between(products, i, j) for j in range(len(products))] for i in range(len(products))])
    best = Autoregression(np.zeros((0, k, k)), products[0])
    smallest = _criterion(best, False, n)
    for joint in (False, True) if k > 1 else (False,):
        for order in orders:
            if joint and order * k * _SAMPLES > n:
                break
            found = _solved(means, order, joint)
            value = _criterion(found, joint, n)
            if value < smallest:
                best, smallest = found, value
    return best


def _with_gaps(
    rows: NDArray[np.float64], usable: NDArray[np.bool_], parts: Sequence[slice], orders: Sequence[int]
) -> Autoregression:
    """Return the autoregression if samples are missing: two orders are compared where both have a past."""
    k = rows.shape[1]
    best, joined = _solved(_means_of_whole(rows, usable, parts, 0)[0], 0, False), False
    for joint in (False, True) if k > 1 else (False,):
        for order in orders:
            means, count = _means_of_whole(rows, usable, parts, max(order, best.order))
            if count < order * _SAMPLES * (k if joint else 1):
                break
            found, rival = _solved(means, order, joint), _solved(means, best.order, joined)
            if _criterion(found, joint, count) < _criterion(rival, joined, count) and _is_stable(found):
                best, joined = found, joint
    return best


def _has_gaps(usable: NDArray[np.bool_], parts: Sequence[slice]) -> bool:
    """Tell whether samples are missing between others of their recording, so often that it counts."""
    runs = [np.count_nonzero(np.diff(usable[part].astype(np.int8), prepend=0) > 0) for part in parts]
    gaps = sum(max(int(count) - 1, 0) for count in runs)
    return gaps > 1 and gaps * _TO_EACH_GAP > int(np.count_nonzero(usable))


def _means_of_whole(
    rows: NDArray[np.float64], usable: NDArray[np.bool_], parts: Sequence[slice], order: int
) -> tuple[NDArray[np.float64], int]:
    """Return the means of ``q_{t-i}^T q_{t-j}`` over the samples whose past is available, and their number."""
    k = rows.shape[1]
    total, count = np.zeros(((order + 1) * k, (order + 1) * k)), 0
    for part in parts:
        whole = usable[part].copy()
        for lag in range(1, order + 1):
            whole[lag:] &= usable[part][:-lag]
            whole[:lag] = False
        at = np.flatnonzero(whole)
        for first in range(0, len(at), _PIECE):
            some = at[first : first + _PIECE]
            lagged = np.concatenate([rows[part][some - lag] for lag in range(order + 1)], axis=1)
            total += lagged.T @ lagged
        count += len(at)
    return (total / max(count, 1)).reshape(order + 1, k, order + 1, k).transpose(0, 2, 1, 3), count


def _criterion(model: Autoregression, joint: bool, n: int) -> float:
    """Return Akaike's criterion, corrected for few samples."""
    k = len(model.covariance)
    count = model.order * k * (k if joint else 1)
    return n * _log_determinant(model.covariance) + 2 * count * n / max(n - count / k - k - 1, 1)


def whiteness(e: NDArray[np.float64], seen: NDArray[np.bool_], parts: Sequence[slice], *, most: int = LAGS) -> float:
    r"""Return the probability that white noise shows correlations in time as large as these.

    Where the samples are few for that, of each residual with itself alone. ``most`` is the largest lag.

    .. math:: Q = n^2 \sum_{l=1}^{L} \frac{1}{n_l} \mathrm{tr}(C_l^T C_0^{-1} C_l C_0^{-1}) \sim \chi^2(k^2 L)

    with :math:`n_l` pairs of samples :math:`l` apart, :math:`n - l` where none is missing.

    References
    ----------
    Hosking (1980), Journal of the American Statistical Association 75, 602-608.
    """
    from scipy.special import chdtrc

    n, k = int(seen.sum()), e.shape[1]
    lags = min(most, max(n // 4, 1))
    products = _products(np.where(seen[:, None], e, 0.0), parts, lags) / max(n, 1)
    pairs = _products(seen[:, None].astype(float), parts, lags)[1:, 0, 0]
    there = pairs > 0
    later, pairs, lags = products[1:][there], pairs[there], int(there.sum())
    if 2 * k * k * lags > n:  # too few for all cross-correlations
        own = np.diagonal(later, axis1=1, axis2=2)
        shares = (own / np.maximum(np.diagonal(products[0]), np.finfo(float).tiny)) ** 2
        return float(chdtrc(k * lags, n**2 * np.sum(shares / pairs[:, None])))
    inverse = np.linalg.pinv(products[0])
    terms = [float(np.trace(C.T @ inverse @ C @ inverse)) / count for C, count in zip(later, pairs, strict=True)]
    return float(chdtrc(k * k * lags, n**2 * sum(terms)))


def _products(rows: NDArray[np.float64], parts: Sequence[slice], lags: int) -> NDArray[np.float64]:
    """Return the sums of ``q_{t-l}^T q_t`` for the lags from zero."""
    k = rows.shape[1]
    out = np.zeros((lags + 1, k, k))
    for part in parts:
        here = rows[part]
        for lag in range(min(lags, len(here) - 1) + 1):
            out[lag] += here[: len(here) - lag].T @ here[lag:]
    return out


def _solved(means: NDArray[np.float64], order: int, joint: bool) -> Autoregression:
    """Return the autoregression by the means of ``q_{t-i}^T q_{t-j}``, shape (lags, lags, k, k)."""
    k, lags = means.shape[2], order + 1
    A = np.zeros((order, k, k))
    if joint:
        left = means[1:lags, 1:lags].transpose(0, 2, 1, 3).reshape(order * k, order * k)
        A = np.linalg.lstsq(left, means[1:lags, 0].reshape(order * k, k), rcond=RANK)[0].reshape(order, k, k)
    elif order:
        for j in range(k):
            A[:, j, j] = np.linalg.lstsq(means[1:lags, 1:lags, j, j], means[1:lags, 0, j, j], rcond=RANK)[0]
    terms = [np.eye(k), *(-A)]
    covariance = np.zeros((k, k))
    for i, a in enumerate(terms):
        for j, b in enumerate(terms):
            covariance += a.T @ means[i, j] @ b
    return Autoregression(np.asarray(A, dtype=float), (covariance + covariance.T) / 2)


def _is_stable(model: Autoregression) -> bool:
    """Tell whether the autoregression is stable."""
    order, k = model.coefficients.shape[:2]
    A = np.eye(order * k, k=-k)
    A[:k] = np.hstack([M.T for M in model.coefficients])
    return bool(np.abs(np.linalg.eigvals(A)).max() < 1)


def _between(products: NDArray[np.float64], i: int, j: int) -> NDArray[np.float64]:
    """Return the mean of ``q_{t-i}^T q_{t-j}``."""
    return products[i - j] if i >= j else products[j - i].T


def _log_determinant(covariance: NDArray[np.float64]) -> float:
    """Return the log determinant of a covariance in units of samples; exactly predictable combinations count alike."""
    values = np.linalg.eigvalsh(covariance)
    return float(np.log(np.maximum(values, VARIANCE_FLOOR)).sum())


__all__ = ["LAGS", "Autoregression", "Past", "autoregression", "unforetold", "whiteness"]
