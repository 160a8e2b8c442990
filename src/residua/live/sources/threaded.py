"""Common parts of sources: a thread that ends in time, its health, and a bounded hand-over to the run."""

from __future__ import annotations

import logging
import threading
from abc import abstractmethod
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from residua.live.messages import Message
from residua.live.source import Health, RunStoppedError, Source

logger = logging.getLogger("residua.live")

#: Seconds that ``stop`` waits for a thread.
PATIENCE = 10.0


class ThreadedSource(Source):
    """A source with its own thread, which runs :meth:`work` and ends when :attr:`stopping` is set.

    Attributes
    ----------
    stopping : threading.Event
    put : callable
        As :meth:`start` was told.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.stopping = threading.Event()
        self._health = Health(False, "not started")
        self._thread: threading.Thread | None = None
        self._over = False
        self._hand: HandOver | None = None

    def start(self, put: Callable[[Message], None]) -> None:
        """Begin."""
        self.put = put
        self._thread = threading.Thread(target=self._run, name=f"residua {self.name}", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the thread."""
        self.stopping.set()
        self.wake()
        if self._thread is not None:
            self._thread.join(PATIENCE)

    @property
    def over(self) -> bool:
        """True if it has ended by itself: all was put, or it cannot continue, as :attr:`health` then says."""
        return self._over

    @property
    def health(self) -> Health:
        """Health now."""
        return self._health

    def say(self, good: bool, text: str) -> None:
        """Keep the health for the page, and log a change."""
        if (good, text) != (self._health.good, self._health.text):
            logger.log(logging.INFO if good else logging.WARNING, "%s: %s", self.name, text)
        self._health = Health(good, text)

    @property
    def waiting(self) -> int:
        """Number of messages waiting to be put, in a source that hands over."""
        return self._hand.count if self._hand else 0

    @contextmanager
    def handing_over(self, most: int, most_bytes: int, freed: Callable[[], None]) -> Iterator[HandOver]:
        """Hand messages over for as long as :meth:`work` lasts; parameters as of :class:`HandOver`."""
        self._hand = HandOver(self.put, most, most_bytes, freed, f"residua {self.name}, putting")
        try:
            yield self._hand
        finally:
            self._hand.close()
            self._health = Health(False, "has ended")

    @abstractmethod
    def work(self) -> None:
        """Bring messages until there are no more, or :attr:`stopping` is set; in the thread."""

    def wake(self) -> None:
        """Wake the thread, to check :attr:`stopping` now; from any thread."""

    def _run(self) -> None:
        try:
            self.work()
        except RunStoppedError:
            return
        except Exception as error:  # a source never raises: errors are reported with its health
            logger.exception("%s: it has ended", self.name)
            self.say(False, f"it has ended: {error}")
        self._over = not self.stopping.is_set()


class HandOver:
    """Messages on their way from a thread that must not wait (it answers a broker) to a run that may be busy.

    A thread of its own puts them one after another. The queue is bounded: :attr:`full` tells when to stop reading.

    Parameters
    ----------
    put : callable
        Of the run.
    most, most_bytes : int
        Messages, and bytes of their payloads, from which on it is full.
    freed : callable
        Called, from the thread that puts, when it is no longer full.
    name : str
        Of the thread.
    """

    def __init__(
        self, put: Callable[[Message], None], most: int, most_bytes: int, freed: Callable[[], None], name: str
    ) -> None:
        self._put, self._freed, self._most, self._most_bytes = put, freed, most, most_bytes
        self._waiting: deque[list[Message]] = deque()
        self._change = threading.Condition()
        #: Messages and bytes that came, which the one who gives counts, and that were put, which the thread counts.
        self._came = self._came_bytes = self._gone = self._gone_bytes = 0
        self._ended = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    @property
    def full(self) -> bool:
        """True if no more should be read."""
        return self.count >= self._most or self.heavy

    @property
    def heavy(self) -> bool:
        """True if it is full of bytes, not of messages."""
        return self._came_bytes - self._gone_bytes >= self._most_bytes

    @property
    def count(self) -> int:
        """Number of waiting messages."""
        return self._came - self._gone

    @property
    def ended(self) -> bool:
        """True if the run accepts no more messages."""
        return self._ended

    def give(self, messages: list[Message]) -> None:
        """Add messages in their order, without waiting. From one thread, as :meth:`forget`."""
        self._came += len(messages)
        self._came_bytes += sum(map(_size, messages))
        with self._change:
            self._waiting.append(messages)
            self._change.notify()

    def forget(self, gone: Callable[[Message], bool]) -> None:
        """Drop messages that come again, or that belong to another now."""
        with self._change:
            before, self._waiting = self._waiting, deque()
            for messages in before:
                kept = [one for one in messages if not gone(one)]
                self._came -= len(messages) - len(kept)
                self._came_bytes -= sum(map(_size, messages)) - sum(map(_size, kept))
                if kept:
                    self._waiting.append(kept)

    def close(self) -> None:
        """End the thread; waiting messages are not handed over."""
        with self._change:
            self._ended = True
            self._change.notify()
        self._thread.join(PATIENCE)

    def _run(self) -> None:
        try:
            while True:
                with self._change:
                    while not self._waiting and not self._ended:
                        self._change.wait()
                    if self._ended:
                        return
                    messages = self._waiting.popleft()
                was_full = self.full
                for message in messages:
                    self._put(message)
                    self._gone += 1
                    self._gone_bytes += _size(message)
                    if self._ended:
                        return
                if was_full and not self.full:
                    self._freed()
        except RunStoppedError:
            self._ended = True
            self._freed()


def _size(message: Message) -> int:
    return len(message.payload) if isinstance(message.payload, bytes) else 8


__all__ = ["PATIENCE", "HandOver", "ThreadedSource", "logger"]
