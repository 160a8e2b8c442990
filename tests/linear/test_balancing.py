"""Balanced units where no scaling gives all rows and columns one size."""

from __future__ import annotations

import numpy as np
import pytest

import residua as rs


@pytest.mark.parametrize("count", [2, 3, 4])
def test_an_estimator_decouples_faults_that_several_outputs_read(count: int) -> None:
    """The scales that ran away hid a fault that several sensors read from the check of the estimator."""
    plant = rs.Plant(
        [[-1.0, 0.5], [0.3, -2.0]], [[1.0], [1.0]], np.vstack([[1.0, 0.3], [0.7, 1.0], np.zeros((count, 2))])
    )
    plant = plant.with_faults(
        {"drift": ([1.0, 0.7], np.zeros(count + 2)), "supply": ([0.0, 0.0], [0.0] + [1.0] * (count + 1))}
    )
    found = rs.design.fault_estimator(plant, faults=["drift", "supply"])
    s = 0.5j
    from_faults = plant.C @ np.linalg.solve(s * np.eye(2) - plant.A, plant.Bf) + plant.Df
    K = found.system
    gain = K.C @ np.linalg.solve(s * np.eye(K.n_states) - K.A, K.B) + K.D
    assert np.abs((gain[:, 1:] @ from_faults)[0, 1]) < 1e-9
