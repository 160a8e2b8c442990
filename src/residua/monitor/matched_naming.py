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
    """
    last = at if last is None else last
    ratios, shown = match.ratios[at], at
    if last - at > test.window:
        ratios = ratios + match.ratios[last]
        shown = max(at, last, key=lambda k: match.ratios[k].max())
    ends = match.settled_sizes[last] if settled or last != at else match.sizes[last]
    out = []
    for g, columns in enumerate(test.columns):
        best = max(columns, key=lambda j: ratios[j])
        age = int(match.ages[at, best])
        score = float(scores[shown, g])
        told = tuple(
            Size(
                test.faults[j],
                float(match.sizes[at, j]),
                float(ends[j]),
                fault_unit(generator.plant, test.faults[j]),
                float(match.deviations[at, j]),
            )
            for j in columns
        )
        distance = float(np.sqrt(max(0.0, 1.0 - score**2)))
        arrival = clock(at - age) if age >= 0 else None
        out.append(Candidate(test.groups[g], score, distance, told, arrival, float(ratios[best])))
    return tuple(sorted(out, key=lambda c: -(c.ratio or 0.0)))


def named_by_match(
    test: MatchedTest,
    match: Match,
    scores: NDArray[np.float64],
    stop: int,
    last: int,
    generator: ResidualGenerator,
    time: NDArray[np.float64],
) -> dict[str, Any]:
    """Return what an alarm is put down to at its end: candidates, sizes, arrival, and the onset where it is known."""

    def clock(number: float) -> float:
        inside = 0 <= number < len(time)
        return float(time[int(number)]) if inside else float(time[0] + number * generator.dt)

    at = int(match.source[stop - 1])
    candidates = candidates_of_match(test, match, scores, at, generator, clock, max(at, last))
    number = float(match.arrival[stop - 1])
    arrival = clock(number) if np.isfinite(number) else None
    found = {"candidates": candidates, "sizes": tuple(s for c in candidates for s in c.sizes), "arrival": arrival}
    return found if arrival is None else found | {"onset": arrival}


def settled_bases(test: MatchedTest | None) -> tuple[NDArray[np.float64], ...]:
    """Return the direction that the first fault of each group settles to, no column where that vanishes."""
    directions = [test.settled[:, [columns[0]]] for columns in test.columns] if test else []
    return tuple(d / np.linalg.norm(d) if d.any() else d[:, :0] for d in directions)
