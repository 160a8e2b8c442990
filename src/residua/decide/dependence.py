"""Number of independent samples that a stretch of data is worth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

#: Lags are summed up to so many times the correlation time that they give.
CUT = 5.0
#: Longest lag that is looked at, as a share of the longest stretch.
_LONGEST = 0.25


def correlation_times(columns: NDArray[np.float64], parts: Sequence[slice], power: int = 1) -> NDArray[np.float64]:
    r"""Return for each column its integrated correlation time in samples, at least 1.

    .. math:: \tau = 1 + 2 \sum_{l=1}^{L} \hat\varrho(l)^{power}, \qquad L \ge 5 \tau(L)

    The mean of ``n`` samples has the variance of ``n / tau`` independent ones; with ``power`` 2 so has the covariance
    of Gaussian samples.

    Parameters
    ----------
    columns : ndarray, shape (time, k)
        Zero where nothing is known.
    parts : sequence of slice
        Stretches that follow upon each other without a gap; no lag reaches from one into another.
    power : {1, 2}

    References
    ----------
    Sokal (1997), Monte Carlo methods in statistical mechanics, section 3 (the window); Bartlett (1946) for covariances.
    """
    longest = max((part.stop - part.start for part in parts), default=0)
    lags = max(1, int(_LONGEST * longest))
    total = np.zeros((lags + 1, columns.shape[1]))
    pairs = np.zeros(lags + 1)
    for part in parts:
        rows = columns[part]
        centred = rows - rows.mean(axis=0) if len(parts) == 1 else rows
        count = min(lags, len(rows) - 1) + 1
        total[:count] += _products(centred, count)
        pairs[:count] += len(rows) - np.arange(count)
    size = np.where(total[0] > 0, total[0], 1.0)
    rho = total / size * (pairs[0] / np.maximum(pairs, 1))[:, None]
    tau = 1 + 2 * np.cumsum(np.clip(rho[1:], -1, 1) ** power, axis=0)
    enough = np.arange(1, lags + 1)[:, None] >= CUT * np.maximum(tau, 1.0)
    cut = np.where(enough.any(axis=0), enough.argmax(axis=0), lags - 1)
    return np.maximum(tau[cut, np.arange(columns.shape[1])], 1.0)


def mean_autocorrelation(
    columns: NDArray[np.float64], known: NDArray[np.bool_], parts: Sequence[slice], lags: int
) -> NDArray[np.float64]:
    """Return the autocorrelation at lags from 0 to ``lags``, the mean over all columns that move, with gaps left out.

    Parameters
    ----------
    columns : ndarray, shape (time, k)
        Of mean zero; zero where not known.
    known : ndarray of bool, shape (time,)
    parts : sequence of slice
        As of :func:`correlation_times`.
    lags : int
    """
    total, pairs = np.zeros((lags + 1, columns.shape[1])), np.zeros((lags + 1, 1))
    for part in parts:
        count = min(lags, part.stop - part.start - 1) + 1
        total[:count] += _products(columns[part], count)
        pairs[:count] += np.rint(_products(known[part, None].astype(float), count))
    moving = total[0] > 0
    if not moving.any():
        return np.eye(1, lags + 1)[0]
    covariance = total[:, moving] / np.maximum(pairs, 1.0)
    return np.clip(covariance / covariance[0], -1.0, 1.0).mean(axis=1)


def _products(rows: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """Return the sums of products of samples 0, 1, 2, ... apart. apart, by column."""
    length = 1 << int(2 * len(rows) - 1).bit_length()
    out = np.empty((count, rows.shape[1]))
    for j in range(rows.shape[1]):  # one by one: memory
        spectrum = np.fft.rfft(rows[:, j], length)
        out[:, j] = np.fft.irfft(spectrum.real**2 + spectrum.imag**2, length)[:count]
    return out


def effective_exceedances(counts: NDArray[np.float64]) -> float:
    r"""Return the number of independent exceedances in ``B`` blocks, from the number in each block.

    The relative variance of their sum is :math:`\frac{\sum c_i^2}{(\sum c_i)^2} - \frac{1}{B}`, and the inverse of the
    first term is what counts: the number of blocks with exceedances, where all have as many.
    """
    total = float(counts.sum())
    return total**2 / float(np.sum(counts**2)) if total > 0 else 0.0


__all__ = ["correlation_times", "effective_exceedances"]
