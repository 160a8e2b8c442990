"""Continuous uncertain systems for the tests, made of sampled ones."""

from __future__ import annotations

import numpy as np

from residua.linear import UncertainSystem


def continuous(system: UncertainSystem) -> UncertainSystem:
    """Return a continuous system every member of which is stable, from a sampled one of which that holds."""
    return UncertainSystem(
        system.A - np.eye(system.n_states), system.Bp, system.Bw, system.Cq, system.Cz, system.Dzp, system.Dzw,
        low=system.low, high=system.high, channels=system.channels,
    )  # fmt: skip
