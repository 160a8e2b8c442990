"""Known delays of inputs as states of a plant."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from residua.plant import Plant


def with_input_delays(plant: Plant, delays: Mapping[str, int]) -> Plant:
    """Return a sampled plant without faults and disturbances whose inputs act so many samples later.

    Each sample of delay is a state: ``w1[k+1] = u[k]``, ``w2[k+1] = w1[k]``, and so on.
    """
    total = sum(delays.values())
    if not total:
        return plant
    n, m = plant.n_states, len(plant.inputs)
    A, C = np.zeros((n + total, n + total)), np.zeros((plant.n_outputs, n + total))
    B, D = np.zeros((n + total, m)), np.array(plant.Du)
    A[:n, :n], C[:, :n], B[:n] = plant.A, plant.C, plant.Bu
    first = n
    for name, rows in delays.items():
        j = plant.inputs.index(name)
        if not rows:
            continue
        last = first + rows - 1
        A[:n, last], C[:, last], D[:, j] = plant.Bu[:, j], plant.Du[:, j], 0.0
        B[:n, j], B[first, j] = 0.0, 1.0
        A[range(first + 1, last + 1), range(first, last)] = 1.0
        first += rows
    made = Plant(
        A,
        B,
        C,
        D,
        dt=plant.dt,
        inputs=plant.inputs,
        outputs=plant.outputs,
        name=plant.name,
        operating_point=plant.operating_point,
        units=plant.units,
    )
    if not plant.Bw.shape[1]:
        return made
    return made.with_noise_input(np.vstack([plant.Bw, np.zeros((total, plant.Bw.shape[1]))]), plant.Dw)
