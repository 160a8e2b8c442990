"""Interface of sources, which bring messages and learn when these are safe: delivery at least once."""

from __future__ import annotations

import math
import threading
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

#: Bytes of a message at most, and characters of the id of a plant.
LARGEST, LONGEST_ID = 4_000_000, 200


@dataclass(slots=True)
class Message:
    """One message of a source, unchanged.

    Attributes
    ----------
    source : Source
        Which is told when the message is safe: :meth:`residua.live.source.Source.acknowledge`.
    payload : bytes or float
        JSON, as the page "Live sources" describes it; of one channel its value, or JSON with ``t`` and ``value``.
    arrived : float
        When it came, in seconds since 1970: the time of a value that has none.
    plant : str
        The id of the plant, where the topic or the node says it; a message that says another is refused.
    channel : str
        The channel, where a topic or a node has one channel; else empty: the payload names its channels.
    time : float or None
        In seconds, where the protocol says it.
    token : object
        Data with which the source acknowledges it.
    refused : str
        Reason for which the source refuses the message, as a word by which it is counted (``"size"``, ``"topic"``,
        ``"retained"``, ``"null"``): it is dropped, and acknowledged in its turn. Empty: no error so far.
    line : int
        Its number, from 1, where it is a line of text; else 0.
    """

    source: Any
    payload: bytes | float
    arrived: float
    plant: str = ""
    channel: str = ""
    time: float | None = None
    token: Any = None
    refused: str = ""
    line: int = 0


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


class MessageQueue:
    """A queue with limits on the number of messages and of bytes, so that a reader exerts backpressure on its writers.

    Parameters
    ----------
    messages, octets : int
        Messages that may wait, and bytes of them, from which on it is full.
    """

    def __init__(self, messages: int, octets: int) -> None:
        self._most, self._most_bytes = messages, octets
        self._queue: deque[Message] = deque()
        self._bytes = 0
        self._lock = threading.Lock()
        self._some, self._room = threading.Condition(self._lock), threading.Condition(self._lock)
        self.closed = False

    def __len__(self) -> int:
        return len(self._queue)

    @property
    def heavy(self) -> bool:
        """True if it is full of bytes."""
        return self._bytes >= self._most_bytes

    @property
    def full(self) -> bool:
        """True if no more should be read."""
        return self.heavy or len(self._queue) >= self._most

    def put(self, message: Message) -> None:
        """Put a message; wait while there is no room.

        Raises
        ------
        RunStoppedError
            If the queue is closed.
        """
        size = _size(message)
        with self._lock:
            while not self.closed and self._queue and (self.full or self._bytes + size > self._most_bytes):
                self._room.wait()
            if self.closed:
                raise RunStoppedError
            self._append(message, size)

    def give(self, messages: Iterable[Message]) -> None:
        """Add messages in their order, without waiting for room."""
        with self._lock:
            for message in messages:
                self._append(message, _size(message))

    def _append(self, message: Message, size: int) -> None:
        self._queue.append(message)
        self._bytes += size
        if len(self._queue) == 1:
            self._some.notify()

    def take(self, most: int, seconds: float | None = None, octets: float = math.inf) -> list[Message]:
        """Return the waiting messages, up to so many messages and bytes; wait for the first for a limited time."""
        with self._lock:
            if not self._queue and not self.closed:
                self._some.wait(seconds)
            out: list[Message] = []
            size = 0
            while self._queue and len(out) < most and size < octets:
                out.append(self._queue.popleft())
                size += _size(out[-1])
            self._bytes -= size
            if out:
                self._room.notify_all()
            return out

    def drop(self, unwanted: Callable[[Message], bool]) -> None:
        """Drop some of the waiting messages."""
        with self._lock:
            self._queue = deque(one for one in self._queue if not unwanted(one))
            self._bytes = sum(map(_size, self._queue))

    def oldest(self) -> float:
        """Return the arrival time of the oldest waiting message; infinite without one."""
        with self._lock:
            return self._queue[0].arrived if self._queue else math.inf

    def wake(self) -> None:
        """Wake the thread that takes messages."""
        with self._lock:
            self._some.notify_all()

    def close(self) -> None:
        """Refuse further messages, and wake all waiting threads."""
        with self._lock:
            self.closed = True
            self._room.notify_all()
            self._some.notify_all()


def _size(message: Message) -> int:
    """Return the bytes of a message in memory, about."""
    return len(message.payload) + 200 if isinstance(message.payload, bytes) else 200


class Backoff:
    """Exponential backoff: pauses between retries, doubled each time from the first to the longest.

    Examples
    --------
    >>> backoff = Backoff(first=0.5, longest=3.0)
    >>> [backoff.next() for _ in range(5)]
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


__all__ = ["LARGEST", "LONGEST_ID", "Backoff", "Health", "Message", "MessageQueue", "RunStoppedError", "Source"]
