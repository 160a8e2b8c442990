"""What rounding makes of the residual of a filter, beside what a fault leaves in it."""

from __future__ import annotations

import numpy as np

from residua.design.core.generator import ResidualGenerator
from residua.design.core.internal_form import frequency_grid

_EPS = float(np.finfo(float).eps)


def rounding_share(generator: ResidualGenerator) -> float:
    r"""Return how large rounding is over the response to the fault that is weakest against it.

    For the signals of a slow fault: the terms :math:`|F| |x| + |K| |y|` of each step are rounded and pass through
    :math:`C (zI - F)^{-1}` on to the residual, whose own terms are :math:`|C| |x| + |D| |y|`. Zero without faults.
    """
    system, plant = generator.system, generator.plant
    w = frequency_grid(system, plant.system(()))
    w = w[: max(len(w) // 3, 1)]
    y = np.abs(plant.system("fault").frequency_response(w))
    n_u, n = len(plant.inputs), system.n_states
    K, H = np.abs(system.B[:, n_u:]), np.abs(system.D[:, n_u:])
    response = np.abs(generator.internal_form().frequency_response(w)[:, :, : len(plant.faults)])
    left = H @ y
    if n:
        z = np.exp(1j * w * plant.dt) if plant.is_discrete else 1j * w
        R = np.linalg.inv(z[:, None, None] * np.eye(n) - system.A)
        x = np.abs(R @ system.B[:, n_u:] @ plant.system("fault").frequency_response(w))
        steps = np.abs(system.A) @ x + K @ y
        left = left + np.abs(system.C) @ x + np.abs(system.C @ R) @ steps
    # A response below the rounding of its terms is lost as a whole, however small it is: a share of one.
    lost = response < _EPS * left
    share = np.median(np.where(lost, 1.0, _EPS * left / np.where(lost | (response == 0), 1.0, response)), axis=0)
    best = np.where(generator.structure, share, np.inf).min(axis=0, initial=np.inf)  # of the residuals that see it
    return float(np.max(best, initial=0.0, where=np.isfinite(best)))
