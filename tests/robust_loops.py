"""Uncertain loops for the tests of robust estimators: generated, stable for every member, with sensor faults."""

from __future__ import annotations

import numpy as np

from residua.plant import Perturbation, Plant, UncertainPlant


def random_loop(seed: int, *, actuator: bool = False, most_states: int = 6) -> UncertainPlant:
    """Return a loop with uncertain ``A`` and ``C`` and a fault in every sensor, which may also act on the states."""
    rng = np.random.default_rng(seed)
    n, p = int(rng.integers(2, most_states + 1)), int(rng.integers(2, 5))
    A = rng.standard_normal((n, n))
    A *= rng.uniform(0.4, 0.95) / np.abs(np.linalg.eigvals(A)).max()
    C = rng.standard_normal((p, n))
    plant = Plant(A, np.zeros((n, 0)), C, dt=0.1, name=f"loop {seed}")
    plant = plant.with_disturbances(rng.standard_normal((n, 2)), output=0.3 * rng.standard_normal((p, 2)))
    driven = 0.2 * rng.standard_normal((n, p)) * (seed % 2)  # as through a controller
    plant = plant.with_faults({f"sensor {i + 1}": (driven[:, i], np.eye(p)[i]) for i in range(p)}, kind="sensor")
    if actuator:
        plant = plant.with_faults({"actuator": rng.standard_normal(n)}, kind="actuator")
    size = 0.05 * (1 - np.abs(np.linalg.eigvals(A)).max())
    return UncertainPlant(
        plant,
        deltas=[
            Perturbation("A", rng.standard_normal((n, 2)), rng.standard_normal((2, n)), -size, size, ["a", "b"]),
            Perturbation("C", rng.standard_normal((p, 1)), rng.standard_normal((1, n)), 0.0, size, ["c"]),
        ],
    )
