"""A diagnosis in words."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from residua.monitor.diagnosis import CLOSE_LEAD, CLOSE_MARGIN, NO_DIRECTION, NO_FIT
from residua.monitor.naming import alike, began_text
from residua.recording.clock import Clock
from residua.report.text import lead_text, listing, number, percent, score, size_text, sizes_text, some

if TYPE_CHECKING:
    from residua.decide.alarm import Alarm, Candidate
    from residua.monitor.diagnosis import Diagnosis

#: A lead in score at or above this is called clear.
CLEAR_MARGIN = 0.10
#: By matched filters, a lead in twice the logarithm of the likelihood at or above this (22,000 to 1) is called clear.
CLEAR_LEAD = 20.0
#: Below this score no listed fault explains the residual well (it points more than 45 degrees away).
POOR_SCORE = 0.70

#: Groups of faults that are not told apart, besides the one that is named, that a sentence lists.
_TOLD = 5

#: A code that stood in less than this fraction of an alarm's samples is called unsteady.
STEADY_SHARE = 0.5

BEGAN_RULE = (
    "The interval in which it began holds for a change of the residual that begins as a step, a ramp or the square of "
    "time, in noise that goes on as before. A fault that no residual answers to at first began by that much earlier."
)

RULES = (
    "The score is the cosine of the angle between the residual and a signature, judged over the monitor's window. "
    f"A lead over the next candidate of {CLEAR_MARGIN:.2f} or more is called clear, below {CLOSE_MARGIN:.2f} a close "
    f"call; a best score below {POOR_SCORE:.2f} means that no listed fault explains the residual well."
)

MATCH_RULES = (
    "The score is the root of the fraction that a fault explains of what exceeds the noise in the window; the "
    "logarithm of its likelihood ratio against no fault adds the evidence of the window in which it arrived and of the "
    f"last one of the alarm. A lead in it of {CLEAR_LEAD:g} or more over the next candidate is called clear, below "
    f"{CLOSE_LEAD:g} (20 to 1) a close call. Where scores less than {CLOSE_MARGIN:.2f} apart leave more unexplained "
    "than sets them apart, the match is inexact: a model error may decide, however large the lead is. A best score "
    f"below {POOR_SCORE:.2f} means that no listed fault, as a step, explains the innovations well. Sizes are those of "
    "a step with the arrival given, with one standard deviation."
)


#: What is said of an alarm by certified thresholds.
CERTAIN = (
    "The thresholds are certified: without a fault no plant of the uncertainty set goes over them while the "
    "disturbances keep their bounds."
)


@dataclass(frozen=True)
class Verdict:
    """What a diagnosis comes to.

    Attributes
    ----------
    kind : {"fault", "none", "undecided"}
    headline : str
    sentences : tuple of str
    confidence : str
        ``"clear lead"``, ``"moderate lead"``, ``"close call"``, ``"no good match"``, ``"short alarm"``,
        ``"not isolated"``; by matched filters also ``"inexact match"``; by code ``"exact code"``,
        ``"exact codes"`` (of several faults), ``"degraded code"``, ``"nearest code"``, ``"no code"``,
        ``"unsteady code"``, ``"short alarm"``; or empty.
    margin : float or None
        Lead of the best candidate over the next in score.
    present : tuple of tuple of str
        Several faults that a dedicated bank names together.
    """

    kind: str
    headline: str
    sentences: tuple[str, ...]
    confidence: str = ""
    margin: float | None = None
    present: tuple[tuple[str, ...], ...] = ()


def verdict(diagnosis: Diagnosis) -> Verdict:
    """Return the outcome of a diagnosis in words.

    Parameters
    ----------
    diagnosis : Diagnosis

    Returns
    -------
    Verdict
    """
    decided = int(diagnosis.decided.sum())
    if diagnosis.alarms:
        return _fault(diagnosis)
    if decided == 0:
        why = (
            "the recording is empty"
            if not len(diagnosis.time)
            else (
                "no sample of the recording could be judged: it is shorter than the filter needs to settle, "
                "or values are missing throughout"
            )
        )
        return Verdict("undecided", "No decision.", (f"{why[0].upper()}{why[1:]}.",))
    sentences = [f"{decided:,} of {len(diagnosis.time):,} samples were judged."]
    seen = diagnosis.statistic[diagnosis.decided]
    largest = float(np.nanmax(seen)) if np.isfinite(seen).any() else math.nan
    if math.isfinite(largest) and math.isfinite(diagnosis.threshold) and diagnosis.threshold > 0:
        share = 100 * largest / diagnosis.threshold
        sentences.append(
            f"The statistic reached {number(share, 3)} % of its threshold at most"
            + (", but not for long enough to raise an alarm." if share > 100 else ".")
        )
    if diagnosis.unjudged:
        want = "code" if diagnosis.codes else "signature"
        sentences.append(f"This monitor may not see {some(diagnosis.unjudged)}: without a {want} in it.")
    return Verdict("none", "No fault found.", tuple(sentences))


def _fault(diagnosis: Diagnosis) -> Verdict:
    main, clock = diagnosis.main_alarm, diagnosis.clock
    assert main is not None
    when = f"alarm raised at {clock.at(main.raised)}"
    began = began_text(main, clock)
    sentences = [
        f"{began[0].upper()}{began[1:]}.",
        f"The statistic first went over its threshold and stayed at {clock.at(_crossed(main, diagnosis))}; "
        f"{when}, {_end(main.ended, clock)}.",
    ]
    if main.fired:
        more = f" and {len(main.fired) - 10} more" if len(main.fired) > 10 else ""
        sentences.append(f"Over their thresholds: {listing(main.fired[:10])}{more}.")
    candidates = [c for c in main.candidates if math.isfinite(c.score)]
    if main.reading is not None:
        headline, confidence, margin = _by_code(main, diagnosis.window, when, sentences, clock)
    elif not candidates:
        headline = f"A fault was found, {when}; it was not isolated."
        sentences.append("This monitor names no candidates for it.")
        confidence, margin = "not isolated", None
    else:
        best = candidates[0]
        confidence, margin = _confidence(candidates, main)
        if main.samples < diagnosis.window:
            confidence = "short alarm"
            headline = f"{when[0].upper()}{when[1:]}, too short to be sure of the name; nearest: {best.name}."
        elif confidence == "no good match":
            headline = f"A fault was found, {when}; no listed fault explains it well. Nearest: {best.name}."
        elif confidence == "close call":
            headline = f"Fault found: {best.name}, or {candidates[1].name} (a close call), {when}."
        elif confidence == "inexact match":
            headline = f"Fault found: {best.name}, or {candidates[1].name} (neither fits exactly), {when}."
        else:
            headline = f"Fault found: {best.name}, {when}."
        if diagnosis.unjudged and (main.ended is not None or best.score < 0.9):
            headline = f"{headline[:-1]}; or {some(diagnosis.unjudged)}, which this monitor never names."
        if diagnosis.match is None:
            sentences.append(_how_sure(candidates, confidence, margin))
        else:
            sentences += [_how_likely(main, confidence), _arrived(main, clock)]
        if len(best.faults) > 1:
            sentences.append(f"This monitor cannot tell {some(best.faults)} apart.")
        if diagnosis.no_direction:
            sentences.append(f"{NO_DIRECTION[0].upper()}{NO_DIRECTION[1:]}, and the size is that of what it estimates.")
    if diagnosis.certified:
        sentences.append(CERTAIN)
    sentences += _sized(main)
    told = main.reading.named if main.reading else (_first(candidates),)
    others = [names for group, names in alike(diagnosis.groups, diagnosis.codes) if group not in told]
    if others:
        more = f"; and {len(others) - _TOLD} more groups" if len(others) > _TOLD + 1 else ""
        shown = others[: _TOLD if more else None]
        sentences.append(f"Not told apart here either: {'; '.join(map(some, shown))}{more}.")
    if diagnosis.unjudged:
        want = "code" if diagnosis.codes else "signature"
        sentences.append(f"Without a {want} in this monitor, so never named: {some(diagnosis.unjudged)}.")
    if len(diagnosis.alarms) > 1:
        sentences.append(f"This is the longest of {len(diagnosis.alarms):,} alarms.")
    present = main.reading.together if main.reading else ()
    return Verdict("fault", headline, tuple(sentences), confidence, margin, present)


def _by_code(main: Alarm, window: int, when: str, sentences: list[str], clock: Clock) -> tuple[str, str, float | None]:
    """Return headline, confidence and margin of a reading, and say what it rests on."""
    reading = main.reading
    assert reading is not None
    name = " or ".join(reading.faults)
    sentences.append(f"Fired: {listing(reading.fired) or 'none'}; {reading.meaning}.")
    if reading.together:
        return _several(main, window, sentences, clock)
    if main.read_share is not None:
        share = percent(round(1000 * main.read_share), 1000)
        sentences.append(f"In {share} of the alarm's samples these were the members that fired.")
    if len(reading.faults) > 1:
        sentences.append(f"This monitor cannot tell {listing(reading.faults)} apart.")
    if not reading.faults:
        one = f", such as {' and '.join(' or '.join(g) for g in reading.pairs[0])}" if len(reading.pairs) == 1 else ""
        several = f"ore than one fault{one}, or one that the bank does not know, {when}."
        if reading.possible:
            return f"Fault found, not told which: {reading.either} with members silent; or m{several}", "no code", None
        near = f"Nearest: {' or '.join(reading.close)}, 1 member off; or m" if reading.close else "M"
        headline = f"{near}{several}"
        return headline, "no code", None
    if main.samples < window:
        return (
            f"{when[0].upper()}{when[1:]}, too short to be sure of the name; read as {name}.",
            "short alarm",
            main.margin,
        )
    off = "" if reading.answer == "exact" else f" ({reading.answer} code)"
    steady = main.read_share is None or main.read_share >= STEADY_SHARE
    return f"Fault found: {name}{off}, {when}.", f"{reading.answer if steady else 'unsteady'} code", main.margin


def _several(main: Alarm, window: int, sentences: list[str], clock: Clock) -> tuple[str, str, None]:
    """Return headline and confidence where a dedicated bank names several faults, each with its own time."""
    reading = main.reading
    assert reading is not None
    if main.read_share:
        share = percent(round(1000 * main.read_share), 1000)
        sentences.append(f"In {share} of the alarm's samples all of these members had fired.")
    sentences += [
        f"{p.name}: its member fell silent at {clock.at(p.until)}." for p in main.present if p.until is not None
    ]
    sentences += [f"This monitor cannot tell {listing(group)} apart." for group in reading.together if len(group) > 1]
    sentences.append(
        "Each fault has a member of its own here; a fault that the bank does not know may fire any of them."
    )
    timed = [p.faults for p in main.present]
    names = listing(
        [f"{p.name} (fired from {clock.at(p.since)})" for p in main.present]
        + [" or ".join(group) for group in reading.together if group not in timed]
    )
    if main.samples < window:
        start = f"Alarm raised at {clock.at(main.raised)}"
        return f"{start}, too short to be sure of the names; read as {names}.", "short alarm", None
    return f"{len(reading.together)} faults found: {names}.", "exact codes", None


def _first(candidates: list[Candidate]) -> tuple[str, ...]:
    return candidates[0].faults if candidates else ()


def _sized(alarm: Alarm) -> list[str]:
    """Tell the estimated sizes of the best candidate; of all faults where none is named, or it is not estimated."""
    best = alarm.candidates[0].sizes if alarm.candidates else ()
    if len(best) > 1:
        return [f"Estimated size: {sizes_text(best)}."]
    return [f"Estimated size of {size.fault}: {size_text(size)}." for size in best or alarm.sizes]


def _arrived(alarm: Alarm, clock: Clock) -> str:
    """Say when the fault arrived by matched filters."""
    if alarm.arrival is None:
        return "It arrived before the window of the matched filters, or grew slowly."
    return f"Estimated arrival {clock.at(alarm.arrival)}, as a step."


def _crossed(alarm: Alarm, diagnosis: Diagnosis) -> float:
    """Return when the statistic first went over its threshold for an alarm; matched filters have the arrival there."""
    return alarm.onset if diagnosis.match is None else alarm.raised


def _end(ended: float | None, clock: Clock) -> str:
    return "lasting to the end of the recording" if ended is None else f"ended at {clock.at(ended)}"


def _confidence(candidates: list[Candidate], alarm: Alarm) -> tuple[str, float | None]:
    margin = candidates[0].score - candidates[1].score if len(candidates) > 1 else None
    if candidates[0].score < POOR_SCORE:
        return "no good match", margin
    if alarm.lead is not None:
        surely = "clear lead" if alarm.lead >= CLEAR_LEAD else "moderate lead"
        return {"likelihood": "close call", "fit": "inexact match"}.get(alarm.doubt, surely), margin
    if margin is None or margin >= CLEAR_MARGIN:
        return "clear lead", margin
    return ("close call" if margin < CLOSE_MARGIN else "moderate lead"), margin


def _how_sure(candidates: list[Candidate], confidence: str, margin: float | None) -> str:
    best = candidates[0]
    text = f"Score {score(best.score)}, {angle(best.score)} off its signature"
    if margin is None:
        return f"{text}; there is no other candidate to compare with."
    following = candidates[1]
    words = {
        "clear lead": "a clear lead",
        "moderate lead": "a moderate lead",
        "close call": "a close call",
        "no good match": "neither fits",
        "short alarm": "judged over a window that is longer than the alarm",
    }[confidence]
    return (
        f"{text}; next is {following.name} with {score(following.score)}"
        f" ({angle(following.score)}): {words}, margin {score(margin)}."
    )


def _how_likely(alarm: Alarm, confidence: str) -> str:
    """Say by how much the best candidate of matched filters leads in likelihood, and whether it fits."""
    best, *others = alarm.candidates
    text = f"Score {score(best.score)}"
    if alarm.lead is None:
        return f"{text}; there is no other candidate to compare with."
    words = {
        "clear lead": "a clear lead",
        "moderate lead": "a moderate lead",
        "close call": "a close call",
        "no good match": "neither fits: the model is in error, or the fault is no step, or none of these",
        "inexact match": NO_FIT,
        "short alarm": "judged over a window that is longer than the alarm",
    }[confidence]
    lead = f"its likelihood leads that of {others[0].name} by 2 ln L = {lead_text(alarm.lead)}"
    return f"{text}, next {score(others[0].score)}; {lead}: {words}."


def angle(cosine: float) -> str:
    """Return the angle that a score stands for, in degrees."""
    if not math.isfinite(cosine):
        return "–"
    degrees = math.degrees(math.acos(min(1.0, max(0.0, cosine))))
    return f"{degrees:.0f}°" if degrees >= 10 else f"{degrees:.1f}°"
