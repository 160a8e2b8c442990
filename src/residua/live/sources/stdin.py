"""Messages as lines of JSON from standard input, a named pipe or a file."""

from __future__ import annotations

import os
import selectors
import stat
import sys
import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from residua.errors import SettingError
from residua.live.messages import LARGEST, Message
from residua.live.setting_checks import flag, text
from residua.live.sources.threaded import ThreadedSource
from residua.live.sources.waking import Waker

#: Bytes that are read at once.
_PIECE = 1 << 16


@dataclass(frozen=True)
class Settings:
    """Settings of the file or pipe.

    Attributes
    ----------
    path : str
        A file or a named pipe; empty: standard input.
    plant : str
        The plant of lines that do not say theirs; a line that says another is refused.
    follow : bool
        Whether it goes on where the file ends, or the last writer has left: lines may still be appended.
    name : str
        Of the source; empty: ``"stdin"``, or the path.

    Raises
    ------
    SettingError
        If there is no such file.
    """

    path: str = ""
    plant: str = ""
    follow: bool = False
    name: str = ""

    def __post_init__(self) -> None:
        for key in ("path", "plant", "name"):
            text(self, key)
        flag(self, "follow")
        if self.path and not (Path(self.path).exists() and not Path(self.path).is_dir()):
            raise SettingError(f"path: {self.path} is neither a file nor a named pipe")


class JsonLines(ThreadedSource):
    """Source with one message a line. It ends with its input, unless it follows it.

    A line of more than :data:`residua.live.messages.LARGEST` bytes is refused, and never held whole; empty lines are
    ignored. Nothing is acknowledged: lines read but not saved when a run ends are lost with a pipe; a file is read from
    its beginning again, and rows that the store has are dropped by the run.

    Parameters
    ----------
    settings : Settings
    """

    kind: ClassVar[str] = "stdin"

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings.name or settings.path or "stdin")
        self._settings = settings
        self._waker = Waker()
        self.finite = not settings.follow
        self.rereads = _is_file(settings.path)

    def wake(self) -> None:
        """Wake the thread, to check whether the run is ending."""
        self._waker.wake()

    def stop(self) -> None:
        """End the thread."""
        super().stop()
        self._waker.close()

    def work(self) -> None:
        """Put every line as a message."""
        settings = self._settings
        self.say(True, f"reads {settings.path or 'standard input'}")
        lines = 0
        try:
            for line in split(self._pieces()):
                lines += 1
                if line is None:
                    self.put(Message(self, b"", time.time(), settings.plant, refused="size", line=lines))
                elif line.strip():
                    self.put(Message(self, line, time.time(), settings.plant, line=lines))
            self.say(True, f"has ended, after {lines:,} lines")
        except OSError as error:
            self.say(False, f"cannot be read: {error.strerror or error}")

    def _pieces(self) -> Iterator[bytes]:
        """Read the available data, wait for more; end with the input, or when the run is ending."""
        path = self._settings.path
        # Without blocking, a pipe without a writer can be opened, and left again.
        file = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0)) if path else os.dup(sys.stdin.fileno())
        try:
            waits = not stat.S_ISREG(os.fstat(file).st_mode) and os.name == "posix"
            with closing(selectors.PollSelector() if waits else _Ready()) as ready:
                ready.register(file, selectors.EVENT_READ)
                ready.register(self._waker, selectors.EVENT_READ)
                yield from self._read(file, ready)
        finally:
            os.close(file)

    def _read(self, file: int, ready: selectors.BaseSelector | _Ready) -> Iterator[bytes]:
        while not self.stopping.is_set():
            if all(key.fd != file for key, _ in ready.select()):
                continue
            try:
                piece = os.read(file, _PIECE)
            except BlockingIOError:
                continue
            if piece:
                yield piece
            elif not self._settings.follow:
                return
            else:
                self.stopping.wait(0.2)  # at the end of a file a system only reports that it is readable


def _is_file(path: str) -> bool:
    """Tell whether lines come from a file, which starts from its beginning when it is read again."""
    try:
        return stat.S_ISREG(os.stat(path).st_mode if path else os.fstat(sys.stdin.fileno()).st_mode)
    except (OSError, ValueError, AttributeError):  # a standard input that is none
        return False


def split(pieces: Iterator[bytes], most: int = LARGEST) -> Iterator[bytes | None]:
    r"""Return the lines of text in pieces, ``None`` for one that is too long, which is not kept.

    Parameters
    ----------
    pieces : iterator of bytes
    most : int
        Bytes of a line at most.

    Examples
    --------
    >>> list(split(iter([b"one\ntw", b"o\nmuch too", b" long\nend"]), most=5))
    [b'one', b'two', None, b'end']
    """
    held, too_long = bytearray(), False
    for piece in pieces:
        *lines, rest = piece.split(b"\n")
        for line in lines:
            held += line if not too_long else b""
            yield None if too_long or len(held) > most else bytes(held)
            held, too_long = bytearray(), False
        held += rest if not too_long else b""
        if len(held) > most:
            held, too_long = bytearray(), True
    if too_long or held:
        yield None if too_long else bytes(held)


class _Ready:
    """Substitute for a selector if a file never waits, or the system cannot tell."""

    def __init__(self) -> None:
        self._keys: list[selectors.SelectorKey] = []

    def register(self, file: int | Waker, events: int) -> None:
        if isinstance(file, int):
            self._keys.append(selectors.SelectorKey(file, file, events, None))

    def select(self) -> list[tuple[selectors.SelectorKey, int]]:
        return [(key, key.events) for key in self._keys]

    def close(self) -> None:
        pass


__all__ = ["JsonLines", "Settings", "split"]
