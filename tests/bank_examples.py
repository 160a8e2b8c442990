"""Banks stacked by hand from observers that each leave sensors out, and recordings of their plants."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.linalg

import residua as rs
from residua.design import Member, ResidualGenerator
from residua.design.core.decoupling import Decoupled
from residua.design.core.evidence import Evidence
from residua.design.core.generator import make_generator
from residua.linear import StateSpace


def sampled_plant(seed: int, *, outputs: int = 4, states: int = 4, actuators: bool = False) -> rs.Plant:
    """A stable plant with noise, a fault on every sensor, and units."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((states, states))
    A *= 0.8 / np.abs(np.linalg.eigvals(A)).max()
    plant = rs.Plant(
        A,
        rng.standard_normal((states, 2)),
        rng.standard_normal((outputs, states)),
        dt=0.5,
        units={f"y{i + 1}": "m" for i in range(outputs)},
        name="hand-made",
    )
    plant = plant.with_operating_point(inputs=[1.0, -2.0], outputs=np.arange(outputs) + 3.0)
    plant = plant.with_sensor_faults()
    if actuators:
        plant = plant.with_actuator_faults()
    return plant.with_noise(process=0.05, measurement=0.05)


def observer_on(plant: rs.Plant, used: Sequence[int]) -> tuple[StateSpace, np.ndarray]:
    """The stationary Kalman filter of some of the outputs, from SciPy's Riccati solver: its system, and its T."""
    A, C, n_y = plant.A, plant.C[list(used)], plant.n_outputs
    Q, R = plant.Bw @ plant.Bw.T, plant.Dw[list(used)] @ plant.Dw[list(used)].T
    P = scipy.linalg.solve_discrete_are(A.T, C.T, Q, R)
    K = A @ P @ C.T @ np.linalg.inv(C @ P @ C.T + R)
    pick = np.eye(n_y)[list(used)]
    system = StateSpace(
        A - K @ C,
        np.hstack([plant.B, K @ pick]),
        -C,
        np.hstack([np.zeros((len(used), len(plant.inputs))), pick]),
        dt=plant.dt,
    )
    return system, np.eye(plant.n_states)


def hand_made_bank(plant: rs.Plant, *, dedicated: bool = False) -> ResidualGenerator:
    """Member ``j`` uses all sensors but ``y_j``, or ``y_j`` alone."""
    m = plant.n_outputs
    choices = [[j] if dedicated else [i for i in range(m) if i != j] for j in range(m)]
    parts = [observer_on(plant, used) for used in choices]
    systems = [system for system, _ in parts]
    counts = np.cumsum([0, *(system.n_outputs for system in systems)])
    names = [f"{'only' if dedicated else 'without'} {y}" for y in plant.outputs]
    codes = np.array(
        [[plant.Df[used, j].any() or plant.Bf[:, j].any() for j in range(len(plant.faults))] for used in choices]
    )
    stacked = StateSpace(
        scipy.linalg.block_diag(*(s.A for s in systems)),
        np.vstack([s.B for s in systems]),
        scipy.linalg.block_diag(*(s.C for s in systems)),
        np.vstack([s.D for s in systems]),
        dt=plant.dt,
        outputs=[f"r {plant.outputs[i]}, {name}" for name, used in zip(names, choices, strict=True) for i in used],
    )
    members = tuple(
        Member(
            name,
            tuple(range(counts[k], counts[k + 1])),
            tuple(f for f, on in zip(plant.faults, codes[k], strict=True) if on),
        )
        for k, name in enumerate(names)
    )
    return make_generator(
        stacked,
        plant,
        "hand-made bank",
        Evidence("hand-made bank"),
        decouples=Decoupled(disturbances=False),
        state_map=np.vstack([T for _, T in parts]),
        members=members,
        codes=codes,
    )


def static_estimator(plant: rs.Plant, fault: str) -> ResidualGenerator:
    """The one parity relation of a plant with a sensor more than states, scaled to the size of one sensor fault."""
    v = scipy.linalg.null_space(plant.C.T)[:, 0]
    v = v / (v @ plant.Df[:, plant.faults.index(fault)])
    n_u = len(plant.inputs)
    system = StateSpace(
        np.zeros((0, 0)),
        np.zeros((0, n_u + len(v))),
        np.zeros((1, 0)),
        np.concatenate([np.zeros(n_u), v])[None],
        dt=plant.dt,
        outputs=[f"estimate {fault}"],
    )
    evidence = Evidence("parity relation")
    maps = {
        "decouples": Decoupled(disturbances=False),
        "state_map": np.zeros((0, plant.n_states)),
        "estimated": (fault,),
    }
    return make_generator(system, plant, "parity relation", evidence, **maps)  # pyright: ignore


def recording(
    plant: rs.Plant, samples: int = 1500, *, faults: dict[str, float] | None = None, start: int = 800, seed: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Random inputs, noise, and constant faults from ``start`` on, in plant units."""
    rng = np.random.default_rng(seed)
    u = rng.standard_normal((samples, len(plant.inputs)))
    f = np.zeros((samples, len(plant.faults)))
    for name, size in (faults or {}).items():
        f[start:, plant.faults.index(name)] = size
    w = rng.standard_normal((samples, len(plant.noises)))
    y = plant.system(("control", "fault", "noise")).simulate(np.hstack([u, f, w]))
    return u + plant.operating_point.inputs, y + plant.operating_point.outputs


def with_gaps(u: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Missing values at the start, short gaps and one that is longer than is held."""
    u, y = u.copy(), y.copy()
    y[:4] = np.nan
    y[100:103, 0] = np.nan
    y[400:430] = np.inf
    u[900] = np.nan
    return u, y
