"""Who is to blame: candidates by direction or by code, and the sizes of faults that are estimated."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from residua.decide.structured import CodeReading, CodeTest, distinct_rows
from residua.design import ResidualGenerator
from residua.monitor.alarm import Alarm, Candidate, Size
from residua.plant import Plant
from residua.recording.clock import Clock


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


def candidates_of_code(reading: CodeReading, codes: CodeTest) -> tuple[Candidate, ...]:
    """Return the group that was read, then the others by the members that agree; none where nothing was read.

    Every fault is named once: with that of its codes which agrees better.
    """
    if not reading.faults:
        return ()
    pattern = np.array(reading.pattern)
    agree = np.mean(codes.codes == pattern[:, None], axis=0)
    first = column_read(reading, codes)
    assert first is not None
    named: set[str] = set()
    out = []
    for g in (first, *(int(g) for g in np.argsort(-agree, kind="stable") if g != first)):
        faults = tuple(name for name in codes.groups[g] if name not in named)
        named.update(faults)
        if faults:
            out.append(Candidate(faults, float(agree[g]), float(1.0 - agree[g])))
    return tuple(out)


def column_read(reading: CodeReading, codes: CodeTest) -> int | None:
    """Return the number of the code that was read; ``None`` where none was."""
    off = np.count_nonzero(codes.codes != np.array(reading.pattern)[:, None], axis=0)
    same = [g for g, group in enumerate(codes.groups) if reading.faults and group == reading.faults]
    return min(same, key=lambda g: off[g], default=None)


def ranked(candidates: tuple[Candidate, ...]) -> list[tuple[int, Candidate]]:
    """Return the candidates with their ranks: after the first, those whose scores agree to three digits share one.

    By matched filters those whose likelihood ratios agree to one decimal.
    """
    out: list[tuple[int, Candidate]] = []
    for k, candidate in enumerate(candidates):
        tied = k > 1 and _weight(candidate) == _weight(candidates[k - 1])
        out.append((out[-1][0] if tied else k + 1, candidate))
    return out


def _weight(candidate: Candidate) -> float:
    """Return what a candidate is ranked by, with the digits that are shown."""
    return round(candidate.score, 3) if candidate.ratio is None else round(candidate.ratio, 1)


def tied_name(candidates: tuple[Candidate, ...], rank: int) -> str:
    """Return the first candidate of a rank as text, with how many others share it; empty where nobody has it."""
    names = [candidate.name for place, candidate in ranked(candidates) if place == rank]
    more = len(names) - 1
    return f"{names[0]} (tied with {more} more)" if more > 0 else "".join(names)


def sizes_text(sizes: Sequence[Size], told: Callable[[Size], str] = str) -> str:
    """Return the estimated sizes of one candidate: each with its fault where it may be one of several."""
    return told(sizes[0]) if len(sizes) == 1 else ", or ".join(f"{size.fault} {told(size)}" for size in sizes)


def arrival_text(candidate: Candidate) -> str:
    """Return when a fault arrived and how likely it is, as matched filters tell it; empty for anything else."""
    if candidate.ratio is None:
        return ""
    when = "before the window" if candidate.arrival is None else f"{candidate.arrival:.6g} s"
    return f"  arrived {when}  2 ln L {candidate.ratio:.1f}"


def began_text(alarm: Alarm, clock: Clock) -> str:
    """Return when what an alarm is about began, as an interval; never its first crossing of the threshold as a fact."""
    found = alarm.began
    if found is None:
        return f"when it began cannot be told: at or before {clock.at(alarm.raised)}"
    if found.earliest is None:
        return f"began at or before {clock.at(found.latest)}: what was recorded before does not tell from when on"
    between = f"began between {clock.at(found.earliest)} and {clock.at(found.latest)}"
    return f"{between} ({100 * found.confidence:g} % confidence), most likely at {clock.at(found.estimate)}"


def alike(groups: tuple[tuple[str, ...], ...], codes: CodeTest | None) -> list[tuple[tuple[str, ...], tuple[str, ...]]]:
    """Return the groups of several faults, each with its names as shown: with *once constant* where that is meant."""
    groups, settled = (codes.groups, codes.settled) if codes else (groups, ((),) * len(groups))
    out = []
    always = [set(group) - set(later) for group, later in zip(groups, settled, strict=True)]
    for group, later in zip(groups, settled, strict=True):
        if len(group) > 1 and not (later and any(set(group) <= own for own in always)):
            out.append((group, tuple(f"{name} once constant" if name in later else name for name in group)))
    return out


def longest_code(code: NDArray[np.bool_], counted: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], float]:
    """Return the pattern that stood for the most samples, the latest of those, and the fraction in which it did.

    Parameters
    ----------
    code : ndarray of bool, shape (time, members)
    counted : ndarray of bool, shape (time,)
        Samples that count.
    """
    rows = code[counted & code.any(axis=1)]
    if not len(rows):
        return np.zeros(code.shape[1], dtype=bool), 0.0
    counts, first, _ = distinct_rows(rows[::-1])
    best = np.lexsort((first, -counts))[0]
    return rows[::-1][first[best]], float(counts[best] / len(rows))


def estimates_of(generator: ResidualGenerator, residuals: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """Return the columns that estimate a fault; one estimated more than once is told apart by its residual's name."""
    names = generator.estimated
    labels = [f if names.count(f) == 1 else f"{f} ({r})" for f, r in zip(names, generator.residuals, strict=False)]
    return {label: residuals[..., i] for i, label in enumerate(labels) if names[i]}


def sizes_over(
    generator: ResidualGenerator, residuals: NDArray[np.float64], usable: NDArray[np.bool_], first: int, last: int
) -> tuple[Size, ...]:
    """Return mean and last value of every estimate over a stretch of samples, both ends included."""
    if not generator.estimated:
        return ()
    rows = residuals[first : last + 1][usable[first : last + 1]]
    return tuple(
        Size(
            fault,
            float(rows[:, i].mean()) if len(rows) else float("nan"),
            float(rows[-1, i]) if len(rows) else float("nan"),
            fault_unit(generator.plant, fault),
        )
        for i, fault in enumerate(generator.estimated)
        if fault
    )


def with_sizes(candidates: tuple[Candidate, ...], sizes: tuple[Size, ...]) -> tuple[Candidate, ...]:
    """Return the candidates, each with the sizes of its faults."""
    if not sizes:
        return candidates
    return tuple(replace(c, sizes=tuple(size for size in sizes if size.fault in c.faults)) for c in candidates)


def fault_unit(plant: Plant, fault: str) -> str:
    """Return the unit that a fault is measured in: its own, or that of its channel, where the plant knows it."""
    if fault not in plant.faults:
        return ""
    i = plant.faults.index(fault)
    if plant.fault_list[i].unit:
        return plant.fault_list[i].unit
    if plant.fault_kinds[i] not in ("sensor", "actuator"):
        return ""  # the size of a process fault is in whatever its direction was given in
    return str(plant.units.get(plant.fault_components[i], ""))
