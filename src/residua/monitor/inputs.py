"""Conversion of the arrays, data frames or recordings that users pass to a monitor."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.decide.test import ResidualTest
from residua.design import ResidualGenerator
from residua.design.core.evidence import format_pole
from residua.design.core.signals import checked_signals
from residua.errors import DataError
from residua.linear.systems.scaling import scaling
from residua.plant import Plant
from residua.recording.matching import matched_names, required_columns, spelling_notes
from residua.recording.recording import Recording, read_recording, recording_from_frame
from residua.recording.time_axis import regular_step, seconds_from_dates
from residua.tolerances import ROUNDING
from residua.visible import echo

#: Remainder of the slowest pole once a filter counts as settled: where thresholds come from data or a noise model,
#: and, for bounds that are known or certified, to the digits that these are computed to.
SETTLED, SETTLED_FOR_BOUNDS = 1e-2, 1e-6
#: Samples after which a filter counts as settled, however slow it is.
_MOST_SAMPLES = 1_000_000


@dataclass(frozen=True, eq=False)
class Signals:
    """Inputs and outputs of a recording, with its clock if one is known.

    Attributes
    ----------
    u, y : array_like
    time : ndarray or None
    dt : float or None
    source : str
    notes : tuple of str
        The changes to the rows at reading.
    origin : str
        The moment that ``time`` counts from, where the recording had dates.
    """

    u: Any
    y: Any
    time: NDArray[np.float64] | None
    dt: float | None
    source: str
    notes: tuple[str, ...] = ()
    origin: str = ""


def several_signals(u: Any, y: Any, time: ArrayLike | None, dt: float | None, plant: Plant) -> list[Signals]:
    """Return the recordings passed by a user: one as in :func:`signals`, or a list of such.

    In a list arrays come as pairs ``(u, y)``.
    """
    if y is not None or not isinstance(u, (list, tuple)):
        return [signals(u, y, time, dt, "", plant)]
    if time is not None:
        raise DataError("time is for one recording: give several as data frames or recordings, which bring their times")
    if not len(u):
        raise DataError("the list of recordings is empty")
    recordings = []
    for number, one in enumerate(u, 1):
        if isinstance(one, np.ndarray):
            raise DataError(
                f"recording {number} of {len(u)} is an array: give pairs, [(u, y), (u, y)], or one, fit(u, y)"
            )
        pair = one if isinstance(one, tuple) and len(one) == 2 else (one, None)
        try:
            recordings.append(signals(*pair, None, dt, "", plant))
        except DataError as error:
            raise DataError(f"recording {number} of {len(u)}: {error}") from error
    return recordings


def signals(u: Any, y: Any, time: ArrayLike | None, dt: float | None, source: str, plant: Plant) -> Signals:
    """Return the data passed by a user as arrays, with the step that the times imply.

    Without ``y``, ``u`` is a :class:`residua.monitor.Recording`, the path of a file, or a data frame whose columns are
    matched by name.
    """
    if y is None and time is not None and not (isinstance(time, str) and not isinstance(u, Recording)):
        raise DataError("time= is for arrays, or names the time column of a path or data frame, time='Date'")
    column = time if isinstance(time, str) else None
    if y is None and isinstance(u, (str, Path)):
        u = read_recording(u, plant, dt=dt, time=column)
    if y is None:
        if not isinstance(u, Recording):
            if not _is_frame(u):
                raise DataError("give u and y as arrays, or one data frame, recording or path, with named columns")
            u = recording_from_frame(u, plant, dt=dt, time=column, source=source or "data frame")
        u = with_channels(u, plant)
        return Signals(u.u, u.y, u.time, u.dt, source or u.source, u.notes, u.origin)
    if dt is not None and not (np.isfinite(dt) and dt > 0):
        raise DataError(f"dt must be a positive step in seconds, got {echo(dt)}")
    u, y, notes = _by_names(u, y, plant)
    if time is None:
        return Signals(u, y, None, dt, source, notes)
    clock, origin = _seconds(time)
    samples = np.shape(y)[-2] if np.ndim(y) > 1 else np.size(y)
    if clock.shape != (samples,):
        raise DataError(f"time has shape {clock.shape}, y has {samples} samples")
    if len(clock) < 2:
        raise DataError("time must be one column of at least two finite numbers")
    step = regular_step(clock, 0.01, 0, source or "recording")
    if dt is not None and abs(dt - step) > 1e-6 * step:
        raise DataError(f"dt={dt:g} s was given, the times are {step:g} s apart")
    return Signals(u, y, clock, step, source, notes, origin)


def with_channels(one: Recording, plant: Plant) -> Recording:
    """Return a recording with the channels of a plant, matched by name."""
    channels, columns = (*plant.inputs, *plant.outputs), tuple(one.columns)
    if columns == channels and one.u.shape[1] == len(plant.inputs):
        return one
    found = required_columns(channels, columns, one.source or "the recording")
    rows = np.hstack([one.u, one.y])[:, [columns.index(found[name]) for name in channels]]
    m = len(plant.inputs)
    return replace(
        one,
        u=rows[:, :m],
        y=rows[:, m:],
        columns={name: one.columns[found[name]] for name in channels},
        n_missing=int((~np.isfinite(rows)).sum()),
        notes=(*one.notes, *spelling_notes(found, plant.units)),
    )


def plant_signals(
    u: ArrayLike | None, y: ArrayLike, plant: Plant
) -> tuple[NDArray[np.float64] | None, NDArray[np.float64]]:
    """Return inputs, or ``None`` without any, and outputs of (plants, time, channels), checked against the plant."""
    u_, y_ = checked_signals(plant, *with_all_channels(u, y, plant))
    return (u_, y_) if y_.ndim == 3 else (None if u_ is None else u_[None], y_[None])


def with_all_channels(u: Any, y: Any, plant: Plant) -> tuple[Any, Any]:
    """Return inputs and outputs as the plant has them; for a plant of recorded channels, inputs become outputs.

    Raises
    ------
    DataError
        If the columns of both are not together the channels.
    """
    if u is None or not _is_of_channels(plant):
        return u, y
    try:
        parts = [np.ma.filled(np.ma.asarray(one, dtype=float), np.nan) for one in (u, y)]
    except (TypeError, ValueError):
        return u, y  # refused with the reason where they are stacked
    most = max(2, *(one.ndim for one in parts))
    parts = [one[..., None] if one.ndim == most - 1 else one for one in parts]
    sizes = [one.shape[-1] for one in parts]
    if not sizes[0]:
        return u, y
    if sum(sizes) != plant.n_outputs or parts[0].shape[:-1] != parts[1].shape[:-1]:
        raise DataError(
            f"this monitor reads {len(plant.outputs)} recorded channels, {', '.join(plant.outputs)}: give them as the "
            "columns of y, with None for u, or as those of u and y together, in this order; got u of shape "
            f"{parts[0].shape} and y of shape {parts[1].shape}"
        )
    return None, np.concatenate(parts, axis=-1)


def _is_frame(data: Any) -> bool:
    """Tell whether data have columns with names."""
    return hasattr(data, "columns")


def _is_of_channels(plant: Plant) -> bool:
    """Tell whether a plant consists of recorded channels alone."""
    return not plant.inputs and not plant.n_states


def _by_names(u: Any, y: Any, plant: Plant) -> tuple[Any, Any, tuple[str, ...]]:
    """Return the columns of data frames in the order of the plant, with a note on those of another name.

    Arrays are taken as they are.
    """
    if not (_is_of_channels(plant) and _is_frame(u) and _is_frame(y)):
        u, of_u = _by_name(u, plant.inputs, "u", plant)
        y, of_y = _by_name(y, plant.outputs, "y", plant)
        return u, y, of_u + of_y
    ours = tuple(matched_names(plant.outputs, [str(name) for name in u.columns]))
    rest = tuple(name for name in plant.outputs if name not in ours)
    first, of_u = _by_name(u, ours, "u", plant)
    second, of_y = _by_name(y, rest, "y", plant)
    place = [(*ours, *rest).index(name) for name in plant.outputs]
    return None, np.hstack([first, second])[:, place], of_u + of_y


def _by_name(data: Any, channels: tuple[str, ...], source: str, plant: Plant) -> tuple[Any, tuple[str, ...]]:
    if not _is_frame(data):
        return data, ()
    columns = {str(name): name for name in data.columns}
    found = required_columns(channels, list(columns), source)
    parts = [np.asarray(data[columns[found[name]]], dtype=float) for name in channels]
    rows = np.column_stack(parts) if parts else np.zeros((len(data), 0))
    return rows, spelling_notes(found, plant.units)


def _seconds(time: ArrayLike) -> tuple[NDArray[np.float64], str]:
    """Return times in seconds, and their origin; dates are counted from the first."""
    clock = np.asarray(time)
    if clock.dtype.kind == "M":
        return seconds_from_dates(clock)
    if clock.dtype.kind == "m":
        return clock / np.timedelta64(1, "s"), ""
    try:
        return np.asarray(clock, dtype=float), ""
    except (TypeError, ValueError) as error:
        raise DataError(f"time must be seconds, or dates: {error}") from error


def settling_samples(generator: ResidualGenerator, test: ResidualTest | None = None) -> int:
    """Return the number of samples in which the slowest pole of a sampled generator decays to 1 %.

    To a millionth for a test by bounds: 1 % of the effect of a start on the residual is in no certified threshold. And
    until the residual itself has forgotten the start as far: poles that are near to each other, or zero, take longer.
    """
    if test is None or not test.is_bound:
        return _samples_until(generator, SETTLED)
    return _samples_for_bounds(generator)


def settling_reason(generator: ResidualGenerator, settle: int) -> str:
    """Describe the settling time of a filter, and the pole that causes it."""
    settling = f"settling takes {settle} samples ({settle * generator.dt:g} s)"
    by_itself = [_samples_until(generator, SETTLED), _samples_for_bounds(generator)]
    if settle not in by_itself or not generator.system.n_states:
        return f"{settling}, as asked for by settle"
    poles = generator.system.poles()
    slowest = poles[np.abs(poles).argmax()]
    return f"{settling} because of its slowest pole, sampled at {format_pole(slowest)}: a faster one settles sooner"


def _samples_for_bounds(generator: ResidualGenerator) -> int:
    return max(_samples_until(generator, SETTLED_FOR_BOUNDS), _forgotten(generator, SETTLED_FOR_BOUNDS))


def _forgotten(generator: ResidualGenerator, left: float) -> int:
    """Return the number of samples after which an initial state leaves at most a fraction of its largest effect."""
    s = generator.system.explicit()
    if not s.n_states or not np.any(s.C):
        return 0
    units = scaling(s.A, s.B, s.C, s.D, sampled=True).states
    rows, step, largest = s.C * units, s.A / units[:, None] * units, 0.0
    for k in range(_MOST_SAMPLES):
        size = float(np.linalg.norm(rows))
        largest = max(largest, size)
        if k >= s.n_states and size <= left * largest:
            return k
        rows = rows @ step
    return _MOST_SAMPLES


def _samples_until(generator: ResidualGenerator, left: float) -> int:
    slowest = float(np.abs(generator.system.poles()).max(initial=0.0))
    if slowest < 1e-6:  # a moving average: samples before the start leave it with the last one that it reads
        return _last_read(generator)
    return int(np.ceil(np.log(left) / np.log(min(slowest, 1 - 1e-9))))


def _last_read(generator: ResidualGenerator) -> int:
    """Return the number of samples after which an initial state leaves the residual of a moving average."""
    s = generator.system.explicit()
    units = scaling(s.A, s.B, s.C, s.D, sampled=True).states
    rows, step = s.C * units, s.A / units[:, None] * units
    largest = float(np.abs(rows).max(initial=0.0))
    for k in range(s.n_states):
        if not np.abs(rows).max(initial=0.0) > ROUNDING * largest:
            return k
        rows = rows @ step
    return s.n_states


def signal_levels(generator: ResidualGenerator, v: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return for each residual the size of the signals that cancel in it, from deviations of (time, channels)."""
    finite = np.where(np.isfinite(v), v, 0.0)
    rms = np.sqrt(np.mean(finite**2, axis=0))
    gain = np.abs(generator.system.dc_gain()) + np.abs(generator.system.D)
    return np.asarray(gain @ rms)
