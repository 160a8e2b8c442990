"""A diagnosis in words."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from residua.decide.statement import began_text, capital, over_thresholds, raised_text, size_text, sizes_text
from residua.monitor.diagnosis import NO_DIRECTION
from residua.recording.clock import Clock
from residua.words import number, percent, some

if TYPE_CHECKING:
    from residua.decide.alarm import Alarm
    from residua.monitor.diagnosis import Diagnosis

#: Groups of indistinguishable faults, besides the named one, that a sentence lists.
_TOLD = 5
#: From this score on, a lasting alarm names its best candidate alone, without faults that are never named.
_SURE = 0.9

BEGAN_RULE = (
    "The interval in which it began assumes that the residual starts to move as a step, a ramp or the square of time, "
    "in unchanged noise. A fault may have begun well before it if a control loop compensates for it at first, or if it "
    "grows out of the noise in another way."
)

#: Fraction of the samples outside of the learnt range from which on that is the answer.
_MOSTLY = 0.5
_UNLIKE = "The data differ from those of the fit: other units, or another operating point."

#: Remark on an alarm by certified thresholds.
CERTAIN = (
    "The thresholds are certified: without a fault, no plant of the uncertainty set exceeds them while the "
    "disturbances keep within their bounds."
)


@dataclass(frozen=True)
class Verdict:
    """Verdict of a diagnosis.

    Attributes
    ----------
    kind : {"fault", "none", "cannot tell", "outside", "undecided"}
        ``"cannot tell"``: no alarm, of a monitor that sees no fault that lasts; ``"outside"``: no alarm, on data that
        mostly lie outside of the learnt range; ``"undecided"``: no sample was judged.
    headline : str
    sentences : tuple of str
    confidence : str
        ``"good match"``, ``"either"``, ``"poor match"``, ``"too early"``; empty where nothing is named.
    margin : float or None
        Lead of the best candidate over the next in score.
    present : tuple of tuple of str
        Several faults that a dedicated bank names together.
    rules : str
        How the numbers are to be read.
    """

    kind: str
    headline: str
    sentences: tuple[str, ...]
    confidence: str = ""
    margin: float | None = None
    present: tuple[tuple[str, ...], ...] = ()
    rules: str = ""


def verdict(diagnosis: Diagnosis) -> Verdict:
    """Return the outcome of a diagnosis in words.

    Parameters
    ----------
    diagnosis : Diagnosis

    Returns
    -------
    Verdict
    """
    found, check = _verdict(diagnosis), diagnosis.fit_check
    first = [_UNLIKE] if diagnosis.recording.is_unlike_the_fit else []
    if diagnosis.test.outside > _MOSTLY and found.kind != "outside":
        first.append(f"{_outside(diagnosis)}.")
    first += [f"{capital(one)}." for one in (check.cautions if check else ())]
    return replace(found, headline=" ".join([*first, found.headline])) if first else found


def _verdict(diagnosis: Diagnosis) -> Verdict:
    decided = int(diagnosis.decided.sum())
    if diagnosis.alarms:
        return _fault(diagnosis)
    if decided == 0:
        why = diagnosis.why_undecided
        return Verdict("undecided", "No decision.", (f"No sample could be judged: {why}.",))
    sentences = [f"{decided:,} of {len(diagnosis.time):,} samples were judged."]
    largest = _largest(diagnosis)
    if math.isfinite(largest) and math.isfinite(diagnosis.threshold) and diagnosis.threshold > 0:
        share = 100 * largest / diagnosis.threshold
        sentences.append(
            f"The statistic reached {number(share, 3)} % of its threshold at most"
            + (", but not for long enough to raise an alarm." if share > 100 else ".")
        )
    if diagnosis.naming.unjudged:
        want = "code" if diagnosis.naming.codes else "signature"
        sentences.append(f"This monitor may miss {some(diagnosis.naming.unjudged)}: it has no {want} for it.")
    check = diagnosis.fit_check
    if diagnosis.test.outside > _MOSTLY:
        return Verdict("outside", f"Cannot tell: {_outside(diagnosis)}.", tuple(sentences))
    if check is not None:
        sentences += check.could_have_seen
        if check.sees_nothing:
            return Verdict("cannot tell", f"Cannot tell: {check.sees_nothing}.", tuple(sentences))
    return Verdict("none", "No fault found.", tuple(sentences))


def _outside(diagnosis: Diagnosis) -> str:
    """Return the share of a recording outside of the learnt range."""
    share = percent(round(100 * diagnosis.test.outside), 100)
    return f"{share} of the samples lie outside the range that the monitor has learnt"


def _largest(diagnosis: Diagnosis, rows: int = 1 << 18) -> float:
    """Return the largest statistic with a decision, NaN without a finite one; piece by piece."""
    largest, there = -math.inf, False
    for k in range(0, len(diagnosis.time), rows):
        seen = diagnosis.statistic[k : k + rows][diagnosis.decided[k : k + rows]]
        seen = seen[~np.isnan(seen)]
        there = there or bool(np.isfinite(seen).any())
        largest = max(largest, float(seen.max(initial=-math.inf)))
    return largest if there else math.nan


def _fault(diagnosis: Diagnosis) -> Verdict:
    main, clock = diagnosis.main_alarm, diagnosis.clock
    assert main is not None
    sentences = [
        f"{capital(began_text(main, clock))}.",
        f"The statistic is over its threshold from {clock.at(_crossed(main, diagnosis))} on; "
        f"{raised_text(main, clock)}, {_end(main.ended, clock)}.",
    ]
    if main.fired:
        sentences.append(f"{capital(over_thresholds(main))}.")
    said = diagnosis.statement(main)
    headline = said.headline
    best = main.candidates[0] if main.candidates else None
    if diagnosis.naming.unjudged and main.reading is None and best and (main.ended is not None or best.score < _SURE):
        headline = f"{headline[:-1]}; or {some(diagnosis.naming.unjudged)}, which this monitor never names."
    sentences += said.sentences
    if diagnosis.no_direction:
        sentences.append(f"{capital(NO_DIRECTION)}, and the size is that of what it estimates.")
    if diagnosis.test.certified:
        sentences.append(CERTAIN)
    sentences += [*_sized(main), *_not_apart(diagnosis, main)]
    if diagnosis.naming.unjudged:
        want = "code" if diagnosis.naming.codes else "signature"
        sentences.append(f"Never named, because this monitor has no {want} for it: {some(diagnosis.naming.unjudged)}.")
    if len(diagnosis.alarms) > 1:
        sentences.append(f"This is the longest of {len(diagnosis.alarms):,} alarms.")
    return Verdict("fault", headline, tuple(sentences), said.confidence, said.margin, said.present, said.rules)


def _not_apart(diagnosis: Diagnosis, main: Alarm) -> list[str]:
    """Return a sentence about further groups that this monitor cannot distinguish."""
    others = [names for group, names in diagnosis.alike if group not in main.named]
    if not others:
        return []
    more = f"; and {len(others) - _TOLD} more groups" if len(others) > _TOLD + 1 else ""
    shown = others[: _TOLD if more else None]
    return [f"Other faults that this monitor cannot tell apart: {'; '.join(map(some, shown))}{more}."]


def _sized(alarm: Alarm) -> list[str]:
    """Describe the estimated sizes of the best candidate; of all faults if none is named, or it is not estimated."""
    best = alarm.candidates[0].sizes if alarm.candidates else ()
    if len(best) > 1:
        return [f"Estimated size: {sizes_text(best)}."]
    return [f"Estimated size of {size.fault}: {size_text(size)}." for size in best or alarm.sizes]


def _crossed(alarm: Alarm, diagnosis: Diagnosis) -> float:
    """Return the time at which the statistic first exceeded its threshold; with matched filters the arrival."""
    return alarm.onset if diagnosis.match is None else alarm.raised


def _end(ended: float | None, clock: Clock) -> str:
    return "lasting to the end of the recording" if ended is None else f"ended at {clock.at(ended)}"
