"""Common parts of the simulated plants of the library."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.errors import ModelError, SettingError

#: The size of a fault over time: samples, one number, or a function of the times of the samples.
Course = ArrayLike | Callable[[NDArray[np.float64]], ArrayLike]


@dataclass(frozen=True, eq=False, repr=False)
class SimulatedRecording:
    """Recording of a simulated plant.

    Attributes
    ----------
    time : ndarray, shape (T,)
        Seconds.
    u : ndarray, shape (T, inputs)
        Commanded inputs, in plant units.
    y : ndarray, shape (T, outputs)
        Measurements, with noise and sensor faults.
    x : ndarray, shape (T, states)
        True states.
    dt : float
        Step in seconds.
    """

    time: NDArray[np.float64]
    u: NDArray[np.float64]
    y: NDArray[np.float64]
    x: NDArray[np.float64]
    dt: float

    def __repr__(self) -> str:
        shapes = ", ".join(f"{name} {getattr(self, name).shape}" for name in ("u", "y", "x"))
        return f"SimulatedRecording({len(self.time)} samples, {self.dt:g} s apart: {shapes})"


def runge_kutta(rate: Callable[[NDArray], NDArray], x: NDArray, dt: float) -> NDArray:
    """Return the state one step later, by the Runge-Kutta method of fourth order.

    Parameters
    ----------
    rate : callable
        The derivative of the state.
    x : ndarray, shape (n,)
    dt : float

    Returns
    -------
    ndarray, shape (n,)
    """
    k1 = rate(x)
    k2 = rate(x + dt / 2 * k1)
    k3 = rate(x + dt / 2 * k2)
    k4 = rate(x + dt * k3)
    return x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def drift(start: float, slope: float) -> Callable[[NDArray[np.float64]], NDArray[np.float64]]:
    """Return a fault that grows steadily from a certain time on, in the form of the simulations.

    Parameters
    ----------
    start : float
        Seconds.
    slope : float
        Per second, in the unit of the fault.

    Returns
    -------
    callable
        From times in seconds to sizes.

    Examples
    --------
    >>> from residua.library import drift
    >>> drift(1.0, 0.5)([0.0, 1.0, 2.0, 3.0])
    array([0. , 0. , 0.5, 1. ])
    """
    if not np.isfinite([start, slope]).all():
        raise SettingError(f"start and slope of a drift must be finite numbers, got {start!r} and {slope!r}")
    return lambda time: slope * np.maximum(np.asarray(time, dtype=float) - start, 0.0)


def fault_courses(
    faults: Mapping[str, Course] | None, known: tuple[str, ...], steps: int, *, dt: float
) -> dict[str, NDArray]:
    """Return the time course of every known fault, zero if none is given.

    Parameters
    ----------
    faults : mapping of str to array_like, shape (steps,), to one number, or to a function of time
    known : tuple of str
    steps : int
    dt : float
        Step in seconds; the first sample is at 0.

    Returns
    -------
    dict of str to ndarray, shape (steps,)
    """
    out = {name: np.zeros(steps) for name in known}
    for name, course in (faults or {}).items():
        if name not in known:
            raise ModelError(f"unknown fault {name!r}; known: {', '.join(known)}")
        sizes = course(dt * np.arange(steps, dtype=np.float64)) if callable(course) else course
        out[name] = filled(sizes, (steps,), f"fault {name!r}")
    return out


def filled(value: ArrayLike, shape: tuple[int, ...], what: str) -> NDArray[np.float64]:
    """Return finite numbers as an array of the given shape, repeated if there are fewer.

    Parameters
    ----------
    value : array_like
    shape : tuple of int
    what : str
        Name in messages.

    Returns
    -------
    ndarray
    """
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError) as error:
        raise ModelError(f"{what}: expected numbers") from error
    if not np.isfinite(array).all():
        raise ModelError(f"{what}: every number must be finite")
    try:
        return np.broadcast_to(array, shape)
    except ValueError as error:
        raise ModelError(f"{what}: expected shape {shape}, got {array.shape}") from error
