"""Settings are what their fields say: text, numbers, true or false."""

from __future__ import annotations

import math
from dataclasses import fields
from typing import Any

from residua.errors import SettingError
from residua.visible import echo


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
    """Raise where a value is not of the kind that its field is declared to be; lists are kept as tuples.

    Parameters
    ----------
    settings : dataclass
        With fields of text, truth values, numbers and tuples of texts.

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
    residua.errors.SettingError: timeout: a number is expected, not '10'
    """
    for one in fields(settings):
        value = getattr(settings, one.name)
        fits, meant = _KINDS[getattr(one.type, "__name__", str(one.type))]
        if not fits(value):
            raise SettingError(f"{one.name}: {meant} is expected, not {echo(value)}")
        if isinstance(value, list):
            object.__setattr__(settings, one.name, tuple(value))


def check_seconds(settings: Any, name: str) -> None:
    """Raise where a time is not more than nothing.

    Raises
    ------
    SettingError
    """
    if getattr(settings, name) <= 0:
        raise SettingError(f"{name}: more than 0 seconds are expected, not {getattr(settings, name)}")
