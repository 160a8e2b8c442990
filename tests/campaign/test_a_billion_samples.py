"""A billion samples through one monitor: counters do not wrap, and nothing drifts.

A recording of a million samples comes again and again. From its second time on, everything that is decided has the same
bits each time: a sum that took up rounding errors, or a counter that wrapped, would change some.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import residua as rs
from residua.monitor import fused

BLOCK, TIMES = 1_000_000, 1000
KEPT = ("statistic", "alarm", "usable", "up")

MONITORS = {
    "norm over a window, directions": lambda: {
        "test": rs.decide.NormThreshold(window=5, threshold=8.0, persistence=3),
        "isolate": rs.decide.Directional(window=50),
    },
    "CUSUM": lambda: {"test": rs.decide.CUSUM(), "isolate": None},
    "EWMA": lambda: {"test": rs.decide.EWMA(), "isolate": None},
}


def recorded(samples: int) -> tuple[rs.Plant, np.ndarray, np.ndarray]:
    """Return a plant with an operating point, and its recording without a fault."""
    rng = np.random.default_rng(0)
    A = np.diag([0.9, 0.8, 0.7, 0.6])
    plant = rs.Plant(A, 0.1 * rng.standard_normal((4, 2)), rng.standard_normal((3, 4)), dt=1)
    plant = plant.with_sensor_faults().with_noise(process=1e-2, measurement=1e-1)
    u, noise = rng.standard_normal((samples, 2)), rng.standard_normal((samples, len(plant.noises)))
    y = plant.system(("control", "noise")).simulate(np.hstack([u, noise]))
    plant = plant.with_operating_point(inputs=[1.0, 2.0], outputs=[10.0, -3.0, 0.1])
    return plant, u + [1.0, 2.0], y + [10.0, -3.0, 0.1]


def kept(decisions: Any) -> dict[str, bytes]:
    return {name: getattr(decisions, name).tobytes() for name in KEPT}


@pytest.mark.campaign
@pytest.mark.skipif(fused._kernel is None, reason="in NumPy it would take hours")
@pytest.mark.parametrize("name", MONITORS)
def test_a_billion_samples_leave_the_bits_of_the_first_ones(name: str) -> None:
    plant, u, y = recorded(BLOCK)
    monitor = rs.Monitor(rs.design.kalman_filter(plant), **MONITORS[name]())
    monitor.update(u, y, keep=("alarm",))
    second = kept(monitor.update(u, y, keep=KEPT))
    for _ in range(TIMES - 3):
        monitor.update(u, y, keep=("alarm",))
    assert kept(monitor.update(u, y, keep=KEPT)) == second
    state = monitor._state
    assert state is not None
    assert state.count.tolist() == [BLOCK * TIMES]
    assert state.filter.age.tolist() == [BLOCK * TIMES]
