"""Statement about an alarm, with one wording for the page, the screen and the printed diagnosis."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from residua.decide.alarm import CLOSE_MARGIN, Alarm, Candidate, Size
from residua.decide.word import ANYTHING, EITHER, POOR, RULES as RULES_OF_WORDS, TOO_EARLY, Word
from residua.recording.clock import Clock
from residua.words import counted, listing, number, score, some

#: Below this score no listed fault explains the residual well: it points more than 26 degrees away.
POOR_SCORE = 0.90
#: Alarms that are printed at most, the longest ones; and those whose beginning is dated.
SHOWN_ALARMS = 20

RULES = (
    "A score alone cannot show that a fault explains the residual, so no name is a good match by it. Either: the best "
    f"candidate, those less than {CLOSE_MARGIN:.2f} behind it, or something not listed. Poor match: the best score is "
    f"below {POOR_SCORE:.2f}. Too early: the alarm is shorter than the window by which names are judged."
)


@dataclass(frozen=True)
class Statement:
    """Statement of an isolation about one alarm.

    Attributes
    ----------
    headline : str
        One sentence, with the name if there is one.
    confidence : str
        How sure the name is: ``"good match"``, ``"either"``, ``"poor match"`` or ``"too early"``; empty where nothing
        is named.
    margin : float or None
        Lead of the best candidate over the next, in score.
    sentences : tuple of str
        Basis of the name.
    lines : tuple of str
        Lines of a printed diagnosis, without full stops: doubts about the name come first.
    present : tuple of tuple of str
        Several faults that are named together.
    rules : str
        How the numbers are to be read.
    """

    headline: str
    confidence: str = ""
    margin: float | None = None
    sentences: tuple[str, ...] = ()
    lines: tuple[str, ...] = ()
    present: tuple[tuple[str, ...], ...] = ()
    rules: str = ""


def raised_text(alarm: Alarm, clock: Clock) -> str:
    """Describe the time at which an alarm was raised."""
    return f"alarm raised at {clock.at(alarm.raised)}"


def capital(text: str) -> str:
    """Return a text with a capital first letter."""
    return f"{text[:1].upper()}{text[1:]}"


def not_isolated(alarm: Alarm, clock: Clock) -> Statement:
    """Return the words for an alarm without a named fault."""
    headline = f"A fault was found, {raised_text(alarm, clock)}; it was not isolated."
    return Statement(headline, "", None, ("This monitor names no candidates for it.",))


def statement_by_score(
    alarm: Alarm, clock: Clock, word: Word | None, beside: Callable[[float], str] | None = None, meaning: str = ""
) -> Statement:
    """Return the statement about an alarm whose candidates are ranked by a score.

    ``beside`` adds to each score, ``meaning`` explains scores.
    """
    if word is None:
        return not_isolated(alarm, clock)
    if word.fitted:
        return statement_by_word(alarm, word, clock, word.sentences, RULES_OF_WORDS)
    candidates = scored(alarm)
    margin = candidates[0].score - candidates[1].score if len(candidates) > 1 else None
    rules = f"{meaning} {RULES}".strip()
    return statement_by_word(alarm, word, clock, (_comparison(candidates, beside),), rules, margin)


def statement_by_word(
    alarm: Alarm, word: Word, clock: Clock, sentences: Sequence[str], rules: str, margin: float | None = None
) -> Statement:
    """Return the statement about an alarm that has a word, with its basis and the reading of its numbers."""
    basis = (*sentences, *(line for group in word.faults[:1] for line in not_apart(group)))
    return Statement(word.headline(raised_text(alarm, clock)), word.kind, margin, basis, (word.line,), rules=rules)


def word_by_score(alarm: Alarm, window: int) -> Word | None:
    """Return the word for an alarm by the scores of its candidates alone; ``None`` without candidates."""
    candidates = scored(alarm)
    if not candidates:
        return None
    best = candidates[0]
    word = Word(EITHER, (best.faults,), after=alarm.samples)
    if alarm.samples < window:
        return replace(word, kind=TOO_EARLY, why=too_short(window))
    if best.score < POOR_SCORE:
        return replace(word, kind=POOR, why=f"the best score is {score(best.score)}, below {POOR_SCORE:.2f}")
    close = tuple(c.faults for c in candidates if c.score > best.score - CLOSE_MARGIN)
    return replace(word, faults=close, unlisted=ANYTHING)


def scored(alarm: Alarm) -> list[Candidate]:
    """Return the candidates of an alarm that have a score."""
    return [c for c in alarm.candidates if math.isfinite(c.score)]


def too_short(window: int) -> str:
    """Return the reason why a short alarm has no name yet."""
    return f"the alarm is shorter than the {window} samples that a name is judged by"


def not_apart(faults: Sequence[str]) -> list[str]:
    """Return a sentence about the faults that share one name, if they are several."""
    return [f"This monitor does not distinguish {some(faults)}."] if len(faults) > 1 else []


def _comparison(candidates: Sequence[Candidate], beside: Callable[[float], str] | None) -> str:
    """Return the scores of the best candidate and of the next."""
    best = candidates[0]
    text = f"Score {score(best.score)}" + (f", {beside(best.score)} off its signature" if beside else "")
    if len(candidates) < 2:
        return f"{text}; there is no other candidate to compare with."
    following = candidates[1]
    next_one = score(following.score) + (f" ({beside(following.score)})" if beside else "")
    return f"{text}; next is {following.name} with {next_one}."


def angle(cosine: float) -> str:
    """Return the angle of a score, in degrees."""
    if not math.isfinite(cosine):
        return "–"
    degrees = math.degrees(math.acos(min(1.0, max(0.0, cosine))))
    return f"{degrees:.0f}°" if degrees >= 10 else f"{degrees:.1f}°"


# ------------------------------------------------------------------------- candidates


def ranked(candidates: tuple[Candidate, ...]) -> list[tuple[int, Candidate]]:
    """Return the candidates with their ranks; scores that agree with the first to three digits share one.

    By matched filters those whose likelihood ratios agree to one decimal.
    """
    out: list[tuple[int, Candidate]] = []
    for k, candidate in enumerate(candidates):
        tied = k > 1 and _weight(candidate) == _weight(candidates[k - 1])
        out.append((out[-1][0] if tied else k + 1, candidate))
    return out


def _weight(candidate: Candidate) -> float:
    """Return the ranking weight of a candidate, with the digits that are shown."""
    if candidate.probability is not None:
        return candidate.probability
    return round(candidate.score, 3) if candidate.ratio is None else round(candidate.ratio, 1)


def tied_name(candidates: tuple[Candidate, ...], rank: int) -> str:
    """Return the first candidate of a rank as text, with the number of others that share it; empty if nobody has it."""
    names = [candidate.name for place, candidate in ranked(candidates) if place == rank]
    more = len(names) - 1
    return f"{names[0]} (tied with {more} more)" if more > 0 else "".join(names)


def weight_text(candidate: Candidate) -> str:
    """Return the probability of a candidate if there is one, else its score."""
    known = candidate.probability is not None
    return f"probability {number(candidate.probability, 3)}" if known else f"score {candidate.score:.3f}"


def arrival_text(candidate: Candidate) -> str:
    """Describe the arrival of a fault and its probability, as given by matched filters; empty for anything else."""
    if candidate.ratio is None:
        return ""
    when = "before the window" if candidate.arrival is None else f"{candidate.arrival:.6g} s"
    return f"  arrived {when}  2 ln L {candidate.ratio:.1f}"


def size_text(size: Size) -> str:
    """Return an estimated size with its unit and its last value."""
    unit = f" {size.unit}" if size.unit else ""
    spread = "" if size.deviation is None else f" ± {number(size.deviation, 2)}"
    last = f" (last {number(size.last, 3)}{unit})" if math.isfinite(size.last) else ""
    return f"{number(size.mean, 3)}{spread}{unit}{last}"


def sizes_text(sizes: Sequence[Size], of_one: Callable[[Size], str] = size_text) -> str:
    """Return the estimated sizes of one candidate: each with its fault if there may be several."""
    return of_one(sizes[0]) if len(sizes) == 1 else ", or ".join(f"{size.fault} {of_one(size)}" for size in sizes)


def began_text(alarm: Alarm, clock: Clock) -> str:
    """Describe the beginning of an alarm as an interval; never its first crossing of the threshold as a fact."""
    began = alarm.began
    if began is None:
        return f"began at an unknown time, at or before {clock.at(alarm.raised)}"
    if began.earliest is None:
        return f"began at or before {clock.at(began.latest)}; the earlier data do not show when"
    between = f"began between {clock.at(began.earliest)} and {clock.at(began.latest)}"
    sure = f"{100 * began.confidence:g} % confidence if the residual began to move by a step or a ramp"
    return f"{between} ({sure}), most likely at {clock.at(began.estimate)}"


def longest_alarms(alarms: Sequence[Alarm], most: int) -> list[tuple[int, Alarm]]:
    """Return the longest alarms, at most so many, in order of time and with their numbers.

    A list cut off after the first ones would hide a fault behind the short false alarms before it.
    """
    numbered = sorted(enumerate(alarms, 1), key=lambda pair: -pair[1].samples)
    return sorted(numbered[:most], key=lambda pair: pair[0])


def left_out_text(alarms: Sequence[Alarm], most: int) -> str:
    """Describe the number and length of alarms that are not among the longest; empty if all are."""
    lengths = sorted((alarm.samples for alarm in alarms), reverse=True)[most:]
    if not lengths:
        return ""
    return f"... and {counted(len(lengths), 'more alarm')}, none longer than {counted(lengths[0], 'sample')}"


def over_thresholds(alarm: Alarm, most: int = 10) -> str:
    """Describe the groups of residuals over their thresholds: the first ones and the number of others."""
    more = f" and {len(alarm.fired) - most} more" if len(alarm.fired) > most else ""
    return f"over their thresholds: {listing(alarm.fired[:most])}{more}"


def alike(
    groups: Sequence[tuple[str, ...]], settled: Sequence[tuple[str, ...]] = ()
) -> list[tuple[tuple[str, ...], tuple[str, ...]]]:
    """Return the groups of several faults, each with its names as shown: with *once constant* if it applies.

    Parameters
    ----------
    groups : sequence of tuple of str
    settled : sequence of tuple of str
        Of each group those that are meant only once they are constant; none when omitted.
    """
    settled = settled or ((),) * len(groups)
    out = []
    always = [set(group) - set(later) for group, later in zip(groups, settled, strict=True)]
    for group, later in zip(groups, settled, strict=True):
        if len(group) > 1 and not (later and any(set(group) <= own for own in always)):
            out.append((group, tuple(f"{name} once constant" if name in later else name for name in group)))
    return out
