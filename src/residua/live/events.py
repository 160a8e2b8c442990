"""Events of a plant: alarms raised, their names, their ends; missing data, and their return."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

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
