"""Statistics of the channels of recordings: size, drift, resolution, linear dependence, outliers and standstills."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from residua.errors import DataError
from residua.identify.segments import BLOCK, Gathered
from residua.linear.systems.scaling import power_near
from residua.recording.levels import units_between
from residua.tolerances import DATA_ROUNDING, RANK
from residua.visible import listed
from residua.words import counted, number, some

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
#: A value is far outside the rest at more than so many units: the middle half, or the usual step, of its channel.
_FAR = 20.0
#: Values far outside are outliers where they are no more than this part of the rows, and carry most of the variance.
_FEW, _MOST = 1 / 200, 0.5
#: Rows that the usual values are taken from.
_SAMPLE = 100_000
#: A sensor stands still in a run of equal values of so many rows and this part of them, ...
_LEAST_RUN, _LEAST_SHARE = 30, 0.05
#: ... so many times as long as nearly all other runs of its channel, ...
_LONGER, _NEARLY_ALL = 20.0, 0.99
#: ... and if no more than this part of the rows elsewhere repeat the value before: else it moves in steps anyway.
_REPEATS = 0.5
#: Runs are counted by powers of two of their length, up to this one.
_LENGTHS = 48


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
    means = first + total / np.maximum(count, 1.0)[:, None]
    mean = first + total.sum(axis=0) / count.sum()
    outer, within = np.zeros((n, n)), np.zeros((recordings, n))
    slope, spread_of_time = np.zeros((recordings, n)), np.zeros(recordings)
    middle = np.zeros(recordings)  # of the row numbers
    for one in gathered.segments:
        middle[one.recording] += len(one) * (one.start + one.stop - 1) / 2 / count[one.recording]
    for segment, start, block in gathered.blocks():
        k, centred = segment.recording, block - mean
        outer += centred.T @ centred
        within_recording = centred - (means[k] - mean)
        within[k] += np.einsum("ij,ij->j", within_recording, within_recording)
        times = segment.start + start + np.arange(len(within_recording)) - middle[k]
        slope[k] += times @ within_recording
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
        np.where(seen[:, None], means, np.nan),
        np.where(seen[:, None], np.sqrt(within / np.maximum(count, 1.0)[:, None]), np.nan),
        explained / np.where(within_all > 0, within_all, 1.0),
        np.array([len(np.unique(column)) for column in np.vstack(longest).T]),
        rows,
    )


@dataclass
class _Runs:
    """The runs of equal values of one channel, while its rows are read.

    Attributes
    ----------
    count, rows : ndarray of int, shape (powers of two,)
        Runs by length, and the rows in them.
    longest : tuple of (int, int, int, float)
        Its length, recording, first row and value.
    begun : int
        The first row of the run that goes on.
    """

    count: NDArray[np.int64] = field(default_factory=lambda: np.zeros(_LENGTHS, dtype=np.int64))
    rows: NDArray[np.int64] = field(default_factory=lambda: np.zeros(_LENGTHS, dtype=np.int64))
    longest: tuple[int, int, int, float] = (0, 0, 0, 0.0)
    begun: int = 0

    def add(self, recording: int, starts: NDArray[np.int64], values: NDArray[np.float64], stop: int) -> None:
        """Take in runs that follow on each other, the last one up to ``stop``."""
        lengths = np.diff(np.append(starts, stop))
        power = np.frexp(lengths.astype(float))[1] - 1
        self.count += np.bincount(power, minlength=_LENGTHS)
        self.rows += np.bincount(power, weights=lengths, minlength=_LENGTHS).astype(np.int64)
        k = int(lengths.argmax())
        if lengths[k] > self.longest[0]:
            self.longest = int(lengths[k]), recording, int(starts[k]), float(values[k])

    def note(self, name: str, rows: int, where: str) -> str | None:
        """Return a note on the longest run, unless the channel moves in steps."""
        length, _, first, value = self.longest
        if length < max(_LEAST_RUN, _LEAST_SHARE * rows) or length == rows:
            return None
        others, ends = self.count.copy(), 2 ** np.arange(1, _LENGTHS + 1) - 1
        others[length.bit_length() - 1] -= 1
        usual = 1
        if others.sum():
            usual = int(ends[np.searchsorted(np.cumsum(others), _NEARLY_ALL * others.sum())])
        if length < _LONGER * usual:
            return None
        short = ends < length / _LONGER  # the runs of a sensor that moves; longer ones may be further standstills
        moving, runs = int(self.rows[short].sum()), int(self.count[short].sum())
        if moving - runs > _REPEATS * moving:
            return None
        return (
            f"{name!r} stands still at {number(value)} for {counted(length, 'row')} from row {first}{where} on, "
            f"{100 * length / rows:.0f} % of all rows, and moves in most rows elsewhere: set these values missing "
            "(NaN) if the sensor was stuck, not the plant at rest or at a limit"
        )


def outlying_values(gathered: Gathered) -> tuple[str, ...]:
    """Return notes on values that are hardly measurements: outliers of any channel, and outputs that stand still.

    Outliers are no more than 1 in 200 rows further from the median than 20 units, the largest of the distance between
    the quartiles, the median absolute step and the median distance from the median of values other than it, which
    carry more than half of the variance. An output stands still in a run of equal values that is long against its
    others; channels that move in steps, quantised ones and those of which several stand still together do not.
    """
    plain = gathered.of_channels(gathered.channels)  # the values themselves where changes are read
    every, picked = max(2 * (plain.n_samples // _SAMPLE), 1), []
    for *_, block in plain.blocks():  # evenly spaced pairs of rows
        chosen = np.arange(0, len(block), every)
        picked.append(block[np.unique(np.minimum(np.concatenate([chosen, chosen + 1]), len(block) - 1))])
    sample = np.vstack(picked)
    middle = np.median(sample, axis=0)
    unit = _units(sample, middle)
    m, q = len(gathered.inputs), len(gathered.channels)
    runs = [_Runs() for _ in gathered.outputs]
    count, far_squares, squares = np.zeros(q), np.zeros(q), np.zeros(q)
    first_far: dict[int, tuple[int, int, float]] = {}
    before = sample[0, m:]
    for segment, start, block in plain.blocks():
        with np.errstate(over="ignore"):  # values whose squares overflow are refused by their name
            apart = (block - middle) / np.where(unit > 0, unit, np.inf)
            far = np.abs(apart) > _FAR
            squares += np.einsum("ij,ij->j", apart, apart)
            if far.any():
                count += far.sum(axis=0)
                far_squares += (np.where(far, apart, 0.0) ** 2).sum(axis=0)
        first = segment.start + start
        for k in np.flatnonzero(far.any(axis=0)).tolist():
            row = int(far[:, k].argmax())
            delay = segment.delays[k] if segment.delays else 0
            first_far.setdefault(k, (segment.recording, first + row - delay, float(block[row, k])))
        for one, column, last in zip(runs, block.T[m:], before if start else block[0, m:], strict=True):
            changes = np.flatnonzero(np.diff(column, prepend=last) != 0) + first
            starts = np.append(one.begun if start else first, changes)
            values = np.append(last, column[changes - first])
            stop = first + len(block)
            one.begun = int(starts[-1])
            if stop < segment.stop:  # the last run goes on
                starts, values, stop = starts[:-1], values[:-1], one.begun
            if len(starts):
                one.add(segment.recording, starts, values, stop)
        before = block[-1, m:]
    notes = []
    for k, (recording, row, value) in sorted(first_far.items()):
        if count[k] > max(_FEW * plain.n_samples, 1) or not far_squares[k] > _MOST * squares[k]:
            continue
        place = f"{number(value)} in row {row}{_where(plain, recording)}"
        usual = f"the middle is {number(float(middle[k]))}, the usual distance {number(float(unit[k]))}"
        share = f"{100 * far_squares[k] / squares[k]:.3g} % of its variance"
        if count[k] == 1:
            remark = (
                f"a value far outside the rest, {place} ({usual}): this one row makes {share}, and decides what a "
                "model says of it; set it missing (NaN) unless it is a measurement"
            )
        else:
            remark = (
                f"{counted(int(count[k]), 'value')} far outside the rest, the first one {place} ({usual}): they make "
                f"{share}, and decide what a model says of it; set them missing (NaN) unless they are measurements"
            )
        notes.append(f"{plain.channels[k]!r} has {remark}")
    return (*notes, *_standstills(plain, runs))


def _units(sample: NDArray[np.float64], middle: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the usual distance of the values of each channel; zero where they do not move."""
    low, high = np.quantile(sample, (0.25, 0.75), axis=0)
    steps = np.median(np.abs(np.diff(sample, axis=0)), axis=0) if len(sample) > 1 else np.zeros(len(middle))
    apart = np.abs(sample - middle)
    other = np.array([float(np.median(one[one > 0])) if one.any() else 0.0 for one in apart.T])
    return np.maximum(np.maximum(high - low, steps), other)


def _standstills(gathered: Gathered, runs: list[_Runs]) -> list[str]:
    """Return notes on the outputs that stand still while others move."""
    notes: dict[str, tuple[_Runs, str]] = {}
    for name, one in zip(gathered.outputs, runs, strict=True):
        note = one.note(name, gathered.n_samples, _where(gathered, one.longest[1]))
        if note is not None:
            notes[name] = one, note
    together = []
    for name, (one, _) in notes.items():
        length, recording, first, _ = one.longest
        for other in (run.longest for run in runs if run is not one):  # of the same size, and most of its rows
            shared = min(length + first, other[0] + other[2]) - max(first, other[2])
            if recording == other[1] and shared > 0.8 * max(length, other[0]) and name not in together:
                together.append(name)
    remarks = [note for name, (_, note) in notes.items() if name not in together]
    if together:
        length, recording, first, _ = notes[together[0]][0].longest
        remarks.append(
            f"{some(map(repr, together))} {'stands' if len(together) == 1 else 'stand'} still together with other "
            f"outputs for about {counted(length, 'row')} from row {first}{_where(gathered, recording)} on: was the "
            "plant at rest, or did the recording stop? Rows that show no normal operation are better left out"
        )
    return remarks


def _where(gathered: Gathered, recording: int) -> str:
    return f" of {gathered.sources[recording]}" if len(gathered.sources) > 1 else ""


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
    repeated = (known & (steps == 0)).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    found = tuple(name for name, share in zip(channels, repeated.tolist(), strict=True) if _HELD <= share < 1)
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
