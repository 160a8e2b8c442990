"""Statistics of the channels of recordings: size, drift, resolution, and linear dependence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.errors import DataError
from residua.identify.outlying_values import outlying_values
from residua.identify.segments import BLOCK, Gathered
from residua.linear.systems.scaling import power_near
from residua.recording.levels import units_between
from residua.tolerances import DATA_ROUNDING, RANK
from residua.visible import listed
from residua.words import counted

#: A straight line over a recording that explains more than this part of a channel's variance is a drift.
_DRIFT = 0.5
#: Fewer different values than this in a block of rows: a channel in steps.
_FEW_VALUES = 12
#: A part of a linear dependence that is named, relative to the largest.
_SHARE = 0.05
#: Share of the rows in which a command holds its value, at least.
_HELD = 0.5
#: Deviations below which a channel follows exactly, and rows that this is looked at on.
_EXACT, _ROWS = 1e-6, 5_000


@dataclass(frozen=True, eq=False)
class ChannelFacts:
    """The channels of recordings in numbers: inputs, then outputs.

    Attributes
    ----------
    channels : tuple of str
    n_inputs : int
    mean, deviation : ndarray, shape (channels,)
        Over all rows.
    covariance : ndarray, shape (channels, channels)
    recording_mean, recording_deviation : ndarray, shape (recordings, channels)
        Of each recording by itself; NaN for one of which no row is left.
    drift : ndarray, shape (channels,)
        The part of the variance within the recordings that a straight line over each explains.
    values : ndarray of int, shape (channels,)
        Different values in the largest block of rows that was counted; and ``rows``, its length.
    rows : int
    """

    channels: tuple[str, ...]
    n_inputs: int
    mean: NDArray[np.float64]
    deviation: NDArray[np.float64]
    covariance: NDArray[np.float64]
    recording_mean: NDArray[np.float64]
    recording_deviation: NDArray[np.float64]
    drift: NDArray[np.float64]
    values: NDArray[np.int_]
    rows: int

    @property
    def units(self) -> NDArray[np.float64]:
        """A power of two near the standard deviation of each channel, by which it is divided."""
        return power_near(self.deviation)

    @property
    def _still(self) -> NDArray[np.bool_]:
        return np.asarray(self.deviation <= DATA_ROUNDING * np.abs(self.mean))

    def constant(self) -> tuple[str, ...]:
        """Return the channels that never move, beyond the rounding of their values."""
        return tuple(name for name, one in zip(self.channels, self._still, strict=True) if one)

    def dependent(self) -> tuple[tuple[str, ...], ...]:
        """Return the groups of channels of which one is a linear function of the others at every sample.

        Those that never move are left out: see :meth:`constant`.
        """
        moving = np.flatnonzero(~self._still)
        if not len(moving):
            return ()
        size = self.deviation[moving]
        values, vectors = np.linalg.eigh(self.covariance[np.ix_(moving, moving)] / np.outer(size, size))
        # the covariance is known to the square root of what the data are
        basis = vectors[:, values <= max(RANK, np.finfo(float).eps * len(values)) * values[-1]]
        groups = []
        while basis.shape[1]:  # the vector of fewest channels first: eliminate as in row echelon form
            pivot = int(np.abs(basis).max(axis=1).argmax())
            chosen = int(np.abs(basis[pivot]).argmax())
            vector = basis[:, chosen] / basis[pivot, chosen]
            basis = np.delete(basis - np.outer(vector, basis[pivot]), chosen, axis=1)
            named = np.flatnonzero(np.abs(vector) > _SHARE * np.abs(vector).max())
            groups.append(tuple(self.channels[i] for i in moving[named]))
        return tuple(groups)

    def check_size(self) -> None:
        """Raise where values are so large that nothing can be computed from their squares."""
        vast = [name for name, one in zip(self.channels, self.deviation, strict=True) if not np.isfinite(one)]
        if vast:
            raise DataError(f"{listed(vast)}: values so large that their squares overflow; mark missing values as NaN")

    def check(self, *, dependent: bool = True) -> None:
        """Raise where channels are constant, or, if asked, linear functions of others, which no model tells apart.

        All that is wrong is said at once.
        """
        self.check_size()
        if self.rows < 2:  # nothing can move in one row
            raise DataError(
                f"{counted(self.rows, 'complete row')} of {counted(len(self.channels), 'channel')}: too few to learn "
                "anything from; give a longer recording"
            )
        still, same, wrong = self.constant(), "; ".join(map(self._dependence, self.dependent())), []
        if still:
            left = [name for name in self.channels if name not in still]
            wrong.append(
                f"{listed(still)} never {'moves' if len(still) == 1 else 'move'}: a constant channel carries no "
                f"information; leave {'it' if len(still) == 1 else 'them'} out "
                f"(there are {listed(left) if left else 'no others'})"
            )
        if same and (dependent or still):
            wrong.append(f"{same}: no model can tell their parts apart; leave one of each group out")
        if wrong:
            raise DataError(". Besides, ".join(wrong))

    def repeated_outputs(self) -> tuple[str, ...]:
        """Return a note where outputs say the same as other channels, for methods that do not refuse them."""
        outputs = set(self.channels[self.n_inputs :])
        same = "; ".join(self._dependence(group) for group in self.dependent() if outputs & set(group))
        if not same:
            return ()
        return (f"{same}: one of them is no measurement of its own, and a residual of them is zero; leave one out",)

    def _dependence(self, group: Sequence[str]) -> str:
        if len(group) != 2:
            return f"{listed(group)} are linear functions of one another at every sample"
        kinds = {name in self.channels[: self.n_inputs] for name in group}
        if len(kinds) == 2:
            return f"the output {group[1]!r} is the input {group[0]!r}, times a number"
        return f"{group[0]!r} and {group[1]!r} are the same signal, times a number"

    def notes(self, gathered: Gathered, *, drifts: bool = True) -> tuple[str, ...]:
        """Return notes on the channels: outliers, standstills, drifts, few values, other units.

        Outliers and standstills are those of ``gathered``, which may have more rows than the facts are from.
        """
        found = list(outlying_values(gathered))
        for i, name in enumerate(self.channels):
            if drifts and self.drift[i] > _DRIFT:
                found.append(
                    f"{name!r} drifts: a straight line explains {100 * self.drift[i]:.0f} % of its variance within a "
                    "recording; a model of it is one of this drift"
                )
            if self.values[i] < _FEW_VALUES:
                found.append(f"{name!r} takes only {self.values[i]} different values in {self.rows} rows")
        return (*found, *units_between(self.channels, gathered.sources, self.recording_mean, self.recording_deviation))


@np.errstate(over="ignore", invalid="ignore")  # values that overflow are refused by their name
def channel_facts(gathered: Gathered) -> ChannelFacts:
    """Return the facts of the channels, read block by block."""
    n, recordings = len(gathered.channels), len(gathered.sources)
    first = gathered.segments[0].rows(0, 1)[0]
    count, total = np.zeros(recordings), np.zeros((recordings, n))
    for segment, _, block in gathered.blocks():
        count[segment.recording] += len(block)
        total[segment.recording] += (block - first).sum(axis=0)
    seen = count > 0
    own_mean = first + total / np.maximum(count, 1.0)[:, None]
    mean = first + total.sum(axis=0) / count.sum()
    outer, within = np.zeros((n, n)), np.zeros((recordings, n))
    slope, spread_of_time = np.zeros((recordings, n)), np.zeros(recordings)
    middle = np.zeros(recordings)  # of the row numbers
    for one in gathered.segments:
        middle[one.recording] += len(one) * (one.start + one.stop - 1) / 2 / count[one.recording]
    for segment, start, block in gathered.blocks():
        k, centred = segment.recording, block - mean
        outer += centred.T @ centred
        own = centred - (own_mean[k] - mean)
        within[k] += np.einsum("ij,ij->j", own, own)
        times = segment.start + start + np.arange(len(own)) - middle[k]
        slope[k] += times @ own
        spread_of_time[k] += times @ times
    explained = (slope**2 / np.maximum(spread_of_time, 1.0)[:, None])[seen].sum(axis=0)
    within_all = within[seen].sum(axis=0)
    longest, rows = [], 0
    for one in sorted(gathered.segments, key=len, reverse=True):
        longest.append(one.rows(0, min(len(one), BLOCK - rows)))
        rows += len(longest[-1])
        if rows >= BLOCK:
            break
    return ChannelFacts(
        gathered.channels,
        len(gathered.inputs),
        mean,
        np.sqrt(np.diag(outer) / count.sum()),
        outer / count.sum(),
        np.where(seen[:, None], own_mean, np.nan),
        np.where(seen[:, None], np.sqrt(within / np.maximum(count, 1.0)[:, None]), np.nan),
        explained / np.where(within_all > 0, within_all, 1.0),
        np.array([len(np.unique(column)) for column in np.vstack(longest).T]),
        rows,
    )


def guessed_inputs(recordings: Sequence[NDArray[np.float64]], channels: Sequence[str]) -> tuple[str, ...]:
    """Return the channels that look like commands: they change, and hold their value in most rows.

    None where all channels do so, as of sensors with a coarse resolution.

    Parameters
    ----------
    recordings : sequence of ndarray, shape (time, channels)
    channels : sequence of str

    Examples
    --------
    >>> import numpy as np
    >>> valve, level = np.repeat([0.0, 1.0], 50), np.random.default_rng(0).standard_normal(100)
    >>> guessed_inputs([np.column_stack([level, valve])], ["level", "valve"])
    ('valve',)
    """
    steps = np.vstack([np.diff(one, axis=0) for one in recordings])
    known = np.isfinite(steps)
    held = (known & (steps == 0)).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    found = tuple(name for name, share in zip(channels, held.tolist(), strict=True) if _HELD <= share < 1)
    return () if len(found) == len(channels) else found


def exact_channels(recordings: Sequence[NDArray[np.float64]], channels: Sequence[str]) -> tuple[str, ...]:
    """Return the channels that follow from the others, and from the row before, without any noise.

    Commands of a controller do so from what it measures, and so does what it measures from its commands.

    Parameters
    ----------
    recordings : sequence of ndarray, shape (time, channels)
    channels : sequence of str

    Examples
    --------
    >>> import numpy as np
    >>> level = np.random.default_rng(0).standard_normal((100, 2))
    >>> valve = -2 * level[:, [0]]
    >>> exact_channels([np.hstack([valve, level])], ["valve", "level", "flow"])
    ('valve', 'level')
    """
    rows = np.vstack([np.hstack([one[1:], one[:-1]]) for one in recordings])
    rows = rows[np.isfinite(rows).all(axis=1)][:_ROWS]
    spread = rows.std(axis=0) if len(rows) else np.zeros(2 * len(channels))
    rows = (rows - rows.mean(axis=0)) / np.where(spread > 0, spread, 1.0) if len(rows) else rows
    found = []
    for i, name in enumerate(channels):
        if not spread[i] > 0 or len(rows) <= rows.shape[1]:
            continue
        others = np.delete(rows, i, axis=1)
        error = rows[:, i] - others @ np.linalg.lstsq(others, rows[:, i], rcond=None)[0]
        if float(np.sqrt(np.mean(error**2))) < _EXACT:
            found.append(name)
    return tuple(found)
