"""Who is to blame by matched filters: candidates with likelihood ratio, arrival and size."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.decide.matched import MatchedTest
from residua.decide.matched_hold import Match
from residua.design import ResidualGenerator
from residua.monitor.alarm import Candidate, Size
from residua.monitor.naming import fault_unit


def candidates_of_match(
    test: MatchedTest,
    match: Match,
    scores: NDArray[np.float64],
    at: int,
    generator: ResidualGenerator,
    clock: Callable[[float], float],
    last: int | None = None,
    settled: bool = False,
    sources: NDArray[np.int64] | None = None,
) -> tuple[Candidate, ...]:
    """Return the groups ranked by their likelihood, each with the arrival and size of its faults.

    Parameters
    ----------
    test : MatchedTest
    match : Match
        Of one plant.
    scores : ndarray, shape (time, groups)
    at : int
        The sample at which arrivals and sizes are taken.
    generator : ResidualGenerator
    clock : callable
        From the number of a sample to seconds.
    last : int, optional
        A later sample, that the last sizes are of. Where its window holds nothing of that of ``at``, it is new
        evidence, and the likelihoods of the two are added: it tells a fault that grows, or another one that follows,
        from the step that the beginning looked like.
    settled : bool
        Whether the last sizes are by the steady responses; always so where ``last`` is not ``at``.
    sources : ndarray of int, shape (faults,), optional
        For each fault the sample at which its arrival and size are taken instead; see :func:`sources_of`.
    """
    sources = np.full(len(test.faults), at) if sources is None else sources
    last = at if last is None else last
    ratios, shown = match.ratios[at], at
    if last - at > test.window:
        ratios = ratios + match.ratios[last]
        shown = max(at, last, key=lambda k: match.ratios[k].max())
    ends = match.settled_sizes[last] if settled or last != at else match.sizes[last]
    out = []
    for g, columns in enumerate(test.columns):
        best = max(columns, key=lambda j: ratios[j])
        age = int(match.ages[sources[best], best])
        score = float(scores[shown, g])
        told = tuple(
            Size(
                test.faults[j],
                float(match.sizes[sources[j], j]),
                float(ends[j]),
                fault_unit(generator.plant, test.faults[j]),
                float(match.deviations[sources[j], j]),
            )
            for j in columns
        )
        distance = float(np.sqrt(max(0.0, 1.0 - score**2)))
        arrival = clock(int(sources[best]) - age) if age >= 0 else None
        out.append(Candidate(test.groups[g], score, distance, told, arrival, float(ratios[best])))
    return tuple(sorted(out, key=lambda c: -(c.ratio or 0.0)))


def sources_of(match: Match, judged: NDArray[np.bool_], raised: int, at: int) -> NDArray[np.int64]:
    """Return for each fault the last sample up to ``at`` at which it arrived no later than the alarm was raised.

    Without any, the last one at which it had arrived before the window. A fault cannot have arrived after its alarm.
    Later samples may yet date it so: once its true arrival has left the window, and where it has not settled, or never
    does, the best step is one that begins somewhere in the window.

    Parameters
    ----------
    match : Match
        Of one plant.
    judged : ndarray of bool, shape (time,)
        Samples in alarm and over the threshold.
    raised, at : int
    """
    now = np.arange(raised, at + 1)[:, None]
    ages = match.ages[raised : at + 1]
    over = judged[raised : at + 1, None]
    dated, settled = over & (ages >= 0) & (now - ages <= raised), over & (ages < 0)
    can = np.where(dated.any(axis=0), dated, settled)
    return np.where(can.any(axis=0), at - np.argmax(can[::-1], axis=0), raised)


def named_by_match(
    test: MatchedTest,
    match: Match,
    scores: NDArray[np.float64],
    judged: NDArray[np.bool_],
    raised: int,
    stop: int,
    last: int,
    generator: ResidualGenerator,
    time: NDArray[np.float64],
) -> dict[str, Any]:
    """Return what an alarm is put down to at its end: candidates, sizes, arrival, and the onset where it is known.

    Parameters
    ----------
    test : MatchedTest
    match : Match
        Of one plant.
    scores : ndarray, shape (time, groups)
    judged : ndarray of bool, shape (time,)
        Samples in alarm and over the threshold.
    raised : int
        Sample at which the alarm was raised, the first of those that were joined.
    stop : int
        The sample after the alarm, or after that of the joined ones which is taken.
    last : int
        The last sample over the threshold.
    generator : ResidualGenerator
    time : ndarray, shape (time,)
    """

    def clock(number: float) -> float:
        inside = 0 <= number < len(time)
        return float(time[int(number)]) if inside else float(time[0] + number * generator.dt)

    at = int(match.source[stop - 1])
    sources = sources_of(match, judged, raised, at)
    candidates = candidates_of_match(test, match, scores, at, generator, clock, max(at, last), sources=sources)
    arrival = candidates[0].arrival
    found = {"candidates": candidates, "sizes": tuple(s for c in candidates for s in c.sizes), "arrival": arrival}
    return found if arrival is None else found | {"onset": arrival}


def settled_bases(test: MatchedTest | None) -> tuple[NDArray[np.float64], ...]:
    """Return the direction that the first fault of each group settles to, no column where that vanishes."""
    directions = [test.settled[:, [columns[0]]] for columns in test.columns] if test else []
    return tuple(d / np.linalg.norm(d) if d.any() else d[:, :0] for d in directions)
