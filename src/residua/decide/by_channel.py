"""Name the channel that deviates most from its prediction by the other channels."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from residua.decide.alarm import Alarm
from residua.decide.channel_relations import MODEL, ChannelRelations
from residua.decide.isolation import Isolation, IsolationSettings, Named, Scores, Seen, check_groups
from residua.decide.statement import Statement, scored, statement_by_score, statement_by_word, too_short
from residua.decide.test import Block, ResidualTest, Tested, TestSettings, Watched
from residua.decide.word import ANYTHING, EITHER, GOOD, POOR, TOO_EARLY, Word
from residua.design import ResidualGenerator
from residua.errors import FileFormatError, SettingError
from residua.number_kinds import INDEX, NumberKind
from residua.recording.clock import Clock
from residua.words import listing

#: Samples from the beginning of an alarm over which channels are compared.
_COMPARED = 100
#: A channel may be the one if it is that part as far off as the furthest.
_AS_FAR = 0.6
#: Samples of an alarm below which a name is too early, and channels that a sentence lists.
_EARLY, _LISTED = 5, 5
_RULES = (
    "The score is the deviation of a channel in its own thresholds, relative to the largest. Channels are compared "
    "only with each other: even if one deviates by far the most, something that is not listed may be the cause. "
    f"Either: others deviate at least {_AS_FAR:g} times as much."
)


@dataclass(frozen=True, eq=False)
class ChannelNames(Isolation):
    """Fitted isolation of channel faults by the number of the channel.

    Attributes
    ----------
    groups : tuple of tuple of str
        One fault of one channel each.
    parts : ndarray of int, shape (groups,)
        The part of the test that is its channel.
    unjudged : tuple of str
        Faults that do not belong to a single channel.
    """

    NUMBER_KINDS: ClassVar[Mapping[str, NumberKind]] = {"parts": INDEX}
    has_words: ClassVar[bool] = True
    names_early: ClassVar[bool] = True

    groups: tuple[tuple[str, ...], ...]
    parts: NDArray[np.int64]
    unjudged: tuple[str, ...]

    def start(self, plants: int) -> None:
        """Return ``None``: there is no state."""

    def run(self, state: Any, block: Block, tested: Tested) -> tuple[Any, Scores]:
        """Return the deviation of each channel, relative to the largest."""
        return state, Scores(_relative(tested.part_statistics[..., self.parts]))

    def name(self, seen: Seen, start: int, stop: int, last: int) -> Named:
        """Return the channels ranked by their mean deviation since the beginning of the alarm."""
        around = super().name(seen, start, stop, last)
        rows = seen.tested.part_statistics[start : min(start + _COMPARED, max(last, start) + 1)][:, self.parts]
        judged = np.isfinite(rows)
        mean = np.where(judged, rows, 0.0).sum(axis=0) / np.maximum(judged.sum(axis=0), 1)
        mean = np.where(judged.any(axis=0), mean, np.nan)
        return Named(candidates=self.candidates(_relative(mean)), sizes=around.sizes, fired=around.fired)

    def word(self, alarm: Alarm, window: int) -> Word | None:
        """Return the word for an alarm from the residual of the model, else from the channels that deviate."""
        candidates = scored(alarm)
        if alarm.word is not None or not candidates:
            return alarm.word
        word = Word(EITHER, (candidates[0].faults,), after=alarm.samples)
        if alarm.samples < _EARLY:
            return replace(word, kind=TOO_EARLY, why=too_short(_EARLY))
        if not any(name != MODEL for name in alarm.fired):
            return replace(word, kind=POOR, why="no single channel deviates, only the model's prediction")
        near = tuple(one.faults for one in candidates if one.score >= _AS_FAR)
        return replace(word, faults=near, unlisted=ANYTHING)

    def agreed(self, alarm: Alarm, word: Word) -> Word:
        """Return a good match as "either" if another channel deviates more than its own: the model may be wrong.

        Of a poor match the nearest is the channel that is furthest off.
        """
        candidates = scored(alarm)
        if word.kind == POOR and candidates and candidates[0].faults not in word.faults:
            return replace(word, faults=(candidates[0].faults,), share=math.nan, size=math.nan, deviation=math.nan)
        if word.kind != GOOD:
            return word
        least = max((one.score for one in alarm.candidates if set(one.faults) & set(word.faults[0])), default=0.0)
        further = tuple(one.faults for one in candidates if one.score > least)
        return replace(word, kind=EITHER, faults=(*word.faults, *further[:2])) if further else word

    def statement(self, alarm: Alarm, clock: Clock, window: int) -> Statement:
        """Return the statement about an alarm: its word, and the channels that deviate."""
        word, candidates = self.word(alarm, window), scored(alarm)
        if word is None or word.fitted or not candidates:
            return statement_by_score(alarm, clock, word)
        others = [one for one in alarm.fired if one != MODEL]
        sentence = (
            f"Deviation from the other channels: {listing(others[:_LISTED])}"
            if others
            else "Deviation from the model's prediction only"
        )
        if len(candidates) > 1:
            following = candidates[1]
            sentence += f"; {candidates[0].name} deviates most, {following.name} {100 * following.score:.0f} % as far"
        return statement_by_word(alarm, word, clock, (f"{sentence}.",), _RULES, alarm.margin)

    def words(self, step: float) -> dict[str, str]:
        """Describe the naming of faults."""
        return {"isolation": f"the channel with the largest deviation in thresholds, over {_COMPARED} samples at most"}

    @property
    def samples(self) -> int:
        """Five: alarms nearer to each other about one channel are merged."""
        return _EARLY

    # --------------------------------------------------------------------------- files

    def check(self, watched: Watched, test: ResidualTest) -> None:
        """Raise if names from a file do not match the faults and parts."""
        check_groups(self.groups, self.unjudged, "running.isolation", watched.generator.faults)
        if len(self.parts) != len(self.groups) or not (self.parts < max(1, len(test.part_names))).all():
            raise FileFormatError("running.isolation.parts must be a part of the test for each group")


def _relative(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return values relative to the largest of each row; all NaN if none is known."""
    judged = np.isfinite(values)
    largest = np.where(judged, values, 0.0).max(axis=-1, keepdims=True, initial=0.0)
    parts = np.where(judged, values, 0.0) / np.where(largest > 0, largest, 1.0)
    return np.where((largest > 0) & judged.any(axis=-1, keepdims=True), parts, np.nan)


@dataclass(frozen=True)
class ByChannel(IsolationSettings):
    """Name the sensor or actuator whose channel deviates most from its prediction by the others.

    For :class:`residua.decide.ChannelRelations`. An alarm that moves the residual of the model enough gets a
    word by the responses to faults, as with :class:`residua.decide.Directional`. For any other, channels are compared
    in their own thresholds over its first hundred samples; a sensor is then not distinguishable from an unlisted cause.
    Faults that move several channels at once are never named by channel.

    Examples
    --------
    >>> import residua as rs
    >>> rs.decide.ByChannel()
    ByChannel()
    """

    kind: ClassVar[str] = "channel"
    makes: ClassVar[type[Isolation]] = ChannelNames

    def isolation(self, generator: ResidualGenerator, test: ResidualTest) -> ChannelNames:
        """Return the isolation of channel faults."""
        channels = channel_faults(generator)
        names = (*generator.plant.inputs, *generator.plant.outputs)  # after the part of the model
        judged = {fault: 1 + names.index(channel) for fault, channel in channels.items() if channel in names}
        return ChannelNames(
            tuple((fault,) for fault in judged),
            np.array(list(judged.values()), dtype=np.int64),
            tuple(fault for fault in generator.faults if fault not in judged),
        )

    def test_of(self, settings: TestSettings) -> TestSettings:
        """Return the settings of the test, or raise if they are not for channels."""
        if not isinstance(settings, ChannelRelations):
            raise SettingError("ByChannel names channels by the test ChannelRelations: give test=ChannelRelations(...)")
        return settings


def channel_faults(generator: ResidualGenerator) -> dict[str, str]:
    """Return the faults of one sensor or of one actuator, with the channel of each."""
    plant = generator.plant
    facts = zip(plant.faults, plant.fault_kinds, plant.fault_components, strict=True)
    return {fault: component for fault, kind, component in facts if kind in ("sensor", "actuator")}
