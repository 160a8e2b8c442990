"""What waits for the run: messages of all sources, of which there is only so much room."""

from __future__ import annotations

import threading
from collections import deque

from residua.live.messages import Message
from residua.live.source import RunStoppedError

#: Messages that may wait, and bytes of them.
MOST_MESSAGES, MOST_BYTES = 20_000, 64_000_000


class Inbox:
    """A queue that is full at some number of messages, or of bytes; one thread takes, many put."""

    def __init__(self, messages: int = MOST_MESSAGES, octets: int = MOST_BYTES) -> None:
        self._most, self._most_bytes = messages, octets
        self._queue: deque[Message] = deque()
        self._bytes = 0
        self._lock = threading.Lock()
        self._some, self._room = threading.Condition(self._lock), threading.Condition(self._lock)
        self._closed = False

    def __len__(self) -> int:
        return len(self._queue)

    def put(self, message: Message) -> None:
        """Put a message; wait while there is no room.

        Raises
        ------
        RunStoppedError
            If the run is ending.
        """
        size = _size(message)
        with self._lock:
            while (
                not self._closed
                and self._queue
                and (len(self._queue) >= self._most or self._bytes + size > self._most_bytes)
            ):
                self._room.wait()
            if self._closed:
                raise RunStoppedError
            self._queue.append(message)
            self._bytes += size
            if len(self._queue) == 1:
                self._some.notify()

    def take(self, most: int, seconds: float) -> list[Message]:
        """Return the messages that wait, up to a number; wait for the first some seconds at most."""
        with self._lock:
            if not self._queue and not self._closed:
                self._some.wait(seconds)
            count = min(most, len(self._queue))
            out = [self._queue.popleft() for _ in range(count)]
            self._bytes -= sum(map(_size, out))
            if out:
                self._room.notify_all()
            return out

    def wake(self) -> None:
        """Let whoever takes look again."""
        with self._lock:
            self._some.notify_all()

    def close(self) -> None:
        """Take nothing any more; whoever waits to put is told."""
        with self._lock:
            self._closed = True
            self._room.notify_all()
            self._some.notify_all()


def _size(message: Message) -> int:
    return len(message.payload) + 200 if isinstance(message.payload, bytes) else 200


__all__ = ["Inbox"]
