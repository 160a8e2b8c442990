"""From raw decisions to a diagnosis: alarms with onsets and ranked candidates."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.decide.matched_hold import joined_matches
from residua.decide.member_thresholds import BankTest
from residua.decide.norm_threshold import NormTest
from residua.decide.peak_tests import CERTIFIED
from residua.decide.residual_groups import GroupTest
from residua.design import ResidualGenerator
from residua.design.banks.matched_filters import not_settled
from residua.monitor.alarm import Alarm
from residua.monitor.bands import residual_bands
from residua.monitor.beginning import with_beginnings
from residua.monitor.cautions import MemberBounds, leakage_cautions, unit_cautions
from residua.monitor.dedicated import named_faults, named_pattern, present_faults
from residua.monitor.diagnosis import Diagnosis
from residua.monitor.inputs import settling_reason
from residua.monitor.matched_naming import named_by_match, settled_bases
from residua.monitor.naming import candidates_at, candidates_of_code, longest_code, sizes_over, with_sizes
from residua.monitor.running import Decisions, Specification
from residua.monitor.settings_text import settings_of
from residua.robust.estimators.certified_threshold import AFFINE_FORM

#: Part of its threshold that the residual is moved by before it is said.
_TOLD = 0.1


@dataclass(frozen=True, eq=False)
class Recorded:
    """The recording of one plant: times, inputs and outputs, where from, since when, and what the filter predicts."""

    time: NDArray[np.float64]
    signals: NDArray[np.float64]
    source: str
    origin: str
    compared: tuple[tuple[int, int], ...]


def compared_outputs(design: ResidualGenerator) -> tuple[tuple[int, int], ...]:
    """Return the residuals that are an output less its prediction, as pairs (residual, output), each output once.

    Those are the residuals that take just one output as it is measured now: all else is made of what was before. A
    continuous design that was sampled is judged by what it was.
    """
    now = design.system.D[:, len(design.plant.inputs) :]
    found: dict[int, int] = {}
    for i, row in enumerate(now):
        if np.count_nonzero(row) == 1 and row.max() == 1.0 and not (design.estimated and design.estimated[i]):
            found.setdefault(int(row.argmax()), i)
    return tuple((i, j) for j, i in sorted(found.items()))


def diagnosis_from(
    parts: Sequence[Decisions],
    plant: int,
    recorded: Recorded,
    spec: Specification,
    generator: ResidualGenerator,
    restarts: tuple[int, int],
    moved: float,
    notes: tuple[str, ...],
    bounds: Mapping[str, MemberBounds],
) -> Diagnosis:
    """Return the diagnosis of one plant from the decisions on all pieces of its recording.

    ``restarts`` counts those after long gaps, and those of a filter whose state overflowed; ``moved`` is how many
    thresholds the estimate of a start moved the residual by.
    """

    def joined(name: str) -> NDArray:
        return np.concatenate([getattr(part, name)[plant] for part in parts], axis=0)

    time = recorded.time
    alarm, usable = joined("alarm"), joined("usable")
    residuals, scores, code, fired = joined("residuals"), joined("scores"), joined("code"), joined("fired")
    dedicated = spec.codes is not None and spec.codes.dedicated

    matches = [part.match for part in parts if part.match is not None]
    match = joined_matches(matches, plant) if matches else None

    over = joined("exceeded")

    def named(start: int, stop: int, last: int) -> dict[str, Any]:
        if spec.matched is not None and match is not None:
            return named_by_match(spec.matched, match, scores, alarm & over, start, stop, last, generator, time)
        first = max(start, last - spec.window + 1)
        sizes = sizes_over(generator, residuals, usable, first, last)
        if spec.codes is None:
            found = _by_direction(spec, scores, last)
            if spec.members:
                found["fired"] = _fired(spec.members, fired[start : max(stop, start + 1)])
        else:
            found = _by_code(spec, code, fired, usable, start, last)
            found["present"] = present_faults(spec.codes, found["reading"], fired, time, start, stop)
        return found | {"candidates": with_sizes(found["candidates"], sizes), "sizes": sizes}

    alarms = _joined_alarms(
        _alarms(time, alarm, usable, joined("up"), over, named),
        max(spec.window, spec.test.window),
        (lambda parts: _named_anew(parts, over, named)) if match is not None else None,
        (lambda parts: _named_over_all(parts, over, named)) if dedicated else None,
    )
    band, share = residual_bands(spec.test)
    alarms = with_beginnings(alarms, residuals, usable, time)
    statistic, statistics = joined("statistic"), joined("member_statistics")
    return Diagnosis(
        time=time,
        residuals=residuals,
        statistic=statistic,
        threshold=spec.test.threshold,
        alarm=alarm,
        decided=usable,
        missing=joined("missing"),
        scores=scores,
        alarms=alarms,
        resets=restarts[0],
        predicted=spec.partial is not None,
        residual_names=generator.residuals,
        center=spec.test.center,
        band=band,
        band_share=share,
        averaged=spec.test.window,
        generator=generator,
        whitening=spec.test.whole if isinstance(spec.test, GroupTest) else spec.test.whitening,
        settings=settings_of(spec, generator),
        source=recorded.source,
        origin=recorded.origin,
        signals=recorded.signals,
        compared=recorded.compared,
        notes=(
            *notes,
            *_notes(spec, generator, usable, joined("missing")),
            *_aside_notes(spec, generator, parts, plant),
            *_broken_notes(restarts[1]),
            *_start_notes(spec, moved),
            *unit_cautions(spec.test, usable, statistic, statistics),
            *leakage_cautions(bounds, spec.test, spec.codes, alarms, statistics),
        ),
        member_statistics=statistics,
        fired=fired,
        code=code,
        match=match,
        **_judge_fields(spec),
    )


def _judge_fields(spec: Specification) -> dict[str, Any]:
    """Return what a diagnosis says of how faults are named."""
    judge = spec.judge
    alone = spec.codes is not None and spec.codes.dedicated and spec.test.kind == "peak"
    return {
        "groups": judge.groups if judge else (),
        "signatures": spec.direction.bases if spec.direction else settled_bases(spec.matched),
        "unjudged": judge.unjudged if judge else (),
        "window": 1 if spec.matched or alone else spec.window,  # names are as sure after any time
        "codes": spec.codes,
        "tested": rows_of_test(spec.test),
        "member_thresholds": spec.test.thresholds if isinstance(spec.test, BankTest) else np.zeros(0),
        "horizon": spec.test.release if spec.test.kind == "peak" else 0,
        "certified": spec.test.basis.startswith(CERTIFIED),
    }


def rows_of_test(test: NormTest | BankTest) -> dict[str, tuple[int, ...]]:
    """Return the residual numbers of each group that has a threshold of its own; empty for any other test."""
    if not isinstance(test, GroupTest):
        return {}
    columns = zip(test.names, test.columns, strict=True)
    return {n: tuple(np.flatnonzero(np.any(test.whitening[:, a:b] != 0, axis=1)).tolist()) for n, (a, b) in columns}


def _fired(names: tuple[str, ...], fired: NDArray[np.bool_]) -> tuple[str, ...]:
    """Return the groups of residuals that were in alarm, the longest first."""
    share = fired.sum(axis=0)
    return tuple(names[m] for m in np.argsort(-share, kind="stable") if share[m])


def _by_direction(spec: Specification, scores: NDArray, last: int) -> dict[str, Any]:
    """Return what the direction of the residual says at the last sample over the threshold."""
    test = spec.direction
    return {"candidates": candidates_at(scores[last], test.groups, test.dimensions) if test and test.groups else ()}


def _by_code(
    spec: Specification, code: NDArray, fired: NDArray, usable: NDArray, start: int, last: int
) -> dict[str, Any]:
    """Return what the fired members say: the pattern that stood the longest, and the candidates by it.

    Of a dedicated bank with all members that lasted: each is a fault of its own.
    """
    assert spec.codes is not None
    judged = slice(start, last + 1)
    pattern, share = longest_code(code[judged], usable[judged])
    if spec.codes.dedicated:
        pattern, share = named_pattern(spec, pattern, code[judged], fired[judged], usable[judged])
    reading = spec.codes.read(pattern)
    return {"reading": reading, "read_share": share, "candidates": candidates_of_code(reading, spec.codes)}


def _sampling_notes(generator: ResidualGenerator) -> tuple[str, ...]:
    """Return a warning where sampling a continuous design let a notable part of a signal through."""
    return tuple(
        f"sampling at {generator.dt:g} s lets {100 * gain:.2g} % of the {name.removesuffix(', sampled')} signals "
        "into the residual at some frequency: design on the sampled plant, plant.discretize(dt), to avoid it"
        for name, gain in generator.evidence.decoupling.items()
        if name.endswith(", sampled") and gain > 0.01
    )


def _notes(
    spec: Specification, generator: ResidualGenerator, usable: NDArray[np.bool_], missing: NDArray[np.bool_]
) -> tuple[str, ...]:
    """Return what is to be minded of the design, the filter and the settings."""
    settling = _settling_notes(spec, generator, usable, missing)
    return *_affine_notes(spec, generator), *_sampling_notes(generator), *settling, *_window_notes(spec)


def _affine_notes(spec: Specification, generator: ResidualGenerator) -> tuple[str, ...]:
    """Return that certified thresholds are those of a linearised set, once for all members of a bank."""
    if not spec.test.basis.startswith(CERTIFIED):
        return ()
    notes = (note.partition(AFFINE_FORM) for note in generator.evidence.notes)
    return tuple(dict.fromkeys(start + text for _, start, text in notes if start))


def _settling_notes(
    spec: Specification, generator: ResidualGenerator, usable: NDArray[np.bool_], missing: NDArray[np.bool_]
) -> tuple[str, ...]:
    """Return how long the filter settles where nothing could be decided because of that."""
    if usable.any() or missing.all():
        return ()
    return (settling_reason(generator, spec.settle),)


def _aside_notes(
    spec: Specification, generator: ResidualGenerator, parts: Sequence[Decisions], plant: int
) -> tuple[str, ...]:
    """Return how many values of which channels were put aside."""
    counts = np.sum([np.count_nonzero(part.aside[plant], axis=0) for part in parts], axis=0)
    if not np.any(counts):
        return ()
    names, limits = (*generator.plant.inputs, *generator.plant.outputs), spec.plausible + spec.offset[:, None]
    told = [
        f"{name!r} {counts[j]} (plausible from {limits[j, 0]:.3g} to {limits[j, 1]:.3g})"
        for j, name in enumerate(names)
        if counts[j]
    ]
    several = np.sum(counts) > 1
    return (
        f"{np.sum(counts)} value{'s were' if several else ' was'} no plausible measurement, and taken as missing: "
        f"{', '.join(told)}; Monitor(plausible=...) sets the limits",
    )


def _broken_notes(count: int) -> tuple[str, ...]:
    """Return how often the filter overflowed."""
    if not count:
        return ()
    times = "once" if count == 1 else f"{count} times"
    return (f"the filter overflowed and was started anew {times}: is the recording in the units of the model?",)


def _start_notes(spec: Specification, moved: float) -> tuple[str, ...]:
    """Return that the plant was not at rest, where that matters, and what follows for faults."""
    if spec.first is None or moved < _TOLD:
        return ()
    return (
        f"the plant was hardly at rest when the filter started: its state was estimated from {spec.first.samples} "
        f"samples, which moved the residual by {moved:.2g} times its threshold; a fault that was there from the first "
        "sample is partly taken out with it (start='rest' does not)",
    )


def _window_notes(spec: Specification) -> tuple[str, ...]:
    """Return a warning where matched filters look back for less time than the responses take to settle."""
    if spec.matched is None or not len(spec.matched.responses):
        return ()
    late = [spec.matched.faults[j] for j in not_settled(spec.matched.responses, spec.matched.settled)]
    if not late:
        return ()
    return (
        f"the window of {spec.matched.window} samples is shorter than the responses to {', '.join(late)} take to "
        "settle: arrivals and sizes are those found while the arrival lay within the window; a longer window is better",
    )


def _alarms(
    time: NDArray,
    alarm: NDArray[np.bool_],
    usable: NDArray[np.bool_],
    up: NDArray[np.int64],
    exceeded: NDArray[np.bool_],
    named: Callable[[int, int, int], dict[str, Any]],
) -> tuple[Alarm, ...]:
    """Return the alarms; ``named`` says who is to blame.

    It is given the first sample, that after the alarm, and the last over the threshold.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[0], alarm.astype(np.int8), [0]])))
    counted = np.flatnonzero(usable)
    out = []
    for start, stop in edges.reshape(-1, 2):
        position = int(np.searchsorted(counted, start, side="right")) - 1
        first = counted[max(0, position - int(up[start]) + 1)]
        last = _last_over(exceeded, int(start), int(stop))
        found: dict[str, Any] = {"onset": float(time[first])}
        found |= named(int(start), int(stop), int(last))
        ended = float(time[stop]) if stop < len(time) else None
        out.append(Alarm(raised=float(time[start]), ended=ended, start=int(start), stop=int(stop), **found))
    return tuple(out)


def _last_over(exceeded: NDArray[np.bool_], start: int, stop: int) -> int:
    over = np.flatnonzero(exceeded[start:stop])
    return start + (int(over[-1]) if over.size else 0)


_Anew = Callable[[Sequence[Alarm]], dict[str, Any]] | None


def _joined_alarms(alarms: tuple[Alarm, ...], apart: int, anew: _Anew, of_several: _Anew = None) -> tuple[Alarm, ...]:
    """Return the alarms with those joined that lie less than ``apart`` samples apart and name the same fault.

    A small fault takes the statistic over the threshold and back many times; that is one event, and its
    onset is that of the first alarm. The candidates, reading and sizes are those of the longest part (the later one
    of two that are equally long), or what ``anew`` says of all parts together. With ``of_several``, which says it for a
    dedicated bank, parts that have one of several faults in common are one event too.
    """
    joined: list[list[Alarm]] = []
    for alarm in alarms:
        before = joined[-1][-1] if joined else None
        if before is None or alarm.start - before.stop >= apart or not _same_event(before, alarm, bool(of_several)):
            joined.append([alarm])
        else:
            joined[-1].append(alarm)
    return tuple(_one_alarm(parts, of_several or anew) for parts in joined)


def _same_event(before: Alarm, alarm: Alarm, several: bool) -> bool:
    """Tell whether two alarms have the same leader; by the code of a dedicated bank, one of their faults in common."""
    one, other = (named_faults(before), named_faults(alarm)) if several else (set(), set())
    return bool(one & other) if one or other else _leader(before) == _leader(alarm)


def _one_alarm(parts: Sequence[Alarm], anew: _Anew) -> Alarm:
    if len(parts) == 1:
        return parts[0]
    first, last = parts[0], parts[-1]
    found = {"onset": first.onset} | (anew(parts) if anew else {})
    who = _longest(parts)
    return replace(who, raised=first.raised, ended=last.ended, start=first.start, stop=last.stop, **found)


def _named_anew(
    parts: Sequence[Alarm], exceeded: NDArray[np.bool_], named: Callable[[int, int, int], dict[str, Any]]
) -> dict[str, Any]:
    """Return what matched filters put several alarms down to that are one.

    That of the longest part whose arrival is known, and not after the first part was raised; without any, of the
    longest of those in which the fault had arrived before the window. A later part may date the same fault anew, by
    what there is in its own window.
    """
    first, last = parts[0], parts[-1]
    dated = [part for part in parts if part.arrival is not None and part.arrival <= first.raised]
    who = _longest(dated or [part for part in parts if part.arrival is None])
    found = named(first.start, who.stop, _last_over(exceeded, last.start, last.stop))
    if found["candidates"][0].faults == _leader(first):
        return found
    return named(first.start, who.stop, _last_over(exceeded, who.start, who.stop))  # the name that all parts agree on


def _named_over_all(
    parts: Sequence[Alarm], exceeded: NDArray[np.bool_], named: Callable[[int, int, int], dict[str, Any]]
) -> dict[str, Any]:
    """Return what a dedicated bank says of several alarms that are one: all faults of their whole time."""
    first, last = parts[0], parts[-1]
    return named(first.start, last.stop, _last_over(exceeded, last.start, last.stop))


def _longest(alarms: Sequence[Alarm]) -> Alarm:
    return max(reversed(alarms), key=lambda alarm: alarm.samples)


def _leader(alarm: Alarm) -> tuple[str, ...]:
    return alarm.candidates[0].faults if alarm.candidates else ()
