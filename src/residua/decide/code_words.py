"""Text of an alarm by code: members that fired, the reading, and its certainty."""

from __future__ import annotations

from dataclasses import replace

from residua.decide.alarm import Alarm
from residua.decide.code_reading import CodeReading, each_once
from residua.decide.statement import Statement, capital, raised_text, statement_by_word, too_short
from residua.decide.word import ANYTHING, EITHER, GOOD, POOR, TOO_EARLY, Word
from residua.recording.clock import Clock
from residua.words import listing, percent

#: A code that stood in less than this fraction of an alarm's samples is unsteady: too early.
STEADY_SHARE = 0.5

CODE_RULES = (
    "A code says which members a fault fires, not how strongly. Good match: just those of one listed fault fired for "
    f"{100 * STEADY_SHARE:g} % of the alarm at least, not all members did, and no other listed fault's code is one "
    "member away. Either: it is the code of several listed faults, or one is a member away, or members of a code are "
    "silent, or all members fired. Poor match: members fired that no listed fault fires together. Too early: the alarm "
    "is short, or the members that fire change."
)

SCORE_RULE = "The score is the fraction of the members that agree with a code."

DEDICATED_RULES = (
    "Every fault fires a member of its own. A member that fires alone names its fault, a good match unless it is the "
    "only one. Either: members that fire together, or one after the other in one alarm, are of several faults, each "
    "there since its own member fired, or of one that is not listed. Too early: the alarm is short, or the members "
    "that fire change."
)

#: Causes that an exact code cannot exclude.
_SAME_CODE = "Just the members that answer to it fired; a fault that is not listed could fire the same ones."


def word_by_code(
    alarm: Alarm, window: int, around: tuple[tuple[str, ...], ...], near: tuple[tuple[str, ...], ...]
) -> Word:
    """Return the word for an alarm that was read by code.

    ``around`` are the groups whose codes hold the pattern, the nearest first, ``near`` those one member away from it.
    """
    reading = alarm.reading
    assert reading is not None
    made = Word(GOOD, reading.named, why="by its code", after=alarm.samples)
    wavers = not reading.together and alarm.read_share is not None and alarm.read_share < STEADY_SHARE
    if reading.answer == "none" or alarm.samples < window or wavers:
        why = too_short(window) if alarm.samples < window else "the members that fire change"
        return replace(made, kind=TOO_EARLY, why=why, together=bool(reading.together))
    if reading.together:
        return replace(made, kind=EITHER, why="", unlisted=ANYTHING, together=True)
    close = each_once([*around, *near])
    unlisted = "" if reading.answer == "exact" and not all(reading.pattern) else ANYTHING
    if not around:
        faults = reading.named or ((reading.close,) if reading.close else ())
        return replace(made, kind=POOR, faults=faults, why="no listed fault fires just these members")
    if unlisted or sum(map(len, close)) > 1:
        return replace(made, kind=EITHER, why="", faults=close, unlisted=unlisted)
    return made


def statement_by_code(alarm: Alarm, clock: Clock, word: Word, *, dedicated: bool) -> Statement:
    """Return the statement about an alarm that was read by code; ``dedicated``: every fault has its own member."""
    reading = alarm.reading
    assert reading is not None
    sentences = [f"Fired: {listing(reading.fired) or 'none'}; {reading.meaning}."]
    if alarm.read_share:
        share = percent(round(1000 * alarm.read_share), 1000)
        these = "all of these members had fired" if reading.together else "these were the members that fired"
        sentences.append(f"In {share} of the alarm's samples {these}.")
    rules = (DEDICATED_RULES if dedicated else CODE_RULES) + (f" {SCORE_RULE}" if alarm.candidates else "")
    if reading.together:
        return _several(alarm, reading, word, clock, sentences, rules)
    if word.kind == GOOD:
        sentences.append(_SAME_CODE)
    said = statement_by_word(alarm, word, clock, sentences, rules, alarm.margin)
    return replace(said, lines=(str(reading), *said.lines))


def _several(
    alarm: Alarm, reading: CodeReading, word: Word, clock: Clock, sentences: list[str], rules: str
) -> Statement:
    """Return the statement for several faults of a dedicated bank, each with its own time."""
    sentences += [
        f"{p.name}: its member fell silent at {clock.at(p.until)}." for p in alarm.present if p.until is not None
    ]
    sentences += [
        f"This monitor does not distinguish {listing(group)}." for group in reading.together if len(group) > 1
    ]
    sentences.append("Each fault has a member of its own here; one that is not listed may fire any of them.")
    timed = [p.faults for p in alarm.present]
    names = listing(
        [f"{p.name} (fired from {clock.at(p.since)})" for p in alarm.present]
        + [" or ".join(group) for group in reading.together if group not in timed]
    )
    headline = f"Fault found: either {len(reading.together)} at once, {names}, or one that is not listed."
    if word.kind == TOO_EARLY:
        when = capital(raised_text(alarm, clock))
        headline = f"{when}, too early to be sure of the names, for {word.why}; so far {names}."
    lines = (str(reading), *(str(fault) for fault in alarm.present), word.line)
    return Statement(headline, word.kind, None, tuple(sentences), lines, reading.together, rules)
