"""Adapters between the thread of a client and the loop of the run: shutdown in time, backoff, backpressure."""

from __future__ import annotations

import contextlib
import logging
import socket
import threading
from abc import abstractmethod
from collections.abc import Callable

from residua.live.source import Backoff, Health, Message, MessageQueue, RunStoppedError, Source

logger = logging.getLogger("residua.live")

#: Messages, and bytes of them, that are on their way from the queue of a broker to the run.
_AT_ONCE, _BYTES_AT_ONCE = 100, 1_000_000
#: Seconds that ``stop`` waits for a thread.
JOIN_TIMEOUT = 10.0


class ThreadedSource(Source):
    """A source with its own thread, which runs :meth:`work` and ends when :attr:`stopping` is set.

    Attributes
    ----------
    stopping : threading.Event
    waker : Waker
        By which :meth:`wake` wakes a thread that waits on sockets.
    put : callable
        The argument of :meth:`start`.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.stopping = threading.Event()
        self._health = Health(False, "not started")
        self._thread: threading.Thread | None = None
        self._over = False

    def start(self, put: Callable[[Message], None]) -> None:
        """Begin."""
        self.put, self.waker = put, Waker()
        self._thread = threading.Thread(target=self._run, name=f"residua {self.name}", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the thread."""
        self.stopping.set()
        if self._thread is not None:
            self.wake()
            self._thread.join(JOIN_TIMEOUT)
            self.waker.close()

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

    @abstractmethod
    def work(self) -> None:
        """Bring messages until there are no more, or :attr:`stopping` is set; in the thread."""

    def wake(self) -> None:
        """Wake the thread, to check for changes; from any thread."""
        self.waker.wake()

    def _run(self) -> None:
        try:
            self.work()
        except RunStoppedError:
            return
        except Exception as error:  # a source never raises: errors are reported with its health
            logger.exception("%s: it has ended", self.name)
            self.say(False, f"it has ended: {error}")
        self._over = not self.stopping.is_set()


class BrokerSource(ThreadedSource):
    """A source with a connection to a server, which is made again with backoff whenever it is lost.

    The thread of the connection must not wait for a busy run, since it answers the server. It gives messages to
    :attr:`queue`, from which another thread puts them; while the queue is full, it must not read.

    Parameters
    ----------
    name : str
    address : str
        Of the server, for the texts of the health.
    most, most_bytes : int
        Messages that may wait for the run, and bytes of them.
    """

    def __init__(self, name: str, address: str, most: int, most_bytes: int) -> None:
        super().__init__(name)
        self.address = address
        self.queue = MessageQueue(most, most_bytes)
        self.backoff = Backoff()

    @abstractmethod
    def serve(self) -> None:
        """Connect, and read until the source is :attr:`leaving`; raise when the connection is lost."""

    def comes_again(self, message: Message) -> bool:
        """Tell whether the server repeats a message, which was not acknowledged, on the next connection."""
        return False

    @property
    def leaving(self) -> bool:
        """True if the source is to stop, or the run accepts no more messages."""
        return self.stopping.is_set() or self.queue.closed

    def work(self) -> None:
        """Serve one connection after another, with growing pauses between them."""
        putting = threading.Thread(target=self._put_all, name=f"residua {self.name}, putting", daemon=True)
        putting.start()
        try:
            while not self.leaving:
                try:
                    self.serve()
                except Exception as error:  # of the system, of TLS, and those that invalid answers make clients raise
                    if not self.stopping.is_set():
                        self.say(False, f"{self.address}: {reason_of(error)}; tries again")
                self.queue.drop(self.comes_again)
                if not self.leaving:
                    self.backoff.wait(self.stopping)
        finally:
            self.queue.close()
            putting.join(JOIN_TIMEOUT)
            self._health = Health(False, "has ended")

    def _put_all(self) -> None:
        """Put the messages of the queue, one after another, and wake the reader when there is room again."""
        try:
            while not self.queue.closed:
                full = self.queue.full
                for message in self.queue.take(_AT_ONCE, octets=_BYTES_AT_ONCE):
                    self.put(message)
                if full and not self.queue.full:
                    self.wake()
        except RunStoppedError:
            self.queue.close()
            self.wake()


class Waker:
    """Socket by which one thread wakes another that waits on sockets: readable once :meth:`wake` was called."""

    def __init__(self) -> None:
        self._read, self._write = socket.socketpair()
        self._read.setblocking(False)
        self._write.setblocking(False)
        self._woken = False

    def fileno(self) -> int:
        """Return the file descriptor for a selector."""
        return self._read.fileno()

    def wake(self) -> None:
        """Wake the other thread; from any thread."""
        if not self._woken:
            self._woken = True
            with contextlib.suppress(OSError):  # full: it is awake; closed: nobody waits any more
                self._write.send(b"\0")

    def clear(self) -> None:
        """Reset; in the thread that was woken, before it checks for changes."""
        with contextlib.suppress(OSError):  # nothing was there
            self._read.recv(4096)
        self._woken = False

    def close(self) -> None:
        """Close both ends."""
        self._read.close()
        self._write.close()


def reason_of(error: BaseException) -> str:
    """Return the text of an error, or else its kind."""
    return getattr(error, "strerror", None) or str(error) or type(error).__name__


__all__ = ["BrokerSource", "ThreadedSource", "Waker", "reason_of"]
