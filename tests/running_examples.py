"""A noisy plant with an operating point and its recordings, for tests of running monitors."""

from __future__ import annotations

import numpy as np

import residua as rs


def plant() -> rs.Plant:
    point = {"inputs": [3.0], "outputs": [1.0, 2.0]}
    return (
        rs.library.gertler(sensor_faults=True).with_noise(process=0.01, measurement=0.1).with_operating_point(**point)
    )


def recording(samples: int = 600, *, seed: int = 0, fault: str = "", start: int = 300) -> tuple[np.ndarray, np.ndarray]:
    """Return inputs and outputs in plant units, with a fault of size 3 from a sample on."""
    p, rng = plant(), np.random.default_rng(seed)
    u, f = rng.standard_normal((samples, 1)), np.zeros((samples, len(p.faults)))
    if fault:
        f[start:, p.faults.index(fault)] = 3.0
    w = rng.standard_normal((samples, len(p.noises)))
    return u + 3.0, p.system(("control", "fault", "noise")).simulate(np.hstack([u, f, w])) + [1.0, 2.0]
