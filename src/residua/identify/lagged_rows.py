"""Rows of a recording with the rows before them beside each other, in standard units, as one triangular factor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.errors import DataError
from residua.identify.channel_facts import ChannelFacts, channel_facts
from residua.identify.hankel_factor import HankelFactor, count_windows, hankel_factor
from residua.identify.segments import Gathered
from residua.progress import Progress
from residua.visible import listed
from residua.words import counted

#: Rows for each column from which on a covariance counts as known; with fewer, the evidence says so.
KNOWN = 10


@dataclass(frozen=True, eq=False)
class Standard:
    """Mean and standard deviation of each channel, in its own units: inputs, then outputs.

    Attributes
    ----------
    facts : ChannelFacts
    mean, spread : ndarray, shape (channels,)
    """

    facts: ChannelFacts
    mean: NDArray[np.float64]
    spread: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LaggedRows:
    """The rows ``[z_k, z_{k-1}, ..., z_{k-lags}]`` of all segments, as far as each reaches back, less their mean.

    Attributes
    ----------
    factor : ndarray, shape (d, d)
        ``F`` with ``F' F = (Z - mean)' (Z - mean)``: column ``lag * channels + channel``.
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
        If a channel never changes, or has values whose squares overflow.
    """
    facts, count = channel_facts(gathered), gathered.n_samples
    facts.check_size()
    facts.check_rows()
    still = facts.constant()
    if still:
        them = "it" if len(still) == 1 else "them"
        same = facts.dependences()  # said too, for methods that refuse it afterwards
        raise DataError(
            f"{listed(still)} never {'changes' if len(still) == 1 else 'change'} in {counted(count, 'row')}: "
            f"a constant channel carries no information; leave {them} out{same and f'. Besides, {same}'}"
        )
    return Standard(facts, facts.mean, facts.deviation * np.sqrt(count / (count - 1)))


def lagged_rows(gathered: Gathered, units: Standard, lags: int) -> LaggedRows:
    """Return the lagged rows of a recording in standard units, factored block by block.

    Raises
    ------
    DataError
        If there are no more rows than columns.
    """
    hankel = enough_windows(gathered, units, lags)
    return lagged_of(hankel, units, hankel.windows)


def enough_windows(gathered: Gathered, units: Standard, lags: int, progress: Progress | None = None) -> HankelFactor:
    """Return the factor of the Hankel matrix of a recording, if it has more windows than columns.

    Raises
    ------
    DataError
        If there are no more rows than columns.
    """
    q = len(gathered.channels)
    d, count = q * (lags + 1), count_windows(gathered, lags + 1)
    if count <= d + 1:
        longest = max(len(segment) for segment in gathered.segments)
        raise DataError(
            f"{counted(gathered.n_samples, 'complete row')} in {counted(len(gathered.segments), 'segment')}, the "
            f"longest of {longest}, make {counted(count, 'row')} of {d} columns ({q} channels, {lags} lags), but more "
            f"than {d + 1} are needed: give a longer recording, fewer lags, or fewer channels"
        )
    return hankel_factor(gathered, lags + 1, units.facts, progress=progress)


def lagged_of(hankel: HankelFactor, units: Standard, count: int) -> LaggedRows:
    """Return the lagged rows of a Hankel matrix in standard units."""
    lags = hankel.length - 1
    latest_first = hankel.signals(range(lags, -1, -1))
    scale = np.tile(hankel.units / units.spread, lags + 1)
    # without the row of the column of ones, which holds the means of the others
    return LaggedRows(hankel.R[1:, latest_first] * scale, count, hankel.n_channels, lags)


def channels_in(combinations: NDArray[np.float64], channels: Sequence[str], rtol: float) -> list[str]:
    """Return the channels that combinations of lagged rows are made of, beyond the rounding of a tolerance.

    Parameters
    ----------
    combinations : ndarray, shape (lags * channels, any)
        Of length 1 each.
    channels : sequence of str
    rtol : float
        Of the singular values by which the combinations were chosen.
    """
    weight = np.abs(combinations).max(axis=1).reshape(-1, len(channels)).max(axis=0)
    return [name for name, one in zip(channels, weight, strict=True) if one > np.sqrt(rtol)]


def few_rows(count: int, columns: int) -> tuple[str, ...]:
    """Return a note where the rows are few for the covariance of so many columns."""
    if count >= KNOWN * columns:
        return ()
    return (
        f"{counted(count, 'row')} for {columns} columns: the covariance is known badly, and the thresholds of a "
        f"monitor have to come from other rows than these ({KNOWN * columns} would do)",
    )


def with_signs(directions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return directions, one a column, with their largest entries positive."""
    largest = directions[np.abs(directions).argmax(axis=0), np.arange(directions.shape[1])]
    return directions * np.where(largest < 0, -1.0, 1.0)
