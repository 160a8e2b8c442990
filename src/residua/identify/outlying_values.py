"""Values of a recording that are hardly measurements: a few far outside the rest, and a sensor that stands still."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from residua.identify.segments import Gathered
from residua.words import counted, number, some

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
            said = (
                f"a value far outside the rest, {place} ({usual}): this one row makes {share}, and decides what a "
                "model says of it; set it missing (NaN) unless it is a measurement"
            )
        else:
            said = (
                f"{counted(int(count[k]), 'value')} far outside the rest, the first one {place} ({usual}): they make "
                f"{share}, and decide what a model says of it; set them missing (NaN) unless they are measurements"
            )
        notes.append(f"{plain.channels[k]!r} has {said}")
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
    said = [note for name, (_, note) in notes.items() if name not in together]
    if together:
        length, recording, first, _ = notes[together[0]][0].longest
        said.append(
            f"{some(map(repr, together))} {'stands' if len(together) == 1 else 'stand'} still together with other "
            f"outputs for about {counted(length, 'row')} from row {first}{_where(gathered, recording)} on: was the "
            "plant at rest, or did the recording stop? Rows that show no normal operation are better left out"
        )
    return said


def _where(gathered: Gathered, recording: int) -> str:
    return f" of {gathered.sources[recording]}" if len(gathered.sources) > 1 else ""
