"""Checks of settings: numbers, samples, rates."""

from __future__ import annotations

from math import isfinite

import numpy as np

from residua.errors import SettingError
from residua.visible import echo

#: Fraction of fault-free samples in alarm, unless another is asked for.
FALSE_ALARM_RATE = 1e-4
#: Probability with which a fault arrives in a sample, unless another is set: one in ten thousand.
PRIOR_RATE = 1 / 10_000


def is_number(value: object) -> bool:
    """Tell whether a setting is one finite number."""
    return isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool) and isfinite(value)


def check_samples(value: object, name: str, *, least: int = 1) -> None:
    """Raise unless a setting is a whole number of samples."""
    if not is_number(value) or int(value) != value or value < least:  # pyright: ignore
        raise SettingError(f"{name} must be a whole number of samples, at least {least}, got {echo(value)}")


def check_whole(value: object, name: str, *, least: int = 1) -> None:
    """Raise unless a setting is a whole number."""
    if not is_number(value) or int(value) != value or value < least:  # pyright: ignore
        raise SettingError(f"{name} must be a whole number, at least {least}, got {echo(value)}")


def check_rate(rate: float) -> None:
    """Raise unless ``rate`` is a usable false alarm rate."""
    if not is_number(rate) or not 0 < rate < 1:
        raise SettingError(f"false_alarm_rate must lie between 0 and 1, got {echo(rate)}")
