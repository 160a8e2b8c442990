"""Channels whose level does not stay: means that move through a fault-free recording, and slow wandering."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.decide.stationarity import CONFIDENCE, independent_samples, likeliest_change
from residua.errors import DataError
from residua.identify.channel_facts import ChannelFacts, channel_facts
from residua.identify.segments import Gathered, Names, gather
from residua.words import counted, number

#: A mean that moves by fewer standard deviations than this, which those on either side are, is no drift.
LEAST_CHANGE = 1.0
#: A recording that is worth fewer independent samples than this does not tell the level of a channel.
LEAST_WORTH = 6.0
#: Fewest rows of a recording that say anything.
LEAST_ROWS = 60
#: Means over stretches of time that a recording is looked at by, at most.
_STRETCHES = 1000
#: Fewest stretches by which the independent samples of a recording are counted.
_FEWEST = 40
#: The channels drift whose recordings with a drift hold this part of all rows.
_MOST = 0.5


@dataclass(frozen=True, eq=False, repr=False)
class Drifts:
    """The drift of each channel in fault-free recordings.

    Attributes
    ----------
    names : tuple of str
        All channels: inputs, then outputs.
    drifting : tuple of str
        Those whose level moves in recordings that hold half of the rows, or more.
    rows : ndarray of int, shape (recordings,)
        Complete rows of each; those with fewer than 60 are not judged.
    change : ndarray, shape (recordings, channels)
        By how much the mean changes at the likeliest place, in standard deviations on its sides; 0 where it does not
        change by more than chance.
    place : ndarray of int, shape (recordings, channels)
        The complete row of the recording at which it does.
    worth : ndarray, shape (recordings, channels)
        Independent samples that the recording is worth for the mean of the channel, at most a thousand.
    """

    names: tuple[str, ...]
    drifting: tuple[str, ...]
    rows: NDArray[np.int_] = field(repr=False)
    change: NDArray[np.float64] = field(repr=False)
    place: NDArray[np.int_] = field(repr=False)
    worth: NDArray[np.float64] = field(repr=False)

    @property
    def judged(self) -> NDArray[np.bool_]:
        """Recordings that are long enough."""
        return np.asarray(self.rows >= LEAST_ROWS)

    @property
    def moves(self) -> NDArray[np.bool_]:
        """Flags of the channels that drift in each recording, shape (recordings, channels)."""
        slow_or_changing = (np.abs(self.change) >= LEAST_CHANGE) | (self.worth < LEAST_WORTH)
        return np.asarray(slow_or_changing & self.judged[:, None])

    def sentence(self, name: str) -> str:
        """Describe the level of one channel, by its recording with the clearest drift."""
        i = self.names.index(name)
        moves = np.flatnonzero(self.moves[:, i])
        if not len(moves):
            return f"{name!r} keeps its level"
        largest = int(moves[np.abs(self.change[moves, i]).argmax()])
        several = len(self.rows) > 1
        where = f" of recording {largest + 1}" if several else ""
        if abs(self.change[largest, i]) >= LEAST_CHANGE:
            size, row = number(abs(self.change[largest, i]), 2), self.place[largest, i]
            how = f"its mean moves by {size} standard deviations about row {row}{where}"
        else:
            k = int(moves[self.worth[moves, i].argmin()])
            where, worth = (f" of recording {k + 1}" if several else ""), self.worth[k, i]
            few = "less than 1 independent one" if worth < 1 else f"{number(worth, 2)} independent ones"
            how = f"it wanders, so that the {self.rows[k]} rows{where} are worth {few} for its mean"
        often = f" (it drifts in {len(moves)} of {int(self.judged.sum())} recordings)" if several else ""
        return f"{name!r} drifts: {how}{often}"

    def __repr__(self) -> str:
        head = f"Drifts({len(self.drifting)} of {counted(len(self.names), 'channel')}){':' * bool(self.drifting)}"
        return "\n  ".join([head, *map(self.sentence, self.drifting)])


def drifting_channels(
    recordings: Any,
    y: ArrayLike | None = None,
    *,
    inputs: Names = None,
    outputs: Names = None,
    dt: float | None = None,
) -> Drifts:
    r"""Find the channels of fault-free recordings that do not keep their level.

    A monitor compares with the mean of the recordings. Of a channel that warms up, or wanders for longer than they
    last, they do not tell it, and the channel raises alarms later, whatever happens. It drifts in a recording if

    - its mean changes: the largest cumulative sum of its deviations is less likely than 0.1 % without a change, for
      all channels together, with the spread and the correlation time of what is left after a line on each side of the
      likeliest place,

      .. math:: T = \max_k \frac{|\sum_{i \le k} (x_i - \bar x)|}{\sigma \sqrt{n \tau}}, \qquad
         P(T > c) \le 2 e^{-2 c^2},

      and the means on both sides differ by a standard deviation about them, or more; or
    - it wanders: with its correlation time about the mean, not below that of first-order noise
      :math:`\tau = (1 + \varphi) / (1 - \varphi)` for the correlation :math:`\varphi` of neighbours, one standard
      error added, its ``n`` rows are worth :math:`n / \tau < 6` independent ones, and so are means over stretches of
      them: of an oscillation these are worth more.

    Of several recordings a channel drifts whose recordings with a drift hold half of the rows.

    Guaranteed: the same bits when a channel has other units, as far as these differ by a power of two.

    Parameters
    ----------
    recordings : Recording, data frame, path, array, pair (u, y), or a list of these
        Fault-free. Rows with a missing value are left out, and those on both sides of them follow on each other.
    y : array_like, shape (time, outputs), optional
    inputs, outputs : sequence of str, optional
        Channels by name; all columns when omitted.
    dt : float, optional
        Step in seconds of arrays.

    Returns
    -------
    Drifts

    Raises
    ------
    DataError
        If no recording has sixty complete rows, or values are so large that their squares overflow.
    SettingError
        If a channel is named twice.

    Notes
    -----
    Assumes: noise of which some forty correlation times, and oscillations of which some twenty periods, fit into each
    recording. Of slower ones a part is taken for wandering, since so few rows do not tell one from the other: of
    first-order noise of twenty-five correlation times up to 10 %, of twenty up to 35 %. Recordings at different levels,
    each of which keeps its own, have no drift.

    References
    ----------
    Ploberger and Kraemer (1992), Econometrica 60(2), 271-285 (cumulative sums and the Brownian bridge). Marriott and
    Pope (1954), Biometrika 41(3/4), 390-402 (the bias of the correlation of neighbours).

    See Also
    --------
    residua.identify.principal_components : whose option ``drifts`` treats such channels.

    Examples
    --------
    >>> import numpy as np
    >>> import residua as rs
    >>> rng = np.random.default_rng(0)
    >>> rows = rng.standard_normal((1000, 2))
    >>> rows[:, 1] += np.linspace(0, 5, 1000)
    >>> rs.identify.drifting_channels(rows, outputs=["pressure", "temperature"])
    Drifts(1 of 2 channels):
      'temperature' drifts: its mean moves by 2.1 standard deviations about row 497
    """
    gathered = gather(recordings, y, inputs=inputs, outputs=outputs, dt=dt)
    facts = channel_facts(gathered)
    facts.check_size()
    return drifts_in(gathered, facts)


def drifts_in(gathered: Gathered, facts: ChannelFacts) -> Drifts:
    """Return the drifts of recordings that were read already.

    Raises
    ------
    DataError
        If no recording is long enough.
    """
    count, n = len(gathered.sources), len(gathered.channels)
    rows, place = np.zeros(count, dtype=int), np.zeros((count, n), dtype=int)
    change, worth = np.zeros((count, n)), np.full((count, n), np.inf)
    for one in gathered.segments:
        rows[one.recording] += len(one)
    if not (rows >= LEAST_ROWS).any():
        raise DataError(
            f"{counted(int(rows.max()), 'complete row')} of a recording at most: {LEAST_ROWS} are needed to tell a "
            "drift from noise"
        )
    for k in np.flatnonzero(rows >= LEAST_ROWS):
        length = -(-int(rows[k]) // _STRETCHES)
        means = _stretches(gathered, int(k), length, facts)
        deviation = facts.recording_deviation[k] / facts.units
        for j in range(n):
            worth[k, j] = _effective_means(means[:, j])
            found = likeliest_change(means[:, j], (1 - CONFIDENCE) / n)
            if found is not None:
                place[k, j] = found[0] * length
                at, part = found[0], found[0] / len(means)
                one, other = means[:at, j], means[at:, j]
                shift = float(other.mean() - one.mean())
                # the means of stretches of many rows leave out the rows within them
                sides = max(deviation[j] ** 2 - part * (1 - part) * shift**2, 0.0)
                rest = np.concatenate([one - one.mean(), other - other.mean()])
                change[k, j] = shift / float(np.sqrt(max(sides, np.mean(rest**2))))
    found = Drifts(gathered.channels, (), rows, change, place, worth)
    judged = rows * found.judged
    share = judged @ found.moves / judged.sum()
    drifting = tuple(name for name, part in zip(gathered.channels, share, strict=True) if part >= _MOST)
    return replace(found, drifting=drifting)


def _effective_means(means: NDArray[np.float64]) -> float:
    """Return the number of independent samples in means over stretches: the most for any length of them.

    Neighbours of an oscillation that is sampled finely are as alike as those of a walk; over longer stretches it is
    gone, and a walk is not.
    """
    most = independent_samples(means)
    while len(means) >= 2 * _FEWEST:
        means = means[: len(means) // 2 * 2].reshape(-1, 2).mean(axis=1)
        most = max(most, independent_samples(means))
    return most


def _stretches(gathered: Gathered, recording: int, length: int, facts: ChannelFacts) -> NDArray[np.float64]:
    """Return the means of stretches of so many complete rows of a recording, in units of each channel."""
    means, left = [], np.zeros((0, len(gathered.channels)))
    for segment, _, rows in gathered.blocks():
        if segment.recording != recording:
            continue
        left = np.vstack([left, (rows - facts.mean) / facts.units])
        whole = len(left) // length * length
        means.append(left[:whole].reshape(-1, length, left.shape[1]).mean(axis=1))
        left = left[whole:]
    return np.vstack(means)
