"""Gains that give every fault its own direction or plane: the core of all detection filters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.errors import DesignError
from residua.linear.poles.placement import Placement, default_margin, place_observer_margin, place_observer_poles
from residua.linear.poles.spectrum import describe_modes
from residua.linear.poles.stability import is_stable_mode
from residua.linear.subspaces.detection_space import (
    DetectionSpace,
    detection_space,
    inverse_without_rounding,
    separation,
    split_blocks,
)
from residua.linear.subspaces.far_gain import refuse_far_gain
from residua.linear.subspaces.observability import detectability
from residua.linear.subspaces.observable_part import observable_part
from residua.linear.subspaces.rank import DEFAULT_RTOL, decide_rank
from residua.linear.systems.array_cache import cached_by_contents
from residua.linear.systems.balancing import without_rounding
from residua.words import as_given, counted

Poles = Sequence[complex] | ArrayLike | Mapping[str, Sequence[complex]] | None


@dataclass(frozen=True, eq=False)
class FaultEvent:
    """One fault, or several with the same detection space, as events in the error equation.

    Attributes
    ----------
    faults : tuple of str
        Twins share one event: no filter can tell them apart by direction.
    space : DetectionSpace
    """

    faults: tuple[str, ...]
    space: DetectionSpace


@dataclass(frozen=True, eq=False)
class DirectionalGain:
    """A gain with the poles that it reaches.

    Attributes
    ----------
    gain : ndarray, shape (n, p)
    fixed : ndarray
        Poles that no gain can move.
    error : float
        Largest error among the placed poles.
    note : str
    """

    gain: NDArray[np.float64]
    fixed: NDArray[np.complex128]
    requested: NDArray[np.complex128]
    error: float
    note: str = ""


@cached_by_contents
def fault_events(
    A: NDArray, C: NDArray, events: Mapping[str, NDArray], *, rtol: float = DEFAULT_RTOL
) -> tuple[list[FaultEvent], list[str]]:
    """Return the detection space of each fault, twins merged, and the faults that no output sees."""
    merged: list[FaultEvent] = []
    unseen: list[str] = []
    for name, L in events.items():
        space = detection_space(A, C, L, rtol=rtol) if np.any(L) else None
        if space is None or space.outputs.shape[1] == 0:
            unseen.append(name)
            continue
        for k, other in enumerate(merged):
            if _same_space(other.space, space):
                merged[k] = FaultEvent((*other.faults, name), other.space)
                break
        else:
            merged.append(FaultEvent((name,), space))
    return merged, unseen


def _same_space(a: DetectionSpace, b: DetectionSpace) -> bool:
    if a.dimension != b.dimension:
        return False
    return decide_rank(np.hstack([a.basis, b.basis]), rtol=1e-7).rank == a.dimension


def obstacle(A: NDArray, C: NDArray, events: Sequence[FaultEvent], dt: float) -> str | None:
    """Return why no stable gain keeps these faults apart in one filter, or ``None`` when one does."""
    spaces = [event.space for event in events]
    names = ", ".join(" or ".join(event.faults) for event in events)
    apart = separation(spaces)
    if not apart.separable:
        return (
            f"{names}: the signature directions are not linearly independent "
            f"(rank {apart.outputs.rank} of {apart.wanted_outputs} directions, "
            f"{len(C)} measurements)"
        )
    blocks = split_blocks(A, C, spaces)
    rest = detectability(*blocks.rest, dt=dt)
    if not rest.detectable:
        bad = describe_modes(rest.unstable_modes)
        return f"{names}: the invariant zero {bad} of these faults together is a fixed pole, and not stable"
    return None


def checked_options(poles: Poles, margin: float | None) -> tuple[Any, float | None]:
    """Return the wanted poles as numbers and the margin, or say what is wrong with them."""
    if margin is not None:
        if isinstance(margin, bool) or not isinstance(margin, (int, float, np.number)) or not 0 < margin < np.inf:
            raise DesignError(f"margin must be a positive number in 1/s, got {as_given(margin)!r}")
        if poles is not None and not isinstance(poles, Mapping):
            raise DesignError("give poles or margin, not both")
    try:
        if isinstance(poles, Mapping):
            return {name: np.asarray(values, dtype=complex).reshape(-1) for name, values in poles.items()}, margin
        return (None if poles is None else np.asarray(cast("ArrayLike", poles), dtype=complex).reshape(-1)), margin
    except (TypeError, ValueError) as error:
        raise DesignError(f"poles must be numbers, or a mapping of fault name to numbers: {error}") from error


def scalar_gain(A: NDArray, C: NDArray, pole: float, weights: NDArray, *, asked: bool) -> DirectionalGain:
    r"""Return :math:`K = (A - \lambda I) C^+`, which makes :math:`A - KC = \lambda I` when rank C = n (eq. 25).

    The inverse is that of least squares over the weighted outputs.
    """
    K = without_rounding(A - pole * np.eye(len(A)), inverse_without_rounding(weights[:, None] * C)) * weights
    achieved = np.linalg.eigvals(A - K @ C)
    error = float(np.abs(achieved - pole).max(initial=0.0))
    note = "as many independent measurements as states: every fault keeps its direction or plane"
    requested = np.full(len(A) if asked else 0, pole, dtype=complex)
    return DirectionalGain(K, np.zeros(0, complex), requested, error, note)


def scalar_pole(A: NDArray, C: NDArray, poles: Poles, margin: float | None, dt: float) -> float | None:
    """Return the single pole of the ideal case (rank C = n, all poles alike), or ``None`` otherwise."""
    n = len(A)
    if isinstance(poles, Mapping) or decide_rank(C, rtol=DEFAULT_RTOL).rank < n:
        return None
    if poles is None:
        distance = default_margin(A, dt) if margin is None else margin
        return float(np.exp(-distance * dt)) if dt else -float(distance)
    wanted = np.asarray(poles, dtype=complex)
    if len(wanted) != n or np.any(wanted != wanted[0]) or np.any(np.imag(wanted)):
        return None
    pole = float(np.real(wanted[0]))
    if not is_stable_mode(np.array([pole]), dt).all():
        raise DesignError(
            f"the pole {describe_modes([pole])} is not stable for {'a sampled' if dt else 'a continuous'} plant"
        )
    return pole


@cached_by_contents
def block_gain(
    A: NDArray,
    C: NDArray,
    events: Sequence[FaultEvent],
    poles: Poles,
    margin: float | None,
    dt: float,
    *,
    rtol: float = DEFAULT_RTOL,
) -> DirectionalGain:
    r"""Return a gain that keeps each event in its own space, with poles placed block by block.

    The core that detection filters and right eigenvectors share: with detection spaces it is the filter of White and
    Speyer, all of whose poles are free; with the chains ``f, A f, ...`` of :func:`eigenstructure_assignment`,
    lines for faults that the outputs see, it makes the faults themselves eigenvectors,
    :math:`K C F = A F - F \Lambda`.
    """
    blocks = split_blocks(A, C, [event.space for event in events], rtol=rtol)
    pairs = [*blocks.pairs, blocks.rest]
    seen = [observable_part(Ai, Ci, dt) for Ai, Ci in pairs]
    fixed = np.concatenate([part.fixed for part in seen])
    *sizes, rest = (part.order for part in seen)
    shares = share_poles(poles, [event.faults for event in events], sizes, rest, fixed, dt)
    distance = default_margin(A, dt) if margin is None else margin
    gains, requested, errors = [], [], [0.0]
    for (Ai, Ci), share in zip(pairs, shares, strict=True):
        placed = placed_share(Ai, Ci, share, distance, dt)
        gains.append(placed.gain)
        requested.append(np.zeros(0, complex) if share is None else share)
        errors.append(float(placed.error))
    K = blocks.gain(gains[:-1], gains[-1])
    return DirectionalGain(K, fixed, np.concatenate(requested), max(errors))


def placed_share(A: NDArray, C: NDArray, poles: NDArray | None, margin: float, dt: float) -> Placement:
    """Place the poles of a pair in even units where its share says, or beyond the margin, with no gain from rounding.

    Raises
    ------
    DesignError
        If a mode that no output sees is not stable.
    AccuracyError
        If the poles are not reached, or only by a gain so large that rounding would be what it acts through.
    """
    placed = place_observer_margin(A, C, margin, dt=dt) if poles is None else place_observer_poles(A, C, poles, dt=dt)
    refuse_far_gain(A, C, placed.gain, _rate(poles, margin, dt))
    return placed


def _rate(poles: NDArray | None, margin: float, dt: float) -> float:
    """Return the size of the farthest pole that is asked for; that of a sampled plant is in the unit disk."""
    return 1.0 if dt else margin if poles is None else float(np.abs(poles).max(initial=0.0))


def share_poles(
    poles: Poles,
    names: Sequence[tuple[str, ...]],
    sizes: Sequence[int],
    rest: int,
    fixed: NDArray,
    dt: float,
) -> list[NDArray[np.complex128] | None]:
    """Deal the wanted poles out to the faults and the rest, conjugate pairs together.

    ``None`` for a block means: place it by margin.
    """
    if poles is None:
        return [None] * (len(sizes) + 1)
    if isinstance(poles, Mapping):
        return _named_shares(poles, names, sizes, rest)
    wanted = np.atleast_1d(np.asarray(poles, dtype=complex))
    free = sum(sizes) + rest
    if len(wanted) == free + len(fixed) and len(fixed):
        wanted = _without(wanted, fixed)
    if len(wanted) != free:
        raise DesignError(
            f"{len(wanted)} poles were given, {free} are free"
            + (f" (fixed: {describe_modes(fixed)})" if len(fixed) else "")
        )
    reals = [z for z in wanted if z.imag == 0]
    pairs = [z for z in wanted if z.imag > 0]
    if len(reals) + 2 * len(pairs) != len(wanted) or any(
        np.count_nonzero(wanted == z) != np.count_nonzero(wanted == np.conj(z)) for z in pairs
    ):
        raise DesignError("poles must come in conjugate pairs")
    shares: list[NDArray[np.complex128] | None] = []
    counts = [*sizes, rest]
    if len(reals) < sum(size % 2 for size in counts):
        raise DesignError(
            f"the faults need blocks of {', '.join(map(str, counts))} poles; each odd block needs a real pole, "
            f"and only {len(reals)} of the requested poles are real"
        )
    odd_left = sum(size % 2 for size in counts)
    for size in counts:
        share: list[complex] = []
        if size % 2:
            share.append(reals.pop(0))
            odd_left -= 1
        while len(share) < size:
            if len(reals) - odd_left >= 2:
                share += [reals.pop(0), reals.pop(0)]
            else:
                z = pairs.pop(0)
                share += [z, np.conj(z)]
        shares.append(np.asarray(share, dtype=complex))
    return shares


def _named_shares(
    poles: Mapping[str, Sequence[complex]], names: Sequence[tuple[str, ...]], sizes: Sequence[int], rest: int
) -> list[NDArray[np.complex128] | None]:
    known = {name: k for k, group in enumerate(names) for name in group} | {"rest": len(sizes)}
    shares: list[NDArray[np.complex128] | None] = [None] * (len(sizes) + 1)
    for name, values in poles.items():
        if name not in known:
            raise DesignError(f"poles: unknown fault {name!r}; known: {', '.join(known)}")
        k = known[name]
        share = np.atleast_1d(np.asarray(values, dtype=complex))
        size = rest if k == len(sizes) else sizes[k]
        if len(share) != size:
            raise DesignError(
                f"poles[{name!r}]: {len(share)} poles were given, {size} belong to it "
                "(one, plus one for each invariant zero of the fault and each extra integration to the outputs)"
            )
        shares[k] = share
    return shares


def _without(wanted: NDArray, fixed: NDArray) -> NDArray:
    left = list(wanted)
    for z in fixed:
        nearest = int(np.argmin(np.abs(np.asarray(left) - z)))
        if abs(left[nearest] - z) > 1e-6 * max(1.0, abs(z)):
            raise DesignError(
                f"the pole {describe_modes([z])} cannot be moved and is not among the requested poles; "
                f"give the other {counted(len(wanted) - len(fixed), 'pole')}"
            )
        left.pop(nearest)
    return np.asarray(left, dtype=complex)


@cached_by_contents
def partition(A: NDArray, C: NDArray, events: Sequence[FaultEvent], dt: float) -> list[list[FaultEvent]]:
    """Split the events over as few filters as keep them apart.

    Searched exactly: first one filter, then two, and so on; a set that fails makes every larger set fail.

    Raises
    ------
    DesignError
        If a fault cannot be kept in a direction even alone; the message says why.
    """
    known: dict[frozenset[int], bool] = {}

    def fits(members: frozenset[int]) -> bool:
        if members not in known:
            known[members] = obstacle(A, C, [events[i] for i in sorted(members)], dt) is None
        return known[members]

    if fits(frozenset(range(len(events)))):  # then every part of them does
        return [list(events)]
    for event in events:
        why = obstacle(A, C, [event], dt)
        if why:
            raise DesignError(f"no stable directional filter exists: {why}")

    def fill(i: int, groups: list[frozenset[int]], limit: int) -> list[frozenset[int]] | None:
        if i == len(events):
            return groups
        for g, group in enumerate(groups):
            wider = group | {i}
            if fits(wider):
                result = fill(i + 1, [*groups[:g], wider, *groups[g + 1 :]], limit)
                if result:
                    return result
        if len(groups) < limit:
            return fill(i + 1, [*groups, frozenset({i})], limit)
        return None

    total = sum(event.space.outputs.shape[1] for event in events)
    start = max(1, -(-total // max(1, decide_rank(C).rank)))
    for limit in range(start, len(events) + 1):
        groups = fill(0, [], limit)
        if groups:
            return [[events[i] for i in sorted(group)] for group in groups]
    raise DesignError("no partition of the faults was found")
