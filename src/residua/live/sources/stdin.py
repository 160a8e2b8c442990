"""Messages as lines of JSON from standard input, a named pipe or a file."""

from __future__ import annotations

import os
import selectors
import stat
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from residua.errors import SettingError
from residua.live.setting_checks import check_types
from residua.live.source import LARGEST, Message
from residua.live.sources.adapter import ThreadedSource

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
        check_types(self)
        if self.path and not (Path(self.path).exists() and not Path(self.path).is_dir()):
            raise SettingError(f"path: {self.path} is neither a file nor a named pipe")


class JsonLines(ThreadedSource):
    """Source with one message a line. It ends with its input, unless it follows it.

    A line of more than :data:`residua.live.source.LARGEST` bytes is refused, and never held whole; empty lines are
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
        self.finite = not settings.follow
        self.rereads = _is_file(settings.path)

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
            while not self.stopping.is_set():
                if waits and not self._can_read(file):
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
        finally:
            os.close(file)

    def _can_read(self, pipe: int) -> bool:
        """Wait for data in a pipe, its end, or the end of the run; return whether the pipe can be read."""
        with selectors.PollSelector() as selector:
            selector.register(pipe, selectors.EVENT_READ)
            selector.register(self.waker, selectors.EVENT_READ)
            return any(key.fd == pipe for key, _ in selector.select())


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


__all__ = ["JsonLines", "Settings", "split"]
