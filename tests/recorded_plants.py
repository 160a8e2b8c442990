"""Generated plants and recordings of them, for the tests of identification."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import residua as rs


def generated_plant(rng: np.random.Generator, n: int, m: int, p: int, *, least: float = 0.02) -> rs.Plant:
    """Return a stable sampled plant whose smallest Hankel singular value is at least a part of the largest."""
    while True:
        A = np.zeros((n, n))
        i = 0
        while i < n:
            if n - i >= 2 and rng.random() < 0.6:
                r, w = rng.uniform(0.6, 0.95), rng.uniform(0.15, 2.8)
                A[i : i + 2, i : i + 2] = r * np.array([[np.cos(w), np.sin(w)], [-np.sin(w), np.cos(w)]])
                i += 2
            else:
                A[i, i] = rng.uniform(-0.6, 0.95)
                i += 1
        Q = np.linalg.qr(rng.standard_normal((n, n)))[0]
        A = Q @ A @ Q.T
        B, C = rng.standard_normal((n, m)), rng.standard_normal((p, n))
        plant = rs.Plant(A, B, C, dt=1.0)
        s = hankel_singular_values(plant)
        if not n or s[n - 1] > least * s[0]:
            return plant


def hankel_singular_values(plant: rs.Plant) -> NDArray[np.float64]:
    """Return the Hankel singular values, from 60 Markov parameters."""
    G = markov_parameters(plant, 60)
    return np.linalg.svd(np.block([[G[i + j] for j in range(30)] for i in range(30)]), compute_uv=False)


def markov_parameters(plant: rs.Plant, count: int) -> list[NDArray[np.float64]]:
    """Return ``C B, C A B, ...``."""
    out, x = [], np.array(plant.B)
    for _ in range(count):
        out.append(plant.C @ x)
        x = plant.A @ x
    return out


def recorded(
    plant: rs.Plant, rng: np.random.Generator, rows: int, ratio: float, *, process: bool = False
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return inputs and outputs in open loop, white noise on the outputs a part of them (``1 / ratio``).

    With ``process`` as much noise again comes through the states.
    """
    u = rng.standard_normal((rows, len(plant.inputs)))
    y = plant.system("control").simulate(u)
    size = y.std(axis=0)
    noise = size / ratio * rng.standard_normal(y.shape)
    if process:
        driven = plant.system("control").simulate(rng.standard_normal(u.shape))
        noise = noise + driven / driven.std(axis=0) * size / ratio
    return u, y + noise


def in_closed_loop(
    plant: rs.Plant, rng: np.random.Generator, rows: int, ratio: float, *, dither: float = 1.0
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return inputs and outputs while a filtered proportional controller moves the first input by the first output."""
    n, m = plant.n_states, len(plant.inputs)
    open_size = recorded(plant, np.random.default_rng(0), 2000, 1e9)[1].std(axis=0)
    gain = 0.5 / max(float(np.abs(plant.C[0] @ np.linalg.solve(np.eye(n) - plant.A, plant.B[:, 0]))), 1.0)
    whole = np.block(
        [[plant.A, plant.B[:, :1]], [-gain * (plant.C[:1] @ plant.A), 0.5 - gain * plant.C[:1] @ plant.B[:, :1]]]
    )
    while np.abs(np.linalg.eigvals(whole)).max() > 0.97:
        gain /= 2
        whole[-1] = np.concatenate([-gain * (plant.C[0] @ plant.A), [0.5 - gain * plant.C[0] @ plant.B[:, 0]]])
    x, held, u, y = np.zeros(n), 0.0, np.zeros((rows, m)), np.zeros((rows, plant.n_outputs))
    for k in range(rows):
        y[k] = plant.C @ x + open_size / ratio * rng.standard_normal(plant.n_outputs)
        held = 0.5 * held - gain * y[k, 0]
        u[k] = dither * rng.standard_normal(m)
        u[k, 0] += held
        x = plant.A @ x + plant.B @ u[k]
    return u, y
