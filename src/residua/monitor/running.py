"""The arithmetic of a monitor in NumPy: a pure function from state and data to state and decisions.

Everything here is vectorised over plants, those with gaps one by one, and gives the same bits however the time axis is
cut: what is decided depends on the samples so far alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.decide.isolation import Scores
from residua.decide.matched_recursion import Match
from residua.decide.persistence import LAST_COUNT, stopped
from residua.decide.test import Block, Tested
from residua.linear.systems.recursion import ordered_product, run_filter
from residua.monitor.partial_update import empty_partial
from residua.monitor.plant_records import mapped, rows_of
from residua.monitor.specification import FilterState, Specification

#: A residual beyond is one of a filter that overflows.
LARGEST = 1e150
#: Fields of a running monitor's state that the filter changes.
FIELDS = ("x", "held", "gap", "running", "age", "resets", "broken", "starting", "start_sums", "moved", "apart")
#: Likewise, and zero for all plants as a rule: how a Kalman filter is off its stationary one.
SELDOM = ("spread", "bent")
#: Counters of these that stop.
_COUNTERS = ("gap", "age")

_Bends = list[tuple[int, NDArray[np.float64]]]


@dataclass(eq=False)
class OnePlant:
    """The filter of one plant; see :class:`residua.monitor.specification.FilterState`.

    Its counters are whole numbers of any size; what is kept of them is :meth:`field`.
    """

    x: NDArray[np.float64]
    held: NDArray[np.float64]
    gap: int
    running: bool
    age: int
    resets: int
    broken: int
    starting: bool
    start_sums: NDArray[np.float64]
    moved: float
    apart: bool
    spread: NDArray[np.float64]
    bent: NDArray[np.float64]

    @staticmethod
    def of(state: FilterState, plant: int) -> OnePlant:
        """Return the filter of a plant."""
        kept: dict[str, Any] = {name: getattr(state, name)[plant] for name in (*FIELDS, *SELDOM)}
        for name in _COUNTERS:
            kept[name] = int(kept[name])
        return OnePlant(**kept)

    def field(self, name: str) -> Any:
        """Return a field as kept in the state."""
        value = getattr(self, name)
        return min(value, LAST_COUNT) if name in _COUNTERS else value

    def run(self, spec: Specification, v: NDArray, residuals: NDArray, ages: NDArray[np.int64]) -> _Bends:
        """Run over a block, NaN where values are missing; writes into the outputs, and returns the bends."""
        signals = _signals(spec, v, self.held)
        residuals[:], ages[:] = np.nan, 0
        bends: _Bends = []
        k, time = 0, len(v)
        while k < time:
            fresh = not self.running
            if fresh:
                whole = np.flatnonzero(signals.whole[k:])
                if not whole.size:
                    self.gap += time - k
                    break
                k += int(whole[0])
                self._start(spec, signals.filled[k])
            stop, gap = _end_of_piece(signals.blank, k, int(self.gap), spec.max_hold)
            r, changes, broken, known = self._piece_until_lost(spec, signals.cut(k, stop), ages[k:stop])
            bends += [(k + i, R) for i, R in changes]
            stop_now = k + len(r)
            residuals[k:stop_now] = np.where(signals.whole[k:stop_now, None], r, np.nan)
            if broken:
                self._stop()
                self.broken, self.gap = self.broken + 1, 0
            elif not known:  # so little is known of the state that a new start is better
                self._stop()
                self.resets, self.gap = self.resets + 1, 0
            else:
                self.gap = gap
                if stop < time:  # the gap became too long: stop the filter until a complete sample comes
                    self._stop()
                    self.resets += 1
            k = stop_now + int(fresh and stop_now == k)  # a sample that overflows by itself, from a start: pass it over
        self.held = signals.filled[-1, : spec.held]
        return bends

    def _start(self, spec: Specification, v: NDArray) -> None:
        """Start with a complete sample, as if the filter had settled to it."""
        self._stop()
        self.x = ordered_product(v, spec.start.T)
        self.running, self.starting = True, spec.first is not None
        self.age = self.gap = 0

    def _stop(self) -> None:
        self.running = self.starting = self.apart = False
        self.x, self.start_sums = np.zeros_like(self.x), np.zeros_like(self.start_sums)
        self.spread, self.bent = np.zeros_like(self.spread), np.zeros_like(self.bent)

    def _piece_until_lost(
        self, spec: Specification, signals: _Signals, ages: NDArray[np.int64]
    ) -> tuple[NDArray, _Bends, bool, bool]:
        """Run over an uninterrupted piece; return residuals up to an overflow, if there is one.

        And the bends, whether it overflowed, and whether enough is known of the state to go on.
        """
        before = replace(self)
        r, bends, known = self._piece(spec, signals, ages)
        lost = np.flatnonzero(~(np.abs(r) <= LARGEST).all(axis=1))  # a state that is not finite shows in all residuals
        if not lost.size:
            return r, bends, not np.isfinite(self.x).all(), known
        for name in (*FIELDS, *SELDOM):
            setattr(self, name, getattr(before, name))
        ages[:] = 0
        r, bends, _ = self._piece(spec, signals.cut(0, int(lost[0])), ages[: lost[0]])
        return r, bends, True, True

    def _piece(self, spec: Specification, signals: _Signals, ages: NDArray[np.int64]) -> tuple[NDArray, _Bends, bool]:
        """Run over an uninterrupted piece, unless too little is known of the state after a sample.

        In parts: one sample where a Kalman filter has not its stationary gain, or where a start has to be estimated
        anew; else up to the next such sample, or to where the start is known.
        """
        time = len(signals.filled)
        r, bends = np.empty((time, len(spec.C))), []
        i = 0
        while i < time:
            if spec.partial is not None and (self.apart or not signals.whole[i]):
                r[i], response, known = self._sample(spec, signals, i)
                if response is not None:
                    bends.append((i, response))
                self.age = ages[i] = self.age + 1
                i += 1
                if not known:
                    return r[:i], bends, False
                continue
            j = self._end_of_part(spec, signals, i)
            x, part = run_filter(spec.A, spec.B, spec.C, spec.D, self.x[None], signals.filled[None, i:j])
            self.x, r[i:j] = x[0], part[0]
            if self.starting:
                self._learn_start(spec, part, bool(signals.upset[i]))
            self._count(signals.upset[i:j], ages[i:j])
            if spec.first is not None and self.starting and self.age == spec.first.samples:
                x, far = spec.first.corrected(self.x[None], self.start_sums[None])
                self.x, self.moved = x[0], max(self.moved, float(far[0]))
                self.starting, self.start_sums = False, np.zeros_like(self.start_sums)
            i = j
        return r, bends, True

    def _end_of_part(self, spec: Specification, signals: _Signals, i: int) -> int:
        """Return the end of the stretch with a stationary gain and no start to estimate."""
        ends = [len(signals.filled)]
        if spec.partial is not None:
            ends += (i + np.flatnonzero(~signals.whole[i:])[:1]).tolist()
        if self.starting and spec.first is not None:
            ends += [i + 1] if signals.upset[i] else (i + np.flatnonzero(signals.upset[i:])[:1]).tolist()
            ends += [] if signals.upset[i] else [i + spec.first.samples - int(self.age)]
        return min(ends)

    def _learn_start(self, spec: Specification, r: NDArray, upset: bool) -> None:
        """Update the estimate of the start by a residual; a held value begins a new estimate."""
        assert spec.first is not None
        if upset:
            self.start_sums = np.zeros_like(self.start_sums)
        else:
            self.start_sums = spec.first.add(self.start_sums[None], r, int(self.age))[0]

    def _sample(self, spec: Specification, signals: _Signals, i: int) -> tuple[NDArray, NDArray | None, bool]:
        """Run a Kalman filter over one sample with the values that are available, by the gain for them.

        Return the innovation, in units of the stationary one where it is whole; the responses that faults have in it,
        where they are matched; and whether enough is known of the state afterwards.
        """
        partial = spec.partial
        assert partial is not None
        if self.starting:  # nothing is known of the state: the recursion finds out, from here on
            self.starting, self.start_sums = False, np.zeros_like(self.start_sums)
            self.spread = partial.unknown
        whole, response = bool(signals.whole[i]), None
        gain = partial.gain(self.spread, signals.there[i], signals.given[i])
        if whole and not self.spread.any():
            x, part = run_filter(spec.A, spec.B, spec.C, spec.D, self.x[None], signals.filled[None, i : i + 1])
            self.x, r = x[0], part[0, 0]
        else:
            self.x, r = partial.advance(gain, self.x, signals.filled[i])
        if self.bent.size:
            if whole:
                response = partial.responses(gain, self.bent)
            self.bent = partial.bend(gain, self.bent)
        self.spread = gain.covariance
        self.apart = bool(self.spread.any() or self.bent.any())
        return r, response, not gain.lost

    def _count(self, upset: NDArray[np.bool_], ages: NDArray[np.int64]) -> None:
        """Write the samples since the start, or since the last held value."""
        count = np.arange(1, len(upset) + 1)
        ages[:] = count - np.maximum.accumulate(np.where(upset, count, -self.age))
        self.age = int(ages[-1])


@dataclass(frozen=True, eq=False)
class _Signals:
    """A block of one plant: values with missing ones held, and masks of missing values at each sample.

    ``there``: each output that can be used; ``given``: each input; ``whole``: all channels; ``blank``: nothing that the
    filter could be corrected by; ``upset``: whether a value was held for the filter, which then has to settle again.
    """

    filled: NDArray[np.float64]
    there: NDArray[np.bool_]
    given: NDArray[np.bool_]
    whole: NDArray[np.bool_]
    blank: NDArray[np.bool_]
    upset: NDArray[np.bool_]

    def cut(self, start: int, stop: int) -> _Signals:
        """Return the signals of some samples."""
        names = ("filled", "there", "given", "whole", "blank", "upset")
        return _Signals(*(getattr(self, name)[start:stop] for name in names))


def _signals(spec: Specification, v: NDArray, held: NDArray) -> _Signals:
    """Return the signals of a block; ``held`` are the last values before it."""
    finite = np.isfinite(v)
    whole = np.asarray(finite.all(axis=1))
    there = given = finite
    upset = blank = ~whole
    if spec.partial is not None:
        inputs = spec.partial.B.shape[1]
        given = finite[:, :inputs]
        moved = (~given) @ (spec.partial.D != 0).T  # at once, by an input that is missing
        there = finite[:, inputs:] & ~moved
        blank, upset = ~there.any(axis=1), np.zeros_like(whole)
    filled = _hold(v[:, : spec.held], held)
    if spec.held < v.shape[1]:  # the gain takes no notice of outputs that are missing
        filled = np.hstack([filled, np.where(finite[:, spec.held :], v[:, spec.held :], 0.0)])
    return _Signals(filled, there, given, whole, np.asarray(blank), upset)


def _hold(v: NDArray, held: NDArray) -> NDArray:
    """Return the samples with missing values replaced by the last value of their channel."""
    rows = np.where(np.isfinite(v), np.arange(1, len(v) + 1)[:, None], 0)
    return np.take_along_axis(np.vstack([held, v]), np.maximum.accumulate(rows, axis=0), axis=0)


def _end_of_piece(blank: NDArray[np.bool_], k: int, gap: int, max_hold: int) -> tuple[int, int]:
    """Return the sample at which the filter has to stop, the first of a gap that is too long, and the gap there."""
    rest = blank[k:]
    count = np.arange(1, len(rest) + 1)
    run = count - np.maximum.accumulate(np.where(rest, -gap, count))
    too_long = np.flatnonzero(run > max_hold)
    if too_long.size:
        return k + int(too_long[0]), int(run[too_long[0]]) - 1
    return k + len(rest), int(run[-1]) if len(rest) else gap


@dataclass(frozen=True, eq=False)
class Filtered:
    """Result of the filter on a block; every array starts with (plants, time).

    Attributes
    ----------
    residuals : NaN where a value is missing; usable : whether a decision can be taken; missing : whether a value is
    not there; aside : for each channel whether there was one that is not plausible; bends : where faults have other
    responses for a while, since outputs were missing: plant, sample, and the responses of whitened residuals by age,
    (ages + 1, faults, residuals), the settled one last; signals : deviations, NaN where a value is missing.
    """

    residuals: NDArray[np.float64]
    usable: NDArray[np.bool_]
    missing: NDArray[np.bool_]
    aside: NDArray[np.bool_]
    bends: tuple[tuple[int, int, NDArray[np.float64]], ...] = ()
    signals: NDArray[np.float64] | None = None


def filter_block(spec: Specification, state: FilterState, data: NDArray[np.float64]) -> tuple[FilterState, Filtered]:
    """Run the generator over a block; return the next state, and the residuals."""
    changed, filtered = _filter_block(spec, state, data)
    return replace(state, **changed), filtered


def _filter_block(
    spec: Specification, state: FilterState, data: NDArray[np.float64]
) -> tuple[dict[str, NDArray], Filtered]:
    v, missing, aside = plausible_values(spec, data)
    plants, time, _ = v.shape
    before = {name: getattr(state, name) for name in FIELDS}
    if not time:
        return {}, Filtered(np.zeros((plants, 0, len(spec.C))), missing, missing, aside, signals=v)
    calm = ~(np.asarray(missing.any(axis=1)) | state.apart)
    every = bool(calm.all())
    who = np.flatnonzero(calm)
    fields, residuals, ages = _run_calm(spec, before if every else _of(before, who), v if every else v[who])
    sound = _sound(fields["x"], residuals)
    if every and sound.all():
        return fields, Filtered(residuals, ages > spec.settle, missing, aside, signals=v)
    part, plain = (_of(fields, sound), residuals[sound], ages[sound]), who[sound]
    fields = {name: values.copy() for name, values in before.items()}
    residuals, ages = np.full((plants, time, len(spec.C)), np.nan), np.zeros((plants, time), dtype=np.int64)
    for name, values in part[0].items():
        fields[name][plain] = values
    residuals[plain], ages[plain] = part[1:]
    bends = _run_one_by_one(spec, state, fields, np.setdiff1d(np.arange(plants), plain), v, residuals, ages)
    return fields, Filtered(residuals, ~missing & (ages > spec.settle), missing, aside, bends, v)


def plausible_values(
    spec: Specification, data: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_]]:
    """Return deviations, NaN without a plausible value; masks of missing values and of those put aside."""
    with np.errstate(over="ignore"):
        v = data - spec.offset
    low, high = spec.plausible.T
    if not v.size or (v.min() >= low.max() and v.max() <= high.min()):  # as a rule; false for NaN
        return v, np.zeros(v.shape[:2], dtype=bool), np.broadcast_to(False, v.shape)
    there = np.asarray((v >= low) & (v <= high))
    if there.all():
        return v, np.zeros(v.shape[:2], dtype=bool), np.broadcast_to(False, v.shape)
    return np.where(there, v, np.nan), ~np.asarray(there.all(axis=2)), np.asarray(np.isfinite(data) & ~there)


def _of(fields: dict[str, NDArray], who: NDArray) -> dict[str, NDArray]:
    return {name: values[who] for name, values in fields.items()}


def _sound(x: NDArray, residuals: NDArray) -> NDArray[np.bool_]:
    """Return for each plant whether its filter is free of overflow."""
    if np.isfinite(x).all() and (not residuals.size or (residuals.min() >= -LARGEST and residuals.max() <= LARGEST)):
        return np.ones(len(x), dtype=bool)
    return np.asarray(np.isfinite(x).all(axis=1) & (np.abs(residuals) <= LARGEST).all(axis=(1, 2)))


def _run_calm(
    spec: Specification, before: dict[str, NDArray], v: NDArray
) -> tuple[dict[str, NDArray], NDArray, NDArray[np.int64]]:
    """Run plants without missing values; return their fields, residuals, and samples since the start."""
    fields = dict(before)
    if not before["running"].all():
        _start(spec, fields, v)
    ages = fields["age"][:, None] + np.arange(1, v.shape[1] + 1)
    fields["held"], fields["gap"] = v[:, -1, : spec.held].copy(), np.zeros_like(before["gap"])
    if fields["starting"].any():
        residuals = _run_starting(spec, fields, v)
    else:
        fields["x"], residuals = run_filter(spec.A, spec.B, spec.C, spec.D, fields["x"], v)
    fields["age"] = stopped(ages[:, -1])
    return fields, residuals, ages


def _start(spec: Specification, fields: dict[str, NDArray], v: NDArray) -> None:
    """Start the filters that are not running with their first sample, as if they had settled to it."""
    fresh = ~fields["running"]
    x, sums, starting = (fields[name].copy() for name in ("x", "start_sums", "starting"))
    x[fresh], sums[fresh] = ordered_product(v[fresh, 0], spec.start.T), 0.0
    starting[fresh] = spec.first is not None
    fields |= {"x": x, "start_sums": sums, "starting": starting}
    fields |= {"age": np.where(fresh, np.int32(0), fields["age"]), "running": np.ones(len(x), dtype=bool)}


def _run_starting(spec: Specification, fields: dict[str, NDArray], v: NDArray) -> NDArray[np.float64]:
    """Run plants some of which have just started: in groups by age, each up to the correction of its start."""
    assert spec.first is not None
    x, sums, starting, moved = (fields[name].copy() for name in ("x", "start_sums", "starting", "moved"))
    groups = np.where(starting, fields["age"], -1)
    residuals = np.empty((*v.shape[:2], len(spec.C)))
    for age in np.unique(groups):
        who = np.flatnonzero(groups == age)
        cut = 0 if age < 0 else min(v.shape[1], spec.first.samples - int(age))
        if age >= 0:
            x[who], residuals[who, :cut] = run_filter(spec.A, spec.B, spec.C, spec.D, x[who], v[who, :cut])
            sums[who] = spec.first.add(sums[who], residuals[who, :cut], int(age))
            if cut == spec.first.samples - age:
                x[who], far = spec.first.corrected(x[who], sums[who])
                moved[who], sums[who], starting[who] = np.maximum(moved[who], far), 0.0, False
        if cut < v.shape[1]:
            x[who], residuals[who, cut:] = run_filter(spec.A, spec.B, spec.C, spec.D, x[who], v[who, cut:])
    fields |= {"x": x, "start_sums": sums, "starting": starting, "moved": moved}
    return residuals


def _run_one_by_one(
    spec: Specification,
    state: FilterState,
    fields: dict[str, NDArray],
    who: NDArray[np.int64],
    v: NDArray,
    residuals: NDArray,
    ages: NDArray[np.int64],
) -> tuple[tuple[int, int, NDArray[np.float64]], ...]:
    """Run plants with gaps; writes into ``fields`` and the outputs, and returns the bends of all."""
    bends, after = [], {}
    for p in who.tolist():
        one = OnePlant.of(state, p)
        bends += [(p, k, R) for k, R in one.run(spec, v[p], residuals[p], ages[p])]
        for name in FIELDS:
            fields[name][p] = one.field(name)
        after[p] = one
    if fields["apart"].any() or state.apart.any():  # else these are zero, and stay so
        for name in SELDOM:
            values = getattr(state, name)
            if not fields["apart"].any():
                fields[name] = np.broadcast_to(0.0, values.shape)  # takes no memory
                continue
            fields[name] = values.copy()
            for p, one in after.items():
                fields[name][p] = getattr(one, name)
    return tuple(bends)


#: Responses that are held at once, in numbers.
_MOST_NUMBERS = 10**7


@dataclass(frozen=True, eq=False)
class State:
    """State of a running monitor.

    Attributes
    ----------
    filter : FilterState
    test, isolation : dataclass
        As the test and the isolation have it.
    count : ndarray of int, shape (plants,)
        Samples so far.
    """

    filter: FilterState
    test: Any
    isolation: Any
    count: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Decisions:
    """Decisions of a monitor on a block; every array starts with (plants, time), or (time,) for one plant.

    Attributes
    ----------
    residuals, statistic, exceeded, alarm, up, usable, missing : ndarray
    scores : ndarray, shape (plants, time, groups)
        Correlation with the signature of each group, or the fraction of the members of a bank that agree with its
        code; NaN where nothing can be said.
    member_statistics : ndarray, shape (plants, time, members)
        Statistic of each member of a bank, or group of residuals; ``statistic`` is then the largest ratio of one to its
        threshold.
    fired : ndarray of bool, shape (plants, time, members)
        Which members are in alarm.
    code : ndarray of bool, shape (plants, time, members)
        Which members count as fired over the window: what :func:`residua.decide.read_codes` reads. Of a dedicated bank
        with :class:`residua.decide.PeakThreshold`, which has a window of its own, those in alarm.
    aside : ndarray of bool, shape (plants, time, channels)
        Which values are not plausible, and were taken as missing.
    match : Match or None
        Of matched filters: likelihood ratio, arrival and size of every fault.
    tested : Tested
        Results of the test.
    named : Scores
        Results of the isolation.
    """

    residuals: NDArray[np.float64]
    missing: NDArray[np.bool_]
    aside: NDArray[np.bool_]
    tested: Tested
    named: Scores

    @property
    def statistic(self) -> NDArray[np.float64]:
        """Statistic of the test."""
        return self.tested.statistic

    @property
    def exceeded(self) -> NDArray[np.bool_]:
        """True where the statistic is over its threshold."""
        return self.tested.exceeded

    @property
    def alarm(self) -> NDArray[np.bool_]:
        """True while an alarm stands."""
        return self.tested.alarm

    @property
    def up(self) -> NDArray[np.int64]:
        """Samples in a row over the threshold."""
        return self.tested.up

    @property
    def usable(self) -> NDArray[np.bool_]:
        """True where there is a decision."""
        return self.tested.usable

    @property
    def scores(self) -> NDArray[np.float64]:
        """Scores of the isolation."""
        return self.named.scores

    @property
    def member_statistics(self) -> NDArray[np.float64]:
        """Statistics of the parts tested separately."""
        return self.tested.part_statistics

    @property
    def fired(self) -> NDArray[np.bool_]:
        """True where a part tested separately is in alarm."""
        return self.tested.fired

    @property
    def code(self) -> NDArray[np.bool_]:
        """Mask of the members that count as fired; no columns if no code is read."""
        code = self.named.code
        return np.zeros((*self.usable.shape, 0), dtype=bool) if code is None else code

    @property
    def match(self) -> Match | None:
        """Match of matched filters."""
        return self.named.match

    def of(self, plant: int) -> Decisions:
        """Return the decisions of one plant."""
        return rows_of(self, plant)


def joined_decisions(parts: Sequence[Decisions]) -> Decisions:
    """Return the decisions on consecutive blocks as those on one."""
    return parts[0] if len(parts) == 1 else mapped(lambda *blocks: np.concatenate(blocks, axis=1), *parts)


def initial_state(spec: Specification, plants: int) -> State:
    """Return the state before the first sample."""
    n = len(spec.A)
    whole, counter = np.zeros(plants, dtype=np.int64), np.zeros(plants, dtype=np.int32)
    flag, restarts = np.zeros(plants, dtype=bool), np.broadcast_to(np.int64(0), plants)
    filtered = FilterState(
        x=np.zeros((plants, n)),
        held=np.zeros((plants, spec.held)),
        gap=counter,
        running=flag,
        age=counter,
        resets=restarts,
        broken=restarts,
        starting=flag,
        start_sums=np.broadcast_to(0.0, (plants, 0 if spec.first is None else n)),
        moved=np.broadcast_to(0.0, plants),
        apart=flag,
        **empty_partial(spec.partial, plants),
    )
    return State(filtered, spec.test.start(plants), spec.isolation.start(plants), whole)


def run_reference(spec: Specification, state: State, data: NDArray[np.float64]) -> tuple[State, Decisions]:
    """Run filter, test and isolation over a block of samples, in NumPy: the reference for the fused loop.

    Parameters
    ----------
    spec : Specification
    state : State
    data : ndarray, shape (plants, time, channels)
        Control inputs, then outputs, in plant units; NaN or infinity where a value is missing.

    Returns
    -------
    state : State
        To go on with.
    decisions : Decisions
    """
    step = _longest_block(spec, state, data)
    if step >= data.shape[1]:
        return _run_at_once(spec, state, data)
    parts: list[Decisions] = []
    for start in range(0, data.shape[1], step):
        state, part = _run_at_once(spec, state, data[:, start : start + step])
        parts.append(part)
    return state, joined_decisions(parts)


def _run_at_once(spec: Specification, state: State, data: NDArray[np.float64]) -> tuple[State, Decisions]:
    filter_state, filtered = filter_block(spec, state.filter, data)
    return judged(spec, state, filter_state, filtered)


def judged(
    spec: Specification, state: State, filter_state: FilterState, filtered: Filtered, *, name: bool = True
) -> tuple[State, Decisions]:
    """Run the test, and with ``name`` the isolation, on the filtered block."""
    block = Block(filtered.residuals, filtered.usable, state.count, filtered.bends, filtered.signals)
    test, tested = spec.test.run(state.test, block)
    isolation, named = state.isolation, Scores(np.zeros((*filtered.usable.shape, 0)))
    if name:
        isolation, named = spec.isolation.run(state.isolation, block, tested)
    if tested.likelihood is not None:  # already read by the isolation
        tested = replace(tested, likelihood=None)
    if filtered.usable.shape[1]:
        state = State(filter_state, test, isolation, state.count + filtered.usable.shape[1])
    return state, Decisions(filtered.residuals, filtered.missing, filtered.aside, tested, named)


def _longest_block(spec: Specification, state: State, data: NDArray[np.float64]) -> int:
    """Return the number of samples to run at once, limited by the memory of matched filters with missing outputs."""
    if spec.test.responses is None or spec.partial is None or data.shape[1] < 2:
        return data.shape[1]
    low, high = (spec.plausible + spec.offset[:, None]).T
    if not state.filter.apart.any() and ((data >= low) & (data <= high)).all():
        return data.shape[1]
    return max(1, _MOST_NUMBERS // max(1, state.filter.bent.size))
