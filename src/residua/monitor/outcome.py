"""From raw decisions to a diagnosis: alarms with onsets and ranked candidates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from residua.design import ResidualGenerator
from residua.monitor.diagnosis import Alarm, Candidate, Diagnosis
from residua.monitor.running import Decisions, Specification


def candidates_at(
    scores: NDArray[np.float64], groups: tuple[tuple[str, ...], ...], dimensions: tuple[int, ...]
) -> tuple[Candidate, ...]:
    """Return the groups ranked by score, best first; none where the direction is not known.

    Scores that agree to three digits are a tie, which the narrower signature wins: a plane contains more
    residuals by chance than a line.
    """
    if scores.size == 0 or np.isnan(scores).all():
        return ()
    order = np.lexsort((-scores, np.asarray(dimensions), -np.round(scores, 3)))
    return tuple(Candidate(groups[g], float(scores[g]), float(np.sqrt(max(0.0, 1.0 - scores[g] ** 2)))) for g in order)


def diagnosis_from(
    parts: Sequence[Decisions],
    plant: int,
    time: NDArray[np.float64],
    spec: Specification,
    generator: ResidualGenerator,
    resets: int,
    source: str,
    notes: tuple[str, ...],
) -> Diagnosis:
    """Return the diagnosis of one plant from the decisions on all pieces of its recording."""

    def joined(name: str) -> NDArray:
        return np.concatenate([getattr(part, name)[plant] for part in parts], axis=0)

    groups = spec.direction.groups if spec.direction else ()
    dimensions = spec.direction.dimensions if spec.direction else ()
    alarm, usable, up = joined("alarm"), joined("usable"), joined("up")
    scores = joined("scores")
    return Diagnosis(
        time=time,
        residuals=joined("residuals"),
        statistic=joined("statistic"),
        threshold=spec.test.threshold,
        alarm=alarm,
        decided=usable,
        missing=joined("missing"),
        scores=scores,
        groups=groups,
        signatures=spec.direction.bases if spec.direction else (),
        unjudged=spec.direction.unjudged if spec.direction else (),
        alarms=_joined_alarms(
            _alarms(time, alarm, usable, up, joined("exceeded"), scores, groups, dimensions),
            max(spec.window, spec.test.window),
        ),
        resets=resets,
        residual_names=generator.residuals,
        center=spec.test.center,
        band=spec.test.band,
        generator=generator,
        whitening=spec.test.whitening,
        window=spec.window,
        settings=_settings(spec, generator),
        source=source,
        notes=(*notes, *_sampling_notes(generator)),
    )


def _sampling_notes(generator: ResidualGenerator) -> tuple[str, ...]:
    """Return a warning where sampling a continuous design let a notable part of a signal through."""
    return tuple(
        f"sampling at {generator.dt:g} s lets {100 * gain:.2g} % of the {name.removesuffix(', sampled')} signals "
        "into the residual at some frequency: design on the sampled plant, plant.discretize(dt), to avoid it"
        for name, gain in generator.evidence.decoupling.items()
        if name.endswith(", sampled") and gain > 0.01
    )


def _settings(spec: Specification, generator: ResidualGenerator) -> dict[str, str]:
    """Return how the monitor was set, in words."""
    test, step = spec.test, generator.dt
    out = {
        "sample step": f"{step:g} s",
        "threshold": f"{test.threshold:.4g} ({test.basis})",
        "test": f"norm of the whitened residual{f', summed over {test.window} samples' if test.window > 1 else ''}",
        "alarm": f"raised by {test.persistence} samples in a row over it, ended by {test.release} below it",
        "settling": f"no decision in the first {spec.settle} samples after a start ({spec.settle * step:g} s)",
        "missing values": f"held for up to {spec.max_hold} samples, then the filter starts anew",
    }
    if spec.direction is not None:
        window = spec.direction.window
        out["isolation"] = f"direction of the residual averaged over {window} samples ({window * step:g} s)"
    return out


def _alarms(
    time: NDArray,
    alarm: NDArray[np.bool_],
    usable: NDArray[np.bool_],
    up: NDArray[np.int64],
    exceeded: NDArray[np.bool_],
    scores: NDArray,
    groups: tuple[tuple[str, ...], ...],
    dimensions: tuple[int, ...],
) -> tuple[Alarm, ...]:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], alarm.astype(np.int8), [0]])))
    counted = np.flatnonzero(usable)
    out = []
    for start, stop in edges.reshape(-1, 2):
        position = int(np.searchsorted(counted, start, side="right")) - 1
        first = counted[max(0, position - int(up[start]) + 1)]
        over = np.flatnonzero(exceeded[start:stop])
        last = start + (int(over[-1]) if over.size else 0)
        out.append(
            Alarm(
                onset=float(time[first]),
                raised=float(time[start]),
                ended=float(time[stop]) if stop < len(time) else None,
                candidates=candidates_at(scores[last], groups, dimensions) if groups else (),
                start=int(start),
                stop=int(stop),
            )
        )
    return tuple(out)


def _joined_alarms(alarms: tuple[Alarm, ...], apart: int) -> tuple[Alarm, ...]:
    """Return the alarms with those joined that lie less than ``apart`` samples apart and name the same fault.

    A small fault takes the statistic over the threshold and back many times; that is one event, and its
    onset is that of the first alarm. The candidates are those of the longest part.
    """
    out: list[Alarm] = []
    longest = 0
    for alarm in alarms:
        last = out[-1] if out else None
        length = alarm.stop - alarm.start
        if last is None or alarm.start - last.stop >= apart or _leader(last) != _leader(alarm):
            out.append(alarm)
            longest = length
            continue
        candidates = alarm.candidates if length >= longest else last.candidates
        longest = max(longest, length)
        out[-1] = replace(last, ended=alarm.ended, stop=alarm.stop, candidates=candidates)
    return tuple(out)


def _leader(alarm: Alarm) -> tuple[str, ...]:
    return alarm.candidates[0].faults if alarm.candidates else ()
