"""Uncertain systems for the tests: the jet engine of the literature in closed loop, and generated ones."""

from __future__ import annotations

from functools import cache

import numpy as np

import residua as rs
from residua.library import degrading_jet_engine, degrading_jet_engine_controller
from residua.linear import UncertainSystem
from residua.plant import UncertainPlant

A, B, C = (getattr(degrading_jet_engine().nominal, name) for name in ("A", "B", "C"))
D1, D2 = np.diag([0.1, 0.1, 0.01]), 0.1 * np.eye(3)
H_A = -np.array([[1.0, 1, 1, 0, 0, 0], [0, 0, 0, 1, 1, 1], [0, 0, 0, 0, 0, 0]])
G_A = np.vstack([np.eye(3), np.eye(3)])
H_B = H_C = -np.array([[1.0, 1, 1], [0, 0, 0], [0, 0, 0]])
G_B = G_C = np.eye(3)


@cache
def jet_engine_controller() -> rs.StateSpace:
    """Return the regulator of the engine."""
    return degrading_jet_engine_controller()


@cache
def jet_engine() -> UncertainPlant:
    """Return the engine with its perturbations, disturbances and sensor faults."""
    return degrading_jet_engine()


@cache
def jet_engine_residual() -> UncertainSystem:
    """Return the residual of an estimator for the first sensor that both other sensors do not reach."""
    loop = jet_engine().in_closed_loop(jet_engine_controller())
    W = loop.nominal.Bf.copy()
    W[:, 0] = np.concatenate([jet_engine_controller().B[:, 0], np.zeros(3)])
    return loop.estimator_residual(W, [[1.0, 0, 0]], nuisances=["XNL sensor", "TMPC sensor"])


@cache
def random_uncertain_system(seed: int, n: int | None = None, k: int | None = None) -> UncertainSystem:
    """Return a system every member of which is stable, some with parameters in two places, with direct terms."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 8)) if n is None else n
    k = int(rng.integers(1, 4)) if k is None else k
    m, p, twice = int(rng.integers(1, 3)), int(rng.integers(1, 3)), int(rng.integers(0, 2))
    A = rng.standard_normal((n, n))
    A *= rng.uniform(0.3, 0.9) / np.abs(np.linalg.eigvals(A)).max()
    channels = [*range(k), *([0] * twice)]
    Bp, Cq = rng.standard_normal((n, k + twice)), rng.standard_normal((k + twice, n))
    low, high = -rng.uniform(0, 1, k), rng.uniform(0, 1, k)
    Dzp = rng.standard_normal((p, k + twice)) * 0.3 * (seed % 2)
    Dzw = rng.standard_normal((p, m)) * (seed % 3 > 0)
    Bw, Cz = rng.standard_normal((n, m)), rng.standard_normal((p, n))

    def sized(size: float) -> UncertainSystem:
        bounds = {"low": size * low, "high": size * high}
        return UncertainSystem(A, Bp, Bw, Cq, Cz, Dzp, Dzw, **bounds, channels=channels, dt=1.0)

    size, limit = 1.0, 0.49 * (1 + np.abs(np.linalg.eigvals(A)).max())
    points = sized(1.0).sample(seed, 64) if k > 8 else sized(1.0).vertices()

    def largest(system: UncertainSystem) -> float:
        return np.abs(np.linalg.eigvals([system.member(size * f).A for f in points])).max()

    while largest(sized(size)) > limit:
        size *= 0.8
    return sized(0.8 * size)
