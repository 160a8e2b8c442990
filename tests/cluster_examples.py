"""A small fleet on a cluster: its monitor, its recordings, and the events of one process."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from typing import Any

import numpy as np

import residua as rs
from residua.monitor import AlarmEvent

#: Plants and samples.
PLANTS, SAMPLES = 24, 120


def plant() -> rs.Plant:
    made = rs.Plant([[0.8, 0.1], [0, 0.6]], [[0.2], [0.4]], np.eye(2), dt=2.0, inputs=["pump"], outputs=["low", "high"])
    return made.with_sensor_faults().with_noise(process=1e-4, measurement=1e-2)


@cache
def monitor(threshold: float = 4.0) -> rs.Monitor:
    return rs.Monitor(
        rs.design.kalman_filter(plant()), test=rs.decide.NormThreshold(threshold=threshold, persistence=2)
    )


@cache
def recordings() -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """Return inputs and outputs by plant: sensors fail for a while, or to the end, and values are missing."""
    rng, out = np.random.default_rng(7), {}
    for p in range(PLANTS):
        u = rng.standard_normal((SAMPLES, 1))
        noise = rng.standard_normal((SAMPLES, len(plant().noises)))
        y = plant().system(("control", "noise")).simulate(np.hstack([u, noise]))
        if p % 3 == 0:
            y[45 + p : 80, p % 2] += 2.0
        if p % 5 == 1:
            y[SAMPLES - 20 :, 1] -= 3.0
        if p % 4 == 2:
            y[rng.integers(SAMPLES, size=5), 0] = np.nan
        out[100 + p] = u, y
    return out


def key(event: AlarmEvent) -> tuple[Any, ...]:
    """Return an event as it is compared: to the last bit."""
    names, scores = tuple(c.name for c in event.candidates), tuple(c.score for c in event.candidates)
    return event.plant, event.sample, event.kind, event.onset, event.raised, event.ended, names, scores


@cache
def expected(threshold: float = 4.0) -> list[tuple[Any, ...]]:
    """Return the events of one process."""
    fleet = rs.Fleet(monitor(threshold), plants=list(recordings()))
    u, y = (np.array([one[k] for one in recordings().values()]) for k in (0, 1))
    return in_order(map(key, fleet.follow(list(recordings()), u, y)))


def in_order(events: Iterable[tuple[Any, ...]]) -> list[tuple[Any, ...]]:
    """Return events by plant, and by time for each."""
    return sorted(events, key=lambda event: event[:3])


def part(start: int, stop: int) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """Return some of the samples of all plants."""
    return {plant: (u[start:stop], y[start:stop]) for plant, (u, y) in recordings().items()}
