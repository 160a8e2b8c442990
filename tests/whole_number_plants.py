"""Plants of small whole numbers in eighteen kinds, and the same plants in other units."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import residua as rs

_FEW = np.array([-3, -2, -1, 0, 0, 1, 2, 3])
KINDS = (
    "dense",
    "sparse",
    "companion",
    "chain",
    "integrators",
    "delays",
    "stiff",
    "repeated poles",
    "dead sensor",
    "duplicated sensor",
    "feedthrough",
    "no states",
    "more outputs than states",
    "one sensor",
    "index one",
    "singular",
    "zero at the limit",
    "disturbed",
)


def whole_number_plant(seed: int) -> rs.Plant:
    """Return the plant of a seed: of order 0 to 6, with 2 to 6 faults, of the kind ``seed % 18``."""
    rng = np.random.default_rng([31, seed])
    kind = KINDS[seed % len(KINDS)]
    n = 0 if kind == "no states" else int(rng.integers(1, 7))
    p = {"one sensor": 1, "more outputs than states": n + int(rng.integers(1, 3))}.get(kind, int(rng.integers(1, 5)))
    dt = float(rng.choice([0.0, 0.5]))
    A = _dynamics(kind, n, rng)
    if dt:
        A = A / 4.0 if kind not in ("integrators", "delays") else A + (kind == "integrators") * np.eye(n)
    C = _sensors(kind, p, n, rng)
    B = rng.choice(_FEW, (n, int(rng.integers(1, 3)))) * 1.0
    if n:
        B[0, ~B.any(axis=0)] = 1.0
    D = rng.choice(_FEW, (p, B.shape[1])) * 1.0 if kind in ("feedthrough", "no states") else None
    E = _descriptor(kind, A, rng)
    if kind == "zero at the limit" and n > 1:  # an input that passes a differentiator
        A[0], B[0] = 0.0, 0.0
        A[0, 1], C[:, 1:] = 1.0, 0.0
        A[0] += float(dt > 0) * np.eye(n)[0]
    plant = rs.Plant(A, B, C, D, E=E, dt=dt)
    count = int(rng.integers(1, 3)) if kind == "disturbed" else int(rng.random() < 0.4)
    for k in range(count):
        d = rng.choice(_FEW, n), rng.choice(_FEW, p) * (rng.random() < 0.3 or n == 0)
        if np.any(d[0]) or np.any(d[1]):
            plant = plant.with_disturbances({f"d{k}": d})
    return _with_faults(plant, rng)


def _with_faults(plant: rs.Plant, rng: np.random.Generator) -> rs.Plant:
    plant = plant.with_actuator_faults().with_sensor_faults()
    n, p = plant.n_states, plant.n_outputs
    more = {f"f{i}": (rng.choice(_FEW, n), rng.choice(_FEW, p) * (rng.random() < 0.2)) for i in range(2)}
    plant = plant.with_faults({name: f for name, f in more.items() if np.any(f[0]) or np.any(f[1])})
    kept = rng.permutation(len(plant.faults))[: int(rng.integers(2, 7))]
    return plant.without_faults([name for i, name in enumerate(plant.faults) if i not in kept])


def _dynamics(kind: str, n: int, rng: np.random.Generator) -> NDArray:
    if kind == "sparse":
        return rng.choice(_FEW, (n, n)) * (rng.random((n, n)) < 2 / n) * 1.0
    if kind == "companion" and n:
        return np.vstack([np.eye(n)[1:], rng.choice(_FEW, n)])
    if kind == "chain":
        return np.diag(rng.choice([-3.0, -2, -1], n)) + np.diag(rng.choice([1.0, 2], max(n - 1, 0)), -1)[:n, :n]
    if kind in ("integrators", "delays"):
        return np.diag(np.ones(max(n - 1, 0)), -1)[:n, :n]
    if kind == "stiff":
        return np.diag(2.0 ** -rng.integers(-8, 9, n)) @ rng.choice(_FEW, (n, n)) * 1.0
    if kind == "repeated poles":
        return -2.0 * np.eye(n) + np.triu(rng.choice([0.0, 0, 1, 2], (n, n)), 1)
    return rng.choice(_FEW, (n, n)) * 1.0


def _sensors(kind: str, p: int, n: int, rng: np.random.Generator) -> NDArray:
    C = rng.choice(_FEW, (p, n)) * 1.0
    if n and rng.random() < 0.5:
        C = np.eye(n)[rng.integers(0, n, p)]
    if kind == "dead sensor":
        C[int(rng.integers(p))] = 0.0
    if kind == "duplicated sensor":
        C[-1] = C[0]
    return C


def _descriptor(kind: str, A: NDArray, rng: np.random.Generator) -> NDArray | None:
    """Return an ``E`` with a regular pencil, of index one or any; ``None`` for an ordinary plant."""
    n = len(A)
    if kind not in ("index one", "singular"):
        return None
    for _ in range(100):
        E = np.diag(rng.integers(0, 2, n)) * 1.0
        if kind == "singular":
            E = E @ rng.choice(_FEW, (n, n))
        algebraic = ~E.any(axis=1) if kind == "singular" else np.diag(E) == 0
        block = A[np.ix_(algebraic, algebraic)]
        fine = kind == "singular" or not algebraic.any() or round(abs(np.linalg.det(block))) >= 1
        regular = max(abs(np.linalg.det(s * E - A)) for s in (0.37, 1.91, -2.3)) > 1e-9
        if fine and regular:
            return E
    A[:] = A - 7 * np.eye(n)
    return np.eye(n)


def in_other_units(plant: rs.Plant, seed: int, widest: int = 20) -> rs.Plant:
    """Return the plant with states, equations, inputs, outputs, disturbances and faults in units of powers of two."""
    rng = np.random.default_rng([32, seed])

    def units(count: int) -> NDArray:
        return 2.0 ** rng.integers(-widest, widest + 1, count)

    T, Y, U = units(plant.n_states), units(plant.n_outputs), units(len(plant.inputs))
    R = 1 / T if plant.E is None else units(plant.n_states)
    E = None if plant.E is None else R[:, None] * plant.E * T
    out = rs.Plant(
        R[:, None] * plant.A * T,
        R[:, None] * plant.B * U,
        Y[:, None] * plant.C * T,
        Y[:, None] * plant.D * U,
        E=E,
        dt=plant.dt,
        inputs=plant.inputs,
        outputs=plant.outputs,
    )
    Vd, Vf = units(len(plant.disturbances)), units(len(plant.faults))

    def columns(B: NDArray, D: NDArray, V: NDArray, i: int) -> tuple[NDArray, NDArray]:
        return R * B[:, i] * V[i], Y * D[:, i] * V[i]

    if plant.disturbances:
        out = out.with_disturbances(
            {name: columns(plant.Bd, plant.Dd, Vd, i) for i, name in enumerate(plant.disturbances)}
        )
    return out.with_faults({name: columns(plant.Bf, plant.Df, Vf, i) for i, name in enumerate(plant.faults)})
