"""The attribution of an alarm: the most likely fault and arrival, held once the window has passed them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from residua.errors import FileFormatError
from residua.number_kinds import KNOWN_OR_NOT, NumberKind
from residua.records import Record

#: A likelihood ratio that has fallen from its peak by that many of its roots speaks of a fault that has gone; its own
#: standard deviation is two.
FALLEN = 3.0


@dataclass(frozen=True, eq=False)
class Match:
    """The result of the test; every array starts with (plants, time), or (time,) for one plant.

    Attributes
    ----------
    ratios : ndarray, shape (..., faults)
        Twice the logarithm of the generalised likelihood ratio of each fault, at its most likely arrival.
    ages : ndarray of int, shape (..., faults)
        That arrival, in samples ago; -1 if it lies before the window, and the fault has settled.
    sizes, deviations : ndarray, shape (..., faults)
        Most likely size with that arrival, in units of the fault, and its standard deviation; NaN and infinity where
        nothing can be said.
    settled_sizes : ndarray, shape (..., faults)
        Size by the steady response alone, over the window; NaN where that vanishes.
    fault : ndarray of int, shape (...)
        Number of the fault that explains the standing alarm; -1 without an alarm. Refined as long as its
        arrival lies within the window, final thereafter.
    arrival : ndarray, shape (...)
        When it arrived, as a number of samples from the start of the run; NaN when that was before the window.
    source : ndarray of int, shape (...)
        The sample from which both come, counted likewise; -1 without an alarm.
    """

    ratios: NDArray[np.float64]
    ages: NDArray[np.int64]
    sizes: NDArray[np.float64]
    deviations: NDArray[np.float64]
    settled_sizes: NDArray[np.float64]
    fault: NDArray[np.int64]
    arrival: NDArray[np.float64]
    source: NDArray[np.int64]


def no_match(plants: int, time: int, faults: int) -> Match:
    """Return the matches of samples without a search: no fault."""
    each, all_faults = (plants, time), (plants, time, faults)
    return Match(
        ratios=np.zeros(all_faults),
        ages=np.full(all_faults, -1, dtype=np.int64),
        sizes=np.full(all_faults, np.nan),
        deviations=np.full(all_faults, np.inf),
        settled_sizes=np.full(all_faults, np.nan),
        fault=np.full(each, -1, dtype=np.int64),
        arrival=np.full(each, np.nan),
        source=np.full(each, -1, dtype=np.int64),
    )


@dataclass(frozen=True, eq=False)
class HeldState(Record):
    """State of the standing alarm; a row per plant.

    Attributes
    ----------
    held : ndarray, shape (plants, 6)
        Fault, arrival, the sample from which they come, whether they are final, the sample of its raising and the
        largest likelihood ratio so far; NaN without one.
    on : ndarray of bool, shape (plants,)
        Whether one stands.
    """

    NUMBER_KINDS: ClassVar[Mapping[str, NumberKind]] = {"held": KNOWN_OR_NOT}

    held: NDArray[np.float64]
    on: NDArray[np.bool_]

    @staticmethod
    def empty(plants: int) -> HeldState:
        """Return the state before the first sample."""
        return HeldState(np.full((plants, 6), np.nan), np.zeros(plants, dtype=bool))

    def check(self, where: str, faults: int, window: int, count: int) -> None:
        """Raise if a state from a file is not that of an alarm of so many faults, within so many samples."""
        fault, arrival, source, final, raised, peak = self.held[self.on].T
        known = ~np.isnan(fault)
        right = (
            np.isnan(self.held[~self.on]).all()
            and _are_whole(fault[known], 0, faults)
            and np.array_equal(known, ~np.isnan(source))
            and _are_whole(source[known], 0, count)
            and _are_whole(arrival[~np.isnan(arrival)], -window, count)
            and _are_whole(final, 0, 2)
            and _are_whole(raised, 0, count)
            and np.all((peak >= 0) & np.isfinite(peak))
        )
        if not right:
            raise FileFormatError(f"{where}: no alarm within {count} samples is put down to a fault like that")


def hold_block(
    window: int,
    state: HeldState,
    likelihoods: dict[str, NDArray],
    alarm: NDArray[np.bool_],
    over: NDArray[np.bool_],
    count: int | NDArray[np.int64],
) -> tuple[Match, HeldState]:
    """Attribute each alarm to one fault and arrival: the most likely as long as that arrival lies within the window.

    Thereafter the test cannot see how the fault began, so that name and arrival stay until the alarm ends. An alarm
    that begins with a settled fault, one that arrived before the window, has no arrival. Nor can an arrival explain
    an alarm that was raised before it: those of a fault that still grows, or of a filter that settles more slowly than
    the window is long, are not taken. Nor is a sample at which the likelihood has fallen by more than noise does: the
    fault has gone, and the rest is no longer a step.

    Parameters
    ----------
    window : int
        In samples.
    state : HeldState
    likelihoods : dict
        From :func:`residua.decide.matched_responses.match_block`.
    alarm, over : ndarray of bool, shape (plants, time)
        Whether the alarm is on, and whether the statistic of a usable sample is over its threshold.
    count : int, or ndarray of int, shape (plants,)
        Samples before the block.
    """
    time, was = alarm.shape[1], state.on
    count = np.broadcast_to(count, len(alarm))[:, None]
    now = count + np.arange(time)
    best = np.argmax(likelihoods["ratios"], axis=2)
    age = np.take_along_axis(likelihoods["ages"], best[..., None], axis=2)[..., 0]
    # one column before the block: the attribution of an alarm that goes on
    held = np.where(was[:, None], state.held, np.nan)
    at = np.arange(time + 1)
    on = np.concatenate([was[:, None], alarm], axis=1)
    judged = np.concatenate([np.isfinite(held[:, :1]), alarm & over], axis=1)
    fault = np.concatenate([held[:, :1], best], axis=1)
    arrival = np.concatenate([held[:, 1:2], np.where(age >= 0, now - age, np.nan)], axis=1)
    origin = np.concatenate([held[:, 2:3], np.broadcast_to(now, alarm.shape)], axis=1)
    begun = np.concatenate([on[:, :1], on[:, 1:] & ~on[:, :-1]], axis=1)
    start = np.maximum.accumulate(np.where(begun, at, 0), axis=1)
    raised = np.where(start > 0, count + start - 1, held[:, 4:5])
    ratio = np.take_along_axis(likelihoods["ratios"], best[..., None], axis=2)[..., 0]
    before = np.where(was, held[:, 5], 0.0)  # the peak of an alarm without an explanation counts too
    ratio = np.concatenate([before[:, None], np.where(judged[:, 1:], ratio, 0.0)], axis=1)
    peak = _peak(ratio, start)
    dated = judged & (arrival <= raised) & (ratio >= peak - FALLEN * np.sqrt(peak))
    latest = _latest(dated)
    reference = np.where(latest >= start, _pick(arrival, latest), raised)
    late = np.zeros(on.shape, dtype=bool)
    late[:, 0] = held[:, 3] == 1
    late[:, 1:] = on[:, 1:] & ~begun[:, 1:] & (now - reference[:, :-1] > window)
    final = on & (_latest(late) >= start)
    latest = _latest(dated & (~final | (at == 0)))
    known = latest >= start
    source = np.where(known, latest, _latest(judged & ~(arrival > raised)))
    put_down = on & (source >= start)
    fault = np.where(put_down, _pick(fault, source), np.nan)
    arrival = np.where(put_down & known, _pick(arrival, source), np.nan)
    origin = np.where(put_down, _pick(origin, source), np.nan)
    if time:
        last = np.stack([x[:, -1] for x in (fault, arrival, origin, final.astype(float), raised, peak)], axis=1)
        state = HeldState(np.where(on[:, -1:], last, np.nan), alarm[:, -1].copy())
    match = Match(
        **likelihoods,
        fault=np.where(put_down, fault, -1)[:, 1:].astype(np.int64),
        arrival=arrival[:, 1:],
        source=np.where(put_down, origin, -1)[:, 1:].astype(np.int64),
    )
    return match, state


def _are_whole(values: NDArray[np.float64], first: int, stop: int) -> bool:
    """Tell whether numbers are whole and in a range."""
    return bool(np.all((values == np.floor(values)) & (values >= first) & (values < stop)))


def _latest(which: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return for each column the index of the last true entry so far; -1 without any."""
    return np.maximum.accumulate(np.where(which, np.arange(which.shape[1]), -1), axis=1)


def _peak(values: NDArray[np.float64], start: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return for each column the largest value so far, since its own start."""
    order = np.argsort(values, axis=1, kind="stable")
    rank = np.empty_like(order)
    np.put_along_axis(rank, order, np.broadcast_to(np.arange(values.shape[1]), order.shape), axis=1)
    largest = np.maximum.accumulate(start * values.shape[1] + rank, axis=1) % values.shape[1]
    return np.take_along_axis(values, np.take_along_axis(order, largest, axis=1), axis=1)


def _pick(values: NDArray, columns: NDArray[np.int64]) -> NDArray:
    return np.take_along_axis(values, np.maximum(columns, 0), axis=1)
