"""Reading and writing files: outputs appear whole or not at all, and errors have one wording."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from residua.errors import FileFormatError
from residua.visible import echo

#: Names of partial files, which end as the final one: writers choose the format by that.
_PREFIX, _MIDDLE = ".residua-", ".partial"
#: Seconds without a change after which a partial file is one that a killed run has left.
_LEFT = 3600.0
#: Folders that this process has looked through: once is enough.
_swept: set[str] = set()


def check_input(path: str | Path, what: str) -> None:
    """Raise unless ``path`` is a file that can be read.

    Parameters
    ----------
    path : str or Path
    what : str
        The kind of file, such as ``"plant file"``, for the message.

    Raises
    ------
    FileFormatError
    """
    path = Path(path)
    if path.is_dir():
        raise FileFormatError(f"{path} is a folder; name a {what}")
    if not path.exists():
        raise FileFormatError(f"{path}: {what} not found")
    if not os.access(path, os.R_OK):
        raise FileFormatError(f"{path}: no permission to read this {what}")


def check_output(path: str | Path) -> None:
    """Raise unless a file can be written there.

    Parameters
    ----------
    path : str or Path

    Raises
    ------
    FileFormatError
    """
    path = Path(path)
    folder = real(path).parent
    if not folder.is_dir():
        raise FileFormatError(f"{path}: the folder {folder} does not exist; make it first")
    if path.is_dir():
        raise FileFormatError(f"{path} is a folder; name a file")
    if not os.access(path if special(path) else folder, os.W_OK):
        raise FileFormatError(f"{path}: no permission to write there")


def read_bytes(path: str | Path, what: str) -> bytes:
    """Return the content of a file; see :func:`check_input`.

    Parameters
    ----------
    path : str or Path
    what : str

    Returns
    -------
    bytes
    """
    check_input(path, what)
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise FileFormatError(f"{path}: cannot read this {what}: {error.strerror or error}") from error


def other_version(what: str, found: object, known: int, remedy: str) -> str:
    """Return the message about content of another version: the remedy for an older one, an upgrade for a newer one.

    Examples
    --------
    >>> from residua.files import other_version
    >>> other_version("tank.json", 12, 11, "design it again")
    'tank.json has version 12, this residua reads version 11: upgrade residua'
    """
    is_newer = isinstance(found, int) and found > known
    advice = "upgrade residua" if is_newer else remedy
    return f"{what} has version {echo(found)}, this residua reads version {known}: {advice}"


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path in the same folder that replaces ``path`` on success.

    Links are followed; a device or pipe, which must not be replaced, is written to directly. A new file gets the
    permissions that any new file gets, an old one keeps its own. What was written is on the disk before it is renamed:
    after a power cut there is the old file or the new one. Partial files that killed runs have left in the folder are
    removed.

    Parameters
    ----------
    path : str or Path

    Raises
    ------
    FileFormatError
        If the folder does not exist, the path is a folder, or writing there is not allowed or fails.
    """
    path = Path(path)
    check_output(path)
    if special(path):
        with naming(path):
            yield path
        return
    target = real(path)
    with naming(path):
        _remove_remains(target.parent)
        partial = target.with_name(f"{_PREFIX}{os.urandom(6).hex()}{_MIDDLE}{target.suffix}")
        partial.touch(exist_ok=False)
        try:
            yield partial
            if target.exists():
                shutil.copymode(target, partial)
            _on_disk(partial, os.O_RDWR | getattr(os, "O_BINARY", 0))
            os.replace(partial, target)
            with suppress(OSError):  # not all systems let folders be opened for that
                _on_disk(target.parent, os.O_RDONLY)
        finally:
            partial.unlink(missing_ok=True)


def _remove_remains(folder: Path) -> None:
    """Remove the partial files of a folder that nobody is writing; once for each folder and process."""
    if str(folder) in _swept:
        return
    _swept.add(str(folder))
    with suppress(OSError):  # somebody else's folder or file: it is theirs to clean
        for path in folder.glob(f"{_PREFIX}*{_MIDDLE}*"):
            if time.time() - path.stat().st_mtime > _LEFT:
                path.unlink()


def _on_disk(path: Path, how: int) -> None:
    """Return once the content of a file, or the names in a folder, are on the disk."""
    file = os.open(path, how)
    try:
        os.fsync(file)
    finally:
        os.close(file)


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Let errors of writing, such as a full disk, name the user's file, not a partial one.

    Raises
    ------
    FileFormatError
    """
    try:
        yield
    except BrokenPipeError:  # whoever reads the pipe has gone
        raise
    except OSError as error:
        raise FileFormatError(f"{path}: it cannot be written: {error.strerror or error}") from error


def write_text(path: str | Path, text: str) -> Path:
    """Write a text file in UTF-8 with plain line ends; it appears whole or not at all.

    Parameters
    ----------
    path : str or Path
    text : str

    Returns
    -------
    Path
        Where it was written.
    """
    content = text.encode("utf-8")
    with replacing(path) as temporary:
        temporary.write_bytes(content)
    return Path(path)


def real(path: Path) -> Path:
    """Return the path with links followed."""
    return Path(os.path.realpath(path))


def special(path: Path) -> bool:
    """Tell whether the path is a device or pipe."""
    return path.exists() and not path.is_file() and not path.is_dir()
