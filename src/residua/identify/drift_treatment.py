"""What generators of channels make of those that drift: keep them, leave them out, or take their changes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.errors import DataError, SettingError
from residua.identify.drifts import LEAST_ROWS, Drifts, drifts_in
from residua.identify.lagged_rows import Standard, standard
from residua.identify.segments import Gathered
from residua.visible import echo, listed

KEEP, LEAVE_OUT, DIFFERENCE = "keep", "leave out", "difference"
_WAYS = (KEEP, LEAVE_OUT, DIFFERENCE)
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
    _check(gathered, drifts)
    whole = standard(gathered)
    found = _found(gathered, whole, drifts)
    drifting = () if found is None else found.drifting
    ways: dict[str, str] = {**drifts} if isinstance(drifts, Mapping) else {name: str(drifts) for name in drifting}
    left_out = [name for name, way in ways.items() if way == LEAVE_OUT]
    kept = [name for name in gathered.channels if name not in left_out]
    if not set(kept) & set(gathered.outputs):
        raise DataError(
            f"all outputs are left out, since they drift: {listed(left_out)}; keep them by their changes "
            "(drifts='difference'), or record where they are at rest"
        )
    changing = [name for name, way in ways.items() if way == DIFFERENCE]
    told = tuple(_note(found, name, ways.get(name, KEEP)) for name in _told(found, ways))
    if not left_out and not changing:
        told = (*whole.facts.notes(gathered, drifts=found is None), *told)
        return replace(untreated(gathered, whole, told), ways=ways)
    part = gathered.of_channels(kept, changing)
    if not part.segments:
        raise DataError("no two complete rows follow on each other: a channel has no changes (drifts='difference')")
    units = standard(part)
    told = (*units.facts.notes(part, drifts=found is None), *told)
    used = tuple(i for i, name in enumerate(gathered.channels) if name in kept)
    spread = whole.spread.copy()
    spread[list(used)] = units.spread
    return Treated(gathered, part, units, ways, whole.mean, spread, used, told)


def _check(gathered: Gathered, drifts: Any) -> None:
    wanted = f"drifts must be one of {', '.join(map(repr, _WAYS))}, or one of these for each channel by its name"
    if not isinstance(drifts, Mapping):
        if not (isinstance(drifts, str) and drifts in _WAYS):
            raise SettingError(f"{wanted}, got {echo(drifts)}")
        return
    for name, way in drifts.items():
        if name not in gathered.channels:
            raise SettingError(f"drifts: there is no channel {echo(name)}, only {listed(gathered.channels)}")
        if not (isinstance(way, str) and way in _WAYS):
            raise SettingError(f"{wanted}, got {echo(way)} for {echo(name)}")


def _found(gathered: Gathered, whole: Standard, drifts: Any) -> Drifts | None:
    """Return the drifts; ``None`` where the recordings are too short to tell, and nobody asked."""
    lengths = np.zeros(len(gathered.sources), dtype=int)
    for one in gathered.segments:
        lengths[one.recording] += len(one)
    if lengths.max() < LEAST_ROWS and (isinstance(drifts, Mapping) or drifts == KEEP):
        return None
    return drifts_in(gathered, whole.facts)


def _told(found: Drifts | None, ways: Mapping[str, str]) -> tuple[str, ...]:
    """Return the channels that a note is about: those that drift anywhere, and those that are treated by name."""
    drifting = () if found is None else tuple(np.array(found.names)[found.moves.any(axis=0)].tolist())
    return (*drifting, *(name for name, way in ways.items() if name not in drifting and way != KEEP))


def _note(found: Drifts | None, name: str, way: str) -> str:
    said = f"{name!r} was named (drifts=)" if found is None else found.sentence(name)
    return f"{said}; {_DONE[way]}"


__all__ = ["DIFFERENCE", "KEEP", "LEAVE_OUT", "Treated", "treated", "untreated"]
