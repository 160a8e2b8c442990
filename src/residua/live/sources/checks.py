"""Checks of what a configuration says of a source: each names its key, what it must be, and what it was."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from residua.errors import SettingError
from residua.visible import echo


def text(settings: Any, key: str, *, needed: str = "") -> None:
    """Check that a value is text; ``needed`` says what it is for where it must not be empty."""
    value = getattr(settings, key)
    if not isinstance(value, str) or not value.isprintable():
        raise SettingError(f"{key}: text on one line is expected, got {echo(value)}")
    if needed and not value:
        raise SettingError(f"{key}: {needed}")


def whole(settings: Any, key: str, least: int, most: int) -> None:
    """Check that a value is a whole number between two others."""
    value = getattr(settings, key)
    if type(value) is not int or not least <= value <= most:
        raise SettingError(f"{key}: a whole number from {least:,} to {most:,} is expected, got {echo(value)}")


def number(settings: Any, key: str, least: float, most: float = math.inf) -> None:
    """Check that a value is a finite number between two others."""
    value = getattr(settings, key)
    if type(value) not in (int, float) or not (math.isfinite(value) and least <= value <= most):
        above = f"from {least:g} to {most:g}" if most < math.inf else f"of at least {least:g}"
        raise SettingError(f"{key}: a number {above} is expected, got {echo(value)}")


def flag(settings: Any, key: str) -> None:
    """Check that a value is true or false."""
    if type(getattr(settings, key)) is not bool:
        raise SettingError(f"{key}: true or false is expected, got {echo(getattr(settings, key))}")


def choice(settings: Any, key: str, among: Sequence[Any]) -> None:
    """Check that a value is one of some."""
    value = getattr(settings, key)
    if not any(type(value) is type(one) and value == one for one in among):
        raise SettingError(f"{key}: one of {', '.join(map(repr, among))} is expected, got {echo(value)}")


def texts(settings: Any, key: str, *, needed: str = "") -> None:
    """Check that a value is a list of texts without repeats, and keep it as a tuple."""
    value = getattr(settings, key)
    fits = isinstance(value, list | tuple) and all(isinstance(one, str) and one and one.isprintable() for one in value)
    if not fits or len(set(value)) != len(value):
        raise SettingError(f"{key}: a list of different texts is expected, got {echo(value)}")
    if needed and not value:
        raise SettingError(f"{key}: {needed}")
    object.__setattr__(settings, key, tuple(value))


def file(settings: Any, key: str) -> None:
    """Check that a value is empty, or the path of a file that is there."""
    text(settings, key)
    value = getattr(settings, key)
    if value and not Path(value).is_file():
        raise SettingError(f"{key}: {value} is no file")


def table_of_texts(value: Any, key: str) -> dict[str, str]:
    """Return a table whose keys and values are text that is not empty."""
    if not isinstance(value, Mapping) or not all(
        isinstance(one, str) and one and one.isprintable() for one in (*value.keys(), *value.values())
    ):
        raise SettingError(f"{key}: a table from text to text is expected, got {echo(value)}")
    return dict(value)


__all__ = ["choice", "file", "flag", "number", "table_of_texts", "text", "texts", "whole"]
