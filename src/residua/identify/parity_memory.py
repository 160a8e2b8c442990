"""What relations from data remember of the recordings before: a triangular factor, discounted as new rows come."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.arrays import runs
from residua.decide.alarm import Alarm
from residua.errors import DataError, SettingError
from residua.identify.channel_facts import ChannelFacts
from residua.identify.hankel_factor import HankelFactor, count_windows, discounted_factor
from residua.identify.lagged_rows import LaggedRows, Standard, lagged_of
from residua.identify.segments import Gathered
from residua.tolerances import DATA_ROUNDING
from residua.visible import echo, listed
from residua.words import counted

Matrix = NDArray[np.float64]
#: The alarms of one recording: for each row whether one stands, or the alarms of a diagnosis.
Alarms = ArrayLike | Sequence[Alarm] | None


@dataclass(frozen=True, eq=False)
class Weights:
    """The sum of weights, and of their squares: with all of them one, the number of what is weighted."""

    total: float
    squares: float

    @property
    def effective(self) -> float:
        """As many equal weights would know a mean as well."""
        return self.total**2 / self.squares

    def and_new(self, count: int, forgetting: float) -> Weights:
        """Return the weights after so many new ones, the last of which is one."""
        new = forgetting ** np.arange(count)
        old = forgetting**count
        return Weights(old * self.total + float(new.sum()), old**2 * self.squares + float((new**2).sum()))


@dataclass(frozen=True, eq=False)
class ParityMemory:
    r"""The factor of all windows so far, each with the weight that forgetting leaves it, and the channels' moments.

    .. math:: R^T R = \sum_k \lambda^{K - k} h_k h_k^T

    Attributes
    ----------
    hankel : HankelFactor
        ``R``, with the units and the reference of the first recordings.
    windows, rows : Weights
    mean, scatter : ndarray, shape (channels,)
        Weighted mean of each channel, and the sum of weighted squares about it.
    inputs, outputs : tuple of str
    dt : float
    poles : tuple of complex or None
        Of the residuals.
    """

    hankel: HankelFactor
    windows: Weights
    rows: Weights
    mean: Matrix
    scatter: Matrix
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    dt: float
    poles: tuple[complex, ...] | None

    @classmethod
    def of(
        cls, hankel: HankelFactor, gathered: Gathered, units: Standard, poles: Sequence[complex] | None
    ) -> ParityMemory:
        """Return what is remembered of the first recordings."""
        count, rows = float(hankel.windows), float(gathered.n_samples)
        return cls(
            replace(hankel, parts=()),
            Weights(count, count),
            Weights(rows, rows),
            units.mean,
            units.facts.deviation**2 * rows,
            gathered.inputs,
            gathered.outputs,
            gathered.dt,
            None if poles is None else tuple(complex(one) for one in np.atleast_1d(np.asarray(poles, dtype=complex))),
        )

    def standard(self, facts: ChannelFacts) -> Standard:
        """Return mean and standard deviation of each channel over all that is remembered.

        Raises
        ------
        DataError
            If a channel no longer changes.
        """
        known = self.rows.effective
        spread = np.sqrt(self.scatter / self.rows.total * known / (known - 1))
        channels = self.inputs + self.outputs
        still = [
            name
            for name, one, mean in zip(channels, spread, self.mean, strict=True)
            if one <= DATA_ROUNDING * abs(mean)
        ]
        if still:
            raise DataError(
                f"{listed(still)} no longer {'changes' if len(still) == 1 else 'change'} in what is remembered: take a "
                "forgetting nearer to 1, or a recording in which they move"
            )
        return Standard(facts, self.mean, spread)

    def lagged(self, units: Standard) -> LaggedRows:
        """Return the lagged rows, as many of them as the weights are worth."""
        known = self.windows.effective
        made = lagged_of(self.hankel, units, round(known))
        return replace(made, factor=made.factor * np.sqrt(known / self.windows.total))

    def updated(self, gathered: Gathered, forgetting: float) -> ParityMemory:
        """Return the memory after new rows: each window takes ``forgetting`` of the weight of those before it.

        Raises
        ------
        DataError
            If what is remembered is worth fewer windows than the relations have columns.
        """
        length = self.hankel.length
        new = count_windows(gathered, length)
        windows = self.windows.and_new(new, forgetting)
        columns = length * self.hankel.n_channels
        if windows.effective <= columns + 1:
            raise DataError(
                f"with forgetting={forgetting:g} {counted(round(windows.effective), 'window')} are remembered, and "
                f"relations over {length} rows of {self.hankel.n_channels} channels need more than {columns + 1}: take "
                f"at least {1 - 2 / (columns + 3):.6g}, or {1 - 2 / (10 * columns):.6g} to know them well"
            )
        hankel = discounted_factor(self.hankel, gathered, forgetting)
        mean, scatter, rows = self.mean, self.scatter, self.rows
        for _, block in gathered.blocks():
            count = len(block)
            weights = forgetting ** np.arange(count - 1, -1, -1)
            share = weights / weights.sum()
            there = mean + share @ (block - mean)
            left = forgetting**count
            after = rows.and_new(count, forgetting)
            apart = (there - mean) ** 2 * (left * rows.total) * weights.sum() / after.total
            scatter = left * scatter + weights @ (block - there) ** 2 + apart
            mean = mean + (there - mean) * (weights.sum() / after.total)
            rows = after
        return replace(self, hankel=hankel, windows=windows, rows=rows, mean=mean, scatter=scatter)


def checked_forgetting(value: object) -> float:
    """Return the weight that a window keeps with each one after it, or say what is wrong with it."""
    if isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating)) or not 0 < value <= 1:
        raise SettingError(f"forgetting must be above 0 and at most 1 (nothing is forgotten), got {echo(value)}")
    return float(value)


def without_alarms(gathered: Gathered, alarms: Alarms | Sequence[Alarms]) -> tuple[Gathered, int]:
    """Return recordings cut where an alarm stands, as where a value is missing, and how many rows that leaves out.

    Parameters
    ----------
    gathered : Gathered
    alarms : array_like of bool, sequence of Alarm, or a sequence of these
        One for each recording where there are several.

    Raises
    ------
    SettingError
        If there is not one for each recording, or not a value for each row.
    """
    if alarms is None:
        return gathered, 0
    several = len(gathered.samples) > 1
    each: list[Any] = list(alarms) if several and isinstance(alarms, Iterable) else [alarms]
    if len(each) != len(gathered.samples):
        raise SettingError(
            f"alarms must have one entry for each of {counted(len(gathered.samples), 'recording')}, got {len(each)}"
        )
    standing = [_rows_of(one, rows, gathered.dt) for one, rows in zip(each, gathered.samples, strict=True)]
    segments = []
    for segment in gathered.segments:
        quiet = ~standing[segment.recording][segment.start : segment.stop]
        segments += [segment.cut(start, stop) for start, stop in runs(quiet).tolist()]
    kept = gathered.with_segments(segments)
    return kept, gathered.n_samples - kept.n_samples


def _rows_of(alarms: Alarms, rows: int, dt: float) -> NDArray[np.bool_]:
    """Return for each row of a recording whether an alarm stands, from when its cause may have begun."""
    if alarms is None:
        return np.zeros(rows, dtype=bool)
    if isinstance(alarms, Sequence):
        known = [one for one in alarms if isinstance(one, Alarm)]
        if len(known) == len(alarms):
            out = np.zeros(rows, dtype=bool)
            for one in known:
                out[_first_row(one, dt) : one.stop] = True
            return out
    out = np.asarray(alarms)
    if out.dtype != bool or out.shape != (rows,):
        raise SettingError(
            f"alarms must be {rows} booleans, one for each row of the recording, or the alarms of a diagnosis; got "
            f"values of type {out.dtype} in the shape {out.shape}"
        )
    return out


def _first_row(alarm: Alarm, dt: float) -> int:
    """Return the earliest row at which the cause of an alarm may have begun; the first one where that is not known."""
    if alarm.began is None:
        since = alarm.onset
    elif alarm.began.earliest is None:
        return 0
    else:
        since = min(alarm.began.earliest, alarm.onset)
    return max(alarm.start - int(np.ceil((alarm.raised - since) / dt)), 0)
