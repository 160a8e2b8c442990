"""File of a campaign: the figures of its runs as arrays, and their meaning as JSON; no pickle."""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from residua.errors import FileFormatError
from residua.files import check_output, other_version, read_bytes, replacing
from residua.validate.runs import RunFigures

#: Of the layout; files of another one are refused.
VERSION = 1
_HEAD = "head"
_ARRAYS = tuple(one.name for one in fields(RunFigures))


def write_runs(path: str | Path, head: Mapping[str, Any], figures: RunFigures) -> Path:
    """Write a campaign; the file appears whole or not at all."""
    path = Path(path)
    check_output(path)
    content = {name: getattr(figures, name) for name in _ARRAYS}
    text = json.dumps({"version": VERSION, **head}, allow_nan=False)
    with replacing(path) as partial, open(partial, "wb") as file:
        np.savez(file, **content, **{_HEAD: np.array(text)})  # pyright: ignore[reportArgumentType]
    return path


def read_runs(path: str | Path) -> tuple[dict[str, Any], RunFigures]:
    """Return head and figures of a campaign's file.

    Raises
    ------
    FileFormatError
        If it is none, or damaged.
    """
    content = read_bytes(path, "campaign file")
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as file:
            head = json.loads(str(file[_HEAD]))
            arrays = {name: file[name] for name in _ARRAYS}
    except (ValueError, KeyError, OSError, EOFError, zipfile.BadZipFile) as error:
        raise FileFormatError(f"{path} is not the file of a campaign: {error}") from error
    version = head.get("version") if isinstance(head, dict) else None
    if version != VERSION:
        raise FileFormatError(other_version(str(path), version, VERSION, "run the campaign again"))
    like = RunFigures.empty(len(arrays["onset"]), len(arrays["decided"]))
    for name, values in arrays.items():
        wanted = getattr(like, name)
        if values.shape != wanted.shape or values.dtype != wanted.dtype:
            got = f"{values.dtype} of shape {values.shape}"
            raise FileFormatError(f"{path}: {name} must be {wanted.dtype} of shape {wanted.shape}, got {got}")
    return head, RunFigures(**arrays)


def digest(*values: Any) -> str:
    """Return a digest that depends on all settings, matrices and signals."""
    sha = hashlib.sha256()
    for value in values:
        _feed(sha, value)
    return sha.hexdigest()


def _feed(sha: Any, value: Any) -> None:
    """Feed a value: arrays by their bytes, dataclasses and containers by their parts, anything else by its text."""
    if isinstance(value, np.ndarray):
        sha.update(f"{value.dtype}{value.shape}".encode())
        sha.update(np.ascontiguousarray(value).tobytes() if value.dtype != object else repr(value.tolist()).encode())
    elif is_dataclass(value) and not isinstance(value, type):
        sha.update(type(value).__qualname__.encode())
        for one in fields(value):
            sha.update(one.name.encode())
            _feed(sha, getattr(value, one.name))
    elif isinstance(value, Mapping):
        _feed(sha, list(value.items()))
    elif isinstance(value, (list, tuple)):
        sha.update(f"{len(value)}[".encode())
        for one in value:
            _feed(sha, one)
    elif isinstance(value, (str, int, float, complex, bool, bytes, np.generic)) or value is None:
        sha.update(repr(value).encode())
    else:
        sha.update(getattr(value, "__qualname__", type(value).__qualname__).encode())


__all__ = ["VERSION", "digest", "read_runs", "write_runs"]
