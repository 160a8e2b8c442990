"""The generator on a block of samples of many plants: in groups of equal treatment, those with gaps one by one.

Everything gives the same bits however the time axis is cut: what is decided here depends on the samples so far alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from residua.decide.persistence import stopped
from residua.linear.systems.recursion import ordered_product, run_filter
from residua.monitor.one_plant import FIELDS, LARGEST, SELDOM, OnePlant
from residua.monitor.specification import FilterState, Specification


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
