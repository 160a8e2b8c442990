"""Assumed noise of a plant, from the size of its signals; and a step to sample a plant with."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from residua.errors import ModelError
from residua.linear.poles.spectrum import mean_rate
from residua.plant.plant import Plant
from residua.tolerances import RANK

#: Standard deviations: of a measurement relative to its output, and of process noise in one sample to its state.
MEASUREMENT, PROCESS = 0.1, 0.003
#: Samples in the time constant of the mean rate, and those over which the signals of a plant that integrates are taken.
_SAMPLES, _INTEGRATED = 10, 100


def sensible_step(plant: Plant) -> float:
    """Return the step of a sampled plant, or a tenth of the time constant of the mean rate of a continuous one."""
    if plant.is_discrete:
        return plant.dt
    return 1 / (_SAMPLES * mean_rate(plant.system(()).poles()))


def lasting_gains(plant: Plant, role: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the steady-state gains from constant inputs to states and outputs, (states or outputs, inputs).

    Of a plant with a pole on the boundary of stability, or beyond, what slow inputs do within a hundred samples.
    """
    system = plant.system(role)
    rate = 0.0
    poles = system.poles()
    inside = 1 - np.abs(poles) if plant.is_discrete else -poles.real / max(float(np.abs(poles).max(initial=0.0)), 1.0)
    if (inside < RANK).any():
        rate = 1 / (_INTEGRATED * sensible_step(plant))
    at = np.exp(rate * plant.dt) if plant.is_discrete else rate
    E = np.eye(plant.n_states) if plant.E is None else plant.E
    try:
        states = np.linalg.solve(at * E - plant.A, system.B)
    except np.linalg.LinAlgError as error:
        raise ModelError("the equations of the plant do not say what its inputs do in the end") from error
    return np.abs(states), np.abs(plant.C @ states + system.D)


def with_assumed_noise(plant: Plant) -> Plant:
    """Return a plant with the noise of :meth:`residua.Plant.with_assumed_noise`."""
    if plant.noises:
        raise ModelError("the plant has noise: plant.with_noise(...) replaces it")
    sizes = [np.zeros(plant.n_states), np.zeros(plant.n_outputs)]
    for role in ("control", "disturbance", "fault"):
        moved = [gain.max(axis=1, initial=0.0) for gain in lasting_gains(plant, role)]
        sizes = [
            np.where(size > RANK * size.max(initial=0.0), size, new) for size, new in zip(sizes, moved, strict=True)
        ]
    states = sizes[0] if plant.E is None else np.abs(plant.E) @ sizes[0]
    outputs = np.where(sizes[1] > 0, sizes[1], 1.0)  # moved by nothing: a sensor that reads its own noise
    per_step = 1.0 if plant.is_discrete else sensible_step(plant)
    return plant.with_noise(
        process=(PROCESS * states) ** 2 / per_step, measurement=(MEASUREMENT * outputs) ** 2 * per_step
    )
