"""Events of a plant: alarms raised, their names, their ends; missing data, and their return.

Events of alarms are the differences between two looks at the rows of a plant. A look runs the code of a recorded run
over the rows, and gives its alarms as that would, those that are one event joined. When it is looked depends on the
rows alone, so that events do not depend on how rows came in batches.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, field, replace
from typing import Any

from residua.decide.alarm import Alarm, Beginning

#: What events are about: an alarm was raised, is put down to another fault, or with another word to the same one, has
#: ended, or stands where the data end; values are missing, so that the plant is not watched, and are back; the clock of
#: the plant has gone back.
KINDS = ("raised", "renamed", "confirmed", "ended", "standing", "missing", "back", "clock")


@dataclass(frozen=True)
class Event:
    """One event of one plant.

    Attributes
    ----------
    place : int
        In the order of all plants: 1, 2, ...
    plant : str
    number : int
        In the order of its plant: 1, 2, ...; the same event has the same number whenever it is delivered.
    kind : str
        One of :data:`KINDS`.
    time : float
        Of the sample that brought it, in seconds.
    clock : str
        The same as ISO 8601 in UTC, where times are dates; else empty.
    content : mapping
        Of an alarm: the entries of :meth:`residua.monitor.Alarm.to_dict`, ``name`` (the faults it is attributed to, as
        text), ``text`` (the statement about it, sentence by sentence), and ``plant_name``; of missing values
        ``channels``. Of plain values for JSON.
    """

    place: int
    plant: str
    number: int
    kind: str
    time: float
    clock: str = ""
    content: Mapping[str, Any] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Return the event as plain values: ``plant``, ``number``, ``kind``, ``time``, ``clock``, and the content."""
        head: dict[str, Any] = {"plant": self.plant, "number": self.number, "kind": self.kind, "time": self.time}
        return head | ({"clock": self.clock} if self.clock else {}) | dict(self.content)

    def to_json(self) -> str:
        """Return the event as one line of JSON, as sent by every sink.

        Examples
        --------
        >>> Event(7, "north", 2, "missing", 40.0, content={"channels": ["level"]}).to_json()
        '{"plant": "north", "number": 2, "kind": "missing", "time": 40.0, "channels": ["level"]}'
        """
        return json.dumps(self.to_dict(), allow_nan=False)


@dataclass(frozen=True, slots=True)
class ReportedAlarm:
    """An alarm that was reported, and may not be over.

    Attributes
    ----------
    raised, onset : float
        ``raised`` tells alarms apart.
    named : tuple of tuple of str
    began : Beginning or None
        As the last look had it.
    shortened : bool
        Whether rows of its beginning are no longer kept.
    word : str
        How well the named faults explained it; empty where that is not said.
    """

    raised: float
    onset: float
    named: tuple[tuple[str, ...], ...]
    began: Beginning | None = None
    shortened: bool = False
    word: str = ""

    def to_record(self) -> list[Any]:
        """Return the alarm as plain values for JSON."""
        began = None if self.began is None else list(astuple(self.began))
        return [self.raised, self.onset, [list(group) for group in self.named], began, self.shortened, self.word]

    @staticmethod
    def from_record(content: list[Any]) -> ReportedAlarm:
        """Return the alarm of a record by :meth:`to_record`."""
        raised, onset, named, began, shortened, word = content
        since = None if began is None else Beginning(*began)
        return ReportedAlarm(raised, onset, tuple(tuple(group) for group in named), since, shortened, word)


@dataclass(frozen=True, slots=True)
class News:
    """News about an alarm.

    Attributes
    ----------
    kind : str
        ``raised``, ``renamed``, ``confirmed`` or ``ended``.
    alarm : Alarm
    part : ReportedAlarm or None
        Of an ended one that turned out to be part of an earlier one, ``alarm``: its last report.
    """

    kind: str
    alarm: Alarm
    part: ReportedAlarm | None = None


def news(
    reported: Sequence[ReportedAlarm], alarms: Sequence[Alarm], since: float, over: bool
) -> tuple[list[ReportedAlarm], list[News]]:
    """Return the news about alarms, and the alarms reported then.

    Parameters
    ----------
    reported : sequence of ReportedAlarm
        Those that are not over.
    alarms : sequence of Alarm
        Of the rows that are kept.
    since : float
        When the first alarm of those that are not over was raised: earlier ones are over.
    over : bool
        Whether no row to come can belong to an alarm of these any more.

    Returns
    -------
    reported : list of ReportedAlarm
    events : list of News
        In the order of the alarms; those that are part of an earlier one first.
    """
    known = {one.raised: one for one in reported}
    now: list[ReportedAlarm] = []
    events: list[News] = []
    for alarm in those_since(reported, alarms, since):
        before = known.pop(alarm.raised, None)
        if before is None:
            events.append(News("raised", alarm))
        elif before.named != alarm.named:
            events.append(News("renamed", alarm))
        elif before.word != word_of(alarm):
            events.append(News("confirmed", alarm))
        if over:
            events.append(News("ended", alarm))
        else:
            shortened = before is not None and before.shortened
            now.append(ReportedAlarm(alarm.raised, alarm.onset, alarm.named, alarm.began, shortened, word_of(alarm)))
    whole = [one.alarm for one in events] + [one for one in alarms if one.raised >= since]
    parts = [News("ended", _owner(part, whole), part) for part in known.values() if whole]
    return now, [*parts, *events]


def word_of(alarm: Alarm) -> str:
    """Return the fit of the named faults to an alarm, in two words; empty without a statement."""
    return alarm.word.kind if alarm.word is not None else ""


def _owner(part: ReportedAlarm, alarms: Sequence[Alarm]) -> Alarm:
    """Return the alarm that a part belongs to: the last one raised before it."""
    before = [one for one in alarms if one.raised <= part.raised]
    return max(before, key=lambda one: one.raised) if before else alarms[0]


def those_since(reported: Sequence[ReportedAlarm], alarms: Sequence[Alarm], since: float) -> list[Alarm]:
    """Return the alarms since a time; one whose beginning is no longer kept gets the reported one."""
    first = next((one for one in reported if one.shortened), None)
    out = [one for one in alarms if one.raised >= since]
    if first is None or not out or out[0].start:
        return out
    return [replace(out[0], raised=first.raised, onset=first.onset, began=first.began), *out[1:]]


__all__ = ["KINDS", "Event", "News", "ReportedAlarm", "news", "those_since"]
