"""Interface of sources, which bring messages and learn when these are safe."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

from residua.live.messages import Message


@dataclass(frozen=True)
class Health:
    """Health of a source or a sink.

    Attributes
    ----------
    good : bool
        Whether it is connected.
    text : str
        Text: its connection, or the reason for having none, and the remedy under way.
    """

    good: bool
    text: str


class Source(ABC):
    """Interface to a protocol that brings messages, in threads of its own between :meth:`start` and :meth:`stop`.

    Attributes
    ----------
    kind : str
        As in the configuration.
    name : str
        Name for the page and the log; never with a secret in it.
    finite : bool
        Whether it ends by itself, as a recording does: the run ends when all sources have.
    rereads : bool
        Whether it repeats earlier messages, as a file does that is read from its beginning: old readings are then no
        sign of a clock set back.

    Notes
    -----
    A source that loses its connection tries again after growing pauses, for ever; it never raises after ``start``.
    Memory is bounded: ``put`` blocks while there is no room, and the source must then stop reading, not collect.
    """

    kind: ClassVar[str]
    finite: bool = False
    rereads: bool = False
    name: str

    @abstractmethod
    def start(self, put: Callable[[Message], None]) -> None:
        """Start to bring messages; ``put`` takes them, from any thread, and blocks while there is no room.

        ``put`` raises :class:`RunStoppedError` where the run is ending: the source then leaves.
        """

    def resume(self, times: Mapping[str, float]) -> None:  # noqa: B027 (most are told by their broker where they are)
        """Learn the progress of the store before :meth:`start`: the time of the last row of each plant, in seconds.

        A source that holds the past, as a recording does, goes on after it. Nothing to do for others.
        """

    @abstractmethod
    def stop(self) -> None:
        """End all threads and connections, within a few seconds; messages that were not acknowledged stay unsafe."""

    def acknowledge(self, messages: Sequence[Message]) -> None:  # noqa: B027 (some protocols have none)
        """Note that messages are safe, with their results committed. Called from the thread of the run.

        In the order in which they were put. Nothing to do where the protocol knows no acknowledgement.
        """

    @property
    def over(self) -> bool:
        """True if a finite source has brought all its messages."""
        return False

    @property
    @abstractmethod
    def health(self) -> Health:
        """Health now; from any thread."""


class RunStoppedError(Exception):
    """The run is ending: no more messages are accepted."""


class Pauses:
    """Growing pauses between attempts: doubled each time, from the first to the longest.

    Examples
    --------
    >>> pauses = Pauses(first=0.5, longest=3.0)
    >>> [pauses.next() for _ in range(5)]
    [0.5, 1.0, 2.0, 3.0, 3.0]
    """

    def __init__(self, first: float = 0.5, longest: float = 30.0) -> None:
        self.first, self.longest = first, longest
        self._now = first

    def next(self) -> float:
        """Return the seconds to wait before the next attempt."""
        now, self._now = self._now, min(2 * self._now, self.longest)
        return now

    def reset(self) -> None:
        """Start again with the shortest pause, after a success."""
        self._now = self.first

    def wait(self, stopping: threading.Event) -> bool:
        """Wait, unless the run is ending; return whether it is."""
        return stopping.wait(self.next())
