"""Plausible values of measurements: values far outside are marks for "no value", and count as missing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from residua.decide.checks import is_number
from residua.decide.test import ResidualTest
from residua.design import ResidualGenerator
from residua.errors import SettingError
from residua.visible import echo, listed

#: Sizes of a signal in a fault-free recording that its plausible values reach from the middle, unless set otherwise.
#: Far above the reading of a sensor that fails to the end of its scale: that is a fault, which must be seen.
TIMES = 1e6
#: Without limits from data: standard deviations, or thresholds, that the largest value may move the residual by.
_GUARD = 1e30
#: Largest ratio of two values that one instrument measures.
_SPAN = 1e12
#: No value is larger, whatever the units.
_LARGEST = 1e100

Plausible = float | Mapping[str, tuple[float, float]] | None


def checked_plausible(value: object, channels: Sequence[str]) -> Plausible:
    """Return the setting ``plausible`` of a monitor: a number of sizes, limits of some channels, or ``None``."""
    if value is None:
        return None
    if isinstance(value, Mapping):
        return {str(name): _limits(name, limits, channels) for name, limits in value.items()}
    if not is_number(value) or not 1 < value < np.inf:  # pyright: ignore[reportOperatorIssue]
        raise SettingError(
            "plausible must be a number over 1 (how many times its size in the fault-free recording a signal may be "
            f"away from its middle), limits by channel such as {{'level': (0, 10)}}, or None, got {echo(value)}"
        )
    return float(value)  # pyright: ignore[reportArgumentType]


def _limits(name: object, limits: object, channels: Sequence[str]) -> tuple[float, float]:
    """Return the limits of one channel."""
    if name not in channels:
        raise SettingError(f"plausible: the plant has no channel {echo(name)}; it has {listed(channels)}")
    try:
        low, high = (float(limit) for limit in limits)  # pyright: ignore[reportGeneralTypeIssues]
    except (TypeError, ValueError):
        low, high = np.nan, np.nan
    if not low < high:
        raise SettingError(
            f"plausible[{echo(name)}] must be (smallest, largest), the first below the other, got {echo(limits)}"
        )
    return low, high


def fitted_ranges(settings: Plausible, data: NDArray[np.float64], guard: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return smallest and largest plausible value of each channel by a fault-free recording, shape (channels, 2).

    The size of a signal is its range, or its largest value. Marks do not count: of the values beyond the quartiles, and
    of those beyond the first and the last per cent, those that are so far away that no instrument could measure both.
    Infinite where nothing is known.

    Parameters
    ----------
    settings : float, mapping or None
    data : ndarray, shape (time, channels)
        In plant units.
    guard : ndarray, shape (channels, 2)
        Limits that hold in any case.
    """
    out = np.tile([-np.inf, np.inf], (data.shape[1], 1))
    if settings is None:
        return out
    times = TIMES if isinstance(settings, Mapping) else settings
    for j, values in enumerate(data.T):
        seen = values[(values >= guard[j, 0]) & (values <= guard[j, 1])]
        if not len(seen):
            continue
        middle = size = 0.0
        for part in ((0.25, 0.75), (0.01, 0.99), (0.0, 1.0)):
            low, high = np.quantile(seen, part)
            wider = float(max(high - low, abs(low), abs(high)))
            if size > 0 and wider > _SPAN * size:
                break
            middle, size = float(low + high) / 2, wider
        if size > 0:
            out[j] = middle - times * size, middle + times * size
    return out


def guarded_ranges(generator: ResidualGenerator, test: ResidualTest) -> NDArray[np.float64]:
    """Return the limits of every channel that hold without data, in plant units: shape (channels, 2).

    Beyond them a value moves the residual by so many standard deviations, or thresholds, that nothing else could be
    seen of it for a long time, if it did not overflow at once.
    """
    point = generator.plant.operating_point
    middle = np.array([*point.inputs, *point.outputs])
    with np.errstate(divide="ignore", over="ignore"):
        size = np.minimum(_GUARD / _largest_response(generator, test), _LARGEST)
    return np.column_stack([middle - size, middle + size])


def plausible_deviations(
    settings: Plausible,
    channels: Sequence[str],
    fitted: NDArray[np.float64] | None,
    generator: ResidualGenerator,
    test: ResidualTest,
) -> NDArray[np.float64]:
    """Return the smallest and largest plausible deviation of every channel: shape (channels, 2).

    Limits that are set count as they are, fitted ones where they are known; no value is over the largest number that
    can be worked with.
    """
    point = generator.plant.operating_point
    offset = np.array([*point.inputs, *point.outputs])
    ranges = guarded_ranges(generator, test)
    if fitted is not None:
        ranges = np.where(np.isfinite(fitted), fitted, ranges)
    for name, limits in settings.items() if isinstance(settings, Mapping) else ():
        ranges[list(channels).index(name)] = limits
    return np.clip(ranges - offset[:, None], -_LARGEST, _LARGEST)


def _largest_response(generator: ResidualGenerator, test: ResidualTest) -> NDArray[np.float64]:
    """Return for each channel the largest response of the whitened residual to an impulse in it."""
    system = generator.system
    weights = test.guarded
    largest, x = np.abs(system.D).T @ weights, system.B
    for _ in range(2 * system.n_states + 1):
        largest = np.maximum(largest, np.abs(system.C @ x).T @ weights)
        x = system.A @ x
    return largest.max(axis=1, initial=0.0)
