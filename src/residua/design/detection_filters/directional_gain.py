"""Gains that give every fault its own direction or plane: the core of all detection filters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.design.core.evidence import Evidence
from residua.design.observers.observer_gain import pair_gain, with_gain
from residua.design.observers.unknown_input_observer import ErrorPair
from residua.errors import AccuracyError, DesignError
from residua.linear.poles.observer_gain import ObserverGain
from residua.linear.poles.spectrum import describe_modes, spectrum_error
from residua.linear.subspaces.detection_space import (
    DetectionSpace,
    are_independent,
    confined_space,
    split_blocks,
)
from residua.linear.subspaces.quotient import observable_split
from residua.linear.subspaces.rank import decide_rank
from residua.plant.balanced import BalancedPlant, is_inside
from residua.tolerances import BALANCED_ANSWER, POLE, above_rounding
from residua.words import counted

Matrix = NDArray[np.float64]
#: Several faults are not kept apart by one filter with a larger gain, in balanced units, if two have smaller ones.
_LARGE = 1e6
Poles = Sequence[complex] | ArrayLike | Mapping[str, Sequence[complex]] | None


@dataclass(frozen=True, eq=False)
class FaultEvent:
    """One fault, or several that no filter tells apart, and the space that it is confined to.

    Attributes
    ----------
    faults : tuple of str
    space : DetectionSpace
    """

    faults: tuple[str, ...]
    space: DetectionSpace


def entrances(pair: ErrorPair, faults: Sequence[str]) -> dict[str, tuple[Matrix, Matrix]]:
    r"""Return the balanced directions of each fault in the error and in the residual of any gain.

    A fault :math:`f, d` enters :math:`\varepsilon = T x - z` as :math:`T (f - G d - A_0 H W d)`, less ``K_1`` times
    how it enters the residual, :math:`(I - C_0 H) W d`.
    """
    plant, (B, D), HW = pair.model.plant, pair.model.faults, pair.H @ pair.W
    columns = [plant.faults.index(name) for name in faults]
    enter = pair.inverse @ pair.T @ (B - (pair.G + pair.A0 @ HW) @ D)[:, columns]
    direct = pair.outputs @ (pair.W - pair.C0 @ HW) @ D[:, columns]
    size = np.linalg.norm(np.vstack([enter, direct]), axis=0)
    whole = np.vstack([enter, direct]) / np.where(size > BALANCED_ANSWER, size, np.inf)
    whole = above_rounding(whole, 1.0)
    return {name: (whole[: len(enter), [i]], whole[len(enter) :, [i]]) for i, name in enumerate(faults)}


def fault_events(
    A: Matrix, C: Matrix, entering: Mapping[str, tuple[Matrix, Matrix]]
) -> tuple[list[FaultEvent], list[str]]:
    """Return the detection space of each fault, twins merged, and the faults that no output sees."""
    events: list[FaultEvent] = []
    unseen: list[str] = []
    for name, (f, d) in entering.items():
        space = confined_space(A, C, f, d)
        twin = next((k for k, event in enumerate(events) if _are_the_same(event.space, space)), None)
        if not space.outputs.shape[1]:
            unseen.append(name)
        elif twin is not None:
            events[twin] = replace(events[twin], faults=(*events[twin].faults, name))
        else:
            events.append(FaultEvent((name,), space))
    return events, unseen


def _are_the_same(a: DetectionSpace, b: DetectionSpace) -> bool:
    """Tell whether a gain that confines one fault confines another in the same way."""
    one, other = (
        np.block([[s.basis, s.confining], [np.zeros((len(s.outputs), s.dimension)), s.outputs]]) for s in (a, b)
    )
    return one.shape == other.shape and decide_rank(np.hstack([one, other]), rtol=1e-7).rank == one.shape[1]


def obstacle(A: Matrix, C: Matrix, events: Sequence[FaultEvent], model: BalancedPlant) -> str | None:
    """Return why no stable gain keeps these faults apart in one filter, or ``None`` when one does."""
    names = ", ".join(" or ".join(event.faults) for event in events)
    outputs = [event.space.outputs for event in events]
    if not are_independent(outputs) or not are_independent([event.space.basis for event in events]):
        return (
            f"{names}: the signature directions are not linearly independent (rank "
            f"{decide_rank(np.hstack(outputs)).rank} of {sum(one.shape[1] for one in outputs)} directions, "
            f"{len(C)} measurements)"
        )
    modes = hidden_modes(*split_blocks(A, C, [event.space for event in events]).pairs[-1])
    inside = is_inside(modes, model.plant.is_discrete)
    if not inside.all():
        zero = describe_modes(model.units.rate * modes[~inside])
        return f"{names}: the invariant zero {zero} of these faults together is a fixed pole, and not stable"
    return None


def hidden_modes(A: Matrix, C: Matrix) -> NDArray[np.complex128]:
    """Return the modes of a balanced pair that no output sees."""
    hidden = observable_split(A, C).hidden
    return np.asarray(np.linalg.eigvals(hidden.T @ A @ hidden), dtype=complex)


def partition(
    pair: ErrorPair, events: list[FaultEvent], hidden: NDArray[np.complex128]
) -> tuple[list[list[FaultEvent]], list[ObserverGain]]:
    """Split the events over as few filters as keep them apart; return these, and gains by least squares.

    Searched exactly: first one filter, then two, and so on; a set that fails makes every larger set fail. Several
    faults whose gain is not found, or large, are split too.

    Raises
    ------
    DesignError
        If a fault cannot be kept in a direction even alone; the message says why.
    """

    @cache
    def designed(members: tuple[int, ...]) -> ObserverGain | str:
        """Return the gain of some events, or why there is none."""
        group = [events[i] for i in members]
        try:
            found = obstacle(pair.A, pair.C, group, pair.model) or block_gain(pair, group, hidden)
        except AccuracyError as error:
            if len(group) == 1:
                raise
            return str(error)
        large = len(group) > 1 and isinstance(found, ObserverGain) and np.linalg.norm(found.K) >= _LARGE
        return "the gain is large" if large else found

    everything = tuple(range(len(events)))
    if isinstance(gain := designed(everything), ObserverGain):
        return [events], [gain]
    for i in everything:
        if isinstance(why := designed((i,)), str):
            raise DesignError(f"no stable directional filter exists: {why}")

    def fill(i: int, groups: list[tuple[int, ...]], limit: int) -> list[tuple[int, ...]] | None:
        if i == len(events):
            return groups
        for g, group in enumerate(groups):
            if isinstance(designed((*group, i)), ObserverGain) and (
                found := fill(i + 1, [*groups[:g], (*group, i), *groups[g + 1 :]], limit)
            ):
                return found
        return fill(i + 1, [*groups, (i,)], limit) if len(groups) < limit else None

    total = sum(event.space.outputs.shape[1] for event in events)
    limit = max(1, -(-total // max(1, decide_rank(pair.C).rank)))
    while not (groups := fill(0, [], limit)):  # each fault has a filter of its own
        limit += 1
    gains = [one for group in groups if isinstance(one := designed(group), ObserverGain)]
    return [[events[i] for i in group] for group in groups], gains


def block_gain(
    pair: ErrorPair,
    events: Sequence[FaultEvent],
    hidden: NDArray | None = None,
    poles: Poles = None,
    margin: float | None = None,
) -> ObserverGain:
    r"""Return a gain that keeps each event in its own space, with poles as asked for or by least squares.

    The core that detection filters and right eigenvectors share: with detection spaces it is the filter of White and
    Speyer, all of whose poles are free; with the chains ``f, A f, ...`` of :func:`eigenstructure_assignment`,
    lines for faults that the outputs see, it makes the faults themselves eigenvectors,
    :math:`K C F = A F - F \Lambda`.

    Parameters
    ----------
    pair : ErrorPair
        With white noise.
    events : sequence of FaultEvent
    hidden : ndarray, optional
        Further poles that no gain moves, of what the pair leaves out.
    poles, margin
        In units of time of the balanced plant.

    Returns
    -------
    ObserverGain
        On the outputs ``W y``, for the states of the balanced plant.
    """
    blocks = split_blocks(pair.A, pair.C, [event.space for event in events])
    splits = [observable_split(F, G) for F, G in blocks.pairs]
    fixed = np.concatenate([*(hidden_modes(F, G) for F, G in blocks.pairs), [] if hidden is None else hidden])
    sizes = [split.seen.shape[1] for split in splits]
    shares = share_poles(poles, [event.faults for event in events], sizes, fixed, pair.model.units.rate)
    gains = [
        pair_gain(pair.model, F, G, (np.eye(len(F)), read @ read.T), share, margin, split=split, faint=True)
        for (F, G), split, read, share in zip(blocks.pairs, splits, blocks.reads, shares, strict=True)
    ]
    return ObserverGain(
        pair.on_outputs(blocks.gain([gain.K for gain in gains])),
        np.concatenate([gain.poles for gain in gains]),
        np.concatenate([gain.requested for gain in gains]),
        fixed,
        max(gain.error for gain in gains),
        "; ".join(dict.fromkeys(gain.note for gain in gains if gain.note)),
    )


def with_poles_of_whole(evidence: Evidence, pair: ErrorPair, gain: ObserverGain) -> Evidence:
    """Return evidence with the poles of the whole observer, after checking them where they are asked for."""
    F, rate = pair.T @ pair.A0 - gain.K @ pair.C0, pair.model.units.rate
    wanted, error = np.concatenate([gain.requested, gain.fixed]), gain.error
    if gain.requested.size and len(wanted) == len(F):
        error = max(error, spectrum_error(F, wanted, float(pair.model.plant.is_discrete), POLE)[0])
        if error > POLE:
            raise AccuracyError(
                f"a pole is off by {error:.2g} > {POLE:.0e} of the requested pole: so ill-conditioned that "
                "rounding moves it; ask for poles nearer to those of the plant or further apart, for a margin, or add "
                "a sensor"
            )
    found = with_gain(evidence, replace(gain, error=error), pair.model)
    return replace(found, poles=rate * np.linalg.eigvals(F).astype(complex))


def share_poles(
    poles: Poles, names: Sequence[tuple[str, ...]], sizes: Sequence[int], fixed: NDArray, rate: float
) -> list[NDArray[np.complex128] | None]:
    """Deal the wanted poles out to the faults and, last, the rest; conjugate pairs together.

    ``None`` for a block means: none were asked for.
    """
    shares: list[NDArray[np.complex128] | None] = [None] * len(sizes)
    if poles is None:
        return shares
    if isinstance(poles, Mapping):
        known = {name: k for k, group in enumerate(names) for name in group} | {"rest": len(names)}
        for name, values in poles.items():
            if name not in known:
                raise DesignError(f"poles: unknown fault {name!r}; known: {', '.join(known)}")
            share, size = np.atleast_1d(np.asarray(values, dtype=complex)), sizes[known[name]]
            if len(share) != size:
                raise DesignError(
                    f"poles[{name!r}]: {len(share)} poles were given, {size} belong to it "
                    "(of the states one, plus one for each invariant zero of the fault and each extra integration to "
                    "the outputs; of an output those that the others do not see)"
                )
            shares[known[name]] = share
        return shares
    wanted, free = list(np.atleast_1d(np.asarray(poles, dtype=complex))), sum(sizes)
    if len(wanted) == free + len(fixed):
        for z in fixed:
            nearest = int(np.argmin(np.abs(np.asarray(wanted) - z)))
            if abs(wanted.pop(nearest) - z) > POLE * max(1.0, abs(z)):
                raise DesignError(
                    f"the pole {describe_modes([rate * z])} cannot be moved and is not among the requested poles; "
                    f"give the other {counted(free, 'pole')}"
                )
    if len(wanted) != free:
        raise DesignError(
            f"{len(wanted)} poles were given, {free} are free"
            + (f" (fixed: {describe_modes(rate * fixed)})" if len(fixed) else "")
        )
    reals, pairs = [z for z in wanted if z.imag == 0], [z for z in wanted if z.imag > 0]
    if not np.array_equal(np.sort_complex(wanted), np.sort_complex([*reals, *pairs, *np.conj(pairs)])):
        raise DesignError("poles must come in conjugate pairs")
    odd = sum(size % 2 for size in sizes)
    if len(reals) < odd:
        raise DesignError(
            f"the faults need blocks of {', '.join(map(str, sizes))} poles; each odd block needs a real pole, "
            f"and only {len(reals)} of the requested poles are real"
        )
    for k, size in enumerate(sizes):
        share = [reals.pop(0)] if size % 2 else []
        odd -= size % 2
        while len(share) < size:
            if len(reals) - odd >= 2:
                share += [reals.pop(0), reals.pop(0)]
            else:
                share += [pairs[0], np.conj(pairs.pop(0))]
        shares[k] = np.asarray(share, dtype=complex)
    return shares
