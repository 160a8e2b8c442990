"""One alarm: its time, its faults and their sizes."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from residua.decide.code_reading import CodeReading
from residua.decide.word import Word
from residua.shown import Bar, Shown, table
from residua.words import number

#: A lead in score below this tells nothing.
CLOSE_MARGIN = 0.02


@dataclass(frozen=True)
class Size:
    """The estimated size of a fault over an alarm.

    Attributes
    ----------
    fault : str
    mean : float
        Mean of the estimate over the judged window; NaN without a value.
    last : float
        Its last value there.
    unit : str
        Of the output of a sensor fault, or the input of an actuator fault, where the plant knows it; else empty.
    deviation : float or None
        Standard deviation of ``mean``, where the noise model tells it (matched filters, for a known arrival).
    """

    fault: str
    mean: float
    last: float
    unit: str
    deviation: float | None = None

    def __str__(self) -> str:
        spread = "" if self.deviation is None else f" ± {self.deviation:.2g}"
        return f"{self.mean:.3g}{spread}{f' ({self.unit})' if self.unit else ''}"


@dataclass(frozen=True)
class Candidate:
    """A fault, or a group of faults that the monitor cannot distinguish, and its fit to an alarm.

    Attributes
    ----------
    faults : tuple of str
    score : float
        Correlation of the residual with the signature of the group, 0 to 1 (``CORR``); by code: the fraction of
        the members of the bank that agree with the group's code; by matched filters: the root of the fraction that
        the fault explains of the excess over the noise.
    distance : float
        Normalised projection distance of the residual from the signature, 0 to 1 (``NPD``);
        ``score**2 + distance**2 = 1``; by code: the fraction of the members that do not agree, ``1 - score``.
    sizes : tuple of Size
        Of those of its faults that are estimated.
    arrival : float or None
        By matched filters: when the fault arrived if it is this one, in seconds; ``None`` if that was before the
        window.
    ratio : float or None
        By matched filters: twice the logarithm of the likelihood ratio of this fault against none. A lead of 6 over
        the next candidate makes this one 20 times as likely.
    probability : float or None
        By likelihood: that this fault is there, with the prior rates that were set.
    p_value : float or None
        By likelihood: the probability that noise leaves as much of the residual beside this fault.
    pair_p_value : float or None
        By likelihood: the probability that noise makes the first candidate explain as much that this one does not;
        ``None`` for the first one.
    """

    faults: tuple[str, ...]
    score: float
    distance: float
    sizes: tuple[Size, ...] = ()
    arrival: float | None = None
    ratio: float | None = None
    probability: float | None = None
    p_value: float | None = None
    pair_p_value: float | None = None

    @property
    def name(self) -> str:
        """The faults as text."""
        return " or ".join(self.faults)

    @property
    def size(self) -> float | None:
        """Estimated size of the (first estimated) fault, mean over the judged window; ``None`` without an estimate."""
        return self.sizes[0].mean if self.sizes else None


@dataclass(frozen=True)
class LearntMatch:
    """Angle between the residual of an alarm and the direction of a fault learnt from recordings.

    Attributes
    ----------
    fault : str
    score : float
        Cosine of the angle between them.
    angle : float
        In degrees.
    allowed : float
        How far off the cone of the direction and the noise over the window take 99 % of the windows of that fault, in
        degrees.
    """

    fault: str
    score: float
    angle: float
    allowed: float

    @property
    def agrees(self) -> bool:
        """True if the fault is consistent with the residual."""
        return self.angle <= self.allowed

    @property
    def text(self) -> str:
        """Both angles, in words."""
        return f"the residual is {self.angle:.2g}° off, its cone and the noise account for {self.allowed:.2g}°"


@dataclass(frozen=True)
class PresentFault:
    """A fault that is present by the code of a dedicated bank, and the time at which its own member fired.

    Attributes
    ----------
    faults : tuple of str
        With those that have the same member: one of them or more is there.
    member : str
    since : float
        Time at which its member first fired in this alarm, in seconds. A fault that grows arrived before.
    until : float or None
        Time at which its member's alarm went away for the last time; ``None`` when it lasts to the end of the
        recording, and always in a :class:`residua.monitor.Decision`.
    """

    faults: tuple[str, ...]
    member: str
    since: float
    until: float | None = None

    @property
    def name(self) -> str:
        """The faults as text."""
        return " or ".join(self.faults)

    def __str__(self) -> str:
        until = "" if self.until is None else f" until {self.until:.6g} s"
        return f"{self.name}, its member fired from {self.since:.6g} s{until}"


@dataclass(frozen=True)
class Beginning:
    """Interval for the time at which the change behind an alarm began.

    It holds for a change that begins as a step, a ramp or the square of time, whatever it becomes later, in noise that
    goes on as it was before; see :func:`residua.decide.change_time.change_time`. A fault whose first effect on the
    residual is later than the fault itself began by that much earlier: inside a control loop, which makes up for the
    fault at first, that can be hours.

    Attributes
    ----------
    earliest : float or None
        In seconds; ``None`` if the recording does not reach back far enough to tell: at or before ``latest``.
    estimate : float
        The most likely time.
    latest : float
    confidence : float
        With which the change began between ``earliest`` and ``latest``: 0.95, kept to 0.90 at least in simulations.
    """

    earliest: float | None
    estimate: float
    latest: float
    confidence: float = 0.95


def put_down_to(reading: CodeReading | None, candidates: tuple[Candidate, ...]) -> tuple[tuple[str, ...], ...]:
    """Return the faults to which an alarm is attributed: all that a code reads, or the best candidate."""
    return reading.named if reading is not None else tuple(c.faults for c in candidates[:1])


@dataclass(frozen=True, repr=False)
class Alarm(Shown):
    """One alarm: its place in the recording and the faults that explain it.

    Alarms that follow each other by less than the isolation window and name the same fault are one; by the code of a
    dedicated bank those that have one of their faults in common.

    Attributes
    ----------
    onset : float
        Time at which the statistic first went over the threshold and stayed, in seconds; by matched filters the
        estimated arrival of the fault, if known. The cause of the alarm began earlier, as a rule: ``began``.
    raised : float
        Time at which the alarm was raised (later than the onset when persistence was asked for).
    ended : float or None
        Time at which it went away, ``None`` when it lasts to the end of the recording.
    candidates : tuple of Candidate
        Best first, judged over the isolation window that ends with the last sample over the threshold (of the
        longest part, where alarms were joined). By matched filters arrivals and sizes are those of the longest part
        whose arrival is not after ``raised``, and no candidate arrives after it. By code: the group that was read, then
        the others by the number of members that agree; empty if the reading is unknown, or several faults, which are
        no alternatives of each other: ``named`` has them.
    start, stop : int
        Sample numbers of ``raised`` and of the first sample after the alarm.
    reading : CodeReading or None
        For a bank: the reading of the fired members, from the pattern that stood for the largest number of samples of
        the alarm, the later one of two that stood equally long. Of a dedicated bank, with them every member that
        counted as fired for an isolation window; by :class:`residua.decide.PeakThreshold` every one that fired.
    read_share : float or None
        The fraction of the alarm's samples in which just that pattern stood.
    sizes : tuple of Size
        Estimated sizes of all faults that are estimated, over the isolation window that ends with the last sample
        over the threshold.
    arrival : float or None
        By matched filters: the estimated arrival of the best candidate; ``None`` if it was before the window.
    present : tuple of PresentFault
        By the code of a dedicated bank: every fault that was read and when its own member fired, the first one first.
    began : Beginning or None
        When the change began that raised the alarm, as an interval; ``None`` if the data do not show it: it was before
        ``raised``. Of the twenty longest alarms of a recording.
    fired : tuple of str
        Where groups of residuals are tested by themselves: those that were in alarm, the longest first.
    learnt : tuple of LearntMatch
        Where faults were learnt from recordings: how the residual lies to the direction of each.
    unknown, no_fault : float or None
        By likelihood: the probability of a fault that is not listed, and of none.
    word : Word or None
        How well listed faults explain it; ``None`` where nothing is named. By direction and by matched filters every
        fault is fitted to the residual of the twenty longest alarms of a recording, and those that the word names are
        the first candidates.
    """

    onset: float
    raised: float
    ended: float | None
    candidates: tuple[Candidate, ...]
    start: int
    stop: int
    reading: CodeReading | None = None
    read_share: float | None = None
    sizes: tuple[Size, ...] = field(default=())
    arrival: float | None = None
    present: tuple[PresentFault, ...] = ()
    began: Beginning | None = None
    fired: tuple[str, ...] = ()
    learnt: tuple[LearntMatch, ...] = ()
    unknown: float | None = None
    no_fault: float | None = None
    word: Word | None = None

    def _headline(self) -> str:
        until = "to the end" if self.ended is None else f"until {_clean(self.ended):g} s"
        names = " and ".join(" or ".join(group) for group in self.named) or "no fault named"
        word = f", {self.word.kind}" if self.word else ""
        return f"raised at {_clean(self.raised):g} s, {until}: {names}{word}"

    def _parts(self) -> list[str]:
        sized = any(one.sizes for one in self.candidates)
        rows = [
            (one.name, Bar(one.score, number(one.score, 3)), *([", ".join(map(str, one.sizes))] if sized else []))
            for one in self.candidates
        ]
        return [table(["fault", "score", *(["estimated size"] if sized else [])], rows)]

    @property
    def named(self) -> tuple[tuple[str, ...], ...]:
        """The faults that explain the alarm: the best candidate, or all of several at once by code.

        Faults that cannot be distinguished are one group, of which one fault or more is there. Empty without a
        named fault.
        """
        return put_down_to(self.reading, self.candidates)

    @property
    def samples(self) -> int:
        """Number of samples in alarm: from ``raised`` up to ``ended``."""
        return self.stop - self.start

    @property
    def margin(self) -> float | None:
        """Lead of the best candidate over the next, in probability or else in score; ``None`` with fewer than two."""
        if len(self.candidates) < 2:
            return None
        first, second = (c.score if c.probability is None else c.probability for c in self.candidates[:2])
        return first - second

    @property
    def lead(self) -> float | None:
        """Lead of the best candidate over the next in ``ratio``, by matched filters; ``None`` with fewer than two."""
        ratios = [c.ratio for c in self.candidates[:2] if c.ratio is not None]
        return ratios[0] - ratios[1] if len(ratios) == 2 else None

    def to_dict(self, *, window: int = 1) -> dict[str, Any]:
        """Return the alarm as plain values for JSON; ``short`` means shorter than the isolation window.

        ``began`` is there if it is known, ``code`` for banks, ``present`` for dedicated ones, ``sizes`` for
        estimators and matched filters, ``arrival`` and ``lead`` for the latter, ``fired`` for groups of residuals,
        ``learnt`` where faults were learnt.
        """
        out: dict[str, Any] = {
            "onset": _clean(self.onset),
            "raised": _clean(self.raised),
            "ended": None if self.ended is None else _clean(self.ended),
            "samples": self.samples,
            "short": self.samples < window,
            "margin": self.margin,
            "candidates": [_candidate(c) for c in self.candidates],
        }
        if self.word is not None:
            out |= self.word.to_dict()
        if self.began is not None:
            out["began"] = _began(self.began)
        if any(c.ratio is not None for c in self.candidates):
            out |= {"arrival": self.arrival, "lead": self.lead}
        if self.reading is not None:
            out["code"] = _code(self.reading) | {"share": self.read_share}
        if self.unknown is not None:
            out |= {"unknown": self.unknown, "no_fault": self.no_fault}
        if self.fired:
            out["fired"] = list(self.fired)
        if self.learnt:
            out["learnt"] = [
                {"fault": m.fault, "angle": m.angle, "allowed": m.allowed, "agrees": m.agrees} for m in self.learnt
            ]
        if self.present:
            out["present"] = [_present(fault) for fault in self.present]
        if self.sizes:
            out["sizes"] = [_size(s) for s in self.sizes]
        return out


def _candidate(c: Candidate) -> dict[str, Any]:
    out: dict[str, Any] = {"faults": list(c.faults), "score": c.score, "distance": c.distance}
    if c.probability is not None:
        out |= {"probability": c.probability, "p_value": c.p_value, "pair_p_value": c.pair_p_value}
    return out if c.ratio is None else out | {"arrival": c.arrival, "ratio": c.ratio}


def _began(b: Beginning) -> dict[str, Any]:
    earliest = None if b.earliest is None else _clean(b.earliest)
    times = {"earliest": earliest, "estimate": _clean(b.estimate), "latest": _clean(b.latest)}
    return times | {"confidence": b.confidence}


def _present(p: PresentFault) -> dict[str, Any]:
    until = None if p.until is None else _clean(p.until)
    return {"faults": list(p.faults), "member": p.member, "since": _clean(p.since), "until": until}


def _size(s: Size) -> dict[str, Any]:
    out = {"fault": s.fault, "mean": _finite(s.mean), "last": _finite(s.last), "unit": s.unit}
    return out if s.deviation is None else out | {"deviation": _finite(s.deviation)}


def _code(reading: CodeReading) -> dict[str, Any]:
    return {
        "fired": list(reading.fired),
        "answer": reading.answer,
        "faults": list(reading.faults),
        "settled": list(reading.settled),
        "distance": reading.distance,
        "pairs": [[list(a), list(b)] for a, b in reading.pairs],
        "possible": [list(group) for group in reading.possible],
        "together": [list(group) for group in reading.together],
        "text": reading.meaning,
    }


def _clean(time: float) -> float:
    """Return a time without the rounding errors of a multiple of the step."""
    return float(f"{time:.12g}")


def _finite(value: float) -> float | None:
    return value if value - value == 0 else None
