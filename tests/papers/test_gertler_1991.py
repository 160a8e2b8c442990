"""Numbers of Gertler's survey that belong to observers (E-V5, part D)."""

from __future__ import annotations

import numpy as np

import residua as rs
from residua.design.core.decoupling import Decoupled
from residua.design.core.evidence import Evidence
from residua.design.core.generator import make_generator
from residua.linear import StateSpace

M = np.diag([0.25, 0.3])
T = np.array([[6.5, -6.5, -4], [6, -6, -3]])
N = np.array([[0.975, -2.6], [0.6, -1.8]])  # printed as a second "T"
J = np.array([[-3.65], [-3.3]])
LS, LY = np.array([[-2.0, 2]]), np.array([[1.0, -2]])


def test_v5_d_the_printed_unknown_input_observer() -> None:
    plant = rs.library.gertler()
    np.testing.assert_allclose(T @ plant.A - M @ T - N @ plant.C, 0, atol=1e-12)
    np.testing.assert_allclose(T @ plant.B, J, atol=1e-12)
    np.testing.assert_allclose(LS @ T + LY @ plant.C, 0, atol=1e-12)
    np.testing.assert_allclose(T @ plant.Bf[:, 0], 0, atol=1e-12)
    system = StateSpace(M, np.hstack([J, N]), LS, np.hstack([[[0.0]], LY]), dt=1, outputs=["r"])
    printed = make_generator(
        system,
        plant,
        "Gertler (1991), Example 2 D",
        Evidence(method="printed"),
        decouples=Decoupled(faults=("p1",)),
        state_map=T,
    )
    z = np.exp(1j * np.array([0.2, 1.0, 2.5]))
    denominator = (z - 0.25) * (z - 0.3)
    form = printed.internal_form().evaluate(z)[:, 0]
    np.testing.assert_allclose(form[:, 0], 0, atol=1e-12)
    np.testing.assert_allclose(form[:, 1] * denominator, -3 * (z - 0.6), atol=1e-12)


def test_v5_d_the_decoupled_residual_is_the_printed_one() -> None:
    """The same filter, up to scale: computed from subspaces, with the paper's poles."""
    found = rs.design.decoupled_residual(rs.library.gertler(), insensitive_to="p1", poles=[0.25, 0.3])
    z = np.exp(1j * np.array([0.2, 1.0, 2.5]))
    u, y1, y2 = found.system.evaluate(z)[:, 0].T * ((z - 0.25) * (z - 0.3))
    scale = y1 / ((z - 0.4) * (z - 0.9))
    np.testing.assert_allclose(scale, scale[0].real, atol=1e-10)
    np.testing.assert_allclose(u / scale, 0.7 * z - 0.54, atol=1e-10)
    np.testing.assert_allclose(y2 / scale, -2 * (z - 0.45) * (z - 0.9), atol=1e-10)
