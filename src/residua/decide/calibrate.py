"""Thresholds by simulation: worlds of the fitted residual model, each refitted, and an allowance from held-out data.

A fit knows the residual only as well as its rows show it. So the model that was fitted is simulated many times with as
many rows, fitted anew to each, and run over new rows of the same world: errors of means, covariances and memory need no
formula. What the model does not hold, such as noise that becomes larger and smaller, shows where each quarter of the
data is judged by a fit to the others.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.linear.subspaces.whitening import VARIANCE_FLOOR

#: Worlds, fewer of many residuals, and at least; rows that each is fitted to at most, new rows of each, and samples
#: that it takes to settle.
_WORLDS, _NUMBERS, _LEAST_WORLDS = 200, 2000, 40
_MOST_ROWS, _NEW_ROWS, SETTLING = 1000, 3000, 200
#: Share of the samples by which a heavy tail is known, and samples at least.
_TAIL, _LEAST_IN_TAIL = 0.02, 20
#: Rates at which data are compared with worlds, alarms that show one, and worlds that a difference has to pass.
_RATES, _SHOWN, _SURE = [0.1 / 2**k for k in range(11)], 6, 0.95
#: Growth of the allowance over each decade of rarer alarms, at most.
_GROWTH = 0.3
#: Standard errors by which memory is taken longer than it seems, and what is added to a threshold for what so few rows
#: do not show of their model, in units of one by the root of their number: chosen on 20 fits a kind of 1,000 rows.
_LONGER, _UNSEEN = 2.0, 2.0
#: Poles of a corrected autoregression, at most.
_MOST_POLE = 0.9995


@dataclass(frozen=True, eq=False)
class ResidualModel:
    """Residual model fitted to fault-free data, in whitened units.

    Attributes
    ----------
    coefficients : ndarray, shape (p, k, k)
        Of the autoregression, as of :class:`residua.decide.autoregression.Autoregression`.
    rewhitening : ndarray, shape (k, k)
        Whitening of its innovations.
    covariance : ndarray, shape (k, k)
        Of the innovations, whitened: the identity but where parts share residuals or a direction does not move.
    columns : tuple of slice
        The parts, each of which has a whitening of its own.
    radii : tuple of ndarray or None
        Of each part with heavy tails the lengths of its innovations, sorted.
    rows : int
        Of the fit.
    """

    coefficients: NDArray[np.float64]
    rewhitening: NDArray[np.float64]
    covariance: NDArray[np.float64]
    columns: tuple[slice, ...]
    radii: tuple[NDArray[np.float64] | None, ...]
    rows: int

    @property
    def is_plain(self) -> bool:
        """True if innovations are independent and Gaussian, so that worlds depend on the number of rows alone."""
        return (
            not self.coefficients.size
            and all(one is None for one in self.radii)
            and bool(np.array_equal(np.round(self.covariance, 1), np.eye(len(self.covariance))))
        )


@dataclass(frozen=True, eq=False)
class Worlds:
    """Simulated worlds, each whitened by a fit to its own rows.

    Attributes
    ----------
    fitted : ndarray, shape (worlds, rows, k)
        White residuals of the rows of each fit.
    new : ndarray, shape (worlds, time, k)
        Of new rows of the same world.
    shrink : float
        Part of their own errors that fits to as many rows as the data have make.
    """

    fitted: NDArray[np.float64]
    new: NDArray[np.float64]
    shrink: float


def simulated_worlds(model: ResidualModel, *, seed: int = 0) -> Worlds:
    """Simulate the model, refit each world, and return its whitened rows and new rows of the same world.

    Mean, memory and covariance are fitted anew. Of more than a thousand rows the errors are those of a thousand,
    reduced by the root of their number.
    """
    rows = min(model.rows, _MOST_ROWS)
    shrink = float(np.sqrt(rows / model.rows))
    A = model.coefficients
    if len(A):
        A = _as_long_as_it_may_be(A, _refit(_simulated(model, A, rows, seed)[:, :rows], model), shrink)
    q = _simulated(model, A, rows, seed)
    q = q - shrink * q[:, :rows].mean(axis=1, keepdims=True)
    if len(A):
        own = A + shrink * (_refit(q[:, :rows], model) - A)
        e = q.copy()
        for lag in range(1, len(A) + 1):
            e[:, lag:] -= q[:, :-lag] @ own[:, lag - 1]
        q = e @ model.rewhitening
    fitted = q[:, len(A) : rows]
    whole = np.swapaxes(fitted, 1, 2) @ fitted / fitted.shape[1]
    mean = whole.mean(axis=0)
    whitening = np.zeros_like(whole)
    for part in model.columns:
        block = mean[part, part] + shrink * (whole[:, part, part] - mean[part, part])
        whitening[:, part, part] = _inverse_root(block)
    return Worlds(fitted @ whitening, q[:, rows:] @ whitening, shrink)


def _inverse_root(covariances: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the symmetric inverse root of covariances; directions without variance are left as they are."""
    values, vectors = np.linalg.eigh(covariances)
    values = np.where(values > VARIANCE_FLOOR, values, 1.0)
    return vectors / np.sqrt(values)[..., None, :] @ np.swapaxes(vectors, -1, -2)


def levels_of(statistic: NDArray[np.float64], falls_to: float) -> NDArray[np.float64]:
    r"""Return for every sample of series in rows the threshold below which it is in alarm.

    .. math:: a_t = \max(s_t, \min(a_{t-1}, s_t / \gamma))

    where an alarm ends with the statistic :math:`s` at or below :math:`\gamma` times the threshold.
    """
    rows = np.maximum(statistic.T, 0.0)
    out, level = np.empty_like(rows), np.zeros(rows.shape[1])
    for t, value in enumerate(rows):
        level = np.maximum(value, np.minimum(level, value / falls_to))
        out[t] = level
    return out.T


def allowance(levels: NDArray[np.float64], worlds: NDArray[np.float64], rate: float, rows: int) -> tuple[float, float]:
    """Return the factor for thresholds that covers few rows and effects outside of the noise model.

    The second is the factor by which levels of the data lie above those of worlds, at a rate: 1 where chance explains
    it.

    Levels of the data are those that each stretch of time has by a fit to the others. They are compared at rates that
    the data show, by six alarms at least; the factor goes on growing towards rarer alarms as it grew, by at most 0.3 a
    decade.

    Parameters
    ----------
    levels : ndarray, shape (time,)
    worlds : ndarray, shape (worlds, time)
    rate : float
    rows : int
        Of the fit.
    """
    few = 1 + _UNSEEN / rows**0.5
    found: list[tuple[float, float]] = []
    passes = False
    own = worlds[:, : min(len(levels), worlds.shape[1])]
    for one in _RATES:
        level = float(np.quantile(levels, 1 - one))
        if np.count_nonzero((levels[1:] > level) & (levels[:-1] <= level)) < _SHOWN:
            break
        expected = float(np.quantile(worlds, 1 - one))
        if not expected > 0:  # residuals that mostly stand still
            break
        passes |= level > np.quantile(np.quantile(own, 1 - one, axis=1), _SURE)
        found.append((one, level / expected))
        if one <= rate:
            break
    if not passes:
        return few, 1.0
    (first, least), (last, most) = found[0], found[-1]
    growth = min(max((most - least) / np.log10(first / last), 0.0), _GROWTH) if first > last else 0.0
    return few, max(1.0, most) + growth * max(0.0, float(np.log10(last / rate)))


def _as_long_as_it_may_be(A: NDArray[np.float64], found: NDArray[np.float64], shrink: float) -> NDArray[np.float64]:
    """Return the autoregression of the worlds: corrected for the bias of few rows, and two standard errors longer.

    ``found`` are fits to worlds with the memory ``A``. The longer the memory, the more wrong is a mean.
    """
    whole, kept = np.trace(A.sum(axis=0)), np.trace(found.sum(axis=1), axis1=1, axis2=2)
    longer = 1 + _LONGER * shrink * kept.std() / abs(whole) if whole > 0 else 1.0
    for wanted in (longer * (2 * A - found.mean(axis=0)), 2 * A - found.mean(axis=0), A):
        if _largest_pole(wanted) < _MOST_POLE:
            return wanted
    return A


def _simulated(model: ResidualModel, A: NDArray[np.float64], rows: int, seed: int) -> NDArray[np.float64]:
    """Return whitened residuals of all worlds, for the rows of a fit and for new rows."""
    k, order = len(model.covariance), len(A)
    worlds = max(_LEAST_WORLDS, min(_WORLDS, _NUMBERS // k))
    values, vectors = np.linalg.eigh(model.covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
    e = np.random.default_rng(seed).standard_normal((worlds, SETTLING + rows + _NEW_ROWS, k))
    e = e if np.array_equal(root, np.eye(k)) else e @ root
    for part, radii in zip(model.columns, model.radii, strict=True):
        if radii is not None:
            e[..., part] = _with_tails(e[..., part], radii)
    if not order:
        return e[:, SETTLING:]
    innovations, oldest_first = e @ np.linalg.inv(model.rewhitening), A[::-1].reshape(order * k, k)
    q = np.zeros((worlds, order + e.shape[1], k))
    for t in range(e.shape[1]):
        q[:, order + t] = innovations[:, t] + q[:, t : order + t].reshape(worlds, -1) @ oldest_first
    return q[:, order + SETTLING :]


def _with_tails(e: NDArray[np.float64], radii: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return Gaussian samples given the lengths of the data, with a power-law tail beyond them (Hill)."""
    from scipy.special import chdtrc  # slow to import, and needed only here

    n, k = len(radii), e.shape[-1]
    count = max(int(_TAIL * n), _LEAST_IN_TAIL)
    length = np.sqrt(np.sum(e**2, axis=-1))
    rarity = np.maximum(chdtrc(k, length**2), np.finfo(float).tiny)
    start = max(float(radii[-count - 1]), np.finfo(float).tiny)
    power = float(np.mean(np.log(np.maximum(radii[-count:], start) / start)))
    body = np.interp(1 - rarity, (np.arange(n) + 0.5) / n, radii)
    wanted = np.where(rarity < count / n, start * (rarity * n / count) ** -power, body)
    return e * (wanted / np.maximum(length, np.finfo(float).tiny))[..., None]


def _refit(q: NDArray[np.float64], model: ResidualModel) -> NDArray[np.float64]:
    """Return the Yule-Walker autoregression of each world, shape (worlds, p, k, k)."""
    A = model.coefficients
    order, k, time = len(A), len(model.covariance), q.shape[1]
    out = np.zeros((len(q), order, k, k))
    products = np.array([np.swapaxes(q[:, : time - lag], 1, 2) @ q[:, lag:] / time for lag in range(order + 1)])
    for part in model.columns:
        mine = A[:, part, part]
        used = int(np.flatnonzero(mine.any(axis=(1, 2)))[-1]) + 1 if mine.any() else 0
        size, C = mine.shape[1], products[: used + 1, :, part, part]
        is_joint = any(np.count_nonzero(one - np.diag(np.diag(one))) for one in mine)
        for own in [np.arange(size)] if is_joint else [np.array([j]) for j in range(size)]:
            if used and mine[:, own[:, None], own].any():
                solved = _yule_walker(C[:, :, own[:, None], own])
                rows = np.arange(k)[part][own]
                out[:, :used, rows[:, None], rows] = solved
    return out


def _yule_walker(C: NDArray[np.float64]) -> NDArray[np.float64]:
    """Solve for the autoregression by the autocovariances at lags 0 to p, shape (p + 1, worlds, k, k)."""
    order, worlds, k = len(C) - 1, C.shape[1], C.shape[2]
    left = np.empty((worlds, order * k, order * k))
    for i in range(order):
        for j in range(order):
            block = C[i - j] if i >= j else np.swapaxes(C[j - i], 1, 2)
            left[:, i * k : (i + 1) * k, j * k : (j + 1) * k] = block
    right = np.moveaxis(C[1:], 0, 1).reshape(worlds, order * k, k)
    ridge = VARIANCE_FLOOR * np.eye(order * k)
    return np.asarray(np.linalg.solve(left + ridge, right), dtype=float).reshape(worlds, order, k, k)


def _largest_pole(A: NDArray[np.float64]) -> float:
    """Return the size of the largest pole of an autoregression."""
    order, k = A.shape[:2]
    state = np.eye(order * k, k=-k)
    state[:k] = np.hstack([one.T for one in A])
    return float(np.abs(np.linalg.eigvals(state)).max())


__all__ = ["ResidualModel", "Worlds", "allowance", "levels_of", "simulated_worlds"]
