"""The generator on a block of samples of one plant: gaps, restarts, and a Kalman filter with some of its values."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.decide.persistence import LAST_COUNT
from residua.linear.systems.recursion import ordered_product, run_filter
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
