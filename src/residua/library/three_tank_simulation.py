"""The nonlinear three-tank system, run in closed or open loop with faults and noise."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.errors import ModelError
from residua.library.simulation import Course, SimulatedRecording, fault_courses, filled, runge_kutta
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
_POINT, _PROPORTIONAL = np.array(FLOWS), np.array(GAINS)


def simulate_three_tank(
    steps: int = 2001,
    *,
    dt: float = 1.0,
    faults: Mapping[str, Course] | None = None,
    u: ArrayLike | None = None,
    setpoints: ArrayLike | None = None,
    noise: float = 1.0,
    seed: int = 0,
) -> SimulatedRecording:
    """Simulate the nonlinear three-tank system from its nominal point.

    Runge-Kutta of fourth order; pump flows and faults are held over each step. Pumps deliver between 0 and
    150 cm³/s, tanks hold up to 62 cm.

    Parameters
    ----------
    steps : int
        Number of samples.
    dt : float
        Step in seconds, at most 5.
    faults : mapping of str to array_like, shape (steps,), number, or function of time, optional
        Fault name (as in :func:`three_tank`) to its course; a number is a constant fault, :func:`drift` makes one that
        grows.
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
    SimulatedRecording

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
    course = fault_courses(faults, (*ACTUATORS, *SENSORS, *LEAKS, *CLOGS), steps, dt=dt)
    commands = None if u is None else filled(u, (steps, 2), "u")
    wanted = filled(LEVELS[:2] if setpoints is None else setpoints, (steps, 2), "setpoints")
    draw = np.random.default_rng(seed).standard_normal((steps, 8)) * noise
    sensor, level = draw[:, :3] * np.sqrt(LEVEL_NOISE), draw[:, 3:6] * np.sqrt(PROCESS_NOISE * dt)
    flow = draw[:, 6:] * np.sqrt(FLOW_NOISE)
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
            error = wanted[k] - y[k, :2]
            free = _POINT + _PROPORTIONAL * (error + integral)
            q[k] = _within(free, LARGEST_FLOW)
            # frozen while a pump is at its limit
            integral = np.where(q[k] == free, integral + error * dt / INTEGRAL_TIME, integral)
        else:
            q[k] = commands[k]
        real = _within(q[k] + extra[k] + flow[k], LARGEST_FLOW)
        rate = partial(three_tank_rate, q=real, leaks=leaks[k], clogs=clogs[k])
        h = runge_kutta(rate, h, dt) + level[k]
        h = _within(h, HIGHEST_LEVEL)
    return SimulatedRecording(np.arange(steps, dtype=np.float64) * dt, q, y, x, float(dt))


def _within(value: NDArray, highest: float) -> NDArray:
    """Clip between zero and a limit; ``np.clip`` takes three times as long for three numbers."""
    return np.minimum(np.maximum(value, 0.0), highest)
