"""Recursions of matched filters: the likelihood ratio of each fault and arrival, and its hold over an alarm."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from residua.decide.test import Bends
from residua.errors import FileFormatError
from residua.linear.systems.recursion import ordered_product
from residua.number_kinds import KNOWN_OR_NOT, WINDOW, NumberKind
from residua.records import Record

#: Numbers that one pass over a block works on at most; bounds memory and does not change a bit of the result.
_PASS = 1_000_000
#: A likelihood ratio that has fallen from its peak by that many of its roots speaks of a fault that has gone; its own
#: standard deviation is two.
_FALLEN = 3.0


@dataclass(frozen=True, eq=False)
class MatchedTest(Record):
    """Responses to faults in whitened residual space, for likelihoods.

    Attributes
    ----------
    window : int
    faults : tuple of str
        The columns of the responses.
    groups : tuple of tuple of str
        Faults that cannot be distinguished are one group.
    responses : ndarray, shape (window + 1, residuals, faults)
        Of a fault that arrived 0 to ``window`` samples ago; with no rows, only settled faults are looked for.
    settled : ndarray, shape (residuals, faults)
    unjudged : tuple of str
        Faults without a response.
    """

    NUMBER_KINDS: ClassVar[Mapping[str, NumberKind]] = {"window": WINDOW}

    window: int
    faults: tuple[str, ...]
    groups: tuple[tuple[str, ...], ...]
    responses: NDArray[np.float64]
    settled: NDArray[np.float64]
    unjudged: tuple[str, ...]

    @property
    def samples(self) -> int:
        """Number of samples in use: those of the window, and the one of the arrival."""
        return self.window + 1

    @cached_property
    def columns(self) -> tuple[tuple[int, ...], ...]:
        """Fault numbers of each group."""
        return tuple(tuple(self.faults.index(name) for name in group) for group in self.groups)

    @cached_property
    def energies(self) -> NDArray[np.float64]:
        """Squared size of the responses at each sample: (window + 1, faults)."""
        return _squares(np.swapaxes(self.responses, 1, 2))

    @cached_property
    def weights(self) -> NDArray[np.float64]:
        """Squared size of the responses up to each sample, added in order: (window + 1, faults)."""
        return np.cumsum(self.energies, axis=0)

    @cached_property
    def bank(self) -> NDArray[np.float64]:
        """All responses side by side: (residuals, (window + 1) faults)."""
        return np.ascontiguousarray(np.swapaxes(self.responses, 0, 1).reshape(len(self.settled), -1))


@dataclass(frozen=True, eq=False)
class MatchState:
    """State of the test; every array has one row per plant.

    Attributes
    ----------
    sums, weights : ndarray, shape (plants, window + 1, faults)
        For each arrival: the products with the expected response so far, and the squared size of that response.
    extra : ndarray, shape (plants, window + 1, 2 faults)
        For each of the last samples what faults that arrived before the window add there to the products with their
        settled responses, and to the squared size of these, if they have other responses.
    """

    sums: NDArray[np.float64]
    weights: NDArray[np.float64]
    extra: NDArray[np.float64]


def empty_match(test: MatchedTest, plants: int, *, bends: bool = False) -> MatchState:
    """Return the state before the first sample; ``bends`` is true if responses may vary."""
    sums = np.zeros((plants, len(test.responses), len(test.faults)))
    extra = np.broadcast_to(0.0, (plants, test.samples if bends else 0, 2 * len(test.faults)))
    return MatchState(sums, sums, extra)


def match_after(test: MatchedTest, q: NDArray[np.float64], usable: NDArray[np.bool_]) -> MatchState:
    """Return the state after samples as if they were the first, equal to the last bit.

    That holds for the arrivals within them. Of earlier ones no product is known; nor are they missed after a window.

    Parameters
    ----------
    test : MatchedTest
    q : ndarray, shape (plants, time, residuals)
        Whitened residuals, zero where not usable.
    usable : ndarray of bool, shape (plants, time)
    """
    state = empty_match(test, len(q))
    if not len(test.responses):
        return state
    _, sums = _along_arrivals(_products(test, q), state.sums)
    weights = np.broadcast_to(test.weights, sums.shape)
    if not usable.all():
        energies = np.where(usable[None, :, :, None], test.energies[:, None, None], 0.0)
        _, weights = _along_arrivals(energies, weights)
    return replace(state, sums=sums, weights=weights)


# ------------------------------------------------------------------ likelihood ratios


def match_block(
    test: MatchedTest,
    state: MatchState,
    q: NDArray[np.float64],
    usable: NDArray[np.bool_],
    sums: NDArray[np.float64],
    bends: Bends = (),
) -> tuple[dict[str, NDArray], MatchState]:
    """Return the likelihood ratio, arrival and size of every fault at every sample of a block.

    Each pair of fault and arrival adds its products sample by sample, in the order of time, so that the result is the
    same to the last bit for any cutting. Samples that are not usable add nothing and count for nothing: they carry no
    information, and what was known before them stays.

    Parameters
    ----------
    test : MatchedTest
    state : MatchState
    q : ndarray, shape (plants, time, residuals)
        Whitened residuals, zero where not usable.
    usable : ndarray of bool, shape (plants, time)
    sums : ndarray, shape (plants, time, residuals + 2)
        Sums of :func:`summed` over the last ``window + 1`` samples.
    bends : sequence of (int, int, ndarray)
        Where faults have other responses than those of the test, as while a Kalman filter recovers from missing
        outputs: plant, sample of the block, and the responses.

    Returns
    -------
    likelihoods : dict
        ``ratios``, ``ages``, ``sizes``, ``deviations`` and ``settled_sizes`` of :class:`Match`.
    state : MatchState
    """
    plants, time, _ = q.shape
    step = max(1, _PASS // max(1, plants * max(1, state.sums.shape[1]) * max(1, len(test.faults))))
    parts = []
    for start in range(0, max(time, 1), step):
        cut = slice(start, start + step)
        bent = [(p, k - start, R) for p, k, R in bends if start <= k < start + step and usable[p, k]]
        part, state = _match_pass(test, state, q[:, cut], usable[:, cut], sums[:, cut], bent)
        parts.append(part)
    return {name: np.concatenate([part[name] for part in parts], axis=1) for name in parts[0]}, state


def summed(q: NDArray[np.float64], usable: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the terms to be summed: the whitened residual, its square and the mask of usable samples."""
    return np.concatenate([q, _squares(q)[..., None], usable[..., None].astype(float)], axis=2)


def _match_pass(
    test: MatchedTest, state: MatchState, q: NDArray, usable: NDArray[np.bool_], sums: NDArray, bends: Bends
) -> tuple[dict[str, NDArray], MatchState]:
    m = q.shape[2]
    count = sums[..., -1:]
    products = ordered_product(sums[..., :m], test.settled)
    weights = count * _squares(test.settled.T)
    if bends or (state.extra.size and state.extra.strides[0] and state.extra.any()):
        products, weights, state = _with_extra(test, state, q, bends, products, weights)
    ratios, settled_sizes, deviations = _likelihood(products, weights)
    sizes, ages = settled_sizes, np.full(ratios.shape, -1, dtype=np.int64)
    if len(test.responses):
        steps = _products(test, q)
        for p, k, R in bends:
            steps[:, p, k] = _inner(R[:-1], q[p, k])
        products, before = _along_arrivals(steps, state.sums)
        full = not bends and usable.all() and bool(np.all(state.weights[:, :-1] == test.weights[:-1]))
        if full:  # no sample was ever missing: the same numbers, known beforehand
            weights = np.broadcast_to(test.weights[:, None, None], products.shape)
            known = np.broadcast_to(test.weights, state.weights.shape)
        else:
            steps = np.where(usable[None, :, :, None], test.energies[:, None, None], 0.0)
            for p, k, R in bends:
                steps[:, p, k] = _squares(R[:-1])
            weights, known = _along_arrivals(steps, state.weights)
        state = replace(state, sums=before, weights=known)
        best = np.argmax(_ratios(products, weights), axis=0)
        of_step = _likelihood(*(np.take_along_axis(values, best[None], axis=0)[0] for values in (products, weights)))
        younger = of_step[0] > ratios * (1 + 1e-9)  # a response that never changes cannot tell when it began
        ratios, sizes, deviations = (
            np.where(younger, a, b) for a, b in zip(of_step, (ratios, sizes, deviations), strict=True)
        )
        ages = np.where(younger, best, -1)
    likelihoods = {
        "ratios": ratios,
        "ages": ages,
        "sizes": sizes,
        "deviations": deviations,
        "settled_sizes": settled_sizes,
    }
    return likelihoods, state


def _products(test: MatchedTest, q: NDArray) -> NDArray[np.float64]:
    """Return the product of each sample with the response at each age: (ages, plants, time, faults)."""
    product = ordered_product(q, test.bank).reshape(*q.shape[:2], len(test.responses), len(test.faults))
    return np.ascontiguousarray(np.moveaxis(product, 2, 0))


def _with_extra(
    test: MatchedTest, state: MatchState, q: NDArray, bends: Bends, products: NDArray, weights: NDArray
) -> tuple[NDArray, NDArray, MatchState]:
    """Correct the products and weights of settled faults by their errors at the samples of the window.

    Sums over the window are formed anew at each sample, from the oldest on: nothing drifts.
    """
    extra, faults = state.extra.copy(), len(test.faults)
    settled = test.settled.T
    off = {(p, k): R[-1] for p, k, R in bends}
    for p in sorted({p for p, _ in off} | set(np.flatnonzero(extra.any(axis=(1, 2))).tolist())):
        for k in range(q.shape[1]):
            now = np.zeros(2 * faults)
            if (p, k) in off:
                now[:faults] = _inner(off[p, k], q[p, k]) - _inner(settled, q[p, k])
                now[faults:] = _squares(off[p, k]) - _squares(settled)
            extra[p, :-1] = extra[p, 1:]
            extra[p, -1] = now
            total = np.cumsum(extra[p], axis=0)[-1]
            products[p, k] += total[:faults]
            weights[p, k] = np.maximum(weights[p, k] + total[faults:], 0.0)
    return products, weights, replace(state, extra=extra if extra.any() else np.broadcast_to(0.0, extra.shape))


def _inner(rows: NDArray, q: NDArray) -> NDArray[np.float64]:
    """Return the product of each row with a residual, added in order."""
    total = np.zeros(rows.shape[:-1])
    for j in range(rows.shape[-1]):
        total = total + rows[..., j] * q[j]
    return total


def _along_arrivals(steps: NDArray, before: NDArray) -> tuple[NDArray, NDArray]:
    """Add up the terms of one arrival, into ``steps``: age ``k`` now was age ``k - 1`` a sample ago."""
    if steps.shape[2]:
        for k in range(1, len(steps)):
            steps[k, :, 0] += before[:, k - 1]
            steps[k, :, 1:] += steps[k - 1, :, :-1]
        before = np.moveaxis(steps[:, :, -1], 0, 1).copy()
    return steps, before


def _likelihood(products: NDArray, weights: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    """Return likelihood ratio, size and deviation; 0, NaN and infinity if no part of the response was seen."""
    present = weights > 0
    safe = np.where(present, weights, 1.0)
    return (
        _ratios(products, weights),
        np.where(present, products / safe, np.nan),
        np.where(present, 1 / np.sqrt(safe), np.inf),
    )


def _ratios(products: NDArray, weights: NDArray) -> NDArray[np.float64]:
    """Return the likelihood ratio; 0 if no part of the response was seen."""
    present = weights > 0
    return np.where(present, products * products / np.where(present, weights, 1.0), 0.0)


def _squares(rows: NDArray) -> NDArray[np.float64]:
    """Return the squared norm of each row, its squares added in order."""
    total = np.zeros(rows.shape[:-1])
    for j in range(rows.shape[-1]):
        total = total + rows[..., j] * rows[..., j]
    return total


# ----------------------------------------------------------- the attribution of an alarm


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
    all_samples, all_faults = (plants, time), (plants, time, faults)
    return Match(
        ratios=np.zeros(all_faults),
        ages=np.full(all_faults, -1, dtype=np.int64),
        sizes=np.full(all_faults, np.nan),
        deviations=np.full(all_faults, np.inf),
        settled_sizes=np.full(all_faults, np.nan),
        fault=np.full(all_samples, -1, dtype=np.int64),
        arrival=np.full(all_samples, np.nan),
        source=np.full(all_samples, -1, dtype=np.int64),
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
        True if one stands.
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
        named = ~np.isnan(fault)
        right = (
            np.isnan(self.held[~self.on]).all()
            and _are_whole(fault[named], 0, faults)
            and np.array_equal(named, ~np.isnan(source))
            and _are_whole(source[named], 0, count)
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
        From :func:`match_block`.
    alarm, over : ndarray of bool, shape (plants, time)
        Masks of samples in alarm, and of those at which the statistic of a usable sample is over its threshold.
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
    dated = judged & (arrival <= raised) & (ratio >= peak - _FALLEN * np.sqrt(peak))
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
