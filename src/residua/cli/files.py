"""Files that appear whole or not at all."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from residua.errors import DataError


def check_input(path: Path, what: str) -> None:
    """Raise unless ``path`` is a file that can be read.

    Parameters
    ----------
    path : Path
    what : str
        What it is to be, for the message.
    """
    if not path.exists():
        raise DataError(f"{path}: no such file; it was to be {what}")
    if path.is_dir():
        raise DataError(f"{path} is a folder; it was to be {what}")
    if not os.access(path, os.R_OK):
        raise DataError(f"{path}: no permission to read it")


def check_outputs(outputs: Iterable[Path | None], inputs: Iterable[Path] = ()) -> None:
    """Raise unless every output can be written, before any work is done.

    Parameters
    ----------
    outputs : iterable of Path or None
        ``None`` stands for an output that was not asked for.
    inputs : iterable of Path
        Files that must not be overwritten.
    """
    taken = {_real(path): "is read by this command" for path in inputs}
    for path in outputs:
        if path is None:
            continue
        folder = path.parent
        if not folder.is_dir():
            raise DataError(f"{path}: the folder {folder} does not exist; make it first")
        if path.is_dir():
            raise DataError(f"{path} is a folder; name a file")
        if not os.access(path if _special(path) else folder, os.W_OK):
            raise DataError(f"{path}: no permission to write there")
        if _special(path):
            continue
        if _real(path) in taken:
            raise DataError(f"{path} {taken[_real(path)]}; give the output another name")
        taken[_real(path)] = "is given for two outputs"


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path in the same folder that takes the place of ``path`` when all went well.

    Links are followed; a device or pipe, which must not be replaced, is written to directly. The ending of
    the name is kept, since writers choose the format by it.
    """
    if _special(path):
        yield path
        return
    target = _real(path)
    temporary = target.with_name(f".{target.stem}.{os.getpid()}.partial{target.suffix}")
    try:
        yield temporary
        if target.exists():
            shutil.copymode(target, temporary)
        os.replace(temporary, target)
    finally:
        temporary.unlink(missing_ok=True)


def _real(path: Path) -> Path:
    return Path(os.path.realpath(path))


def _special(path: Path) -> bool:
    return path.exists() and not path.is_file() and not path.is_dir()
