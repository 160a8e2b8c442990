"""Partial files: files until their content is complete on disk. Those left by killed runs are removed.

A run that writes holds a lock on its partial file, which the operating system releases when the run ends, however that
comes about. So whoever gets the lock of a partial file knows that nobody writes it any more.
"""

from __future__ import annotations

import os
import time
from pathlib import Path
from types import ModuleType

fcntl: ModuleType | None
try:
    import fcntl
except ImportError:  # Windows, where a file that is open cannot be removed, lock or not
    fcntl = None

_PREFIX, _MIDDLE = ".residua-", ".partial"
#: Seconds after which a partial file that can be removed is one that was left: where there are no locks, a run has
#: closed its file for a moment before it is renamed.
_MOMENT = 60.0
#: Folders that this process has looked through: once is enough.
_swept: set[str] = set()


class PartialFile:
    """A new, empty file beside its final place, with the same ending, since writers choose the format by it.

    Attributes
    ----------
    path : Path
    """

    def __init__(self, target: Path) -> None:
        sweep(target.parent)
        self._file: int | None = None
        while self._file is None:
            self.path = target.with_name(f"{_PREFIX}{os.urandom(6).hex()}{_MIDDLE}{target.suffix}")
            # ours alone; the umask applies
            file = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o666)
            if _locked(file) is False or not _same(file, self.path):  # a sweep came between: take another
                os.close(file)
                self.path.unlink(missing_ok=True)
            else:
                self._file = file

    def take_place_of(self, target: Path) -> None:
        """Rename the file, once its content is on the disk: after a power cut there is the old file or the new one."""
        file = os.open(self.path, os.O_RDWR | getattr(os, "O_BINARY", 0))  # a writer may have made a new one
        try:
            os.fsync(file)
        finally:
            os.close(file)
        if fcntl is None:
            self._close()  # Windows does not rename open files
        os.replace(self.path, target)
        _sync_folder(target.parent)

    def discard(self) -> None:
        """Remove the file unless it was renamed."""
        self._close()
        self.path.unlink(missing_ok=True)

    def _close(self) -> None:
        if self._file is not None:
            os.close(self._file)
            self._file = None


def sweep(folder: Path) -> None:
    """Remove the partial files in a folder that nobody is writing; once for each folder and process."""
    name = str(folder)
    if name in _swept:
        return
    _swept.add(name)
    try:
        with os.scandir(folder) as entries:
            left = [Path(e.path) for e in entries if e.name.startswith(_PREFIX) and _MIDDLE in e.name]
        for path in left:
            _remove_if_left(path)
    except OSError:  # somebody else's folder or file: it is theirs to clean
        pass


def _remove_if_left(path: Path) -> None:
    if fcntl is None:
        if time.time() - path.stat().st_mtime > _MOMENT:
            path.unlink()
        return
    file = os.open(path, os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0))
    try:
        if _locked(file) and _same(file, path):
            path.unlink()
    finally:
        os.close(file)


def _locked(file: int) -> bool | None:
    """Lock a file: return success, or ``None`` if the file system has no locks."""
    if fcntl is None:
        return None
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return None
    return True


def _same(file: int, path: Path) -> bool:
    """Tell whether an open file is still the one under that name."""
    try:
        return os.path.samestat(os.fstat(file), os.stat(path))
    except OSError:
        return False


def _sync_folder(folder: Path) -> None:
    """Make the new name durable on disk, if folders can be opened for that."""
    try:
        file = os.open(folder, os.O_RDONLY | getattr(os, "O_DIRECTORY", 0))
    except OSError:
        return
    try:
        os.fsync(file)
    except OSError:
        pass
    finally:
        os.close(file)
