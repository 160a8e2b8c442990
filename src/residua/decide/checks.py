"""Checks of settings: numbers, samples, rates."""

from __future__ import annotations

from math import isfinite

import numpy as np

from residua.errors import SettingError
from residua.visible import echo

#: Fractions of fault-free samples in alarm among which a test without a wish of its user aims, and the samples in alarm
#: that a fit may expect among its rows: with fewer its threshold would be a guess.
_LEAST_RATE, _MOST_RATE, _EXPECTED = 1e-4, 1e-2, 5
#: Probability with which a fault arrives in a sample, unless another is set: one in ten thousand.
PRIOR_RATE = 1 / 10_000


def is_number(value: object) -> bool:
    """Tell whether a setting is one finite number."""
    return isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool) and isfinite(value)


def check_whole(value: object, name: str, *, least: int = 1, of: str = "") -> None:
    """Raise unless a setting is a whole number, of samples or of other things."""
    if not is_number(value) or int(value) != value or value < least:  # pyright: ignore
        raise SettingError(f"{name} must be a whole number{of}, at least {least}, got {echo(value)}")


def check_samples(value: object, name: str, *, least: int = 1) -> None:
    """Raise unless a setting is a whole number of samples."""
    check_whole(value, name, least=least, of=" of samples")


def check_probability(value: object, name: str) -> None:
    """Raise unless a setting lies between 0 and 1."""
    if not (is_number(value) and 0 < value < 1):  # pyright: ignore
        raise SettingError(f"{name} must lie between 0 and 1, got {echo(value)}")


def rate_aimed_at(wish: float | None, rows: int = 0) -> float:
    """Return the target fraction of fault-free samples in alarm: the wish, else one that so many rows support.

    Parameters
    ----------
    wish : float or None
        As it was set.
    rows : int
        Usable fault-free rows that a fit uses: without a wish it aims at five of them, within 1e-4 and 1e-2. 0 without
        data, where the threshold is from the noise of the plant: 1e-4.

    Examples
    --------
    >>> [rate_aimed_at(None, rows) for rows in (500, 5_000, 50_000, 0)]
    [0.01, 0.001, 0.0001, 0.0001]
    """
    if wish is not None:
        return wish
    return min(max(_EXPECTED / rows, _LEAST_RATE), _MOST_RATE) if rows else _LEAST_RATE


def check_rate(rate: float | None) -> None:
    """Raise unless ``rate`` is a usable false alarm rate, or ``None`` for one that suits the log."""
    if rate is not None:
        check_probability(rate, "false_alarm_rate")
