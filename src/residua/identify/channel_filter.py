r"""Residual generators of recorded channels: a filter of their present and past, and the plant that it watches.

There is no model. The plant has no states and no control inputs: all channels are its outputs, inputs of the recording
first, and its operating point are their means. It says all that is known: a fault of a channel adds to that channel.
Channels that drift are kept, left out, or taken by their changes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.design.core.decoupling import Decoupled
from residua.design.core.evidence import Evidence
from residua.design.core.generator import Member, ResidualGenerator, make_generator
from residua.errors import DataError, SettingError
from residua.identify.channel_facts import ChannelFacts, channel_facts
from residua.identify.drifts import LEAST_ROWS, drifts_in
from residua.identify.hankel_factor import HankelFactor, count_windows, hankel_factor
from residua.identify.segments import Gathered
from residua.linear import StateSpace
from residua.plant import Plant
from residua.progress import Progress
from residua.visible import echo, listed
from residua.words import counted

KEEP, LEAVE_OUT, DIFFERENCE = "keep", "leave out", "difference"
_DONE = {
    KEEP: "kept, so that it may raise alarms whatever happens (drifts='leave out' or 'difference' treats it)",
    LEAVE_OUT: "left out, so that its own faults show nowhere",
    DIFFERENCE: "taken by its changes from row to row, so that its own faults show only while they change",
}
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
    facts.check(dependent=False)
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


@dataclass(frozen=True, eq=False)
class Treated:
    """The channels that a generator is made from, and the way back to all of them.

    Attributes
    ----------
    whole : Gathered
        As they were recorded.
    gathered : Gathered
        Without those that are left out; of some the changes.
    units : Standard
        Of ``gathered``.
    ways : dict of str to str
        The treatment of each channel that drifts, or was named.
    mean, spread : ndarray, shape (channels,)
        Of all channels; of those that are differenced the spread of the changes, of those left out their own.
    used : tuple of int
        The channels of ``gathered``, among all.
    notes : tuple of str
        On drifts and their treatment, and those of :class:`ChannelFacts`.
    """

    whole: Gathered
    gathered: Gathered
    units: Standard
    ways: Mapping[str, str]
    mean: NDArray[np.float64]
    spread: NDArray[np.float64]
    used: tuple[int, ...]
    notes: tuple[str, ...]

    def weights(self, weights: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return weights of all channels in their own units, from those of ``gathered`` in standard ones.

        As arrays of shape (lags + 1, residuals, channels), the present sample first; a difference reads one more.
        """
        plain = weights / self.units.spread
        differenced = [self.ways.get(name) == DIFFERENCE for name in self.gathered.channels]
        if any(differenced):
            plain = np.concatenate([plain, np.zeros_like(plain[:1])])
            plain[1:, :, differenced] -= plain[:-1, :, differenced].copy()
        out = np.zeros((*plain.shape[:2], len(self.whole.channels)))
        out[:, :, list(self.used)] = plain
        return out


def untreated(gathered: Gathered, units: Standard, notes: tuple[str, ...] = ()) -> Treated:
    """Return the channels as they are, in these units."""
    everything = tuple(range(len(gathered.channels)))
    return Treated(gathered, gathered, units, {}, units.mean, units.spread, everything, notes)


def treated(gathered: Gathered, drifts: Any) -> Treated:
    """Return the channels as ``drifts`` asks for: one way for all that drift, or a way for each channel by name.

    Raises
    ------
    DataError
        If no output is left, no recording is long enough to tell a drift, or what :func:`standard` finds.
    SettingError
        If ``drifts`` is no way, or names what is no channel.
    """
    ways = drifts if isinstance(drifts, Mapping) else {}
    for name, way in ways.items() if isinstance(drifts, Mapping) else [("", drifts)]:
        if name and name not in gathered.channels:
            raise SettingError(f"drifts: there is no channel {echo(name)}, only {listed(gathered.channels)}")
        if not (isinstance(way, str) and way in _DONE):
            of = f" for {echo(name)}" if name else ""
            raise SettingError(
                f"drifts must be one of {', '.join(map(repr, _DONE))}, or one of these for each channel by its name, "
                f"got {echo(way)}{of}"
            )
    whole = standard(gathered)
    rows = np.bincount([one.recording for one in gathered.segments], weights=[len(one) for one in gathered.segments])
    # the recordings may be too short to tell, where nobody asked
    short = rows.max() < LEAST_ROWS and (isinstance(drifts, Mapping) or drifts == KEEP)
    found = None if short else drifts_in(gathered, whole.facts)
    if not isinstance(drifts, Mapping):
        ways = {} if found is None else dict.fromkeys(found.drifting, drifts)
    left_out = [name for name, way in ways.items() if way == LEAVE_OUT]
    kept = [name for name in gathered.channels if name not in left_out]
    if not set(kept) & set(gathered.outputs):
        raise DataError(
            f"all outputs are left out, since they drift: {listed(left_out)}; keep them by their changes "
            "(drifts='difference'), or record where they are at rest"
        )
    changing = [name for name, way in ways.items() if way == DIFFERENCE]
    anywhere = (
        () if found is None else [name for name, moves in zip(found.names, found.moves.T, strict=True) if any(moves)]
    )
    remarks = []
    for name in (*anywhere, *(name for name, way in ways.items() if name not in anywhere and way != KEEP)):
        remark = f"{name!r} was named (drifts=)" if found is None else found.sentence(name)
        remarks.append(f"{remark}; {_DONE[ways.get(name, KEEP)]}")
    if not left_out and not changing:
        notes = (*whole.facts.notes(gathered, drifts=found is None), *remarks)
        return replace(untreated(gathered, whole, notes), ways=dict(ways))
    part = gathered.of_channels(kept, changing)
    if not part.segments:
        raise DataError("no two complete rows follow on each other: a channel has no changes (drifts='difference')")
    units = standard(part)
    used = tuple(i for i, name in enumerate(gathered.channels) if name in kept)
    spread = whole.spread.copy()
    spread[list(used)] = units.spread
    notes = (*units.facts.notes(part, drifts=found is None), *remarks)
    return Treated(gathered, part, units, dict(ways), whole.mean, spread, used, notes)


def channel_generator(
    channels: Treated,
    weights: NDArray[np.float64],
    groups: dict[str, int],
    evidence: Evidence,
    *,
    denominator: Sequence[float] = (),
) -> ResidualGenerator:
    r"""Return the generator :math:`d(q^{-1})\, r_k = \sum_i W_i z_{k-i}` of channels in standard units.

    The fault of an output is called ``"NAME sensor"`` and adds to it. That of an input is called ``"NAME actuator"``:
    the plant gets more than the record says, so it takes away from the record. Channels that are left out have none.

    Parameters
    ----------
    weights : ndarray, shape (lags + 1, residuals, channels)
        ``W``, the present sample first; of the channels as they are treated.
    groups : dict of str to int
        Names of groups of residuals, in their order, and how many each has.
    denominator : sequence of float
        :math:`d_1, ..., d_{lags}` of :math:`d = 1 + \sum_i d_i q^{-i}`; all zero, a moving average, when omitted.
    """
    gathered, watched = channels.whole, channels.gathered
    q, names = len(gathered.channels), gathered.channels
    nothing = np.zeros((0, 0))
    plant = Plant(nothing, nothing, np.zeros((q, 0)), dt=gathered.dt, outputs=names, name="recorded channels")
    for name in watched.inputs:
        column = -1.0 * (np.array(names) == name)
        plant = plant.with_faults({f"{name} actuator": (np.zeros(0), column)}, kind="actuator", component=name)
    plant = plant.with_sensor_faults(watched.outputs).with_operating_point(outputs=channels.mean)
    W = channels.weights(weights)
    lags = len(W) - 1
    d = np.array([*denominator, *np.zeros(lags - len(denominator))])
    A = np.zeros((lags * q, lags * q))
    B = np.zeros((lags * q, q))
    if lags:
        A[:q] = np.kron(-d, np.eye(q))
        A[q:, :-q] = np.eye((lags - 1) * q)
        B[:q] = np.eye(q)
    C = np.hstack([W[i + 1] - d[i] * W[0] for i in range(lags)]) if lags else np.zeros((W.shape[1], 0))
    residuals = tuple(f"{group} {k + 1}" if size > 1 else group for group, size in groups.items() for k in range(size))
    system = StateSpace(A, B, C, W[0], dt=gathered.dt, inputs=names, outputs=residuals)
    ends = np.cumsum([0, *groups.values()]).tolist()
    members = tuple(
        Member(group, tuple(range(a, b)), plant.faults) for group, a, b in zip(groups, ends[:-1], ends[1:], strict=True)
    )
    notes = (*watched.notes, *channels.notes)
    # nothing is known of the plant, so that its state, of dimension zero, is mapped exactly, and nothing is decoupled
    return make_generator(
        system,
        plant,
        evidence.method,
        evidence.extended(poles=system.poles(), notes=notes),
        decouples=Decoupled(),
        state_map=np.zeros((lags * q, 0)),
        members=members,
    )


def names_of_groups(generator: ResidualGenerator) -> dict[str, tuple[str, ...]]:
    """Return the names of the residuals of each group."""
    return {one.name: tuple(generator.residuals[i] for i in one.residuals) for one in generator.members}
