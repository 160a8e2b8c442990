"""The generator on a block of samples: starts, gaps, values to put aside, and states that are no numbers any more.

Everything gives the same bits however the time axis is cut: what is decided here depends on the samples so far alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from residua.linear.recursion import ordered_product, run_filter

if TYPE_CHECKING:
    from residua.monitor.running import Specification, State

#: A residual beyond is one of a filter that overflows.
_LARGEST = 1e150
#: What the filter changes of a running monitor's state.
_FIELDS = ("x", "held", "gap", "running", "age", "resets", "broken")


@dataclass(frozen=True, eq=False)
class Filtered:
    """What the filter made of a block; every array starts with (plants, time).

    Attributes
    ----------
    residuals : NaN where a value is missing; usable : whether a decision can be taken; missing : whether a value is
    not there; aside : for each channel whether there was one that is not plausible.
    """

    residuals: NDArray[np.float64]
    usable: NDArray[np.bool_]
    missing: NDArray[np.bool_]
    aside: NDArray[np.bool_]


def filter_block(spec: Specification, state: State, data: NDArray) -> tuple[dict[str, NDArray], Filtered]:
    """Run the generator; samples with missing values advance it with held values and yield no residual.

    Returns
    -------
    fields : dict
        What changes of the state.
    found : Filtered
    """
    v, missing, aside = plausible_values(spec, data)
    plants, time, _ = v.shape
    residuals = np.full((plants, time, len(spec.C)), np.nan)
    ages = np.zeros((plants, time), dtype=np.int64)
    fields = {name: getattr(state, name).copy() for name in _FIELDS}
    rest = np.ones(plants, dtype=bool)
    if time:
        rest = np.asarray(missing.any(axis=1))
        rest[_filter_whole(spec, fields, ~rest, v, residuals, ages)] = True
    for p in np.flatnonzero(rest):
        for name in _FIELDS:
            fields[name][p] = getattr(state, name)[p]
        residuals[p], ages[p] = np.nan, 0
        _filter_with_gaps(spec, fields, int(p), v[p], missing[p], residuals[p], ages[p])
    return fields, Filtered(residuals, ~missing & (ages > spec.settle), missing, aside)


def plausible_values(
    spec: Specification, data: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_]]:
    """Return deviations, NaN where there is no plausible value; where one is missing; and which were put aside."""
    with np.errstate(over="ignore"):
        v = data - spec.offset
    low, high = spec.plausible.T
    if not v.size or (v.min() >= low.max() and v.max() <= high.min()):  # as a rule; false for NaN
        return v, np.zeros(v.shape[:2], dtype=bool), np.broadcast_to(False, v.shape)
    there = np.asarray((v >= low) & (v <= high))
    if there.all():
        return v, np.zeros(v.shape[:2], dtype=bool), np.broadcast_to(False, v.shape)
    return np.where(there, v, np.nan), ~np.asarray(there.all(axis=2)), np.asarray(np.isfinite(data) & ~there)


def _filter_whole(
    spec: Specification,
    fields: dict[str, NDArray],
    whole: NDArray[np.bool_],
    v: NDArray,
    residuals: NDArray,
    ages: NDArray[np.int64],
) -> NDArray[np.int64]:
    """Run the plants of which no value is missing in a block; return those whose filter overflowed."""
    fresh = whole & ~fields["running"]
    if fresh.any():
        _start(spec, fields, fresh, v[fresh, 0])
    every = bool(whole.all())
    which = slice(None) if every else np.flatnonzero(whole)
    if not every and not whole.any():
        return np.zeros(0, dtype=np.int64)
    x, r = run_filter(spec.A, spec.B, spec.C, spec.D, fields["x"][which], v[which])
    fields["x"][which], residuals[which] = x, r
    fields["held"][which], fields["gap"][which] = v[which, -1], 0
    ages[which] = fields["age"][which, None] + np.arange(1, v.shape[1] + 1)
    fields["age"][which] += v.shape[1]
    if np.isfinite(x).all() and (not r.size or (r.min() >= -_LARGEST and r.max() <= _LARGEST)):  # false for NaN
        return np.zeros(0, dtype=np.int64)
    sound = np.isfinite(x).all(axis=1) & (np.abs(r) <= _LARGEST).all(axis=(1, 2))
    return np.flatnonzero(whole)[~sound]


def _start(spec: Specification, fields: dict[str, NDArray], which: NDArray[np.bool_] | int, v: NDArray) -> None:
    """Start filters with their first complete sample, as if they had settled to it."""
    fields["x"][which] = ordered_product(v, spec.start.T)
    fields["running"][which] = True
    fields["age"][which] = fields["gap"][which] = 0


def _filter_with_gaps(
    spec: Specification,
    fields: dict[str, NDArray],
    p: int,
    v: NDArray,
    missing: NDArray[np.bool_],
    residuals: NDArray,
    ages: NDArray[np.int64],
) -> None:
    """Run one plant over a block with gaps, piece by piece; writes into ``fields`` and the outputs."""
    time = len(v)
    filled = _hold(v, fields["held"][p])
    k = 0
    while k < time:
        fresh = not fields["running"][p]
        if fresh:
            complete = np.flatnonzero(~missing[k:])
            if complete.size == 0:
                fields["gap"][p] += time - k
                break
            k += int(complete[0])
            _start(spec, fields, p, filled[k])
        stop, gap = _end_of_piece(missing, k, int(fields["gap"][p]), spec.max_hold)
        x, r = run_filter(spec.A, spec.B, spec.C, spec.D, fields["x"][p][None], filled[None, k:stop])
        lost = np.flatnonzero(
            ~(np.abs(r[0]) <= _LARGEST).all(axis=1)
        )  # a state that is not finite shows in all residuals
        if lost.size:
            stop = k + int(lost[0])
        residuals[k:stop] = np.where(missing[k:stop, None], np.nan, r[0, : stop - k])
        if stop > k:
            _count_ages(fields, p, missing[k:stop], ages[k:stop])
        if lost.size or not np.isfinite(x).all():
            fields["running"][p], fields["x"][p], fields["gap"][p] = False, 0.0, 0
            fields["broken"][p] += 1
            k = stop + int(fresh and stop == k)  # a sample that overflows by itself, from a start, is passed over
            continue
        fields["x"][p], fields["gap"][p] = x[0], gap
        if stop < time:  # the gap became too long: stop the filter until a complete sample comes
            fields["running"][p] = False
            fields["resets"][p] += 1
        k = stop
    if time:
        fields["held"][p] = filled[-1]


def _count_ages(fields: dict[str, NDArray], p: int, missing: NDArray[np.bool_], ages: NDArray[np.int64]) -> None:
    """Write the samples since the start, or since the last held value."""
    count = np.arange(1, len(missing) + 1)
    ages[:] = count - np.maximum.accumulate(np.where(missing, count, -fields["age"][p]))
    fields["age"][p] = ages[-1]


def _hold(v: NDArray, held: NDArray) -> NDArray:
    """Return the samples with missing values replaced by the last value of their channel."""
    rows = np.where(np.isfinite(v), np.arange(1, len(v) + 1)[:, None], 0)
    return np.take_along_axis(np.vstack([held, v]), np.maximum.accumulate(rows, axis=0), axis=0)


def _end_of_piece(missing: NDArray[np.bool_], k: int, gap: int, max_hold: int) -> tuple[int, int]:
    """Return where the running filter has to stop (first sample of a gap that is too long) and the gap there."""
    rest = missing[k:]
    count = np.arange(1, len(rest) + 1)
    run = count - np.maximum.accumulate(np.where(rest, -gap, count))
    too_long = np.flatnonzero(run > max_hold)
    if too_long.size:
        return k + int(too_long[0]), int(run[too_long[0]]) - 1
    return k + len(rest), int(run[-1]) if len(rest) else gap
