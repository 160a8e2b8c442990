"""Checks of a configuration: each error names its key, the expected value and the actual one."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

from residua.errors import SettingError
from residua.visible import echo


def needed(settings: Any, key: str, meaning: str) -> None:
    """Check that a value is not empty; otherwise the message is its meaning."""
    if not getattr(settings, key):
        raise SettingError(f"{key}: {meaning}")


def whole(settings: Any, key: str, least: int, most: int) -> None:
    """Check that a value is a whole number within limits."""
    value = getattr(settings, key)
    if type(value) is not int or not least <= value <= most:
        raise SettingError(f"{key}: a whole number from {least:,} to {most:,} is expected, got {echo(value)}")


def number(settings: Any, key: str, least: float, most: float = math.inf) -> None:
    """Check that a value is a finite number within limits."""
    value = getattr(settings, key)
    if not _finite(value) or not least <= value <= most:
        above = f"from {least:g} to {most:g}" if most < math.inf else f"of at least {least:g}"
        raise SettingError(f"{key}: a number {above} is expected, got {echo(value)}")


def seconds(settings: Any, *keys: str) -> None:
    """Check that times are positive."""
    for key in keys:
        value = getattr(settings, key)
        if not _finite(value) or value <= 0:
            raise SettingError(f"{key}: more than 0 seconds are expected, got {echo(value)}")


def choice(settings: Any, key: str, among: Sequence[Any]) -> None:
    """Check that a value is one of several."""
    value = getattr(settings, key)
    if not any(type(value) is type(one) and value == one for one in among):
        raise SettingError(f"{key}: one of {', '.join(map(repr, among))} is expected, got {echo(value)}")


def texts(settings: Any, key: str, *, needed: str = "") -> None:
    """Check that a value is a list of texts without repeats, and store it as a tuple."""
    value = getattr(settings, key)
    fits = isinstance(value, list | tuple) and all(isinstance(one, str) and one and one.isprintable() for one in value)
    if not fits or len(set(value)) != len(value):
        raise SettingError(f"{key}: a list of different texts is expected, got {echo(value)}")
    if needed and not value:
        raise SettingError(f"{key}: {needed}")
    object.__setattr__(settings, key, tuple(value))


def file(settings: Any, key: str) -> None:
    """Check that a value is empty, or the path of an existing file."""
    value = getattr(settings, key)
    if value and not (_one_line(value) and Path(value).is_file()):
        raise SettingError(f"{key}: {value} is not a file")


def table_of_texts(value: Any, key: str) -> dict[str, str]:
    """Return a table whose keys and values are non-empty text."""
    if not isinstance(value, Mapping) or not all(one and _one_line(one) for pair in value.items() for one in pair):
        raise SettingError(f"{key}: a table from text to text is expected, got {echo(value)}")
    return dict(value)


def _one_line(value: object) -> bool:
    return isinstance(value, str) and value.isprintable()


def _finite(value: object) -> bool:
    return type(value) in (int, float) and math.isfinite(value)  # pyright: ignore[reportArgumentType]


_KINDS = {
    "str": (_one_line, "text on one line"),
    "bool": (lambda value: type(value) is bool, "true or false"),
    "int": (lambda value: type(value) is int, "a whole number"),
    "float": (_finite, "a number"),
    "tuple[str, ...]": (
        lambda value: isinstance(value, list | tuple) and all(map(_one_line, value)),
        "a list of texts, each on one line",
    ),
}


def check_types(settings: Any) -> None:
    """Raise if a value does not have the declared type of its field; lists are stored as tuples.

    Parameters
    ----------
    settings : dataclass
        With fields of text, truth values, numbers, tuples of texts, and tables, which are checked apart.

    Raises
    ------
    SettingError

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> @dataclass(frozen=True)
    ... class Settings:
    ...     timeout: float
    >>> check_types(Settings("10"))
    Traceback (most recent call last):
    ...
    residua.errors.SettingError: timeout: a number is expected, got '10'
    """
    for one in fields(settings):
        kind, value = getattr(one.type, "__name__", str(one.type)), getattr(settings, one.name)
        if kind.startswith("Mapping["):
            continue
        fits, meaning = _KINDS[kind]
        if not fits(value):
            raise SettingError(f"{one.name}: {meaning} is expected, got {echo(value)}")
        if isinstance(value, list):
            object.__setattr__(settings, one.name, tuple(value))


__all__ = ["check_types", "choice", "file", "needed", "number", "seconds", "table_of_texts", "texts", "whole"]
