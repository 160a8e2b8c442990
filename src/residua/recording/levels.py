"""Levels and spreads of the channels of recordings, to find channels that may be in other units."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.words import listing, number

#: Two recordings whose spread in a channel differs by more than this factor may have it in different units.
_OTHER_SPREAD = 30.0
#: Likewise two that lie apart by more than so many of the larger spread, and by this part of the larger level.
_FAR, _OTHER_LEVEL = 10.0, 0.3
#: Degrees Celsius and Fahrenheit: spreads within this factor, levels within one spread, and so many spreads apart.
_LIKE, _APART = 1.25, 3.0
#: Beside a channel in Fahrenheit, others whose spreads are so much less alike count too.
_LIKE_BESIDE = 3.0
#: Level and spread that are both this factor larger or smaller, within the other, are those of a multiple.
_MULTIPLE, _SAME_FACTOR = 5.0, 1.5
#: Channels that all move a power of ten more or less than they did, how near to it in the middle, and how much alike.
_SEVERAL, _NEAR_POWER, _ALIKE_POWERS = 2, 0.1, 0.15
#: Rows of a recording that its range is taken from.
_MOST_ROWS = 100_000

Values = NDArray[np.float64]


def level_and_spread(values: Values) -> tuple[Values, Values]:
    """Return mean and standard deviation of each channel without its missing values; NaN if none remains.

    Parameters
    ----------
    values : ndarray, shape (time, channels)
        NaN or infinity where a value is missing.
    """
    there = np.isfinite(values)
    count = np.count_nonzero(there, axis=0)
    first = np.take_along_axis(values, there.argmax(axis=0)[None], axis=0) if len(values) else values.sum(axis=0)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        off = np.where(there, values - first, 0.0)  # exactly zero in a channel that stands still, whatever its value
        shift = off.sum(axis=0) / count
        spread = np.sqrt((np.where(there, off - shift, 0.0) ** 2).sum(axis=0) / count)
        return first.reshape(-1) + shift, spread


def units_between(channels: Sequence[str], sources: Sequence[str], mean: Values, spread: Values) -> list[str]:
    """Return the channels that may be in other units in some recordings, with their numbers.

    The odd ones are named, against the recording that most others are like; where there are two recordings, or two
    halves, nothing tells which are right.

    Parameters
    ----------
    channels, sources : sequence of str
        Names of the channels and the recordings.
    mean, spread : ndarray, shape (recordings, channels)
        NaN where nothing is known. A channel that stands still in a recording is not compared there.
    """
    known = np.isfinite(mean) & np.isfinite(spread) & (spread > 0)
    unlike = np.stack([known & known[k] & _differ(mean, spread, mean[k], spread[k]) for k in range(len(mean))])
    notes = []
    for i in np.flatnonzero(unlike.any(axis=(0, 1))).tolist():
        moving = np.flatnonzero(known[:, i])
        usual = moving[unlike[moving, :, i].sum(axis=1).argmin()]
        odd = np.flatnonzero(unlike[usual, :, i])
        rest = moving[~unlike[usual, moving, i]]

        def named(which: NDArray, i: int = i) -> str:
            shown = [f"{sources[k]} ({_figures(mean[k, i], spread[k, i])})" for k in which[:3].tolist()]
            return listing([*shown, f"{len(which) - 3} more"] if len(which) > 3 else shown)

        if 2 * len(odd) < len(moving):
            notes.append(
                f"{channels[i]!r} may be in other units in {named(odd)} than in the others, such as "
                f"{named(np.array([usual]))}, or the plant is at another operating point there"
            )
        else:
            notes.append(
                f"{channels[i]!r} may be in different units in {named(rest)} and in {named(odd)}, or the plant is at "
                "different operating points: the data do not show which of them is right"
            )
    return notes


def rows_apart(count: int) -> int:
    """Return the distance between the sampled rows of a recording."""
    return -(-count // _MOST_ROWS) or 1


def units_of(channels: Sequence[str], values: Values, mean: Values, spread: Values, reference: str) -> list[str]:
    """Return the channels of one recording that never come near their earlier levels, as with other units.

    Parameters
    ----------
    channels : sequence of str
    values : ndarray, shape (time, channels)
        NaN or infinity where a value is missing.
    mean, spread : ndarray, shape (channels,)
        Earlier values.
    reference : str
        Where that is from, in words.
    """
    shown = values[:: rows_apart(len(values))]
    remarks: dict[int, str] = {}
    factors: list[float] = []
    fahrenheit, perhaps = False, {}
    for i, channel in enumerate(channels):
        column = shown[np.isfinite(shown[:, i]), i]
        if len(column) < 2 or not spread[i] > 0:
            continue
        low, high = np.quantile(column, (0.01, 0.99))
        level, width = (float(one[0]) for one in level_and_spread(column[:, None]))
        if width > 0:
            factors.append(width / float(spread[i]))
        nearest = float(np.clip(mean[i], low, high))
        was = mean[i], spread[i]
        note = (
            f"{channel!r} is unlike {reference}: {_figures(level, width)}, against {_figures(*was)} "
            "there; is it in other units, at another operating point, or at fault from the beginning?"
        )
        warm = bool(_fahrenheit(level, width, *was))
        fahrenheit |= warm
        multiple = _multiple(level, width, *was) and _outside(nearest, width, *was)
        if width > 0 and (width > _OTHER_SPREAD * spread[i] or _far(nearest, 0.0, *was) or warm or multiple):
            remarks[i] = note
        elif width > 0 and _fahrenheit(level, width, *was, _LIKE_BESIDE) and _outside(nearest, width, *was):
            perhaps[i] = note
    remarks |= perhaps if fahrenheit else {}
    return [remarks[i] for i in sorted(remarks)] or _times_ten(factors, reference)


def _times_ten(factors: Sequence[float], reference: str) -> list[str]:
    """Report that all channels move ten times as much as before, a hundred times, or a tenth, as in other units."""
    if len(factors) < _SEVERAL:
        return []
    powers = np.log10(factors)
    middle = float(np.median(powers))
    power = round(middle)
    if not power or abs(middle - power) > _NEAR_POWER or np.abs(powers - middle).max() > _ALIKE_POWERS:
        return []
    return [
        f"all {len(factors)} channels move {10.0**power:g} times as much as in {reference}: are they in other units, "
        "or times a gain?"
    ]


def units_at_point(channels: Sequence[str], mean: Values, spread: Values, point: Values) -> list[str]:
    """Return the channels that lie far from the operating point of the model.

    Parameters
    ----------
    channels : sequence of str
    mean, spread, point : ndarray, shape (channels,)
        A channel whose operating point is zero is not compared: many models have none.
    """
    far = (point != 0) & (spread > 0) & _far(mean, spread, point, spread)
    return [
        f"{channels[i]!r} lies far from the operating point of the model, {number(point[i])}: "
        f"{_figures(mean[i], spread[i])}; is it in the units of the model, and is the model of this operating point?"
        for i in np.flatnonzero(far).tolist()
    ]


def _figures(level: float, spread: float) -> str:
    return f"level {number(level)}, spread {number(spread)}"


def _far(mean: Any, spread: Any, other_mean: Any, other_spread: Any) -> Any:
    """Tell whether levels lie many spreads apart."""
    apart = np.abs(mean - other_mean)
    levels = np.maximum(np.abs(mean), np.abs(other_mean))
    return (apart > _FAR * np.maximum(spread, other_spread)) & (apart > _OTHER_LEVEL * levels)


def _differ(mean: Any, spread: Any, other_mean: Any, other_spread: Any) -> Any:
    """Tell whether recordings differ so much in level or spread that their units may."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        ratio = spread / other_spread
        wide = (ratio > _OTHER_SPREAD) | (ratio < 1 / _OTHER_SPREAD)
    one, other = (mean, spread), (other_mean, other_spread)
    return wide | _far(*one, *other) | _fahrenheit(*one, *other) | _fahrenheit(*other, *one) | _multiple(*one, *other)


def _outside(mean: Any, spread: Any, other_mean: Any, other_spread: Any) -> Any:
    """Tell whether levels lie some spreads apart."""
    return np.abs(mean - other_mean) > _APART * np.maximum(spread, other_spread)


def _multiple(mean: Any, spread: Any, other_mean: Any, other_spread: Any) -> Any:
    """Tell whether the first may be the second times a number: level and spread, by the same factor."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        factor, levels = spread / other_spread, mean / other_mean
        same = (factor < _SAME_FACTOR * levels) & (levels < _SAME_FACTOR * factor)
        large = (factor > _MULTIPLE) | (factor < 1 / _MULTIPLE)
    return same & large & _outside(mean, spread, other_mean, other_spread)


def _fahrenheit(mean: Any, spread: Any, other_mean: Any, other_spread: Any, like: float = _LIKE) -> Any:
    """Tell whether the first may be degrees Fahrenheit and the second Celsius."""
    alike = (spread < like * 1.8 * other_spread) & (like * spread > 1.8 * other_spread)
    apart = _outside(mean, spread, other_mean, other_spread)
    return alike & apart & (np.abs(mean - (1.8 * other_mean + 32.0)) < spread)
