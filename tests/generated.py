"""Seeded random plants for the tests."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np

import residua as rs

T = TypeVar("T")


def nth(make: Callable[[int], T | None], *, most: int = 2000) -> Callable[[int], T]:
    """Return a function from ``k`` to what the ``k``-th seed makes of those that make something; each is tried once.

    For tests over generated plants of which not every one serves: they run over ``k``, and none is skipped.
    """
    tried = (made for made in map(make, range(most)) if made is not None)
    kept: list[T] = []

    def made_by(k: int) -> T:
        while len(kept) <= k:
            kept.append(next(tried))
        return kept[k]

    return made_by


def random_plant(
    rng: np.random.Generator,
    *,
    n: int | None = None,
    outputs: int | None = None,
    inputs: int | None = None,
    disturbances: int = 0,
    faults: int = 2,
    sensors: bool = False,
    feedthrough: bool = False,
    dt: float | None = None,
) -> rs.Plant:
    """Return a plant with random matrices; unstable ones among them."""
    n = int(rng.integers(2, 9)) if n is None else n
    p = int(rng.integers(disturbances + 2, disturbances + 5)) if outputs is None else outputs
    m = int(rng.integers(1, 4)) if inputs is None else inputs
    if dt is None:
        dt = float(rng.choice([0.0, 0.1]))
    A = rng.standard_normal((n, n))
    if dt:
        A *= 1.05 / max(np.abs(np.linalg.eigvals(A)).max(), 1e-6)
    plant = rs.Plant(
        A,
        rng.standard_normal((n, m)),
        rng.standard_normal((p, n)),
        rng.standard_normal((p, m)) if feedthrough else None,
        dt=dt,
    )
    if disturbances:
        plant = plant.with_disturbances(rng.standard_normal((n, disturbances)))
    if faults:
        plant = plant.with_faults({f"f{i}": rng.standard_normal(n) for i in range(faults)})
    return plant.with_sensor_faults() if sensors else plant


def simulate(
    plant: rs.Plant, rng: np.random.Generator, samples: int, fault: str | None = None, size: float = 1.0
) -> tuple[np.ndarray, np.ndarray]:
    """Return (u, y) of a sampled plant with random inputs and disturbances, from rest, without noise."""
    u = rng.standard_normal((samples, len(plant.inputs)))
    d = rng.standard_normal((samples, len(plant.disturbances)))
    f = np.zeros((samples, len(plant.faults)))
    if fault is not None:
        f[:, plant.faults.index(fault)] = size * rng.standard_normal(samples)
    system = plant.system(("control", "disturbance", "fault"))
    return u, system.simulate(np.hstack([u, d, f]))


def singular_plant(
    rng: np.random.Generator,
    *,
    n: int | None = None,
    rank: int | None = None,
    outputs: int | None = None,
    inputs: int | None = None,
    disturbances: int = 0,
    faults: int = 1,
    sensors: bool = True,
    dt: float | None = None,
) -> rs.Plant:
    """Return a plant with a random ``E`` of the given rank, with enough outputs for observers to exist."""
    n = int(rng.integers(3, 8)) if n is None else n
    rank = int(rng.integers(1, n)) if rank is None else rank
    p = n - rank + disturbances + int(rng.integers(1, 3)) if outputs is None else outputs
    m = int(rng.integers(1, 3)) if inputs is None else inputs
    dt = float(rng.choice([0.0, 0.1])) if dt is None else dt
    E = rng.standard_normal((n, rank)) @ rng.standard_normal((rank, n))
    plant = rs.Plant(
        rng.standard_normal((n, n)),
        rng.standard_normal((n, m)),
        rng.standard_normal((p, n)),
        E=E,
        dt=dt,
        name="singular plant",
    )
    if disturbances:
        plant = plant.with_disturbances(rng.standard_normal((n, disturbances)))
    if faults:
        plant = plant.with_faults({f"f{i}": rng.standard_normal(n) for i in range(faults)})
    plant = plant.with_actuator_faults()
    return plant.with_sensor_faults() if sensors else plant
