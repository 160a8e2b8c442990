"""Monitors of every test and isolation that run in C, and recordings with missing values and changes."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

import residua as rs
from residua.decide import CUSUM, EWMA, GLR, ChiSquared, Directional, NormThreshold
from residua.monitor.specification import Specification

MARKS = (np.nan, np.inf, -np.inf, 1e300, 1e308, 1e12, 1e200)

TESTS: dict[str, Any] = {
    "norm": NormThreshold(threshold=3.0),
    "norm over a window": NormThreshold(threshold=2.5, window=7, persistence=2, release=4),
    "page": CUSUM(threshold=4.0, form="page"),
    "crosier": CUSUM(threshold=5.0, form="crosier"),
    "pignatiello-runger": CUSUM(threshold=5.0, form="pignatiello-runger"),
    "ewma": EWMA(threshold=3.0, weight=0.2),
    "chi-squared": ChiSquared(threshold=3.5),
    "chi-squared over a window": ChiSquared(threshold=5.0, window=5),
    "glr": GLR(threshold=3.5, window=6),
    "glr along faults": GLR(threshold=3.5, window=5, directions="faults"),
}
ISOLATIONS: dict[str, Any] = {
    "none": None,
    "short": Directional(window=3),
    "long": Directional(window=40, signature="steady"),
}
ORDERS = (0, 1, 2, 3, 4, 5, 8, 9)


def plant(order: int, outputs: int, inputs: int, seed: int) -> rs.Plant:
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((order, order))
    A *= 0.8 / max(np.abs(np.linalg.eigvals(A)).max(initial=0.0), 1e-3)
    made = rs.Plant(A, rng.standard_normal((order, inputs)), rng.standard_normal((outputs, order)),
                    rng.standard_normal((outputs, inputs)), dt=1)  # fmt: skip
    return made.with_sensor_faults()


@cache
def specification(test: str, isolation: str, order: int, outputs: int, method: str) -> Specification:
    """Return what runs: a Kalman filter, or an observer, fitted where heavy tails and memory are to be taken off."""
    made = plant(order, outputs, 2, 7 * order + outputs)
    rng = np.random.default_rng(5)
    if method == "kalman" and order:
        made = made.with_noise(process=1e-2, measurement=1e-1)
        generator = rs.design.kalman_filter(made)
    elif order:
        generator = rs.design.unknown_input_observer(made).residual_generator()
    else:
        generator = rs.identify.given_residuals([f"r{j}" for j in range(outputs)])
    monitor = rs.Monitor(generator, test=TESTS[test], isolate=ISOLATIONS[isolation])
    channels = monitor.generator.system.n_inputs
    noise = rng.standard_t(4, (3000, channels))
    for k in range(1, len(noise)):
        noise[k] += 0.4 * noise[k - 1]
    n_u = len(monitor.generator.plant.inputs)
    if method != "kalman" or not order:
        monitor.fit(noise[:, :n_u] if n_u else None, noise[:, n_u:], held_out=0)
    return monitor._specification()


def recording(spec: Specification, rng: np.random.Generator, samples: int, marks: list[float]) -> np.ndarray:
    """Return data of three plants: one whole, one with marks, one with gaps, all with a change in the middle."""
    channels = spec.B.shape[1]
    data = rng.standard_normal((3, samples, channels)) + spec.offset
    data[:, samples // 2 : samples // 2 + 60] += 3 * rng.standard_normal(channels)
    for mark in marks:
        data[1, rng.integers(samples), rng.integers(channels)] = mark
    for _ in range(4):
        start, length = rng.integers(samples), rng.integers(1, 25)
        data[2, start : start + length, rng.integers(channels)] = np.nan
    return data
