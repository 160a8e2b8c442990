"""The nonlinear three-tank system, run in closed or open loop with faults and noise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.errors import ModelError
from residua.library.three_tank import (
    ACTUATORS,
    CLOGS,
    FLOW_NOISE,
    FLOWS,
    HIGHEST_LEVEL,
    LARGEST_FLOW,
    LEAKS,
    LEVEL_NOISE,
    LEVELS,
    PROCESS_NOISE,
    SENSORS,
    three_tank_rate,
)

#: Proportional gains in cm2/s and integral time in s of the two level controllers.
GAINS, INTEGRAL_TIME = (5.0, 3.0), 60.0


@dataclass(frozen=True, eq=False)
class ThreeTankRecording:
    """What a simulated three-tank system did.

    Attributes
    ----------
    time : ndarray, shape (T,)
        Seconds.
    u : ndarray, shape (T, 2)
        Commanded pump flows Q1, Q2 in cm³/s.
    y : ndarray, shape (T, 3)
        Measured levels h1, h2, h3 in cm, with noise and sensor faults.
    x : ndarray, shape (T, 3)
        True levels in cm.
    dt : float
    """

    time: NDArray[np.float64]
    u: NDArray[np.float64]
    y: NDArray[np.float64]
    x: NDArray[np.float64]
    dt: float


def simulate_three_tank(
    steps: int = 2001,
    dt: float = 1.0,
    *,
    faults: Mapping[str, ArrayLike] | None = None,
    u: ArrayLike | None = None,
    setpoints: ArrayLike | None = None,
    noise: float = 1.0,
    seed: int = 0,
) -> ThreeTankRecording:
    """Simulate the nonlinear three-tank system from its nominal point.

    Runge-Kutta of fourth order; pump flows and faults are held over each step. Pumps deliver between 0 and
    150 cm³/s, tanks hold up to 62 cm.

    Parameters
    ----------
    steps : int
        Number of samples.
    dt : float
        Step in seconds, at most 5.
    faults : mapping of str to array_like, optional
        Fault name (as in :func:`three_tank`) to its time course, shape (steps,), or one number for a constant fault.
    u : array_like, shape (steps, 2), optional
        Commanded pump flows: open loop. When omitted, two PI controllers hold h1 and h2.
    setpoints : array_like, shape (2,) or (steps, 2), optional
        Wanted h1 and h2 in closed loop; the nominal levels when omitted.
    noise : float
        Factor on the standard deviations of the benchmark's noise; 0 for none.
    seed : int
        Of the noise.

    Returns
    -------
    ThreeTankRecording

    Raises
    ------
    ModelError
        If a fault is unknown or a shape does not fit.

    Examples
    --------
    >>> from residua.library import simulate_three_tank
    >>> run = simulate_three_tank(300, noise=0)
    >>> run.y[-1].round(2)
    array([41. , 32. , 36.6])
    """
    if not (np.isfinite(dt) and 0 < dt <= 5):
        raise ModelError(f"dt must lie in (0, 5] seconds, got {dt}")
    if int(steps) != steps or steps < 1:
        raise ModelError(f"steps must be a positive whole number, got {steps!r}")
    course = _courses(faults or {}, steps)
    commands = None if u is None else _shaped(u, (steps, 2), "u")
    wanted = _shaped(LEVELS[:2] if setpoints is None else setpoints, (steps, 2), "setpoints")
    sensor, level, flow = _noise(steps, dt, noise, seed)
    offset = np.column_stack([course[name] for name in SENSORS])
    extra = np.column_stack([course[name] for name in ACTUATORS])
    leaks = np.column_stack([course[name] for name in LEAKS])
    clogs = np.column_stack([course[name] for name in CLOGS])
    x, y, q = np.zeros((steps, 3)), np.zeros((steps, 3)), np.zeros((steps, 2))
    h, integral = np.array(LEVELS), np.zeros(2)
    for k in range(steps):
        x[k] = h
        y[k] = h + offset[k] + sensor[k]
        if commands is None:
            q[k], integral = _control(wanted[k] - y[k, :2], integral, dt)
        else:
            q[k] = commands[k]
        real = np.clip(q[k] + extra[k] + flow[k], 0.0, LARGEST_FLOW)
        h = _step(h, real, leaks[k], clogs[k], dt) + level[k]
        h = np.clip(h, 0.0, HIGHEST_LEVEL)
    return ThreeTankRecording(np.arange(steps, dtype=np.float64) * dt, q, y, x, float(dt))


def _control(error: NDArray, integral: NDArray, dt: float) -> tuple[NDArray, NDArray]:
    """Return the commands of the two controllers; the integral stands still while a pump is at its limit."""
    wanted = np.array(FLOWS) + np.array(GAINS) * (error + integral)
    q = np.clip(wanted, 0.0, LARGEST_FLOW)
    return q, np.where(q == wanted, integral + error * dt / INTEGRAL_TIME, integral)


def _step(h: NDArray, q: NDArray, leaks: NDArray, clogs: NDArray, dt: float) -> NDArray:
    def rate(levels: NDArray) -> NDArray:
        return three_tank_rate(levels, q, leaks=leaks, clogs=clogs)

    k1 = rate(h)
    k2 = rate(h + dt / 2 * k1)
    k3 = rate(h + dt / 2 * k2)
    k4 = rate(h + dt * k3)
    return h + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def _courses(faults: Mapping[str, ArrayLike], steps: int) -> dict[str, NDArray]:
    known = (*ACTUATORS, *SENSORS, *LEAKS, *CLOGS)
    out = {name: np.zeros(steps) for name in known}
    for name, course in faults.items():
        if name not in known:
            raise ModelError(f"unknown fault {name!r}; known: {', '.join(known)}")
        out[name] = _shaped(course, (steps,), f"fault {name!r}")
    return out


def _shaped(value: ArrayLike, shape: tuple[int, ...], what: str) -> NDArray[np.float64]:
    array = np.asarray(value, dtype=float)
    if not np.isfinite(array).all():
        raise ModelError(f"{what}: every number must be finite")
    try:
        return np.broadcast_to(array, shape)
    except ValueError as error:
        raise ModelError(f"{what}: expected shape {shape}, got {array.shape}") from error


def _noise(steps: int, dt: float, factor: float, seed: int) -> tuple[NDArray, NDArray, NDArray]:
    """Return the noise of sensors, of levels over a step, and of pump flows."""
    draw = np.random.default_rng(seed).standard_normal((steps, 8)) * factor
    return (
        draw[:, :3] * np.sqrt(LEVEL_NOISE),
        draw[:, 3:6] * np.sqrt(PROCESS_NOISE * dt),
        draw[:, 6:] * np.sqrt(FLOW_NOISE),
    )
