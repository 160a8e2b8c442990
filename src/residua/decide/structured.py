"""Isolation by code: the members of a bank that fired, compared with the code of each fault."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.analysis.codes import equal_codes, strongly_isolating
from residua.decide.alarm import Alarm, Candidate, PresentFault
from residua.decide.checks import check_samples, is_number
from residua.decide.code_reading import CodeReading, booleans, distinct_rows, each_once, pairs_of
from residua.decide.compiled import CompiledCodes
from residua.decide.isolation import Isolation, IsolationSettings, Named, Naming, Scores, Seen, check_groups, last_over
from residua.decide.member_bounds import MemberBounds, leakage_cautions
from residua.decide.sizes import sizes_over, with_sizes
from residua.decide.statement import Statement, capital, raised_text, statement_by_word, too_short
from residua.decide.test import Block, ResidualTest, Tested, TestSettings, Watched
from residua.decide.window import WindowState, empty_window, moving_sum
from residua.decide.word import ANYTHING, EITHER, GOOD, POOR, TOO_EARLY, Word
from residua.design import ResidualGenerator
from residua.errors import DataError, FileFormatError, ModelError, SettingError
from residua.number_kinds import SHARE, WINDOW, NumberKind
from residua.recording.clock import Clock
from residua.visible import echo
from residua.words import listing, percent

#: A code that stood in less than this fraction of an alarm's samples is unsteady: too early.
_STEADY_SHARE = 0.5

_CODE_RULES = (
    "A code says which members a fault fires, not how strongly. Good match: just those of one listed fault fired for "
    f"{100 * _STEADY_SHARE:g} % of the alarm at least, not all members did, and no other listed fault's code is one "
    "member away. Either: it is the code of several listed faults, or one is a member away, or members of a code are "
    "silent, or all members fired. Poor match: members fired that no listed fault fires together. Too early: the alarm "
    "is short, or the members that fire change."
)

_SCORE_RULE = "The score is the fraction of the members that agree with a code."

_DEDICATED_RULES = (
    "Every fault fires a member of its own. A member that fires alone names its fault, a good match unless it is the "
    "only one. Either: members that fire together, or one after the other in one alarm, are of several faults, each "
    "there since its own member fired, or of one that is not listed. Too early: the alarm is short, or the members "
    "that fire change."
)

#: Causes that an exact code cannot exclude.
_SAME_CODE = "Just the members that answer to it fired; a fault that is not listed could fire the same ones."


@dataclass(frozen=True, eq=False)
class CodeState:
    """State of the reading of codes.

    Attributes
    ----------
    window : WindowState
        Of the alarms of the members.
    since : ndarray of int, shape (plants, members)
        When each first fired in the alarm that stands, as a number of samples, that one included; 0 while none stands.
    fired : ndarray of bool, shape (plants, members)
        At the last sample.
    """

    window: WindowState
    since: NDArray[np.int64]
    fired: NDArray[np.bool_]

    def arrays(self) -> tuple[NDArray | None, ...]:
        """Return the arrays that the fused loop reads and writes, in its order: window, since and fired."""
        return *self.window.arrays(), self.since, self.fired


@dataclass(frozen=True, eq=False)
class CodeTest(Isolation):
    """Codes of a bank, equal ones grouped, and the reading of patterns of fired members.

    A fault that some members see only while it changes has two codes, and may be in two groups: that of all members
    that it fires, and that of those which it still fires once it is constant.

    Attributes
    ----------
    window : int
    share : float
    distance : int
    members : tuple of str
    groups : tuple of tuple of str
        Faults with the same code are one group.
    codes : ndarray of bool, shape (members, groups)
    unjudged : tuple of str
        Faults that fire no member.
    settled : tuple of tuple of str
        For each group, those of its faults that have this code only once they are constant.
    at_once : bool
        True if a member that fires counts as fired at once, in a dedicated bank: its test has a window of its own.
    """

    NUMBER_KINDS: ClassVar[Mapping[str, NumberKind]] = {"window": WINDOW, "share": SHARE}

    window: int
    share: float
    distance: int
    members: tuple[str, ...]
    groups: tuple[tuple[str, ...], ...]
    codes: NDArray[np.bool_]
    unjudged: tuple[str, ...]
    settled: tuple[tuple[str, ...], ...] = ()
    at_once: bool = False

    def __post_init__(self) -> None:
        """Fill in equal codes for constant faults."""
        object.__setattr__(self, "settled", self.settled or ((),) * len(self.groups))

    @property
    def labels(self) -> tuple[str, ...]:
        """Groups as text, all distinct: a fault that has this code only once it is constant is marked *settled*."""
        return tuple(
            " or ".join(f"{name}, settled" if name in later else name for name in group)
            for group, later in zip(self.groups, self.settled, strict=True)
        )

    @cached_property
    def strongly_isolating(self) -> bool:
        """True if no code turns into another one when members that should fire stay silent."""
        return strongly_isolating(self.codes, self.groups)

    @cached_property
    def dedicated(self) -> bool:
        """True if every code is a single member: then each fault fires its own, and several at once are all read."""
        return bool(self.groups) and bool((self.codes.sum(axis=0) == 1).all())

    def member_of(self, group: tuple[str, ...]) -> int:
        """Return the number of the first member that a group of faults fires; of a dedicated bank the only one."""
        return int(self.codes[:, self.groups.index(group)].argmax())

    def read(self, fired: ArrayLike) -> CodeReading:
        """Read one pattern of fired members; see :func:`read_code`."""
        pattern = np.asarray(fired, dtype=bool)
        codes, groups, settled = self.codes, self.groups, self.settled
        seen = (tuple(pattern.tolist()), self.members)
        if not pattern.any():
            return CodeReading("none", (), 0, (), (), *seen)
        off = np.count_nonzero(codes != pattern[:, None], axis=0)
        below = np.flatnonzero((off > 0) & (codes <= pattern[:, None]).all(axis=0))
        first, second = np.triu_indices(len(below), 1)
        whole = ((codes[:, below[first]] | codes[:, below[second]]) == pattern[:, None]).all(axis=0)
        pairs = pairs_of((groups[below[a]], groups[below[b]]) for a, b in zip(first[whole], second[whole], strict=True))
        above = np.flatnonzero((codes >= pattern[:, None]).all(axis=0))
        above = above[np.argsort(off[above], kind="stable")]
        if (off == 0).any():
            g = int(off.argmin())
            wider = each_once([groups[g], *(groups[j] for j in above[off[above] > 0])])[1:]
            return CodeReading("exact", groups[g], 0, pairs, (), *seen, settled[g], wider)
        if self.dedicated and (codes.any(axis=1) | ~pattern).all():  # each member that fired has a fault of its own
            together = sorted((groups[g] for g in np.flatnonzero(pattern @ codes)), key=self.member_of)
            return CodeReading("several", (), 0, pairs, (), *seen, together=tuple(together))
        if len({groups[g] for g in above}) == 1 and self.strongly_isolating:  # its own settled code may be there too
            g = int(above[0])
            return CodeReading("degraded", groups[g], int(off[g]), pairs, (), *seen, settled[g])
        smallest = int(off.min(initial=len(pattern) + 1))
        near = np.flatnonzero(off == smallest)
        nearest = tuple(dict.fromkeys(groups[g] for g in near))  # both codes of one fault can be equally near
        possible = each_once(groups[g] for g in above)
        alone = len(nearest) == 1 and all(set(group) <= set(nearest[0]) for group in possible)
        if alone and smallest <= self.distance and not pattern.all():
            return CodeReading("nearest", nearest[0], smallest, pairs, (), *seen, settled[near[0]])
        return CodeReading("unknown", (), smallest if len(near) else -1, pairs, nearest, *seen, possible=possible)

    # ------------------------------------------------------------------------ running

    def start(self, plants: int) -> CodeState:
        """Return the state before the first sample."""
        count = len(self.members)
        none = np.zeros((plants, count), dtype=np.int64)
        return CodeState(empty_window(plants, self.window, count), none, none.astype(bool))

    def run(self, state: CodeState, block: Block, tested: Tested) -> tuple[CodeState, Scores]:
        """Return the members that fired over the window, and the number that agree with the code of each group."""
        fired, usable = tested.fired, tested.usable
        counts, window = moving_sum((fired & usable[..., None]).astype(float), state.window)  # whole numbers: exact
        largest = counts.max(axis=2, initial=0.0)[..., None]
        code = np.asarray(tested.alarm)[..., None] & (counts > 0) & (counts >= self.share * largest)
        if self.at_once and self.dedicated:  # its window has passed already, and each member speaks for itself
            code = fired
        agree = np.zeros((*usable.shape, len(self.groups)))
        for g in range(len(self.groups)):
            agree[..., g] = np.count_nonzero(code == self.codes[:, g], axis=2)
        read = usable & code.any(axis=2)
        scores = np.where(read[..., None], agree / len(self.members), np.nan)
        if fired.shape[1]:
            since = alarms_since(fired, state, block.count)
            state = CodeState(window, since, fired[:, -1].copy())
        return state, Scores(scores, code=code)

    @property
    def compiled(self) -> CompiledCodes | None:
        """Equivalent for the fused loop."""
        if type(self) is not CodeTest:
            return None
        return CompiledCodes(self.window, self.share, self.codes, self.at_once and self.dedicated)

    def name(self, seen: Seen, start: int, stop: int, last: int) -> Named:
        """Return the pattern of members that stood the longest, and the candidates by it.

        Of a dedicated bank with every other member that counted as fired for an isolation window in all: a fault that
        came later has its member too, and a false alarm of a member is shorter. By a peak test they are all members
        that fired: one sample over its threshold declares the fault, and its own window holds it.
        """
        assert seen.scores.code is not None
        judged = slice(start, last + 1)
        code, fired, usable = seen.scores.code[judged], seen.tested.fired, seen.tested.usable
        pattern, share = longest_code(code, usable[judged])
        if self.dedicated:
            counted = code & usable[judged, None]
            later = fired[judged].any(axis=0) if self.at_once else counted.sum(axis=0) >= self.window
            pattern = pattern | later
            shown = code[usable[judged] & code.any(axis=1)]
            share = float((shown == pattern).all(axis=1).mean()) if len(shown) else 0.0
        reading = self.read(pattern)
        sizes = sizes_over(seen.generator, seen.residuals, usable, max(start, last - self.window + 1), last)
        present = []
        for group in reading.named if self.dedicated else ():
            member = self.member_of(group)
            on = start + np.flatnonzero(fired[start:stop, member])
            if on.size:  # a member may count as fired for a moment longer than its alarm lasts
                after = int(on[-1]) + 1
                until = float(seen.time[after]) if after < len(seen.time) else None
                present.append(PresentFault(group, self.members[member], float(seen.time[on[0]]), until))
        return Named(
            candidates=with_sizes(candidates_of_code(reading, self), sizes),
            sizes=sizes,
            reading=reading,
            read_share=share,
            present=tuple(sorted(present, key=lambda fault: fault.since)),
        )

    def name_now(self, seen: Seen) -> Named:
        """Read the members that fired over the window up to now, with the time at which each first fired."""
        assert seen.scores.code is not None
        reading, since = self.read(seen.scores.code[0]), seen.state.since[0]
        fired = [(group, self.member_of(group)) for group in (reading.named if self.dedicated else ())]
        step = seen.generator.dt
        present = [PresentFault(g, self.members[m], (int(since[m]) - 1) * step) for g, m in fired if since[m] > 0]
        present = tuple(sorted(present, key=lambda fault: fault.since))
        return Named(candidates=candidates_of_code(reading, self), reading=reading, present=present)

    def same_event(self, before: Alarm, alarm: Alarm) -> bool:
        """Tell whether two alarms have the same leader; of a dedicated bank, one of their faults in common."""
        if self.dedicated:
            one, other = (set(alarm.reading.named) if alarm.reading else set() for alarm in (before, alarm))
            if one or other:
                return bool(one & other)
        return super().same_event(before, alarm)

    def name_of_several(self, parts: Sequence[Alarm], exceeded: NDArray[np.bool_], name: Naming) -> Named | None:
        """Read several alarms of a dedicated bank as one: all faults of their whole time."""
        if not self.dedicated:
            return None
        first, last = parts[0], parts[-1]
        return name(first.start, last.stop, last_over(exceeded, last.start, last.stop))

    # ----------------------------------------------- interface to the rest of a monitor

    @property
    def coding(self) -> CodeTest:
        """The codes themselves."""
        return self

    @property
    def samples(self) -> int:
        """Number of samples over which members count as fired."""
        return self.window

    def samples_to_be_sure(self, test: ResidualTest) -> int:
        """Return the length of an alarm from which its name is reliable: one for a dedicated bank read at once."""
        return 1 if self.at_once and self.dedicated else self.window

    def words(self, step: float) -> dict[str, str]:
        """Describe the naming of faults."""
        if self.dedicated and self.at_once:
            return {
                "isolation": "every fault has a member of its own: each member that fires in an alarm names its fault"
            }
        sentence = (
            f"code of the members that fired over {self.window} samples ({self.window * step:g} s): those in alarm for "
            f"at least {self.share:g} of the samples of the one that was in alarm the longest"
        )
        if self.dedicated:
            return {"isolation": f"{sentence}; every fault has a member of its own, so several at once are all named"}
        return {"isolation": f"{sentence}; nearest codes up to {self.distance} off"}

    def word(self, alarm: Alarm, window: int) -> Word:
        """Return the word for an alarm: the fit of the codes of listed faults to the members that fired."""
        reading = alarm.reading
        assert reading is not None
        word = Word(GOOD, reading.named, why="by its code", after=alarm.samples)
        wavers = not reading.together and alarm.read_share is not None and alarm.read_share < _STEADY_SHARE
        if reading.answer == "none" or alarm.samples < window or wavers:
            why = too_short(window) if alarm.samples < window else "the members that fire change"
            return replace(word, kind=TOO_EARLY, why=why, together=bool(reading.together))
        if reading.together:
            return replace(word, kind=EITHER, why="", unlisted=ANYTHING, together=True)
        pattern = np.array(reading.pattern, dtype=bool)[:, None]
        off = np.count_nonzero(self.codes != pattern, axis=0)
        around = np.flatnonzero((self.codes >= pattern).all(axis=0))  # codes that hold the pattern, the nearest first
        around = around[np.argsort(off[around], kind="stable")]
        if not around.size:
            faults = reading.named or ((reading.close,) if reading.close else ())
            return replace(word, kind=POOR, faults=faults, why="no listed fault fires just these members")
        close = each_once(self.groups[g] for g in (*around, *np.flatnonzero(off == 1)))
        unlisted = "" if reading.answer == "exact" and not all(reading.pattern) else ANYTHING
        if unlisted or sum(map(len, close)) > 1:
            return replace(word, kind=EITHER, why="", faults=close, unlisted=unlisted)
        return word

    def statement(self, alarm: Alarm, clock: Clock, window: int) -> Statement:
        """Return the statement about an alarm: the members that fired, their reading, and its certainty."""
        reading, word = alarm.reading, self.word(alarm, window)
        assert reading is not None
        sentences = [f"Fired: {listing(reading.fired) or 'none'}; {reading.meaning}."]
        if alarm.read_share:
            share = percent(round(1000 * alarm.read_share), 1000)
            these = "all of these members had fired" if reading.together else "these were the members that fired"
            sentences.append(f"In {share} of the alarm's samples {these}.")
        rules = (_DEDICATED_RULES if self.dedicated else _CODE_RULES) + (f" {_SCORE_RULE}" if alarm.candidates else "")
        if reading.together:
            return _statement_about_several(alarm, word, clock, sentences, rules)
        if word.kind == GOOD:
            sentences.append(_SAME_CODE)
        statement = statement_by_word(alarm, word, clock, sentences, rules, alarm.margin)
        return replace(statement, lines=(str(reading), *statement.lines))

    def cautions(self, bounds: Mapping[str, MemberBounds], alarms: Sequence[Alarm], seen: Seen) -> tuple[str, ...]:
        """Return for each alarm its residuals that a single other fault may have driven over their thresholds."""
        if not bounds or not self.dedicated or not self.at_once:
            return ()
        return leakage_cautions(bounds, self.members, alarms, seen.tested.part_statistics)

    # --------------------------------------------------------------------------- files

    def check(self, watched: Watched, test: ResidualTest) -> None:
        """Raise if codes from a file do not match the members and faults."""
        where, count = "running.isolation", len(watched.parts or ())
        if len(self.settled) != len(self.groups) or any(
            set(s) - set(g) for s, g in zip(self.settled, self.groups, strict=True)
        ):
            raise FileFormatError(f"{where}: settled must name faults of each of the {len(self.groups)} groups")
        lasting = [[x for x in g if x not in s] for g, s in zip(self.groups, self.settled, strict=True)]
        check_groups(lasting, self.unjudged, where, watched.generator.faults)
        if len(self.members) != count or self.codes.shape != (count, len(self.groups)):
            raise FileFormatError(f"{where}: codes must be true or false, {count} members x {len(self.groups)} groups")
        if self.at_once != (test.horizon > 0):
            raise FileFormatError(f"{where}.at_once must be as the test is")

    def check_state(self, state: CodeState, count: int) -> None:
        """Raise if a state from a file is invalid."""
        state.window.check("state.isolation.window")
        if ((state.since < 0) | (state.since > count)).any():
            raise FileFormatError("state.isolation.since must lie between 0 and state.count")


@dataclass(frozen=True)
class Structured(IsolationSettings):
    """Name the fault whose code the fired members of a bank spell.

    Parameters
    ----------
    window : int
        Samples over which it is judged which members fired: their alarms do not begin and end together.
    share : float
        A member counts as fired if it was in alarm, within the window, at least this fraction of the samples
        of the member that was in alarm the longest.
    distance : int
        Members in which a pattern may differ from the nearest code and still be read as it; 0 turns that off.

    References
    ----------
    Gertler (1991), section 4; Chen and Patton (1999), chapter 3; for sensors one by one, Clark (1978) and
    Frank (1987).
    """

    kind: ClassVar[str] = "code"
    makes: ClassVar[type[Isolation]] = CodeTest
    NUMBER_KINDS: ClassVar[Mapping[str, NumberKind]] = {"window": WINDOW, "share": SHARE}

    window: int = 50
    share: float = 0.5
    distance: int = 1

    def __post_init__(self) -> None:
        """Check the settings."""
        check_samples(self.window, "window")
        check_samples(self.distance, "distance", least=0)
        if not is_number(self.share) or not 0 < self.share <= 1:
            raise SettingError(f"share must lie between 0 and 1, got {echo(self.share)}")
        object.__setattr__(self, "window", int(self.window))
        object.__setattr__(self, "share", float(self.share))
        object.__setattr__(self, "distance", int(self.distance))

    def isolation(self, generator: ResidualGenerator, test: ResidualTest) -> CodeTest:
        """Return the codes of a bank."""
        return codes_of(generator, self, at_once=test.horizon > 0)

    # ----------------------------------------------- interface to the rest of a monitor

    @classmethod
    def for_design(cls, design: Any, generator: ResidualGenerator) -> Self | None:
        """Return the default for a generator with codes."""
        return None if generator.codes is None else cls()

    def check(self, generator: ResidualGenerator) -> None:
        """Raise for a generator without codes."""
        if generator.codes is None:
            raise SettingError(
                "Structured reads the code of a bank, and this generator has none: use a bank, or Directional()"
            )
        if generator.codes.shape != (len(generator.members), len(generator.faults)):
            raise ModelError(f"codes {generator.codes.shape} must have a row per member and a column per fault")

    def parts(self, generator: ResidualGenerator) -> dict[str, tuple[int, ...]]:
        """Return the members, each with its residuals."""
        return {member.name: member.residuals for member in generator.members}

    def test_of(self, settings: TestSettings) -> TestSettings:
        """Refuse groups of residuals: members are tested one by one already."""
        if settings.divides:
            raise SettingError(
                "groups are for residuals that are named by direction or not at all; here faults are by code, and its "
                "members are tested one by one already: leave groups out, or isolate=Directional() or None"
            )
        return settings

    def kept(self, generator: ResidualGenerator) -> tuple[str, int, int] | None:
        """Return the window, and the number of values it keeps: the alarms of the members."""
        return f"Structured(window={self.window})", self.window, len(generator.members)

    def check_record(self, content: Mapping[str, Any], where: str) -> None:
        """Raise if the window of the record differs from that of the settings."""
        if content.get("window") != self.window:
            raise FileFormatError(f"{where}.window must be that of isolate, {self.window}")


def _statement_about_several(alarm: Alarm, word: Word, clock: Clock, sentences: list[str], rules: str) -> Statement:
    """Return the statement for several faults of a dedicated bank, each with its own time."""
    reading = alarm.reading
    assert reading is not None
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


def settled_codes(generator: ResidualGenerator) -> NDArray[np.bool_]:
    """Return the members that a constant fault still fires once the residual has settled: (members, faults).

    A member may see a fault only while it changes; then fewer members fire in the end than the code promises.
    """
    assert generator.codes is not None
    steady = np.array([generator.steady_directions[name] for name in generator.faults])
    steady = steady.reshape(len(generator.faults), generator.n_residuals).T
    rows_of = [member.residuals for member in generator.members]
    seen = [(steady[list(rows)] != 0).any(axis=0) for rows in rows_of]
    return np.array(seen, dtype=bool).reshape(generator.codes.shape) & generator.codes


def codes_of(generator: ResidualGenerator, isolate: Structured, *, at_once: bool = False) -> CodeTest:
    """Return the codes of a bank: those of its faults, and those of constant faults if they differ."""
    assert generator.codes is not None
    names = [member.name for member in generator.members]
    codes = code_test(isolate, generator.codes, generator.faults, names, settled=settled_codes(generator))
    return replace(codes, at_once=at_once)


def code_test(
    settings: Structured,
    codes: ArrayLike,
    faults: Sequence[str],
    members: Sequence[str] | None = None,
    *,
    settled: ArrayLike | None = None,
) -> CodeTest:
    """Return the codes with equal ones grouped, after checking their shape.

    ``settled``, of the same shape, are the codes of constant faults: one that is not empty, and not the fault's own
    code, is a further code of the fault.
    """
    table = booleans(codes, "codes")
    if table.ndim != 2 or table.shape[1] != len(faults):
        raise DataError(f"codes must have a row per member and a column per fault ({len(faults)}), got {table.shape}")
    if members is not None and len(members) != len(table):
        raise DataError(f"expected {len(table)} names of members, got {len(members)}")
    names = tuple(members) if members is not None else tuple(str(i + 1) for i in range(len(table)))
    later = np.zeros_like(table) if settled is None else np.asarray(settled, dtype=bool)
    if later.shape != table.shape:
        raise DataError(f"settled must have the shape of codes, {table.shape}, got {later.shape}")
    later = later & (later != table).any(axis=0)
    both = np.hstack([table, later])
    equal = equal_codes(both)
    n = len(faults)
    groups = tuple(tuple(faults[j % n] for j in group) for group in equal)
    columns = both[:, [group[0] for group in equal]]
    silent = tuple(fault for j, fault in enumerate(faults) if not table[:, j].any())
    marked = tuple(tuple(faults[j % n] for j in group if j >= n) for group in equal)
    return CodeTest(settings.window, settings.share, settings.distance, names, groups, columns, silent, marked)


def candidates_of_code(reading: CodeReading, codes: CodeTest) -> tuple[Candidate, ...]:
    """Return the group that was read, then the others by the members that agree; none without a reading.

    Every fault is named once: with that of its codes which agrees better.
    """
    if not reading.faults:
        return ()
    pattern = np.array(reading.pattern)
    agree = np.mean(codes.codes == pattern[:, None], axis=0)
    first = column_read(reading, codes)
    assert first is not None
    named: set[str] = set()
    out = []
    for g in (first, *(int(g) for g in np.argsort(-agree, kind="stable") if g != first)):
        faults = tuple(name for name in codes.groups[g] if name not in named)
        named.update(faults)
        if faults:
            out.append(Candidate(faults, float(agree[g]), float(1.0 - agree[g])))
    return tuple(out)


def column_read(reading: CodeReading, codes: CodeTest) -> int | None:
    """Return the number of the code that the alarm shows; ``None`` without one."""
    off = np.count_nonzero(codes.codes != np.array(reading.pattern)[:, None], axis=0)
    same = [g for g, group in enumerate(codes.groups) if reading.faults and group == reading.faults]
    return min(same, key=lambda g: off[g], default=None)


def longest_code(code: NDArray[np.bool_], counted: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], float]:
    """Return the pattern that stood for the most samples, the latest of those, and its share of the samples.

    Parameters
    ----------
    code : ndarray of bool, shape (time, members)
    counted : ndarray of bool, shape (time,)
        Samples that count.
    """
    rows = code[counted & code.any(axis=1)]
    if not len(rows):
        return np.zeros(code.shape[1], dtype=bool), 0.0
    counts, first, _ = distinct_rows(rows[::-1])
    best = np.lexsort((first, -counts))[0]
    return rows[::-1][first[best]], float(counts[best] / len(rows))


def alarms_since(fired: NDArray[np.bool_], state: CodeState, count: int | NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the sample number at which each member first fired in the standing alarm.

    0 without a standing alarm, or if the time is not known because the state is one of an earlier version.

    Parameters
    ----------
    fired : ndarray of bool, shape (plants, time, members)
        With a sample at least.
    state : CodeState
        Before the block.
    count : int, or ndarray of int, shape (plants,)
        Samples before the block.
    """
    time = fired.shape[1]
    samples = np.arange(time)
    last_off = np.where(fired.any(axis=2), -1, samples).max(axis=1)
    before = state.since
    unknown = state.fired & (before == 0)  # and so it stays until the member is silent
    if unknown.any():
        fired = fired & ~(unknown[:, None] & np.logical_and.accumulate(fired, axis=1))
    standing = fired & (samples > last_off[:, None])[..., None]
    first = np.where(standing.any(axis=1), np.reshape(count, (-1, 1)) + 1 + standing.argmax(axis=1), 0)
    return np.where((last_off == -1)[:, None] & (before > 0), before, first)
