"""Interface of isolations, which find the fault from the residuals and from the members that fired.

An isolation is two classes in one file, as a test is (:mod:`residua.decide.test`): the *settings* that users write, and
the fitted isolation. A monitor knows no kind of isolation. Your own needs no more than :meth:`Isolation.start`,
:meth:`Isolation.run` and the names of its groups.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from residua.decide.alarm import Alarm, Candidate, LearntMatch, PresentFault, Size
from residua.decide.code_reading import CodeReading
from residua.decide.compiled import CompiledCodes, CompiledIsolation
from residua.decide.matched_recursion import Match
from residua.decide.member_bounds import MemberBounds
from residua.decide.sizes import sizes_over, with_sizes
from residua.decide.statement import Statement, statement_by_score, word_by_score
from residua.decide.test import Block, ResidualTest, Tested, TestSettings, Watched
from residua.decide.word import Word
from residua.design import ResidualGenerator
from residua.errors import FileFormatError
from residua.recording.clock import Clock
from residua.records import Record, field_names, values_in, values_out


@dataclass(frozen=True, eq=False)
class Scores:
    """Scores of each sample by an isolation; every array starts with (plants, time), or (time,) for one plant.

    Attributes
    ----------
    scores : ndarray, shape (..., groups)
        How well each group of faults explains the residual, best 1; NaN where nothing can be said.
    code : ndarray of bool, shape (..., members), or None
        By code: which members count as fired over the window.
    match : Match or None
        By matched filters: likelihood ratio, arrival and size of every fault.
    size : ndarray, shape (...), or None
        Where faults were learnt: the length of the whitened residual, averaged over the window; NaN as the scores.
    posterior : dataclass or None
        By likelihood: the probabilities, a :class:`residua.decide.likelihood.Posterior`.
    """

    scores: NDArray[np.float64]
    code: NDArray[np.bool_] | None = None
    match: Match | None = None
    size: NDArray[np.float64] | None = None
    posterior: Any = None


@dataclass(frozen=True, eq=False)
class Seen:
    """Data of one plant for an isolation: a whole recording, or the latest sample.

    Attributes
    ----------
    time : ndarray, shape (time,)
        In seconds.
    residuals : ndarray, shape (time, k)
    tested : Tested
    scores : Scores
    generator : ResidualGenerator
    test : ResidualTest
    state : object
        Of the isolation, after the last sample; of a recording ``None``.
    count : int
        Samples of the run before the first of these.
    """

    time: NDArray[np.float64]
    residuals: NDArray[np.float64]
    tested: Tested
    scores: Scores
    generator: ResidualGenerator
    test: ResidualTest
    state: Any = None
    count: int = 0


@dataclass(frozen=True)
class Named:
    """The attribution of an alarm; the attributes are those of :class:`residua.monitor.Alarm`.

    Attributes
    ----------
    candidates, sizes, arrival, reading, read_share, present, fired, learnt
    onset : float or None
        In seconds, where the isolation knows better than the first crossing of the threshold.
    arrived, blamed
        Of the latest sample, as of :class:`residua.monitor.Decision`.
    unknown, no_fault : float or None
        By likelihood: the probability of a fault that is not listed, and of none.
    """

    candidates: tuple[Candidate, ...] = ()
    sizes: tuple[Size, ...] = ()
    arrival: float | None = None
    reading: CodeReading | None = None
    read_share: float | None = None
    present: tuple[PresentFault, ...] = ()
    fired: tuple[str, ...] = ()
    learnt: tuple[LearntMatch, ...] = ()
    onset: float | None = None
    arrived: float | None = field(default=None, compare=False)
    blamed: str = field(default="", compare=False)
    unknown: float | None = None
    no_fault: float | None = None

    def of_alarm(self) -> dict[str, Any]:
        """Return the fields that an :class:`residua.monitor.Alarm` takes over."""
        shared = {name: getattr(self, name) for name in field_names(self) if name not in ("onset", "arrived", "blamed")}
        return shared if self.onset is None else shared | {"onset": self.onset}


#: Returns the attribution of an alarm from its first sample, the sample after it, and the last over the threshold.
Naming = Callable[[int, int, int], Named]


class Isolation(Record, ABC):
    """Base of isolations with all parameters set, which name faults. A frozen dataclass with at least these attributes.

    Attributes
    ----------
    groups : tuple of tuple of str
        Faults that cannot be distinguished are one group; one column of the scores each.
    unjudged : tuple of str
        Faults that are never named.
    """

    #: True if alarms get a word by the responses to faults, as with names by direction or response.
    has_words: ClassVar[bool] = False
    #: True if it names alarms that move the residual too little for a word, from other evidence.
    names_early: ClassVar[bool] = False

    groups: tuple[tuple[str, ...], ...]
    unjudged: tuple[str, ...]

    @abstractmethod
    def start(self, plants: int) -> Any:
        """Return the state before the first sample: a frozen dataclass of arrays with a row per plant, and numbers.

        ``None`` if nothing is remembered.
        """

    @abstractmethod
    def run(self, state: Any, block: Block, tested: Tested) -> tuple[Any, Scores]:
        """Run over a block of samples, and return the next state and the outcome for each sample.

        A pure function, with the same bits however time is cut into blocks, and for any number of plants at once.
        """

    @property
    def compiled(self) -> CompiledIsolation | CompiledCodes | None:
        """Equivalent for the fused loop, equal to the last bit; ``None`` if there is only :meth:`run`."""
        return None

    def candidates(self, scores: NDArray[np.float64]) -> tuple[Candidate, ...]:
        """Return the groups by their scores at one sample, best first; none if unknown."""
        if scores.size == 0 or np.isnan(scores).all():
            return ()
        order = np.argsort(-np.nan_to_num(scores, nan=-np.inf), kind="stable")
        return tuple(Candidate(self.groups[g], float(scores[g]), 1.0 - float(scores[g])) for g in order)

    def name(self, seen: Seen, start: int, stop: int, last: int) -> Named:
        """Return the attribution of an alarm of a recording.

        Parameters
        ----------
        seen : Seen
        start, stop : int
            First sample of the alarm, and the one after it.
        last : int
            The last sample over the threshold.
        """
        first = max(start, last - self.samples + 1)
        sizes = sizes_over(seen.generator, seen.residuals, seen.tested.usable, first, last)
        fired: tuple[str, ...] = ()
        if seen.test.part_names:
            share = seen.tested.fired[start : max(stop, start + 1)].sum(axis=0)
            fired = tuple(seen.test.part_names[m] for m in np.argsort(-share, kind="stable") if share[m])
        candidates = with_sizes(self.candidates(seen.scores.scores[last]), sizes)
        return Named(candidates=candidates, sizes=sizes, fired=fired)

    def name_now(self, seen: Seen) -> Named:
        """Return the attribution of the standing alarm; ``seen`` is the latest sample."""
        return Named(candidates=self.candidates(seen.scores.scores[0]))

    def same_event(self, before: Alarm, alarm: Alarm) -> bool:
        """Tell whether an alarm that soon follows another is about the same event."""
        return leader(before) == leader(alarm)

    def name_of_several(self, parts: Sequence[Alarm], exceeded: NDArray[np.bool_], name: Naming) -> Named | None:
        """Return the attribution of several merged alarms; ``None`` for that of the longest of them."""
        return None

    # ----------------------------------------------- interface to the rest of a monitor

    @property
    def samples(self) -> int:
        """Number of samples from which a name is judged."""
        return 1

    def samples_to_be_sure(self, test: ResidualTest) -> int:
        """Return the length of an alarm from which its name is reliable."""
        return self.samples

    @property
    def signatures(self) -> tuple[NDArray[np.float64], ...]:
        """Orthonormal basis of the whitened residual for each group; empty if not used."""
        return ()

    @property
    def learnt(self) -> tuple[Any, ...]:
        """The faults that were learnt from recordings, :class:`residua.decide.learnt_faults.LearntFault`; or empty."""
        return ()

    def agreed(self, alarm: Alarm, word: Word) -> Word:
        """Return the word for an alarm from the responses to faults, as far as the other evidence agrees."""
        return word

    @property
    def coding(self) -> Any:
        """Codes against which members are read, a :class:`residua.decide.CodeTest`; or ``None``."""
        return None

    def words(self, step: float) -> dict[str, str]:
        """Describe the naming of faults, and override descriptions of the test.

        Parameters
        ----------
        step : float
            Seconds between samples.
        """
        return {"isolation": type(self).__name__}

    def statement(self, alarm: Alarm, clock: Clock, window: int) -> Statement:
        """Return the statement about an alarm: the words of page, screen and printed diagnosis.

        Parameters
        ----------
        alarm : Alarm
        clock : Clock
            How times are said.
        window : int
            Samples that an alarm has to last for its name to be sure.
        """
        return statement_by_score(alarm, clock, self.word(alarm, window))

    def word(self, alarm: Alarm, window: int) -> Word | None:
        """Return the word for an alarm: from the fit of listed faults, else from scores; or ``None``.

        Parameters
        ----------
        alarm : Alarm
        window : int
            Samples that an alarm has to last for its name to be sure.
        """
        return alarm.word or word_by_score(alarm, window)

    @property
    def where_missing(self) -> str:
        """Text on the role of missing values in this isolation."""
        return ""

    def notes(self) -> tuple[str, ...]:
        """Return remarks on its settings."""
        return ()

    def cautions(self, bounds: Mapping[str, MemberBounds], alarms: Sequence[Alarm], seen: Seen) -> tuple[str, ...]:
        """Return cautions about a name; ``bounds`` are the certified bounds of the members of a design."""
        return ()

    # --------------------------------------------------------------------------- files

    def to_record(self) -> dict[str, Any]:
        """Return the isolation as a record for a file."""
        return values_out(self)

    def check(self, watched: Watched, test: ResidualTest) -> None:
        """Raise :class:`residua.errors.FileFormatError` if an isolation from a file does not fit its generator."""

    def check_state(self, state: Any, count: int) -> None:
        """Raise :class:`residua.errors.FileFormatError` if a state after ``count`` samples is invalid."""


class IsolationSettings(Record, ABC):
    """Base of the settings of isolations. A frozen dataclass.

    Attributes
    ----------
    kind : str
        The mark of its records in files.
    makes : type
        Class of the fitted :class:`Isolation`.
    """

    kind: ClassVar[str]
    makes: ClassVar[type[Isolation]]

    @abstractmethod
    def isolation(self, generator: ResidualGenerator, test: ResidualTest) -> Isolation:
        """Return the isolation of the faults of a generator, for the alarms of a test."""

    # ----------------------------------------------- interface to the rest of a monitor

    @classmethod
    def for_design(cls, design: Any, generator: ResidualGenerator) -> Self | None:
        """Return the settings for a design that is made to be read this way (``"auto"``); else ``None``."""
        return None

    def check(self, generator: ResidualGenerator) -> None:
        """Raise :class:`residua.errors.SettingError` if faults of this generator cannot be named this way."""

    def parts(self, generator: ResidualGenerator) -> dict[str, tuple[int, ...]] | None:
        """Return the residuals to be tested separately, by name; ``None`` for the residual as a whole."""
        return None

    def own_test(self, design: Any) -> TestSettings | None:
        """Return the settings of the test that a design has beside this isolation; ``None`` for the default."""
        return None

    def test_of(self, settings: TestSettings) -> TestSettings:
        """Return the settings of the test that goes with this isolation, or raise if none does."""
        return settings

    def kept(self, generator: ResidualGenerator) -> tuple[str, int, int] | None:
        """Return the setting of the window, its samples, and the numbers kept for each sample of a plant."""
        return None

    # --------------------------------------------------------------------------- files

    def to_record(self) -> dict[str, Any]:
        """Return the settings as a record for a file, without their kind."""
        return values_out(self)

    @classmethod
    def from_record(cls, content: Any, where: str) -> Self:
        """Return the settings that a record describes."""
        return values_in(content, where, cls)

    def check_record(self, content: Mapping[str, Any], where: str) -> None:
        """Raise if a record of an isolation does not match these settings, before anything is built from it."""

    def isolation_from_record(self, content: Any, where: str, watched: Watched, test: ResidualTest) -> Isolation:
        """Read an isolation from a record, and check it."""
        isolation = values_in(content, where, self.makes)
        isolation.check(watched, test)
        return isolation


@dataclass(frozen=True, eq=False)
class NoNames(Isolation):
    """Isolation that names nothing."""

    groups: tuple[tuple[str, ...], ...] = ()
    unjudged: tuple[str, ...] = ()

    def start(self, plants: int) -> None:
        """Return ``None``: there is no state."""

    def run(self, state: Any, block: Block, tested: Tested) -> tuple[Any, Scores]:
        """Return scores of no group."""
        return state, Scores(np.zeros((*tested.usable.shape, 0)))

    @property
    def compiled(self) -> CompiledIsolation | None:
        """Equivalent for the fused loop, which does nothing."""
        return CompiledIsolation() if type(self) is NoNames else None

    def words(self, step: float) -> dict[str, str]:
        """Return no descriptions."""
        return {}


@dataclass(frozen=True)
class NoIsolation(IsolationSettings):
    """Settings for alarms without names, as with ``isolate=None``."""

    kind: ClassVar[str] = "none"
    makes: ClassVar[type[Isolation]] = NoNames

    def isolation(self, generator: ResidualGenerator, test: ResidualTest) -> Isolation:
        """Return an isolation that names nothing."""
        return NoNames()


def check_groups(groups: Sequence[Sequence[str]], unjudged: Sequence[str], where: str, faults: Sequence[str]) -> None:
    """Raise unless groups and faults that are never named contain each fault of a plant once."""
    if sorted([*unjudged, *(name for group in groups for name in group)]) != sorted(faults):
        raise FileFormatError(f"{where}: groups and unjudged must be the faults of the plant, each once")


def by_cosine(faults: tuple[str, ...], score: float, **facts: Any) -> Candidate:
    """Return a candidate whose score is a cosine: its distance is the sine."""
    return Candidate(faults, score, float(np.sqrt(max(0.0, 1.0 - score**2))), **facts)


def leader(alarm: Alarm) -> tuple[str, ...]:
    """Return the best candidate of an alarm; empty if nobody is named."""
    return alarm.candidates[0].faults if alarm.candidates else ()


def longest(alarms: Sequence[Alarm]) -> Alarm:
    """Return the longest of some alarms, the later one of two that are equally long."""
    return max(reversed(alarms), key=lambda alarm: alarm.samples)


def last_over(exceeded: NDArray[np.bool_], start: int, stop: int) -> int:
    """Return the last sample of a stretch that is over the threshold, or its first."""
    over = exceeded[start:stop][::-1]
    back = int(np.argmax(over)) if len(over) else 0
    return stop - 1 - back if len(over) and over[back] else start
