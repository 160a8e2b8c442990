"""Reading and writing files: outputs appear whole or not at all, and errors have one wording."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from residua.errors import FileFormatError
from residua.partial_files import PartialFile
from residua.visible import echo


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

    Links are followed; a device or pipe, which must not be replaced, is written to directly. The ending of
    the name is kept, since writers choose the format by it. A new file gets the permissions that any new
    file gets, an old one keeps its own. What was written is on the disk before it is renamed, and partial files that
    killed runs have left in the folder are removed.

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
        partial = PartialFile(target)
        try:
            yield partial.path
            if target.exists():
                shutil.copymode(target, partial.path)
            partial.take_place_of(target)
        finally:
            partial.discard()


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
