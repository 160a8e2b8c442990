"""A socket by which one thread wakes another that waits on sockets."""

from __future__ import annotations

import contextlib
import socket


class Waker:
    """Socket that is readable once :meth:`wake` was called: for :mod:`selectors`."""

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


__all__ = ["Waker"]
