"""Plants for the tests of plants and plant files."""

from __future__ import annotations

import numpy as np

from residua.plant import Plant

A = [[-1.0, 0.5, 0.0], [0.0, -2.0, 0.3], [0.1, 0.0, -3.0]]
B = [[1.0, 0.0], [0.0, 2.0], [0.0, 0.0]]
C = [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]


def example(**options) -> Plant:
    names = {"inputs": ["pump", "valve"], "outputs": ["level", "flow"], "states": ["a", "b", "c"]}
    return Plant(A, B, C, **(names | options))


def random_plant(seed: int, n: int = 4, m: int = 2, p: int = 3, dt: float = 0.0) -> Plant:
    rng = np.random.default_rng(seed)
    plant = Plant(
        rng.standard_normal((n, n)) - 3 * np.eye(n),
        rng.standard_normal((n, m)),
        rng.standard_normal((p, n)),
        rng.standard_normal((p, m)),
        dt=dt,
    )
    plant = plant.with_disturbances(rng.standard_normal((n, 2)), output=rng.standard_normal((p, 2)))
    plant = plant.with_faults({"f": (rng.standard_normal(n), rng.standard_normal(p))})
    plant = plant.with_actuator_faults().with_sensor_faults()
    G = rng.standard_normal((n, n))
    return plant.with_noise(process=G @ G.T, measurement=rng.uniform(0.1, 1, p))
