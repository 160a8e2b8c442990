"""Interval for the time at which a signal begins to change, from the likelihood over times and shapes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.tolerances import DATA_ROUNDING

#: 95 % quantile of the likelihood ratio of a jump's time, ``(1 - exp(-x / 2))**2 = 0.95`` (Yao 1987); that of the
#: corner that a ramp begins with is chi-squared with one degree of freedom, 3.84, and smaller.
JUMP_QUANTILE = -2.0 * float(np.log(1.0 - np.sqrt(0.95)))
#: Confidence that is stated; simulated steps and ramps keep it to 0.90 at least.
CONFIDENCE = 0.95
#: A change that raises twice the logarithm of the likelihood by less is not dated; one that raises it by more than
#: the second number is dated without further samples: later ones depend more and more on the shape.
LEAST_EVIDENCE, ENOUGH_EVIDENCE = 30.0, 60.0
#: Samples before a change that are needed to know the noise, and the most that are looked at together.
LEAST_BEFORE, MOST_TOGETHER = 40, 1024
#: Largest order of the noise model.
_MOST_LAGS = 8


@dataclass(frozen=True)
class ChangeTime:
    """Time at which a change began, in samples.

    Attributes
    ----------
    earliest : int or None
        First sample that the change may have reached; ``None`` if the data do not reach back far enough to tell.
    estimate : int
        The most likely one.
    latest : int
    """

    earliest: int | None
    estimate: int
    latest: int


def change_time(signal: NDArray[np.float64], quiet: int, last: int) -> ChangeTime | None:
    r"""Return the interval of stated confidence (0.95) in which a signal left its baseline upwards.

    .. math:: s_t = \beta + a\, g(t - \tau) + e_t, \qquad a > 0,

    where the noise ``e`` is an autoregression that is fitted, and ``g`` is a jump, a rise that ends after 2, 4, 8 ...
    samples, a ramp, or the square of time. The interval has all times ``tau`` whose largest likelihood over shape,
    size and baseline comes within ``JUMP_QUANTILE`` of the largest of all (twice the logarithm). Only so many samples
    after the alarm are used that the change is beyond doubt: whatever a change looks like later, it begins like one of
    these, and the response of a filter does not matter. If the rest after the change still is more than the
    noise before it, no shape fits, and the interval grows by as much.

    Parameters
    ----------
    signal : ndarray, shape (time,)
        Up to the end of the alarm.
    quiet : int
        Samples at the start that come before the first one over the threshold; the noise is fitted to them at first.
    last : int
        The last sample at which the change can have begun.

    Returns
    -------
    ChangeTime or None
        ``None`` if there is too little before the change, or too little of it, to tell.

    References
    ----------
    Yao, Y.-C. (1987), Approximating the distribution of the maximum likelihood estimate of the change-point in a
    sequence of independent random variables, Annals of Statistics 15, 1321-1328.
    """
    width = 1
    while True:  # in bins of more and more samples until the interval ends before the data do
        start = max(0, quiet - width * MOST_TOGETHER) // width * width
        part = signal[start:]
        part = part[: len(part) // width * width].reshape(-1, width).mean(axis=1)
        change = _with_enough(part, (quiet - start) // width, min((last - start) // width, len(part) - 1))
        if start == 0 or (change is not None and change.earliest is not None):
            break
        width *= 4
    if change is None:
        return None
    first = None if change.earliest is None else start + change.earliest * width
    latest = min(start + change.latest * width + width - 1, last)
    return ChangeTime(first, min(start + change.estimate * width, latest), latest)


def _with_enough(signal: NDArray[np.float64], quiet: int, last: int) -> ChangeTime | None:
    """Return the change from as few further samples as make it certain."""
    if quiet < LEAST_BEFORE or last >= len(signal):
        return None
    level = np.median(signal[:quiet])
    if np.abs(signal[:quiet] - level).max() <= DATA_ROUNDING * np.abs(signal - level).max():
        moved = np.flatnonzero(np.abs(signal - level) > DATA_ROUNDING * np.abs(signal - level).max())
        if not len(moved):  # it never moves at all
            return None
        first = min(int(moved[0]), last)
        return ChangeTime(first, first, first)
    more = 1
    while True:
        moment, evidence = _dated(signal[: last + 1 + more], quiet, last)
        if evidence >= ENOUGH_EVIDENCE or last + 1 + more >= len(signal) or more > MOST_TOGETHER:
            return moment
        more = 2 * more + 1


def _dated(signal: NDArray[np.float64], quiet: int, last: int) -> tuple[ChangeTime | None, float]:
    """Return the change and its evidence, twice the log likelihood ratio; the noise model is fitted to the rest."""
    shapes, remainder = _shapes(len(signal)), signal[:quiet] - signal[:quiet].mean()
    profile, lags, begin = np.zeros(len(signal)), np.zeros(0), 0
    for _ in range(3):
        lags = _autoregression(remainder)
        profile, fit = _profile(signal, lags, shapes, last)
        previous, begin = begin, int(np.argmax(profile))
        if begin < LEAST_BEFORE or not profile[begin] > 0:
            return None, 0.0
        remainder = signal - fit
        if np.abs(remainder).max() <= DATA_ROUNDING * np.abs(signal - signal.mean()).max():  # no noise
            return ChangeTime(begin, begin, begin), np.inf
        if begin == previous:
            break
    p = len(lags)
    innovations = np.convolve(remainder, np.concatenate([[1.0], -lags]))[p : len(remainder)]
    before, after = innovations[: begin - p], innovations[begin - p :]
    variance = float(np.sum(before**2)) / max(len(before) - p - 1, 1)
    if variance <= 0:
        return None, 0.0
    noise = variance * max(1.0, float(np.mean(after**2)) / variance if len(after) > 2 else 1.0)
    if profile[begin] < LEAST_EVIDENCE * noise:
        return None, float(profile[begin] / noise)
    likely = np.flatnonzero(profile >= profile[begin] - JUMP_QUANTILE * noise)
    earliest = int(likely[0])
    moment = ChangeTime(None if earliest < LEAST_BEFORE else earliest, begin, int(likely[-1]))
    return moment, float(profile[begin] / noise)


def _shapes(n: int) -> NDArray[np.float64]:
    """Return the shapes of a change, in rows: a jump, rises that end, a ramp, and the square of time."""
    time = np.arange(1, n + 1, dtype=float)
    rises = [np.minimum(time / 2**k, 1.0) for k in range(1, (n - 1).bit_length())]
    return np.array([np.ones(n), *rises, time, time**2])


def _autoregression(noise: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the coefficients of an autoregression by least squares, of the order that Akaike's criterion chooses."""
    n = len(noise)
    most = min(_MOST_LAGS, n // 20)
    target = noise[most:]
    rows = np.column_stack([*(noise[most - k : n - k] for k in range(1, most + 1)), target])
    R = _triangular_factor(rows)  # of every order at once: its first rows and columns
    independent = np.abs(np.diag(R)[:most]) > DATA_ROUNDING * np.linalg.norm(R[:, :most], axis=0)
    orders = np.arange((most if independent.all() else int(np.argmin(independent))) + 1)
    unexplained = np.cumsum(R[::-1, most] ** 2)[::-1][orders]
    exact = np.flatnonzero(unexplained <= 0)
    if len(exact):
        order = int(exact[0])
    else:
        order = int(np.argmin(len(target) * np.log(unexplained) + 2 * orders))
    chosen: NDArray[np.float64] = np.asarray(np.linalg.solve(R[:order, :order], R[:order, most]), dtype=float)
    if len(chosen) == 1:  # least squares underrates a slow noise (Kendall's correction)
        first = float(chosen[0])
        chosen = np.array([min(first + (1 + 3 * first) / n, max(0.99, first))])
    return chosen


def _triangular_factor(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return R of QR, from the Gram matrix where that keeps seven digits, which is much faster."""
    squares = rows.T @ rows
    try:
        R = np.asarray(np.linalg.cholesky(squares).T, dtype=float)
        if (np.diag(R) ** 2 > DATA_ROUNDING * np.diag(squares)).all():
            return R
    except np.linalg.LinAlgError:
        pass
    return np.asarray(np.linalg.qr(rows, mode="r"), dtype=float)


def _profile(
    signal: NDArray[np.float64], lags: NDArray[np.float64], shapes: NDArray[np.float64], last: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the share of the innovations' squares that a change at each time explains, and the best fit of all."""
    n, p = len(signal), len(lags)
    whiten = np.concatenate([[1.0], -lags])
    z = np.convolve(signal, whiten)[p:n]
    z = z - z.mean()
    m = n - p
    along = _along_shapes(np.convolve(z, whiten[::-1])[p:], len(shapes))
    g = shapes[:, :m].copy()
    for k, lag in enumerate(lags, 1):
        g[:, k:] -= lag * shapes[:, : m - k]
    energy = (np.cumsum(g**2, axis=1) - np.cumsum(g, axis=1) ** 2 / m)[:, ::-1]  # less the fit of a baseline
    usable = (along > 0) & (energy > DATA_ROUNDING * energy.max(axis=1, keepdims=True))
    usable[:, last + 1 - p :] = False
    gain = np.where(usable, along**2 / np.where(usable, energy, 1.0), 0.0)
    profile = np.full(n, -np.inf)
    profile[p : last + 1] = gain[:, : last + 1 - p].max(axis=0)
    shape, k = np.unravel_index(int(np.argmax(gain)), gain.shape)
    at_best = np.zeros(n)
    if gain[shape, k] > 0:
        at_best[p + k :] = along[shape, k] / energy[shape, k] * shapes[shape, : m - k]
    return profile, at_best + float(np.mean(signal - at_best))


def _along_shapes(z: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """Return the sums of a signal times each shape, from each sample on, as repeated sums."""

    def later(sums: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.cumsum(sums[::-1])[::-1]

    jump = later(z)
    ramp = later(jump)
    out = np.empty((count, len(z)))
    out[0] = jump
    for j, rise in enumerate(2 ** np.arange(1, count - 2), 1):
        out[j] = ramp
        out[j, : max(len(z) - rise, 0)] -= ramp[rise:]
        out[j] /= rise
    out[-2:] = ramp, 2 * later(ramp) - ramp
    return out
