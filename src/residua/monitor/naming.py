"""Candidates in words: their ranks, sizes, arrivals, and what cannot be told apart."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from residua.decide.alarm import Alarm, Candidate, Size
from residua.decide.structured import CodeTest
from residua.recording.clock import Clock


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
