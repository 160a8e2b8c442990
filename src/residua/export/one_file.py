"""Location of an export that is one file."""

from __future__ import annotations

import os
from pathlib import Path

from residua.errors import DataError
from residua.export.identifiers import identifier


def named_after(path: str | os.PathLike[str], ending: str) -> str | None:
    """Return a name from a requested file; ``None`` if a folder is requested."""
    asked = Path(path)
    return identifier(asked.stem) if asked.suffix.lower() == ending else None


def file_for(path: str | os.PathLike[str], name: str, *, overwrite: bool) -> Path:
    """Return the file to write: the path itself if it has the ending of the name, else the name in that folder.

    Parameters
    ----------
    path : path
    name : str
        With its ending.
    overwrite : bool

    Raises
    ------
    DataError
        If the file is there, or its folder cannot be made.
    """
    asked, ending = Path(path), Path(name).suffix
    target = asked if asked.suffix.lower() == ending else asked / name
    folder = target.parent
    if target is not asked and asked.exists() and not asked.is_dir():
        raise DataError(f"{asked} is a file that does not end in {ending}: name a folder, or a file that does")
    if target.is_dir():
        raise DataError(f"{target} is a folder: name a file")
    if target.exists() and not overwrite:
        raise DataError(f"{target} is there already: name another file, or ask to overwrite (overwrite=True)")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DataError(f"{folder}: {error.strerror or error}; name a folder that can be made") from error
    return target


__all__ = ["file_for", "named_after"]
