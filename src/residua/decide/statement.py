"""The statement about an alarm: one wording for the page, the screen and the printed diagnosis."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from residua.decide.alarm import CLOSE_MARGIN, Alarm, Candidate, Size
from residua.decide.word import EITHER, POOR, RULES as RULES_OF_WORDS, TOO_EARLY, Word
from residua.recording.clock import Clock
from residua.words import counted, listing, number, score, some

#: Below this score no listed fault explains the residual well: it points more than 26 degrees away.
POOR_SCORE = 0.90
#: Alarms that are printed at most, the longest ones; and those whose beginning is dated.
SHOWN_ALARMS = 20

#: How sure a name is by its score alone.
LIKELY = "likely"

RULES = (
    "Likely: by its score alone, as the noise of the residual is not known, so that nobody can say whether the fault "
    f"explains it. Either: the next candidate is less than {CLOSE_MARGIN:.2f} behind. Poor match: the best score is "
    f"below {POOR_SCORE:.2f}. Too early: the alarm is shorter than what a name is judged over."
)


@dataclass(frozen=True)
class Statement:
    """What an isolation says of one alarm.

    Attributes
    ----------
    headline : str
        One sentence, with the name if there is one.
    confidence : str
        How sure the name is, in two words: ``"good match"``, ``"too early"``, ``"exact code"``, ...
    margin : float or None
        Lead of the best candidate over the next, in score.
    sentences : tuple of str
        What the name rests on.
    lines : tuple of str
        What a printed diagnosis says of it, without full stops: what makes the name doubtful, before all else.
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
    """Return when an alarm was raised."""
    return f"alarm raised at {clock.at(alarm.raised)}"


def capital(text: str) -> str:
    """Return a text as the beginning of a sentence."""
    return f"{text[:1].upper()}{text[1:]}"


def not_isolated(alarm: Alarm, clock: Clock) -> Statement:
    """Return the words for an alarm without a named fault."""
    headline = f"A fault was found, {raised_text(alarm, clock)}; it was not isolated."
    return Statement(headline, "not isolated", None, ("This monitor names no candidates for it.",))


def statement_by_score(
    alarm: Alarm, clock: Clock, window: int, beside: Callable[[float], str] | None = None, meaning: str = ""
) -> Statement:
    """Return the statement about an alarm whose candidates are ranked by a score.

    ``beside`` says more of each score, ``meaning`` what a score is.
    """
    if alarm.word is not None:
        return statement_by_word(alarm, alarm.word, clock)
    candidates = scored(alarm)
    if not candidates:
        return not_isolated(alarm, clock)
    confidence, margin = how_sure(candidates)
    if alarm.samples < window:
        confidence = TOO_EARLY
    sentences = [_comparison(candidates, beside), *not_apart(candidates[0].faults)]
    lines = too_short(alarm, window)
    if not lines and alarm.doubt == "score":
        lines = (f"either of the first two, whose scores are {abs(alarm.margin or 0.0):.3f} apart",)
    rules = f"{meaning} {RULES}".strip()
    return Statement(headline_of(alarm, clock, confidence), confidence, margin, tuple(sentences), lines, rules=rules)


def statement_by_word(alarm: Alarm, word: Word, clock: Clock) -> Statement:
    """Return the statement about an alarm by how well the listed faults explain it."""
    apart = [line for group in word.faults[:1] for line in not_apart(group)]
    said = (*word.sentences, *apart)
    return Statement(
        word.headline(raised_text(alarm, clock)), word.kind, None, said, (word.line,), rules=RULES_OF_WORDS
    )


def scored(alarm: Alarm) -> list[Candidate]:
    """Return the candidates of an alarm that have a score."""
    return [c for c in alarm.candidates if math.isfinite(c.score)]


def how_sure(candidates: Sequence[Candidate]) -> tuple[str, float | None]:
    """Return in two words how sure the first of some candidates is by its score, and its lead."""
    margin = candidates[0].score - candidates[1].score if len(candidates) > 1 else None
    if candidates[0].score < POOR_SCORE:
        return POOR, margin
    return (EITHER if margin is not None and margin < CLOSE_MARGIN else LIKELY), margin


def headline_of(alarm: Alarm, clock: Clock, confidence: str) -> str:
    """Return the sentence that names the best candidate as surely as it is sure."""
    best, *others = scored(alarm)
    when = raised_text(alarm, clock)
    if confidence == TOO_EARLY:
        return f"{capital(when)}, too short to be sure of the name; nearest: {best.name}."
    if confidence == POOR:
        return f"A fault was found, {when}; no listed fault explains it well. Nearest: {best.name}."
    if confidence == EITHER:
        return f"Fault found: either {best.name} or {others[0].name}, {when}."
    return f"Fault found: {best.name}, {when}."


def too_short(alarm: Alarm, window: int) -> tuple[str, ...]:
    """Return a line that says so where an alarm is too short for a sure name."""
    if not alarm.candidates or alarm.samples >= window:
        return ()
    return (f"shorter than the {window} samples that a name is judged by: not sure of its name",)


def not_apart(faults: Sequence[str]) -> list[str]:
    """Return a sentence about the faults that one name stands for, if they are several."""
    return [f"This monitor cannot tell {some(faults)} apart."] if len(faults) > 1 else []


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
    """Return the angle that a score stands for, in degrees."""
    if not math.isfinite(cosine):
        return "–"
    degrees = math.degrees(math.acos(min(1.0, max(0.0, cosine))))
    return f"{degrees:.0f}°" if degrees >= 10 else f"{degrees:.1f}°"


# ------------------------------------------------------------------------- candidates


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
    if candidate.probability is not None:
        return candidate.probability
    return round(candidate.score, 3) if candidate.ratio is None else round(candidate.ratio, 1)


def tied_name(candidates: tuple[Candidate, ...], rank: int) -> str:
    """Return the first candidate of a rank as text, with how many others share it; empty if nobody has it."""
    names = [candidate.name for place, candidate in ranked(candidates) if place == rank]
    more = len(names) - 1
    return f"{names[0]} (tied with {more} more)" if more > 0 else "".join(names)


def weight_text(candidate: Candidate) -> str:
    """Return the probability of a candidate where there is one, else its score."""
    known = candidate.probability is not None
    return f"probability {number(candidate.probability, 3)}" if known else f"score {candidate.score:.3f}"


def arrival_text(candidate: Candidate) -> str:
    """Return when a fault arrived and how likely it is, as matched filters say it; empty for anything else."""
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
    """Return the estimated sizes of one candidate: each with its fault where it may be one of several."""
    return of_one(sizes[0]) if len(sizes) == 1 else ", or ".join(f"{size.fault} {of_one(size)}" for size in sizes)


def began_text(alarm: Alarm, clock: Clock) -> str:
    """Return when what an alarm is about began, as an interval; never its first crossing of the threshold as a fact."""
    began = alarm.began
    if began is None:
        return f"when it began cannot be told: at or before {clock.at(alarm.raised)}"
    if began.earliest is None:
        return f"began at or before {clock.at(began.latest)}: what was recorded before does not tell from when on"
    between = f"began between {clock.at(began.earliest)} and {clock.at(began.latest)}"
    sure = f"{100 * began.confidence:g} % confidence if the residual began to move by a step or a ramp"
    return f"{between} ({sure}), most likely at {clock.at(began.estimate)}"


def longest_alarms(alarms: Sequence[Alarm], most: int) -> list[tuple[int, Alarm]]:
    """Return the longest alarms, not more than so many, in order of time and with their numbers.

    A list cut off after the first ones would hide a fault behind the short false alarms before it.
    """
    numbered = sorted(enumerate(alarms, 1), key=lambda pair: -pair[1].samples)
    return sorted(numbered[:most], key=lambda pair: pair[0])


def left_out_text(alarms: Sequence[Alarm], most: int) -> str:
    """Return how many alarms are not among the longest, and how long they are; empty where all are."""
    lengths = sorted((alarm.samples for alarm in alarms), reverse=True)[most:]
    if not lengths:
        return ""
    return f"... and {counted(len(lengths), 'more alarm')}, none longer than {counted(lengths[0], 'sample')}"


def over_thresholds(alarm: Alarm, most: int = 10) -> str:
    """Return which groups of residuals were over their thresholds, the first ones and how many there are besides."""
    more = f" and {len(alarm.fired) - most} more" if len(alarm.fired) > most else ""
    return f"over their thresholds: {listing(alarm.fired[:most])}{more}"


def alike(
    groups: Sequence[tuple[str, ...]], settled: Sequence[tuple[str, ...]] = ()
) -> list[tuple[tuple[str, ...], tuple[str, ...]]]:
    """Return the groups of several faults, each with its names as shown: with *once constant* if that is meant.

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
