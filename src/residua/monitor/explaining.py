"""The word for each alarm: the fit of the listed faults to the residual around it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from residua.decide.alarm import Alarm, Candidate
from residua.decide.explanation import BEFORE, FINAL, Explainer, Whitening
from residua.decide.statement import SHOWN_ALARMS, longest_alarms
from residua.decide.word import EITHER, GOOD, TOO_EARLY, Word
from residua.design import ResidualGenerator
from residua.monitor.fit_check import FitCheck
from residua.monitor.specification import Specification


def explainer_of(spec: Specification, generator: ResidualGenerator, check: FitCheck | None) -> Explainer | None:
    """Return the explainer of alarms, made once for a specification; ``None`` if faults are named in another way."""
    known = spec.__dict__.get("_explainer", False)
    if known is False:
        whitening = Whitening.of(spec.test) if spec.isolation.has_words else None
        known = None
        if whitening is not None:
            known = Explainer(generator, whitening, () if check is None else check.colour)
        object.__setattr__(spec, "_explainer", known)
    return known


def word_of(
    alarm: Alarm,
    residuals: NDArray[np.float64],
    usable: NDArray[np.bool_],
    explainer: Explainer,
    after: int = FINAL,
) -> Word:
    """Return the word for an alarm by so many of its samples, and those before it."""
    begin, stop = max(0, alarm.start - BEFORE), min(alarm.start + after, alarm.stop)
    return explainer.word(residuals[begin:stop], usable[begin:stop], alarm.start - begin)


def with_words(
    alarms: Sequence[Alarm],
    residuals: NDArray[np.float64],
    usable: NDArray[np.bool_],
    explainer: Explainer | None,
    spec: Specification,
    since: float = -np.inf,
) -> tuple[Alarm, ...]:
    """Return the alarms with their words; faults named by a fit come before other candidates.

    Parameters
    ----------
    alarms : sequence of Alarm
        In order.
    residuals : ndarray, shape (time, residuals)
    usable : ndarray of bool, shape (time,)
    explainer : Explainer or None
        Fits faults to the longest ones; all others have the word of the isolation.
    spec : Specification
    since : float
        Only those that were raised from then on.
    """
    window = spec.isolation.samples_to_be_sure(spec.test)
    earlier = [alarm for alarm in alarms if alarm.raised < since]
    out = [alarm for alarm in alarms if alarm.raised >= since]
    if explainer is not None:
        for number, alarm in longest_alarms(out, SHOWN_ALARMS):
            word = spec.isolation.agreed(alarm, word_of(alarm, residuals, usable, explainer))
            if word.kind != TOO_EARLY or not spec.isolation.names_early:
                out[number - 1] = _worded(alarm, word)
    out = [alarm if alarm.word else replace(alarm, word=spec.isolation.word(alarm, window)) for alarm in out]
    return (*earlier, *out)


def _worded(alarm: Alarm, word: Word) -> Alarm:
    """Return an alarm with a word, and the groups in the word as the first candidates, in its order."""
    first, rest = [], list(alarm.candidates)
    for group in word.faults:
        same = [one for one in rest if set(one.faults) & set(group)]
        rest = [one for one in rest if one not in same]
        if word.kind in (GOOD, EITHER):
            best = same[0] if same else Candidate(group, math.sqrt(word.share), math.sqrt(1.0 - word.share))
            first.append(replace(best, faults=group))
        else:
            first += same
    candidates = (*first, *rest)
    arrival = candidates[0].arrival if candidates else None
    onset = alarm.onset if arrival is None else arrival
    return replace(alarm, word=word, candidates=candidates, arrival=arrival, onset=onset)


__all__ = ["explainer_of", "with_words", "word_of"]
