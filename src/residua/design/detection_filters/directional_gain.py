"""Gains that give every fault its own direction or plane: the core of all detection filters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.design.observers.unknown_input_observer import ErrorPair
from residua.errors import AccuracyError, DesignError
from residua.linear.poles.observer_gain import observer_gain
from residua.linear.poles.spectrum import describe_modes, spectrum_error
from residua.linear.subspaces.detection_space import (
    DetectionSpace,
    are_independent,
    event_quotient,
    split_blocks,
    unobservability_space,
)
from residua.linear.subspaces.quotient import observable_split
from residua.linear.subspaces.rank import RankDecision, decide_rank
from residua.plant.balanced import is_inside
from residua.tolerances import BALANCED_RANK, POLE
from residua.words import counted

Matrix = NDArray[np.float64]
Poles = Sequence[complex] | ArrayLike | Mapping[str, Sequence[complex]] | None


@dataclass(frozen=True, eq=False)
class FaultEvent:
    """One fault, or several with the same detection space, as events in the error equation.

    Attributes
    ----------
    faults : tuple of str
        Twins share one event: no filter can tell them apart by direction.
    space : DetectionSpace
    near : tuple of RankDecision
        Decisions about the space that double precision hardly allows.
    """

    faults: tuple[str, ...]
    space: DetectionSpace
    near: tuple[RankDecision, ...] = ()


@dataclass(frozen=True, eq=False)
class DirectionalGain:
    """A gain on the outputs ``W y`` of an error pair, for the states of the balanced plant.

    Attributes
    ----------
    K : ndarray, shape (n, outputs)
    fixed : ndarray
        Poles that no gain can move.
    requested : ndarray
        Those that were asked for.
    error : float
        Largest error among the placed poles.
    notes : tuple of str
    """

    K: Matrix
    fixed: NDArray[np.complex128]
    requested: NDArray[np.complex128]
    error: float
    notes: tuple[str, ...] = ()


def event_matrices(pair: ErrorPair, faults: Sequence[str]) -> dict[str, Matrix]:
    r"""Return what each fault does to the error, as columns of length one: two for a fault in the outputs.

    A fault :math:`f, d` with :math:`C g = d` acts, after the shift :math:`e + g \eta`, as the events :math:`T g` (with
    its derivative) and :math:`T (f - G d - A g)`. Where no ``g`` gives all of ``d``, the gain does not read the rest:
    ``g`` is that of least squares.
    """
    plant, (B, D) = pair.model.plant, pair.model.faults
    inverse, enter, out = np.linalg.pinv(pair.C, rcond=BALANCED_RANK), pair.inverse @ pair.T, {}
    for name in faults:
        i = plant.faults.index(name)
        f, d = B[:, [i]], D[:, [i]]
        L = enter @ (f - pair.G @ d)
        if np.any(d):
            g = inverse @ pair.outputs @ pair.W @ d
            L = np.hstack([enter @ pair.M @ g, L - pair.A @ g])
        size = np.linalg.norm(L, axis=0)
        out[name] = L / np.where(size > BALANCED_RANK, size, np.inf)
    return out


def fault_events(A: Matrix, C: Matrix, events: Mapping[str, Matrix]) -> tuple[list[FaultEvent], list[str]]:
    """Return the detection space of each fault, twins merged, and the faults that no output sees."""
    merged: list[FaultEvent] = []
    unseen: list[str] = []
    for name, L in events.items():
        q = event_quotient(A, C, L)
        space, near = unobservability_space(q), [one for one in (*q.decisions, *q.split.decisions) if not one.is_clear]
        twin = next((k for k, other in enumerate(merged) if _are_the_same(other.space.basis, space.basis)), None)
        if not space.outputs.shape[1]:
            unseen.append(name)
        elif twin is not None:
            merged[twin] = FaultEvent((*merged[twin].faults, name), space, merged[twin].near)
        else:
            merged.append(FaultEvent((name,), space, tuple(near)))
    return merged, unseen


def _are_the_same(a: Matrix, b: Matrix) -> bool:
    return a.shape == b.shape and decide_rank(np.hstack([a, b]), rtol=1e-7).rank == a.shape[1]


def obstacle(A: Matrix, C: Matrix, events: Sequence[FaultEvent], sampled: bool, rate: float = 1.0) -> str | None:
    """Return why no stable gain keeps these faults apart in one filter, or ``None`` when one does."""
    names = ", ".join(" or ".join(event.faults) for event in events)
    outputs = [event.space.outputs for event in events]
    if not are_independent(outputs) or not are_independent([event.space.basis for event in events]):
        return (
            f"{names}: the signature directions are not linearly independent (rank "
            f"{decide_rank(np.hstack(outputs)).rank} of {sum(one.shape[1] for one in outputs)} directions, "
            f"{len(C)} measurements)"
        )
    bad = unstable(*split_blocks(A, C, [event.space for event in events]).pairs[-1], sampled)
    if bad.size:
        zero = describe_modes(rate * bad)
        return f"{names}: the invariant zero {zero} of these faults together is a fixed pole, and not stable"
    return None


def hidden_modes(A: Matrix, C: Matrix) -> NDArray[np.complex128]:
    """Return the modes of a balanced pair that no output sees."""
    hidden = observable_split(A, C).hidden
    return np.asarray(np.linalg.eigvals(hidden.T @ A @ hidden), dtype=complex)


def unstable(A: Matrix, C: Matrix, sampled: bool) -> NDArray[np.complex128]:
    """Return the modes of a balanced pair that no output sees and that are not stable."""
    modes = hidden_modes(A, C)
    return modes[~is_inside(modes, sampled)]


def partition(A: Matrix, C: Matrix, events: list[FaultEvent], sampled: bool, rate: float) -> list[list[FaultEvent]]:
    """Split the events over as few filters as keep them apart.

    Searched exactly: first one filter, then two, and so on; a set that fails makes every larger set fail.

    Raises
    ------
    DesignError
        If a fault cannot be kept in a direction even alone; the message says why.
    """
    known: dict[frozenset[int], str | None] = {}

    def why_not(members: frozenset[int]) -> str | None:
        if members not in known:
            known[members] = obstacle(A, C, [events[i] for i in sorted(members)], sampled, rate)
        return known[members]

    if not events or why_not(frozenset(range(len(events)))) is None:  # then every part of them fits too
        return [events]
    for i in range(len(events)):
        if (why := why_not(frozenset({i}))) is not None:
            raise DesignError(f"no stable directional filter exists: {why}")

    def fill(i: int, groups: list[frozenset[int]], limit: int) -> list[frozenset[int]] | None:
        if i == len(events):
            return groups
        for g, group in enumerate(groups):
            if why_not(group | {i}) is None and (
                found := fill(i + 1, [*groups[:g], group | {i}, *groups[g + 1 :]], limit)
            ):
                return found
        return fill(i + 1, [*groups, frozenset({i})], limit) if len(groups) < limit else None

    total = sum(event.space.outputs.shape[1] for event in events)
    for limit in range(max(1, -(-total // max(1, decide_rank(C).rank))), len(events) + 1):
        if groups := fill(0, [], limit):
            return [[events[i] for i in sorted(group)] for group in groups]
    raise AssertionError("every fault has a filter of its own")


def block_gain(
    pair: ErrorPair, events: Sequence[FaultEvent], poles: Poles = None, margin: float | None = None
) -> DirectionalGain:
    r"""Return a gain that keeps each event in its own space, with the poles of each block as asked, or by least squares.

    The core that detection filters and right eigenvectors share: with detection spaces it is the filter of White and
    Speyer, all of whose poles are free; with the chains ``f, A f, ...`` of :func:`eigenstructure_assignment`,
    lines for faults that the outputs see, it makes the faults themselves eigenvectors,
    :math:`K C F = A F - F \Lambda`.
    """
    rate, sampled = pair.model.units.rate, pair.model.plant.is_discrete
    blocks = split_blocks(pair.A, pair.C, [event.space for event in events])
    splits = [observable_split(F, G) for F, G in blocks.pairs]
    fixed = np.concatenate([hidden_modes(F, G) for F, G in blocks.pairs])
    sizes = [split.seen.shape[1] for split in splits]
    shares = share_poles(poles, [event.faults for event in events], sizes, fixed, rate)
    gains = [
        observer_gain(
            F,
            G,
            split,
            sampled=sampled,
            process=np.eye(len(F)),
            measurement=read @ read.T,
            poles=share,
            margin=margin,
            rate=rate,
        )
        for (F, G), split, read, share in zip(blocks.pairs, splits, blocks.reads, shares, strict=True)
    ]
    return DirectionalGain(
        pair.on_outputs(blocks.gain([gain.K for gain in gains])),
        fixed,
        np.concatenate([gain.requested for gain in gains]),
        max(gain.error for gain in gains),
        tuple(dict.fromkeys(gain.note for gain in gains if gain.note)),
    )


def gain_evidence(pair: ErrorPair, gain: DirectionalGain, *, asked: bool = True) -> dict[str, Any]:
    """Return what the evidence says of a gain, after checking the poles of the whole, if they are as asked for."""
    F, rate = pair.T @ pair.A0 - gain.K @ pair.C0, pair.model.units.rate
    requested = gain.requested if asked else gain.requested[:0]
    wanted, error = np.concatenate([requested, gain.fixed]), gain.error
    if requested.size and len(wanted) == len(F):
        error = max(error, spectrum_error(F, wanted, float(pair.model.plant.is_discrete), POLE)[0])
        if error > POLE:
            raise AccuracyError(
                f"a pole is off by {error:.2g} > {POLE:.0e} of the requested pole: so ill-conditioned that "
                "rounding moves it; ask for poles nearer to those of the plant or further apart, for a margin, or add "
                "a sensor"
            )
    return {
        "poles": rate * np.linalg.eigvals(F),
        "requested_poles": rate * requested,
        "fixed_poles": rate * gain.fixed,
        "conditions": {"pole error": error, "size of K": float(np.linalg.norm(gain.K, 2)) if gain.K.size else 0.0},
        "notes": gain.notes,
    }


def share_poles(
    poles: Poles, names: Sequence[tuple[str, ...]], sizes: Sequence[int], fixed: NDArray, rate: float
) -> list[NDArray[np.complex128] | None]:
    """Deal the wanted poles out to the faults and, last, the rest; conjugate pairs together.

    ``None`` for a block means: none were asked for.
    """
    if poles is None:
        return [None] * len(sizes)
    if isinstance(poles, Mapping):
        return _named_shares(poles, names, sizes)
    wanted = np.atleast_1d(np.asarray(poles, dtype=complex))
    free = sum(sizes)
    if len(fixed) and len(wanted) == free + len(fixed):
        wanted = _without(wanted, fixed, rate)
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
    shares: list[NDArray[np.complex128] | None] = []
    for size in sizes:
        share = [reals.pop(0)] if size % 2 else []
        odd -= size % 2
        while len(share) < size:
            if len(reals) - odd >= 2:
                share += [reals.pop(0), reals.pop(0)]
            else:
                share += [pairs[0], np.conj(pairs.pop(0))]
        shares.append(np.asarray(share, dtype=complex))
    return shares


def _named_shares(
    poles: Mapping[str, Sequence[complex]], names: Sequence[tuple[str, ...]], sizes: Sequence[int]
) -> list[NDArray[np.complex128] | None]:
    known = {name: k for k, group in enumerate(names) for name in group} | {"rest": len(names)}
    shares: list[NDArray[np.complex128] | None] = [None] * len(sizes)
    for name, values in poles.items():
        if name not in known:
            raise DesignError(f"poles: unknown fault {name!r}; known: {', '.join(known)}")
        share, size = np.atleast_1d(np.asarray(values, dtype=complex)), sizes[known[name]]
        if len(share) != size:
            raise DesignError(
                f"poles[{name!r}]: {len(share)} poles were given, {size} belong to it "
                "(one, plus one for each invariant zero of the fault and each extra integration to the outputs)"
            )
        shares[known[name]] = share
    return shares


def _without(wanted: NDArray, fixed: NDArray, rate: float) -> NDArray:
    left = list(wanted)
    for z in fixed:
        nearest = int(np.argmin(np.abs(np.asarray(left) - z)))
        if abs(left.pop(nearest) - z) > POLE * max(1.0, abs(z)):
            raise DesignError(
                f"the pole {describe_modes([rate * z])} cannot be moved and is not among the requested poles; "
                f"give the other {counted(len(wanted) - len(fixed), 'pole')}"
            )
    return np.asarray(left, dtype=complex)
