"""Rows of a recording with the rows before them beside each other, in standard units, as one triangular factor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.errors import DataError
from residua.identify.segments import Gathered
from residua.tolerances import DATA_ROUNDING
from residua.visible import listed
from residua.words import counted

#: Rows that are factored at a time.
_ROWS = 4096
#: Rows for each column from which on a covariance counts as known; with fewer, the evidence says so.
KNOWN = 10


@dataclass(frozen=True, eq=False)
class Standard:
    """Mean and standard deviation of each channel, in its own units: inputs, then outputs.

    Attributes
    ----------
    mean, spread : ndarray, shape (channels,)
    """

    mean: NDArray[np.float64]
    spread: NDArray[np.float64]

    def units(self, rows: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return rows less their mean, in standard deviations."""
        return (rows - self.mean) / self.spread


@dataclass(frozen=True, eq=False)
class LaggedRows:
    """The rows ``[z_k, z_{k-1}, ..., z_{k-lags}]`` of all segments, as far as each reaches back, less their mean.

    Attributes
    ----------
    factor : ndarray, shape (d, d)
        Upper triangular ``R``, ``R' R = (Z - mean)' (Z - mean)``: column ``lag * channels + channel``.
    count : int
        Rows of ``Z``.
    channels, lags : int
    """

    factor: NDArray[np.float64]
    count: int
    channels: int
    lags: int

    def columns(self, lags: range, channels: range | None = None) -> list[int]:
        """Return the columns of some lags and channels, the latest sample first."""
        chosen = range(self.channels) if channels is None else channels
        return [lag * self.channels + channel for lag in lags for channel in chosen]

    def rearranged(self, columns: list[int]) -> NDArray[np.float64]:
        """Return the triangular factor of these columns in this order."""
        return np.asarray(np.linalg.qr(self.factor[:, columns], mode="r"))


def standard(gathered: Gathered) -> Standard:
    """Return mean and standard deviation of each channel over all complete rows.

    Raises
    ------
    DataError
        If a channel never changes.
    """
    count = gathered.n_samples
    largest = np.zeros(len(gathered.channels))
    for _, rows in gathered.blocks():
        largest = np.maximum(largest, np.abs(rows).max(axis=0))
    size = np.exp2(np.floor(np.log2(np.where(largest > 0, largest, 1.0))))  # squares of what is scaled do not overflow
    total, squares = np.zeros(len(size)), np.zeros(len(size))
    for _, rows in gathered.blocks():
        total += (rows / size).sum(axis=0)
    mean = total / count
    for _, rows in gathered.blocks():
        squares += ((rows / size - mean) ** 2).sum(axis=0)
    spread = np.sqrt(squares / max(1, count - 1))
    still = [name for name, one in zip(gathered.channels, spread <= DATA_ROUNDING, strict=True) if one]
    if still:
        raise DataError(
            f"{listed(still)} never {'changes' if len(still) == 1 else 'change'} in {counted(count, 'row')}: "
            "a constant channel shows nothing of what is normal; leave it out"
        )
    return Standard(mean * size, spread * size)


def lagged_rows(gathered: Gathered, units: Standard, lags: int) -> LaggedRows:
    """Return the lagged rows of a recording in standard units, factored block by block.

    Raises
    ------
    DataError
        If there are no more rows than columns.
    """
    q = len(gathered.channels)
    d = q * (lags + 1)
    count = sum(max(0, len(segment) - lags) for segment in gathered.segments)
    if count <= d + 1:
        longest = max(len(segment) for segment in gathered.segments)
        raise DataError(
            f"{counted(gathered.n_samples, 'complete row')} in {counted(len(gathered.segments), 'segment')}, the "
            f"longest of {longest}, make {counted(count, 'row')} of {d} columns ({q} channels, {lags} lags), but more "
            f"than {d + 1} are needed: give a longer recording, fewer lags, or fewer channels"
        )
    factor = np.zeros((0, 1 + d))  # a column of ones first, which takes the mean of every column out of the others
    for segment in gathered.segments:
        for start in range(lags, len(segment), _ROWS):
            stop = min(start + _ROWS, len(segment))
            rows = units.units(segment.rows(start - lags, stop))
            beside = [rows[lags - lag : len(rows) - lag] for lag in range(lags + 1)]
            block = np.vstack([factor, np.hstack([np.ones((stop - start, 1)), *beside])])
            factor = np.asarray(np.linalg.qr(block, mode="r"))
    return LaggedRows(factor[1:, 1:], count, q, lags)


def few_rows(count: int, columns: int) -> tuple[str, ...]:
    """Return a note where the rows are few for the covariance of so many columns."""
    if count >= KNOWN * columns:
        return ()
    return (
        f"{counted(count, 'row')} for {columns} columns: the covariance is known badly, and the thresholds of a "
        f"monitor have to come from other rows than these ({KNOWN * columns} would do)",
    )
