"""External signals of a simulated plant: control inputs and disturbances, the same in every run or drawn."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.decide.checks import is_number
from residua.errors import DataError, SettingError
from residua.recording.recording import Recording
from residua.validate.noise import NoiseModel
from residua.validate.truth import Truth
from residua.visible import echo, listed

#: Samples for which the default excitation holds a level on the average.
HOLD = 25
#: How many times the noise of an output the default excitation of an input moves it.
_TIMES = 10.0


def control_inputs(
    given: Any, truth: Truth, names: tuple[str, ...], samples: int, seeds: np.random.SeedSequence
) -> tuple[NDArray[np.float64], str]:
    """Return the signals added to the command in every run, as deviations of (samples, inputs), and their description.

    Parameters
    ----------
    given : array_like, Recording, data frame, number, or None
        In plant units; ``None``: a persistent excitation, or nothing where a controller moves the inputs.
    truth : Truth
    names : tuple of str
        Of the inputs.
    samples : int
    seeds : numpy.random.SeedSequence

    Raises
    ------
    DataError
        If there are too few samples or channels, or a value is not finite.
    """
    count = len(names)
    if not count:
        return np.zeros((samples, 0)), "none"
    if given is None:
        if truth.looped:
            return np.zeros((samples, count)), "by the controller alone"
        return _excitation(truth, samples, seeds), f"default excitation: random levels, held for about {HOLD} samples"
    offset, words = truth.offset[:count], "as given"
    if isinstance(given, Recording):
        given, words = given.u, f"of {given.source}"
    elif getattr(given, "columns", None) is not None:
        missing = [name for name in names if name not in list(given.columns)]
        if missing:
            raise DataError(f"inputs have no column {echo(missing[0])}; there are {listed(list(given.columns))}")
        given = np.column_stack([np.asarray(given[name], dtype=float) for name in names])
    if is_number(given):
        return np.broadcast_to(float(given) - offset, (samples, count)).copy(), f"constant {given:g}"
    try:
        values = np.asarray(given, dtype=float)
    except (TypeError, ValueError) as error:
        raise DataError(f"inputs must be an array of numbers: {error}") from error
    values = values[:, None] if values.ndim == 1 and count == 1 else values
    if values.ndim != 2 or values.shape[1] != count or len(values) < samples:
        raise DataError(
            f"inputs must be ({samples} samples or more, {count}) with the columns {listed(names)}, got shape "
            f"{values.shape}: give more, or run fewer samples"
        )
    if not np.isfinite(values[:samples]).all():
        raise DataError("inputs must be finite numbers: fill in missing values")
    return values[:samples] - offset, words


def _excitation(truth: Truth, samples: int, seeds: np.random.SeedSequence) -> NDArray[np.float64]:
    """Return random levels held for random times, large enough to move the outputs clear of the noise."""
    rng = np.random.default_rng(seeds)
    m, noises = truth.inputs, truth.noises
    change = rng.random((samples, m)) < 1 / HOLD
    change[0] = True
    levels = rng.uniform(-1.0, 1.0, (samples, m))
    last = np.maximum.accumulate(np.where(change, np.arange(samples)[:, None], 0), axis=0)
    v = np.take_along_axis(levels, last, axis=0)
    z = np.zeros((m + 1, samples, truth.B.shape[1]))
    for i in range(m):
        z[i, :, i] = v[:, i]
    z[m, :, truth.B.shape[1] - noises :] = rng.standard_normal((samples, noises))
    moved = truth.respond(z)[:, :, m:].std(axis=1)
    alone, noise = moved[:m], moved[m]
    size = np.ones(m)
    for i in range(m):
        seen = (alone[i] > 0) & (noise > 0)
        if seen.any():
            size[i] = _TIMES * float(np.min(noise[seen] / alone[i][seen]))
    return v * size


def disturbance_signals(
    given: Mapping[str, Any] | None, names: tuple[str, ...], samples: int
) -> tuple[NDArray[np.float64], tuple[tuple[int, NoiseModel], ...], str]:
    """Return disturbances that are the same in every run, the drawn ones by number, and a description of both.

    Parameters
    ----------
    given : mapping of str to number, array_like or NoiseModel, or None
        By the name of a disturbance; one that is not named stays zero.
    names : tuple of str
    samples : int

    Raises
    ------
    SettingError
        If a disturbance is unknown, or they are not by name.
    DataError
        If a signal is too short, not finite or no number.
    """
    fixed, drawn, words = np.zeros((samples, len(names))), [], []
    if given is not None and not isinstance(given, Mapping):
        raise SettingError(f"disturbances must be signals by name, such as {{'gust': 1.0}}, got {echo(given)}")
    for name, value in (given or {}).items():
        if name not in names:
            raise SettingError(f"the plant has no disturbance {echo(name)}; known: {listed(names)}")
        column = names.index(name)
        if isinstance(value, NoiseModel):
            drawn.append((column, value))
            words.append(f"{name}: {value}, standard deviation {value.size:g}")
            continue
        try:
            signal = np.asarray(value, dtype=float)
        except (TypeError, ValueError) as error:
            raise DataError(f"disturbance {echo(name)} must be a number, an array or a noise model: {error}") from error
        if signal.ndim > 1 or (signal.ndim == 1 and len(signal) < samples):
            raise DataError(f"disturbance {echo(name)}: expected {samples} samples or more, got shape {signal.shape}")
        signal = signal[:samples] if signal.ndim else signal
        if not np.isfinite(signal).all():
            raise DataError(f"disturbance {echo(name)} must be finite")
        fixed[:, column] = signal
        words.append(f"{name}: {'as given' if signal.ndim else f'constant {float(signal):g}'}")
    return fixed, tuple(drawn), "; ".join(words) or "none"
