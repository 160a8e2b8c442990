"""A small plant with a log of its own, and monitors whose test compares its channels."""

from __future__ import annotations

from functools import cache

import numpy as np

import residua as rs
from residua.decide.channel_relations import ChannelRelations
from residua.decide.relations import FORMS

M = 1


def plant() -> rs.Plant:
    """Return one state with two sensors, the second twice as large, about an operating point."""
    made = rs.Plant([[0.9]], [[0.1]], [[1.0], [2.0]], dt=1.0, inputs=["u"], outputs=["a", "b"])
    made = made.with_noise(process=0.04, measurement=[0.01, 0.04]).with_sensor_faults().with_actuator_faults()
    return made.with_operating_point(inputs=[3.0], outputs=[1.0, 20.0])


@cache
def log(rows: int, seed: int = 0) -> np.ndarray:
    """Return fault-free rows (u, a, b)."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], rows // 50 + 1), 50)[:rows] + 0.1 * rng.standard_normal(rows)
    shocks, noise = 0.2 * rng.standard_normal(rows), rng.standard_normal((rows, 2)) * [0.1, 0.2]
    x = np.zeros(rows)
    for k in range(1, rows):
        x[k] = 0.9 * x[k - 1] + 0.1 * u[k - 1] + shocks[k]
    out = np.column_stack([3 + u, 1 + x + noise[:, 0], 20 + 2 * x + noise[:, 1]])
    out.flags.writeable = False
    return out


@cache
def fitted(form: str, raised: tuple[tuple[str, float], ...] = ()) -> rs.Monitor:
    """Return a monitor that compares channels, fitted to 3,000 rows; copy it where its state matters."""
    settings = ChannelRelations(form, raised=dict(raised))  # pyright: ignore[reportArgumentType]
    monitor = rs.Monitor(rs.design.kalman_filter(plant()), test=settings, isolate=rs.decide.ByChannel())
    rows = log(3000)
    return monitor.fit(rows[:, :M], rows[:, M:], false_alarm_rate=1e-3, held_out=0.0)


__all__ = ["FORMS", "M", "fitted", "log", "plant"]
