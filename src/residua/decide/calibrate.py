"""Thresholds by simulation: worlds of the fitted residual model, each refitted, and an allowance from held-out data.

A fit knows the residual only as well as its rows show it. So the model that was fitted is simulated many times with as
many rows, fitted anew to each, and run over new rows of the same world: errors of means, covariances and memory need no
formula. What the model does not hold, such as noise that becomes larger and smaller, shows where each quarter of the
data is judged by a fit to the others.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from residua.decide.normal_scores import raw_values
from residua.decide.test import FaultFreeRun
from residua.linear.subspaces.whitening import VARIANCE_FLOOR
from residua.tolerances import TINY
from residua.words import number, one_in

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
#: The rarest rate that is read off the worlds: beyond, their levels are extended by a Pareto tail, of a shape at most.
_READ, _MOST_SHAPE = 1e-3, 0.3
#: Alarms of all worlds that show how long one lasts, and rounds in which a time between alarms finds its rate.
_ALARMS, _ROUNDS = 30, 8
#: Alarms of each world by which its rate is told from that of others.
_MANY = 10
#: How sure a promise is, and the multiple of the rate from which on it is stated.
_SURE_OF, _DEVIATIONS, TOLERATED = 0.95, 1.645, 1.5
#: Where that allows for more, the threshold is set for less, down to this share of the rate.
_LEAST_AIM = 0.6
#: Independent rows to each residual below which nothing is promised.
LEAST_ROWS = 10.0
#: Stretches of the data that are judged by the others.
_FOLDS = 4


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
    knots, scores : ndarray
        Where heavy tails are made Gaussian: values of each innovation, and their normal scores; else none.
    """

    coefficients: NDArray[np.float64]
    rewhitening: NDArray[np.float64]
    covariance: NDArray[np.float64]
    columns: tuple[slice, ...]
    radii: tuple[NDArray[np.float64] | None, ...]
    rows: int
    knots: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    scores: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))


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


@dataclass(frozen=True, eq=False)
class RawWorlds:
    """Simulated worlds in the units of the model, less the mean of a fit to each.

    Attributes
    ----------
    q : ndarray, shape (worlds, rows + time, k)
        Rows of a fit, and new ones.
    rows : int
        Of each fit.
    coefficients, fitted : ndarray, shapes (p, k, k) and (worlds, p, k, k)
        Autoregression of the worlds, and of a fit to each.
    shrink : float
        Part of their own errors that fits to as many rows as the data have make.
    """

    q: NDArray[np.float64]
    rows: int
    coefficients: NDArray[np.float64]
    fitted: NDArray[np.float64]
    shrink: float


def raw_worlds(model: ResidualModel, *, settling: int = SETTLING, seed: int = 0) -> RawWorlds:
    """Simulate the model, and refit mean and memory of each world.

    Of more than a thousand rows the errors are those of a thousand, reduced by the root of their number.
    """
    rows = min(model.rows, _MOST_ROWS)
    new = _NEW_ROWS + settling - SETTLING
    shrink = float(np.sqrt(rows / model.rows))
    A = model.coefficients
    if len(A):
        A = _as_long_as_it_may_be(A, _refit(_simulated(model, A, rows, new, seed)[:, :rows], model), shrink)
    q = _simulated(model, A, rows, new, seed)
    q = q - shrink * q[:, :rows].mean(axis=1, keepdims=True)
    own = A + shrink * (_refit(q[:, :rows], model) - A) if len(A) else np.zeros((len(q), *A.shape))
    return RawWorlds(q, rows, A, own, shrink)


def simulated_worlds(model: ResidualModel, *, settling: int = SETTLING, seed: int = 0) -> Worlds:
    """Simulate the model, refit each world, and return its whitened innovations, of the fit and of new rows."""
    raw = raw_worlds(model, settling=settling, seed=seed)
    q, rows, order, shrink = raw.q, raw.rows, len(raw.coefficients), raw.shrink
    if order:
        e = q.copy()
        for lag in range(1, order + 1):
            e[:, lag:] -= q[:, :-lag] @ raw.fitted[:, lag - 1]
        q = e @ model.rewhitening
    fitted = q[:, order:rows]
    whole = np.swapaxes(fitted, 1, 2) @ fitted / fitted.shape[1]
    mean = whole.mean(axis=0)
    k, live = len(model.covariance), np.diag(model.covariance) > 0
    whitening = np.tile(np.eye(k), (len(whole), 1, 1))
    for part in model.columns:  # what a fit predicts exactly stays in its own units
        own = np.arange(k)[part][live[part]]
        block = mean[np.ix_(own, own)] + shrink * (whole[:, own[:, None], own] - mean[np.ix_(own, own)])
        whitening[:, own[:, None], own] = inverse_root(block)
    return Worlds(fitted @ whitening, q[:, rows:] @ whitening, shrink)


def inverse_root(covariances: NDArray[np.float64]) -> NDArray[np.float64]:
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


def persistent_levels(statistic: NDArray[np.float64], persistence: int, release: int) -> NDArray[np.float64]:
    r"""Return for every sample the level :math:`a_t` with: the alarm is on if and only if the threshold is below it.

    With :math:`m_t` the smallest of the last ``persistence`` values of the statistic, and :math:`M_t` the largest of
    the last ``release``, an alarm of threshold :math:`h` is raised where :math:`m_t > h` and ends where :math:`M_t \le
    h`. So

    .. math:: a_t = \min(\max(a_{t-1}, m_t), M_t)

    and the fraction of samples in alarm is, for all thresholds at once, the fraction of levels above it. Before
    ``persistence`` samples the level is minus infinity.

    Parameters
    ----------
    statistic : ndarray, shape (time,) or (series, time)
        Of usable samples only: others change nothing, see :func:`residua.decide.persistence.alarm_logic`.
    persistence, release : int
    """
    from scipy.ndimage import maximum_filter1d, minimum_filter1d  # slow to import, and needed only here

    time = statistic.shape[-1]
    if not time or persistence == release == 1:
        return statistic.copy()
    low = minimum_filter1d(statistic, persistence, axis=-1, origin=(persistence - 1) // 2, mode="nearest")
    high = maximum_filter1d(statistic, release, axis=-1, origin=(release - 1) // 2, mode="nearest")
    low[..., : persistence - 1] = -np.inf
    if release > 1:  # fewer samples than that end no alarm
        high[..., : release - 1] = np.inf
    if statistic.ndim > 1:
        rows, level = np.ascontiguousarray(low.T), np.full(len(low), -np.inf)
        for t, highest in enumerate(np.ascontiguousarray(high.T)):
            level = rows[t] = np.minimum(np.maximum(level, rows[t]), highest)
        return rows.T
    # limits of the composition of the last 1, 2, 4, ... samples: a map that clamps, after one that clamps, clamps
    reach = 1
    while reach < time:
        later_low, later_high = low[reach:], high[reach:]
        low_now = np.minimum(np.maximum(low[:-reach], later_low), later_high)
        high_now = np.minimum(np.maximum(high[:-reach], later_low), later_high)
        low[reach:], high[reach:] = low_now, high_now
        reach *= 2
    return low


@dataclass(frozen=True)
class Calibration:
    """Threshold of a test by simulated worlds.

    Attributes
    ----------
    threshold : float
    rate : float
        Fraction of fault-free samples in alarm that is expected.
    promised : float
        The fraction that is not exceeded on other data, with 95 % confidence; 1 if the rows are too few to say.
    time : float
        Samples between false alarms, on average.
    rows : int
        Of the fit.
    excess : float
        The factor by which held-out data are above what worlds explain.
    """

    threshold: float
    rate: float
    promised: float
    time: float
    rows: int
    excess: float

    def __str__(self) -> str:
        text = f"{one_in(self.rate)} samples in alarm, simulated for a fit to {self.rows} fault-free samples"
        if self.promised >= 1:
            text += "; this log is too short to confirm a rate: use a longer one"
        elif self.promised > TOLERATED * self.rate:
            text += f", with 95 % confidence at most {one_in(self.promised)} on other data like these"
        if self.excess > 1:
            text += f"; raised by {number(100 * (self.excess - 1), 2)} % for effects that the noise model does not have"
        return text


def calibrated(
    levels: NDArray[np.float64],
    held_out: NDArray[np.float64],
    rate: float,
    rows: int,
    *,
    worth: float = np.inf,
    time: float | None = None,
) -> Calibration:
    """Return the threshold for a rate, or for a time between alarms.

    Where fits to so few rows differ by more than 1.5 times the rate it is set for less, down to 0.6 of it; if that does
    not suffice, the promise says so.

    Parameters
    ----------
    levels : ndarray, shape (worlds, time)
        Thresholds below which each sample of new rows of a world is in alarm, by a fit to that world.
    held_out : ndarray, shape (time,)
        Levels of each stretch of the data by a fit to the others; none where they are too few.
    rate : float
    rows : int
        Of the fit.
    worth : float
        Independent rows to each residual.
    time : float, optional
        Samples between false alarms, instead of a rate.
    """
    ordered = np.sort(levels, axis=None)
    if time is not None:
        rate = _rate_for(time, levels)
        if allowance(held_out, levels, rate, rows)[1] > 1:  # their alarms may last shorter or longer, too
            rate = _rate_for(time, held_out[None])
    surely = 1.0 if worth < LEAST_ROWS else _promised(levels, ordered, rate)
    _, excess, shown = allowance(held_out, levels, rate, rows)
    if excess > 1:  # then the rate is known no better than the alarms of the data show it
        surely = min(1.0, surely * (1 + _DEVIATIONS / shown**0.5))
    aimed = rate * max(_LEAST_AIM, min(1.0, TOLERATED * rate / surely))
    excess = allowance(held_out, levels, aimed, rows)[1]
    promised = surely * aimed / rate if shown and surely < 1 else 1.0
    if time is None:
        time = _mean_length(levels, ordered, aimed) * (1 - aimed) / aimed
    return Calibration(max(_level(ordered, aimed) * excess, TINY), aimed, promised, time, rows, excess)


def _rate_for(time: float, levels: NDArray[np.float64]) -> float:
    """Return the rate that goes with a time between alarms: each is as long as these levels say."""
    ordered, lasting, rate = np.sort(levels, axis=None), 1.0, 1.0
    for _ in range(_ROUNDS):
        rate = lasting / (time + lasting)
        lasting = _mean_length(levels, ordered, rate)
    return rate


def _level(ordered: NDArray[np.float64], rate: float) -> float:
    """Return the level exceeded at a rate, by a generalised Pareto tail where that is rarer than worlds show."""
    n = len(ordered)
    read = max(rate, min(_READ, 1.0))
    start = float(ordered[min(int(np.ceil((1 - read) * n)), n - 1)])
    if rate >= _READ or not np.isfinite(start):
        return start
    excesses = ordered[n - int(read * n) :] - start
    mean, variance = float(excesses.mean()), float(excesses.var())
    if not mean > 0 or not np.isfinite(mean):
        return start
    shape = float(np.clip(0.5 * (1 - mean**2 / variance), 0.0, _MOST_SHAPE)) if variance > 0 else 0.0
    scale, rarer = mean * (1 - shape), read / rate
    return start + scale * ((rarer**shape - 1) / shape if shape else float(np.log(rarer)))


def _mean_length(levels: NDArray[np.float64], ordered: NDArray[np.float64], rate: float) -> float:
    """Return the mean length of an alarm at a rate, or at the rarest that shows enough alarms."""
    while True:
        over = levels > _level(ordered, rate)
        raised = int(np.count_nonzero(over[:, 1:] & ~over[:, :-1]))
        if raised >= _ALARMS or rate > _RATES[0]:
            return float(over.sum()) / max(raised, 1)
        rate *= 2


def _promised(levels: NDArray[np.float64], ordered: NDArray[np.float64], rate: float) -> float:
    """Return the 95 % point of the rates of worlds, as a gamma distribution.

    Both halves of the new rows of a world have its rate, and nothing else in common: their covariance, and its standard
    error, are its variance. It is read at a rate at which worlds have enough alarms; deviations of a threshold count
    for more where these are rarer, by the logarithm of the rate.
    """
    from scipy.special import gammaincinv  # slow to import, and needed only here

    read = rate
    while True:
        over = levels > _level(ordered, read)
        if np.count_nonzero(over[:, 1:] & ~over[:, :-1]) >= _MANY * len(levels) or read > _RATES[0]:
            break
        read *= 2
    half = over.shape[1] // 2
    first, second = over[:, :half].mean(axis=1), over[:, half:].mean(axis=1)
    mean = max(float(over.mean()), TINY)
    products = (first - first.mean()) * (second - second.mean())
    variance = float(products.mean() + products.std() / len(products) ** 0.5) / mean**2
    variance *= float(np.log(rate) / np.log(min(read, 0.5))) ** 2
    if not variance > 0:
        return rate
    return min(1.0, rate * max(1.0, float(gammaincinv(1 / variance, _SURE_OF)) * variance))


def held_out(run: FaultFreeRun) -> Iterator[tuple[FaultFreeRun, FaultFreeRun]]:
    """Yield each quarter of the usable samples: a run without it, and one of it alone."""
    count = np.cumsum(run.usable)
    edges = np.searchsorted(count, np.arange(_FOLDS + 1) * count[-1] / _FOLDS)
    for start, stop in pairwise([0, *edges[1:-1].tolist(), len(count)]):
        others = run.usable.copy()
        others[start:stop] = False
        yield replace(run, usable=others), replace(run, usable=run.usable & ~others)


def allowance(
    levels: NDArray[np.float64], worlds: NDArray[np.float64], rate: float, rows: int
) -> tuple[float, float, int]:
    """Return factors for thresholds that cover few rows, and effects outside of the noise model.

    The second is the factor by which levels of the data lie above those of worlds, at a rate: 1 where chance explains
    it. The third is the number of alarms at the rarest rate that was compared; 0 if none could be.

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
    passes, shown = False, 0
    if not len(levels):
        return few, 1.0, 0
    own = worlds[:, : min(len(levels), worlds.shape[1])]
    shares = 1 - np.array(_RATES)
    of_data, of_worlds = np.quantile(levels, shares), np.quantile(worlds, shares)
    surely = np.quantile(np.quantile(own, shares, axis=1), _SURE, axis=1)
    for one, level, expected, most in zip(_RATES, of_data, of_worlds, surely, strict=True):
        raised = int(np.count_nonzero((levels[1:] > level) & (levels[:-1] <= level)))
        if raised < _SHOWN or not expected > 0:  # or residuals that mostly stand still
            break
        shown = raised
        passes |= bool(level > most)
        found.append((one, float(level / expected)))
        if one <= rate:
            break
    if not passes:
        return few, 1.0, shown
    (first, least), (last, most) = found[0], found[-1]
    growth = min(max((most - least) / np.log10(first / last), 0.0), _GROWTH) if first > last else 0.0
    return few, max(1.0, most) + growth * max(0.0, float(np.log10(last / rate))), shown


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


def _simulated(model: ResidualModel, A: NDArray[np.float64], rows: int, new: int, seed: int) -> NDArray[np.float64]:
    """Return whitened residuals of all worlds, for the rows of a fit and for new rows."""
    k, order = len(model.covariance), len(A)
    live = np.flatnonzero(np.diag(model.covariance) > 0)  # directions without noise take no random numbers
    worlds = max(_LEAST_WORLDS, min(_WORLDS, _NUMBERS // max(len(live), 1)))
    values, vectors = np.linalg.eigh(model.covariance[np.ix_(live, live)])
    root = vectors * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
    e: NDArray[np.float64] = np.random.default_rng(seed).standard_normal((worlds, SETTLING + rows + new, len(live)))
    e = e if np.array_equal(root, np.eye(len(live))) else e @ root
    if len(live) < k:
        drawn, e = e, np.zeros((*e.shape[:2], k))
        e[..., live] = drawn
    for part, radii in zip(model.columns, model.radii, strict=True):
        if radii is not None:
            e[..., part] = _with_tails(e[..., part], radii)
    if model.scores.size:
        e = raw_values(e, model.knots, model.scores)
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


__all__ = [
    "LEAST_ROWS",
    "SETTLING",
    "Calibration",
    "RawWorlds",
    "ResidualModel",
    "Worlds",
    "allowance",
    "calibrated",
    "held_out",
    "inverse_root",
    "levels_of",
    "persistent_levels",
    "raw_worlds",
    "simulated_worlds",
]
