"""A closed loop without inputs, a dedicated bank for its sensors with thresholds that hold for |w| <= 1, recordings."""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace

import numpy as np
import scipy.linalg

import residua as rs
from residua.design import Member
from residua.design.core.decoupling import Decoupled
from residua.design.core.evidence import Evidence
from residua.design.core.generator import make_generator
from residua.linear import StateSpace, peak_norm

DT = 0.01
OUTPUTS = ("XNH", "XNL", "TMPC")
MEMBERS = tuple(f"only {name}" for name in OUTPUTS)
FAULTS = tuple(f"{name} sensor" for name in OUTPUTS)
#: Open loop, feedback of the measurements, and how the bounded disturbance enters states and measurements.
A = np.array([[0.93, 0.02, 0.0], [-0.01, 0.9, 0.02], [0.0, -0.01, 0.95]])
K = np.array([[-0.05, 0.02, 0.0], [0.01, -0.04, 0.0], [0.02, 0.0, -0.06]])
D1, D2 = np.diag([0.02, 0.02, 0.01]), np.diag([0.1, 0.1, 0.05])


def closed_loop() -> rs.Plant:
    """The loop ``x+ = (A + K C) x + K f``, ``y = C x + f`` with ``C = I``: a faulty sensor also drives the feedback."""
    plant = rs.Plant(A + K, np.zeros((3, 0)), np.eye(3), dt=DT, outputs=OUTPUTS, name="closed loop")
    for k, name in enumerate(FAULTS):
        plant = plant.with_faults({name: (K[:, k], np.eye(3)[k])}, kind="sensor", component=OUTPUTS[k])
    return plant


def member_gain(k: int) -> np.ndarray:
    """The gain that makes the error of member ``k`` deaf to the faults of all other sensors: their columns are K's."""
    gain = K.copy()
    P = scipy.linalg.solve_discrete_are(
        (A + K - np.delete(gain, k, 1) @ np.delete(np.eye(3), k, 0)).T, np.eye(3)[:, [k]], 0.05 * np.eye(3), [[1.0]]
    )
    loop = A + K - np.delete(gain, k, 1) @ np.delete(np.eye(3), k, 0)
    gain[:, k] = (loop @ P[:, k]) / (P[k, k] + 1.0)
    return gain


def dedicated_bank(*, scale: float = 1.0) -> SimpleNamespace:
    """The bank, with ``thresholds`` as a certified design brings them: the exact peak of each residual, no margin."""
    plant, gains = closed_loop(), [member_gain(k) for k in range(3)]
    systems = [StateSpace(A + K - W, W, -np.eye(3)[[k]], np.eye(3)[[k]], dt=DT) for k, W in enumerate(gains)]
    peaks = [
        peak_norm(StateSpace(A + K - W, D1 + K @ D2 - W @ D2, np.eye(3)[[k]], D2[[k]], dt=DT)).value
        for k, W in enumerate(gains)
    ]
    stacked = StateSpace(
        scipy.linalg.block_diag(*(s.A for s in systems)),
        np.vstack([s.B for s in systems]),
        scipy.linalg.block_diag(*(s.C for s in systems)),
        np.vstack([s.D for s in systems]),
        dt=DT,
        outputs=[f"r {name}" for name in OUTPUTS],
    )
    generator = make_generator(
        stacked,
        plant,
        "dedicated bank",
        Evidence("dedicated bank"),
        decouples=Decoupled(disturbances=False),
        state_map=np.vstack([np.eye(3)] * 3),
        members=tuple(Member(name, (k,), (FAULTS[k],)) for k, name in enumerate(MEMBERS)),
        codes=np.eye(3, dtype=bool),
    )
    thresholds = {name: scale * float(peak) for name, peak in zip(MEMBERS, peaks, strict=True)}
    return SimpleNamespace(generator=generator, thresholds=thresholds)


def recording(
    seconds: float = 70.0, *, drifts: Mapping[str, tuple[float, ...]] | None = None, size: float = 1.0, seed: int = 0
) -> np.ndarray:
    """Measurements under disturbances of length ``size`` at every sample, faults that grow: (start, slope[, stop])."""
    rng = np.random.default_rng(seed)
    steps = round(seconds / DT)
    w = rng.standard_normal((steps, 3))
    w *= size / np.linalg.norm(w, axis=1, keepdims=True)
    f = np.zeros((steps, 3))
    time = np.arange(steps) * DT
    for name, (start, slope, *stop) in (drifts or {}).items():
        grown = slope * np.maximum(0.0, time - start)
        f[:, FAULTS.index(name)] = np.where(time < stop[0], grown, 0.0) if stop else grown
    loop = StateSpace(A + K, np.hstack([D1 + K @ D2, K]), np.eye(3), np.hstack([D2, np.eye(3)]), dt=DT)
    return loop.simulate(np.hstack([w, f]))


#: Three sensors that drift one after the other, to the end.
THREE = {FAULTS[0]: (25.0, 0.5), FAULTS[2]: (40.0, 0.5), FAULTS[1]: (60.0, 0.5)}


def three_drifts() -> np.ndarray:
    return recording(drifts=THREE)
