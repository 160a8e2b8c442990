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
from residua.identify.drifts import LEAST_ROWS, drifts_in
from residua.identify.lagged_rows import Standard, standard
from residua.identify.segments import Gathered
from residua.linear import StateSpace
from residua.plant import Plant
from residua.visible import echo, listed

KEEP, LEAVE_OUT, DIFFERENCE = "keep", "leave out", "difference"
_DONE = {
    KEEP: "kept, so that it may raise alarms whatever happens (drifts='leave out' or 'difference' treats it)",
    LEAVE_OUT: "left out, so that its own faults show nowhere",
    DIFFERENCE: "taken by its changes from row to row, so that its own faults show only while they change",
}


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
        What was done with each channel that drifts, or was named.
    mean, spread : ndarray, shape (channels,)
        Of all channels; of those that are differenced the spread of the changes, of those left out their own.
    used : tuple of int
        The channels of ``gathered``, among all.
    notes : tuple of str
        What should be known of the channels: drifts and what was done with them, and what :class:`ChannelFacts` says.
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
        own = weights / self.units.spread
        differenced = [self.ways.get(name) == DIFFERENCE for name in self.gathered.channels]
        if any(differenced):
            own = np.concatenate([own, np.zeros_like(own[:1])])
            own[1:, :, differenced] -= own[:-1, :, differenced].copy()
        out = np.zeros((*own.shape[:2], len(self.whole.channels)))
        out[:, :, list(self.used)] = own
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
    told = []
    for name in (*anywhere, *(name for name, way in ways.items() if name not in anywhere and way != KEEP)):
        said = f"{name!r} was named (drifts=)" if found is None else found.sentence(name)
        told.append(f"{said}; {_DONE[ways.get(name, KEEP)]}")
    if not left_out and not changing:
        notes = (*whole.facts.notes(gathered, drifts=found is None), *told)
        return replace(untreated(gathered, whole, notes), ways=dict(ways))
    part = gathered.of_channels(kept, changing)
    if not part.segments:
        raise DataError("no two complete rows follow on each other: a channel has no changes (drifts='difference')")
    units = standard(part)
    used = tuple(i for i, name in enumerate(gathered.channels) if name in kept)
    spread = whole.spread.copy()
    spread[list(used)] = units.spread
    notes = (*units.facts.notes(part, drifts=found is None), *told)
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
