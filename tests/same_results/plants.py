"""Three hundred generated plants of all kinds, and recordings of each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import residua as rs
from generated import random_plant, singular_plant
from plant_examples import random_plant as mild_plant
from whole_number_plants import KINDS, whole_number_plant

PLANTS = 300
#: Samples without a fault, for thresholds, and of the recording that is diagnosed; step of a continuous plant.
FIT, RUN, STEP = 320, 260, 0.05
#: A simulated output beyond this is that of an unstable plant: its recording is made of noise instead.
LARGEST = 1e4


@dataclass(frozen=True, eq=False)
class Case:
    """A plant with two recordings, one without a fault, one with the fault of its middle and with values missing."""

    name: str
    number: int
    plant: rs.Plant
    normal: tuple[NDArray[np.float64], NDArray[np.float64]]
    faulty: tuple[NDArray[np.float64], NDArray[np.float64]]


def case(number: int) -> Case:
    """Return a case by its number."""
    kind, plant = _plant(number)
    rng = np.random.default_rng([91, number])
    normal = _recording(plant, rng, FIT, None)
    fault = plant.faults[number % len(plant.faults)] if plant.faults else None
    u, y = _recording(plant, rng, RUN, fault)
    if number % 2:
        y[60:62, 0] = np.nan
        y[100:120] = np.nan
        u[220] = np.nan
    return Case(f"plant {number:03d} {kind}", number, plant, normal, (u, y))


def _plant(number: int) -> tuple[str, rs.Plant]:
    """Return a plant and what it is; every second one has noise."""
    rng, turn = np.random.default_rng([90, number]), number % 5
    if turn < 2:
        options = {"disturbances": number // 5 % 3, "sensors": number % 3 > 0, "feedthrough": number % 7 == 0}
        kind, plant = "random", random_plant(rng, faults=1 + number % 4, **options)  # pyright: ignore
    elif turn == 2:
        kind, plant = "singular", singular_plant(rng, disturbances=number // 5 % 2)
    elif turn == 3:
        kind, plant = "mild", mild_plant(number, n=2 + number % 4, dt=0.0)
        return kind, plant if number % 2 else plant.discretize(STEP)
    else:
        kind, plant = KINDS[number // 5 % len(KINDS)], whole_number_plant(number // 5)
    return kind, plant.with_noise(process=1e-3, measurement=1e-2) if number % 2 or turn == 1 else plant


def _recording(
    plant: rs.Plant, rng: np.random.Generator, samples: int, fault: str | None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return inputs and outputs; of an unstable or singular plant outputs that are nothing but noise and a step."""
    u = rng.standard_normal((samples, len(plant.inputs)))
    noise = 0.05 * rng.standard_normal((samples, plant.n_outputs))
    others = [0.1 * rng.standard_normal((samples, k)) for k in (len(plant.disturbances), len(plant.noises))]
    f = np.zeros((samples, len(plant.faults)))
    if fault is not None:
        f[samples // 2 :, plant.faults.index(fault)] = 2.0
    if plant.E is None:
        sampled = plant if plant.is_discrete else plant.discretize(STEP)
        system = sampled.system(("control", "disturbance", "noise", "fault"))
        with np.errstate(all="ignore"):
            y = system.simulate(np.hstack([u, *others, f]))
        if np.all(np.abs(y) < LARGEST):
            return u, y + noise
    noise[samples // 2 :, 0] += 1.0 if fault is not None else 0.0
    return u, 20 * noise
