"""From raw decisions to a diagnosis: alarms with onsets and ranked candidates."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.decide.isolation import Seen
from residua.decide.member_bounds import MemberBounds
from residua.design import ResidualGenerator
from residua.design.core.evidence import AFFINE_FORM
from residua.monitor.alarms import alarms_of, explainer_of, with_beginnings, with_words
from residua.monitor.diagnosis import Diagnosis
from residua.monitor.diagnosis_facts import NamingFacts, PartSeries, RecordingFacts, ThresholdFacts
from residua.monitor.fault_learning import learnt_table
from residua.monitor.fit_check import FitCheck
from residua.monitor.inputs import settling_reason
from residua.monitor.running import Decisions
from residua.monitor.specification import FilterState, Specification
from residua.monitor.start_estimate import MOVED_FROM
from residua.plant import Plant
from residua.recording.levels import rows_apart, units_of
from residua.words import percent

#: Part of a recording that is not judged because values are missing, from which on a note says so.
_TOLD_GAPS = 0.05
#: Samples that are counted at once.
_PIECE = 1 << 18


@dataclass(frozen=True, eq=False)
class Recorded:
    """Recording of one plant: times, inputs and outputs, source, origin, and the outputs that the filter predicts.

    ``own`` are the samples that are this monitor's to judge; ``None`` for all of them.
    """

    time: NDArray[np.float64]
    signals: NDArray[np.float64]
    source: str
    origin: str
    compared: tuple[tuple[int, int], ...]
    own: NDArray[np.bool_] | None = None


def compared_outputs(design: ResidualGenerator) -> tuple[tuple[int, int], ...]:
    """Return the residuals that are an output less its prediction, as pairs (residual, output), each output once.

    Those are the residuals that take just one output as it is measured now: all else is made of what was before. A
    continuous design that was sampled is judged by what it was.
    """
    now = design.system.D[:, len(design.plant.inputs) :]
    residual_of: dict[int, int] = {}
    for i, row in enumerate(now):
        if np.count_nonzero(row) == 1 and row.max() == 1.0 and not (design.estimated and design.estimated[i]):
            residual_of.setdefault(int(row.argmax()), i)
    return tuple((i, j) for j, i in sorted(residual_of.items()))


def diagnosis_from(
    decisions: Decisions,
    recorded: Recorded,
    spec: Specification,
    generator: ResidualGenerator,
    state: FilterState,
    plant: int,
    notes: tuple[str, ...],
    bounds: Mapping[str, MemberBounds],
    check: FitCheck | None = None,
) -> Diagnosis:
    """Return the diagnosis of one plant from the decisions on its recording; ``state`` is the later state of all."""
    tested, named, test, isolation = decisions.tested, decisions.named, spec.test, spec.isolation
    seen = Seen(recorded.time, decisions.residuals, tested, named, generator, test)
    alarms = with_beginnings(alarms_of(seen, isolation), decisions.residuals, tested.usable, recorded.time)
    explainer = explainer_of(spec, generator, check)
    alarms = with_words(alarms, decisions.residuals, tested.usable, explainer, spec)
    unlike = tuple(_unlike_the_fit(check, generator.plant, recorded.signals, decisions.aside))
    band, share = test.bands()
    return Diagnosis(
        time=recorded.time,
        residuals=decisions.residuals,
        statistic=tested.statistic,
        alarm=tested.alarm,
        decided=tested.usable,
        missing=decisions.missing,
        scores=named.scores,
        signals=recorded.signals,
        match=named.match,
        parts=PartSeries(
            tested.part_statistics, test.part_thresholds, tested.fired, decisions.code, test.groups_of_residuals
        ),
        alarms=alarms,
        generator=generator,
        test=ThresholdFacts(
            test.threshold,
            test.center,
            band,
            test.metric,
            band_share=share,
            averaged=test.samples,
            horizon=test.horizon,
            certified=test.is_certified,
            outside=test.outside_share(tested),
        ),
        naming=NamingFacts(
            isolation.groups,
            isolation.signatures,
            isolation.unjudged,
            isolation.samples_to_be_sure(test),
            isolation.coding,
            tuple(learnt_table(isolation)),
        ),
        settings=settings_of(spec, generator),
        recording=RecordingFacts(
            recorded.source,
            recorded.origin,
            resets=int(state.resets[plant]),
            predicted=spec.partial is not None,
            is_unlike_the_fit=bool(unlike),
            compared=recorded.compared,
        ),
        notes=(
            *notes,
            *unlike,
            *_notes(spec, generator, tested.usable, decisions.missing),
            *_gap_notes(spec, generator, decisions, recorded),
            *_aside_notes(spec, generator, decisions),
            *_broken_notes(int(state.broken[plant])),
            *_start_notes(spec, float(state.moved[plant])),
            *test.cautions(tested),
            *isolation.cautions(bounds, alarms, seen),
        ),
        fit_check=check,
        isolation=isolation,
        explainer=explainer,
    )


def settings_of(spec: Specification, generator: ResidualGenerator) -> dict[str, str]:
    """Describe the settings of threshold, alarms and isolation."""
    step = generator.dt
    settled = f"no decision in the first {spec.settle} samples after a start ({spec.settle * step:g} s)"
    return {
        "sample step": f"{step:g} s",
        **spec.test.words(step),
        "settling": settled,
        "start": _start(spec),
        "missing values": _missing(spec),
        **spec.isolation.words(step),
    }


def _start(spec: Specification) -> str:
    if spec.first is None:
        return "as if the plant had been at rest at the first sample"
    return f"state estimated from the residuals of the first {spec.first.samples} samples"


def _missing(spec: Specification) -> str:
    more = f"; {spec.isolation.where_missing}" if spec.isolation.where_missing else ""
    if spec.partial is None:
        return f"held for up to {spec.max_hold} samples, then the filter restarts{more}"
    return (
        "the filter uses the values that are present, and treats a missing input as unknown; "
        f"after more than {spec.max_hold} samples in a row without an output it restarts{more}"
    )


def _sampling_notes(generator: ResidualGenerator) -> tuple[str, ...]:
    """Return a warning if sampling a continuous design let a notable part of a signal through."""
    return tuple(
        f"sampling at {generator.dt:g} s lets {100 * gain:.2g} % of the {name} signals "
        "into the residual at some frequency: design on the sampled plant, plant.discretize(dt), to avoid it"
        for name, gain in generator.evidence.cost_of_sampling.items()
        if gain > 0.01
    )


def _notes(
    spec: Specification, generator: ResidualGenerator, usable: NDArray[np.bool_], missing: NDArray[np.bool_]
) -> tuple[str, ...]:
    """Return remarks on the design, the filter and the settings."""
    settling = _settling_notes(spec, generator, usable, missing)
    return *_affine_notes(spec, generator), *_sampling_notes(generator), *settling, *spec.isolation.notes()


def _affine_notes(spec: Specification, generator: ResidualGenerator) -> tuple[str, ...]:
    """Return a remark that certified thresholds are those of a linearised set, once for all members of a bank."""
    if not spec.test.is_certified:
        return ()
    notes = (note.partition(AFFINE_FORM) for note in generator.evidence.notes)
    return tuple(dict.fromkeys(start + text for _, start, text in notes if start))


def _settling_notes(
    spec: Specification, generator: ResidualGenerator, usable: NDArray[np.bool_], missing: NDArray[np.bool_]
) -> tuple[str, ...]:
    """Return a remark on the settling time of the filter, if it prevented every decision."""
    if usable.any() or missing.all():
        return ()
    return (settling_reason(generator, spec.settle),)


def _gap_notes(
    spec: Specification, generator: ResidualGenerator, decisions: Decisions, recorded: Recorded
) -> tuple[str, ...]:
    """Return a remark on the share not judged because of missing values, the worst channel, and a remedy."""
    if not np.any(decisions.missing):  # as a rule; the rest needs memory for every sample
        return ()
    own = np.ones(len(decisions.missing), dtype=bool) if recorded.own is None else recorded.own
    missing, usable = decisions.missing & own, decisions.tested.usable
    if not missing.any() or missing[own].all():
        return ()
    waiting = own & ~(usable | missing)
    for start in np.flatnonzero(own & ~np.concatenate([[False], own[:-1]])).tolist():
        waiting[start : start + int(np.argmin(missing[start:])) + spec.settle + 1] = False  # any start waits so long
    absent, waited = int(np.count_nonzero(missing)), int(np.count_nonzero(waiting))
    share = (absent + waited) / int(np.count_nonzero(own))
    if share <= _TOLD_GAPS:
        return ()
    gaps = np.zeros(recorded.signals.shape[1], dtype=np.int64)
    for k in range(0, len(own), _PIECE):  # the recording may be larger than memory
        part = slice(k, k + _PIECE)
        gaps += np.count_nonzero((~np.isfinite(recorded.signals[part]) | decisions.aside[part])[own[part]], axis=0)
    worst = (*generator.plant.inputs, *generator.plant.outputs)[int(gaps.argmax())]
    part = "the recording" if recorded.own is None else "its part of the recording"
    lost = percent(absent + waited, int(np.count_nonzero(own)))
    said = f"{lost} of {part} is not judged because values are missing: {absent} samples miss one"
    said += f" (channel {worst!r} at {gaps.max()} of them, the most)"
    if not waited:
        return (f"{said}; fill in known values, or leave out a channel that is rarely present",)
    anew = "after gaps that were too long" if spec.partial is not None else "after every gap"
    remedy = (
        "fill in known values"
        if spec.partial is not None
        else "fill in known values (of a constant command), or use a Kalman filter of the same model, which "
        "uses the other values, or a filter that settles sooner"
    )
    return (f"{said}, and {waited} more pass while the filter settles, for {spec.settle} samples {anew}; {remedy}",)


def _aside_notes(spec: Specification, generator: ResidualGenerator, decisions: Decisions) -> tuple[str, ...]:
    """Return a remark on the number of values put aside, by channel."""
    if not np.any(decisions.aside):  # as a rule; counting takes much longer
        return ()
    counts = np.count_nonzero(decisions.aside, axis=0)
    names, limits = (*generator.plant.inputs, *generator.plant.outputs), spec.plausible + spec.offset[:, None]
    counted = [
        f"{name!r} {counts[j]} (plausible from {limits[j, 0]:.3g} to {limits[j, 1]:.3g})"
        for j, name in enumerate(names)
        if counts[j]
    ]
    several = np.sum(counts) > 1
    return (
        f"{np.sum(counts)} value{'s were' if several else ' was'} not plausible, and taken as missing: "
        f"{', '.join(counted)}; Monitor(plausible=...) sets the limits",
    )


def _broken_notes(count: int) -> tuple[str, ...]:
    """Return a remark on the number of overflows of the filter."""
    if not count:
        return ()
    times = "once" if count == 1 else f"{count} times"
    return (f"the filter overflowed and was restarted {times}: is the recording in the units of the model?",)


def _start_notes(spec: Specification, moved: float) -> tuple[str, ...]:
    """Return a remark that the plant was not at rest, if it matters, and its consequence for faults."""
    if spec.first is None or moved < MOVED_FROM:
        return ()
    return (
        f"the plant was hardly at rest when the filter started: its state was estimated from {spec.first.samples} "
        f"samples, which moved the residual by {moved:.2g} times its threshold; a fault present from the first "
        "sample is partly removed with it (start='rest' does not)",
    )


def _unlike_the_fit(
    check: FitCheck | None, plant: Plant, signals: NDArray[np.float64], aside: NDArray[np.bool_]
) -> list[str]:
    """Return cautions about channels that never come near their values in the fitted recordings."""
    if check is None or not check.mean or not len(signals):
        return []
    apart = rows_apart(len(signals))
    seen = np.where(aside[::apart], np.nan, signals[::apart])
    was = np.array(check.mean), np.array(check.spread)
    return units_of((*plant.inputs, *plant.outputs), seen, *was, "the recordings that the monitor was fitted on")
