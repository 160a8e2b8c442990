"""Events into a file, one line of JSON each."""

from __future__ import annotations

import json
import os
import stat
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from residua.errors import SettingError
from residua.live.delivery import DeliveryError, Sink
from residua.live.events import Event
from residua.live.setting_checks import check_types

if sys.platform != "win32":
    import fcntl

#: Bytes that are written before they are made safe, about; and from the end of the file, those that are looked at.
BATCH, LOOKED_AT = 1 << 18, 1 << 21
#: How each line begins.
_BEGINNING = b'{"plant": "'


@dataclass(frozen=True)
class Settings:
    """Settings of the file.

    Attributes
    ----------
    path : str
        The file; it is made where there is none, and only ever grows.
    name : str
        Of the sink; empty: ``"jsonl "`` and the path.

    Raises
    ------
    SettingError
        If there is no path, its folder does not exist, or it is not a file.
    """

    path: str
    name: str = ""

    def __post_init__(self) -> None:
        check_types(self)
        if not self.path:
            raise SettingError("path: the file that events are written to must be named")
        path = Path(self.path)
        if not path.parent.is_dir():
            raise SettingError(f"path: the folder {path.parent} does not exist; make it first")
        if path.exists() and not path.is_file():
            raise SettingError(f"path: {path} is not a file; to pass events to a program, use the sink 'command'")


class JsonLines(Sink):
    """Sink that appends events to a file, and returns when they are on the disk (fsync).

    A process that is killed, or a machine that loses power, while it writes may leave a torn line at the end. It was
    never said to be delivered, so the next call takes it away, and the event comes again whole: every line of the file
    is an event. The file is opened anew in each call: it may be renamed at any time, and a new one begins.

    Parameters
    ----------
    settings : Settings

    Examples
    --------
    >>> import tempfile
    >>> from residua.live.events import Event
    >>> path = tempfile.mkdtemp() + "/events.jsonl"
    >>> JsonLines(Settings(path)).deliver([Event(1, "north", 1, "missing", 40.0, content={"channels": ["level"]})])
    1
    >>> print(Path(path).read_text(), end="")
    {"plant": "north", "number": 1, "kind": "missing", "time": 40.0, "channels": ["level"]}
    """

    kind: ClassVar[str] = "jsonl"

    def __init__(self, settings: Settings) -> None:
        self._path = Path(settings.path)
        self.name = settings.name or f"jsonl {settings.path}"

    def deliver(self, events: Sequence[Event]) -> int:
        """Append events, and return their number: as many as make up about a quarter of a megabyte.

        Raises
        ------
        DeliveryError
            If the file cannot be written (the disk is full, say), another process is writing it, or it ends in
            something that is not an event.
        """
        lines, size = [], 0
        for event in events:
            lines.append(event.to_json().encode() + b"\n")
            size += len(lines[-1])
            if size >= BATCH:
                break
        try:
            self._append(b"".join(lines))
        except OSError as error:
            raise DeliveryError(f"{self._path} cannot be written: {error.strerror or error}") from error
        return len(lines)

    def _append(self, text: bytes) -> None:
        new = not self._path.exists()
        file = os.open(self._path, os.O_RDWR | os.O_CREAT | getattr(os, "O_BINARY", 0), 0o644)
        try:
            if not stat.S_ISREG(os.fstat(file).st_mode):
                raise DeliveryError(f"{self._path} is no longer a file")
            _hold(file, self._path)
            end = mend(file, self._path)
            try:
                os.lseek(file, end, os.SEEK_SET)
                left = memoryview(text)
                while left:
                    left = left[os.write(file, left) :]
                os.fsync(file)
            except OSError:
                os.ftruncate(file, end)  # a partial write would be an incomplete line
                raise
        finally:
            os.close(file)
        if new:
            _fsync_folder(self._path.parent)


def mend(file: int, path: Path) -> int:
    """Remove the incomplete line of a killed process from the end of a file; return the new end.

    What a loss of power has left may be zeros as well: the file has grown, but nothing was written into it.

    Raises
    ------
    DeliveryError
        If the end is neither a line nor the beginning of one as events have it: then it is not ours to take away.
    """
    size = os.lseek(file, 0, os.SEEK_END)
    begin = max(size - LOOKED_AT, 0)
    os.lseek(file, begin, os.SEEK_SET)
    tail = b""
    while len(tail) < size - begin and (piece := os.read(file, size - begin - len(tail))):
        tail += piece
    zeros = tail.find(b"\0")
    kept = tail[: zeros if zeros >= 0 else len(tail)]
    torn = kept[kept.rfind(b"\n") + 1 :]
    if not torn and zeros < 0:
        return size
    if zeros < 0 and _whole(torn):  # by another hand, or all but the line end
        os.write(file, b"\n")
        return size + 1
    if torn[: len(_BEGINNING)] != _BEGINNING[: len(torn)] or (begin and b"\n" not in kept):
        raise DeliveryError(
            f"{path} ends in {len(torn)} bytes that are not the beginning of an event; it is left alone: name another "
            "file"
        )
    end = begin + len(kept) - len(torn)
    os.ftruncate(file, end)
    return end


def _whole(line: bytes) -> bool:
    try:
        return isinstance(json.loads(line), dict)
    except ValueError:
        return False


def _hold(file: int, path: Path) -> None:
    """Keep other processes from writing the file: mending would take their line for an incomplete one."""
    if sys.platform != "win32":
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise DeliveryError(f"another process is writing {path}") from None


def _fsync_folder(folder: Path) -> None:
    """Make the name of a new file durable, if the system can."""
    if sys.platform != "win32":
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
