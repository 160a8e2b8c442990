"""Uncertain systems for the tests: the jet engine of the literature in closed loop, and generated ones."""

from __future__ import annotations

from functools import cache

import numpy as np
import scipy.linalg

import residua as rs
from residua.linear import UncertainSystem
from residua.plant import Perturbation, UncertainPlant

A = np.array([[0.8938, 0.0034, 0.0020], [-0.0001, 0.8940, 0.0014], [0, -0.0001, 0.8996]])
B = np.array([[0.0059, 0.1119, -0.0160], [0.0042, 0.0720, 0.0083], [0.0001, -0.0003, 0]])
C = np.array([[1, 0.0077, 0.0044], [-0.0003, 1, 0.0031], [0.0299, -0.0208, 0.0010]])
D1, D2 = np.diag([0.1, 0.1, 0.01]), 0.1 * np.eye(3)
H_A = -np.array([[1.0, 1, 1, 0, 0, 0], [0, 0, 0, 1, 1, 1], [0, 0, 0, 0, 0, 0]])
G_A = np.vstack([np.eye(3), np.eye(3)])
H_B = H_C = -np.array([[1.0, 1, 1], [0, 0, 0], [0, 0, 0]])
G_B = G_C = np.eye(3)
LOW_A, HIGH_A = [0, -0.0008, 0, -0.0001, 0, 0], [0.0011, 0, 0.0002, 0, 0.0005, 0.0001]
LOW_B, HIGH_B = [0, 0, -0.0005], [0.0008, 0.0115, 0]
LOW_C, HIGH_C = [-0.0001, -0.0015, 0], [0, 0, 0.0004]


@cache
def jet_engine_controller() -> rs.StateSpace:
    """Return the regulator with unit weights on the estimator for the disturbances of the engine."""
    X = scipy.linalg.solve_discrete_are(A, B, np.eye(3), np.eye(3))
    K = np.linalg.solve(np.eye(3) + B.T @ X @ B, B.T @ X @ A)
    Y = scipy.linalg.solve_discrete_are(A.T, C.T, D1 @ D1.T, D2 @ D2.T)
    L = A @ Y @ C.T @ np.linalg.inv(C @ Y @ C.T + D2 @ D2.T)
    return rs.StateSpace(A - B @ K - L @ C, L, -K, dt=0.01)


@cache
def jet_engine() -> UncertainPlant:
    """Return the engine with its perturbations, disturbances and sensor faults."""
    plant = rs.Plant(A, B, C, dt=0.01, outputs=["XNH", "XNL", "TMPC"], name="engine")
    return UncertainPlant(
        plant.with_disturbances(D1, output=D2).with_sensor_faults(),
        deltas=[
            Perturbation("A", H_A, G_A, LOW_A, HIGH_A),
            Perturbation("C", H_C, G_C, LOW_C, HIGH_C),
            Perturbation("B", H_B, G_B, LOW_B, HIGH_B),
        ],
    )


@cache
def jet_engine_residual() -> UncertainSystem:
    """Return the residual of an estimator for the first sensor that both other sensors do not reach."""
    loop = jet_engine().in_closed_loop(jet_engine_controller())
    W = loop.nominal.Bf.copy()
    W[:, 0] = np.concatenate([jet_engine_controller().B[:, 0], np.zeros(3)])
    return loop.estimator_residual(W, [[1.0, 0, 0]], nuisances=["XNL sensor", "TMPC sensor"])


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
    while max(np.abs(np.linalg.eigvals(sized(size).member(size * f).A)).max() for f in points) > limit:
        size *= 0.8
    return sized(0.8 * size)
