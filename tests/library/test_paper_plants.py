"""The example plants of papers 001 and 003."""

from __future__ import annotations

import numpy as np

from residua.library import gertler, twardy
from residua.plant import factor_disturbance


def test_twardy() -> None:
    plant = twardy()
    np.testing.assert_array_equal(plant.A, [[-1, 1, 0], [-1, 0, 0], [0, -1, -1]])
    np.testing.assert_array_equal(plant.C, [[1, 0, 0], [0, 0, 1]])
    np.testing.assert_array_equal(plant.Bd, [[-1], [0], [0]])
    assert plant.inputs == ()
    E, H = plant.Bd, np.array([[1, 0], [0, 0], [0, 0]])
    np.testing.assert_allclose(E @ np.linalg.pinv(plant.C @ E), H, atol=1e-15)
    np.testing.assert_allclose((np.eye(3) - H @ plant.C) @ plant.A, [[0, 0, 0], [-1, 0, 0], [0, -1, -1]])
    assert factor_disturbance(E)[1].rank == 1


def test_gertler_transfer_functions() -> None:
    """Example 2: the numerators and denominators of the input-output description."""
    plant = gertler()
    for z in (2.0, -1.3, 0.1 + 1j):
        lhs = np.diag([(z - 0.4) * (z - 0.5), (z - 0.5) * (z - 0.9)])
        control = lhs @ plant.system("control").evaluate([z])[0]
        np.testing.assert_allclose(control.ravel(), [1.5 * (z - 13 / 30), 1.1 * (z - 0.95 / 1.1)], rtol=1e-12)
        faults = lhs @ plant.system("fault").evaluate([z])[0]
        np.testing.assert_allclose(faults, [[2 * (z - 0.45), z - 0.4], [z - 0.9, 2 * (z - 0.7)]], rtol=1e-12)
    assert gertler(sensor_faults=True).faults == ("p1", "p2", "y1 sensor", "y2 sensor")
    assert plant.dt == 1.0
