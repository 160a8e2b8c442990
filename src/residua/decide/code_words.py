"""An alarm by code in words: what fired, what it reads as, and how sure that is."""

from __future__ import annotations

from residua.decide.alarm import Alarm
from residua.decide.code_reading import LISTED, CodeReading
from residua.decide.statement import Statement, capital, raised_text, too_short
from residua.decide.word import TOO_EARLY
from residua.recording.clock import Clock
from residua.words import listing, percent

#: A code that stood in less than this fraction of an alarm's samples is called unsteady.
STEADY_SHARE = 0.5

CODE_RULES = (
    "A pattern of fired members is read in this order: exact, the code of one fault; degraded, the code of one fault "
    "with members silent, and of no other (only where no code is part of another); nearest, one code nearer than all "
    "others, within the members that may differ, and the pattern is "
    "part of no other fault's code; else it is more than one fault, or one that the bank does not know."
)

SCORE_RULE = "The score is the fraction of the members that agree with a code."

DEDICATED_RULES = (
    "Every fault fires a member of its own. A member that fires names its fault, and members that fire together, or "
    "one after the other in one alarm, name several faults; each is there since its own member fired."
)


def statement_by_code(alarm: Alarm, clock: Clock, window: int, *, dedicated: bool) -> Statement:
    """Return the statement about an alarm that was read by code; ``dedicated``: every fault has a member of its own."""
    reading = alarm.reading
    assert reading is not None
    first = f"Fired: {listing(reading.fired) or 'none'}; {reading.meaning}."
    made = _several(alarm, reading, window, clock) if reading.together else _one(alarm, reading, window, clock)
    lines = (str(reading), *(str(fault) for fault in alarm.present if reading.together), *too_short(alarm, window))
    rules = (DEDICATED_RULES if dedicated else CODE_RULES) + (f" {SCORE_RULE}" if alarm.candidates else "")
    headline, confidence, margin, sentences = made
    return Statement(headline, confidence, margin, (first, *sentences), lines, reading.together, rules)


def _one(
    alarm: Alarm, reading: CodeReading, window: int, clock: Clock
) -> tuple[str, str, float | None, tuple[str, ...]]:
    """Return headline, confidence, margin and what they rest on where one fault is read, or none."""
    sentences = []
    if alarm.read_share is not None:
        share = percent(round(1000 * alarm.read_share), 1000)
        sentences.append(f"In {share} of the alarm's samples these were the members that fired.")
    if len(reading.faults) > 1:
        sentences.append(f"This monitor cannot tell {listing(reading.faults)} apart.")
    when, name = raised_text(alarm, clock), " or ".join(reading.faults)
    if not reading.faults:
        return _unread(reading, when), "no code", None, tuple(sentences)
    more = [name for group in reading.possible for name in group]
    shown = more if len(more) <= LISTED else [*more[:LISTED], f"{len(more) - LISTED} more"]
    also = f", or {listing(shown, 'or')} with members silent" if more else ""
    if alarm.samples < window:
        headline = f"{capital(when)}, too short to be sure of the name; read as {name}{also}."
        return headline, TOO_EARLY, alarm.margin, tuple(sentences)
    off = "" if reading.answer == "exact" else f" ({reading.answer} code)"
    steady = alarm.read_share is None or alarm.read_share >= STEADY_SHARE
    confidence = f"{reading.answer if steady else 'unsteady'} code"
    return f"Fault found: {name}{also}{off}, {when}.", confidence, alarm.margin, tuple(sentences)


def _unread(reading: CodeReading, when: str) -> str:
    """Return the headline of a pattern that is the code of no single fault."""
    one = f", such as {' and '.join(' or '.join(g) for g in reading.pairs[0])}" if len(reading.pairs) == 1 else ""
    several = f"ore than one fault{one}, or one that the bank does not know, {when}."
    if reading.possible:
        return f"Fault found, not told which: {reading.either} with members silent; or m{several}"
    near = f"Nearest: {' or '.join(reading.close)}, 1 member off; or m" if reading.close else "M"
    return f"{near}{several}"


def _several(alarm: Alarm, reading: CodeReading, window: int, clock: Clock) -> tuple[str, str, None, tuple[str, ...]]:
    """Return the same where a dedicated bank names several faults, each with its own time."""
    sentences = []
    if alarm.read_share:
        share = percent(round(1000 * alarm.read_share), 1000)
        sentences.append(f"In {share} of the alarm's samples all of these members had fired.")
    sentences += [
        f"{p.name}: its member fell silent at {clock.at(p.until)}." for p in alarm.present if p.until is not None
    ]
    sentences += [f"This monitor cannot tell {listing(group)} apart." for group in reading.together if len(group) > 1]
    sentences.append(
        "Each fault has a member of its own here; a fault that the bank does not know may fire any of them."
    )
    timed = [p.faults for p in alarm.present]
    names = listing(
        [f"{p.name} (fired from {clock.at(p.since)})" for p in alarm.present]
        + [" or ".join(group) for group in reading.together if group not in timed]
    )
    if alarm.samples < window:
        headline = f"{capital(raised_text(alarm, clock))}, too short to be sure of the names; read as {names}."
        return headline, TOO_EARLY, None, tuple(sentences)
    return f"{len(reading.together)} faults found: {names}.", "exact codes", None, tuple(sentences)
