"""Gertler's survey: primary residuals, Example 2 A and B, attainable rows, the equivalence of all four designs."""

from __future__ import annotations

import numpy as np
import pytest

import residua as rs
from residua.errors import DesignError
from residua.linear import PolynomialMatrix

#: The residual of Example 2 that ignores p1, newest sample first, for y1, y2 and u.
Y1, Y2, U = [1, -1.3, 0.36], [-2, 2.7, -0.81], [0, 0.7, -0.54]
PARITY_VECTOR = [0.36, -0.81, -1.3, 2.7, 1, -2]


@pytest.fixture(scope="module")
def plant() -> rs.Plant:
    return rs.library.gertler()


def newest_first(rows: PolynomialMatrix, order: int) -> np.ndarray:
    """Return the coefficients of the first row, newest sample first, shape (order + 1, signals)."""
    return rows.padded(order)[::-1, 0]


def test_input_output_form_of_example_2(plant: rs.Plant) -> None:
    io = rs.InputOutputModel.from_plant(plant)
    for i, (h, g_u, g_p1, g_p2) in enumerate(
        [
            (np.poly([0.4, 0.5]), [1.5, -0.65], [2, -0.9], [1, -0.4]),
            (np.poly([0.5, 0.9]), [1.1, -0.95], [1, -0.9], [2, -1.4]),
        ]
    ):
        assert np.allclose(io.H.coefficients[::-1, i, i], h, atol=1e-12)
        assert np.allclose(io.G.padded(1)[::-1, i, 0], g_u, atol=1e-12)
        assert np.allclose(io.Gf.padded(1)[::-1, i], np.transpose([g_p1, g_p2]), atol=1e-12)


@pytest.mark.parametrize("through", ["plant", "input-output model"])
def test_example_2_a_and_b(plant: rs.Plant, through: str) -> None:
    """One relation of order two ignores p1, whichever way the plant is given."""
    source = plant if through == "plant" else rs.InputOutputModel.from_plant(plant)
    relations = rs.design.parity_relations(source, insensitive_to="p1").relations
    assert relations is not None
    assert relations.orders == (2,)
    y, u = newest_first(relations.output_rows, 2), newest_first(relations.input_rows, 2)
    assert np.allclose(y, np.transpose([Y1, Y2]), atol=1e-10)
    assert np.allclose(u[:, 0], U, atol=1e-10)
    assert np.allclose(newest_first(relations.fault_rows, 2), [[0, 0], [0, -3], [0, 1.8]], atol=1e-10)
    w = relations.parity_vectors[0]
    assert np.allclose(w, PARITY_VECTOR, atol=1e-10)


def test_the_parity_vector_solves_the_scheme_of_chow_and_willsky(plant: rs.Plant) -> None:
    R, Q = rs.design.chow_willsky_matrices(plant, 2)
    assert np.allclose(R[-2:], [[0.16, 0.25, 0], [0, 0.25, 0.81]])
    assert np.allclose(Q["control"][-2:], [[0.7, 1.5, 0], [0.59, 1.1, 0]])
    assert np.allclose(Q["fault"][-2:], [[0.9, 0.5, 2, 1, 0, 0], [0.5, 1.4, 1, 2, 0, 0]])
    constraints = np.hstack([R, Q["fault"][:, [0, 2, 4]]])  # the state and p1 at all three samples
    left = np.linalg.svd(constraints)[0][:, np.linalg.matrix_rank(constraints) :]
    assert left.shape[1] == 1
    assert np.allclose(left[:, 0] / left[-2, 0], PARITY_VECTOR, atol=1e-10)


def test_the_polynomial_null_vector_needs_a_common_factor_divided_out(plant: rs.Plant) -> None:
    """Example 2 A as the paper does it, with w = [z - 0.9, -2 (z - 0.45)], and the factor that it leaves out."""
    io = rs.InputOutputModel.from_plant(plant)
    p1 = io.Gf.select(columns=[0])
    found = rs.linear.shortest_left_null_vectors(p1, most=3)
    assert found is not None
    assert found.vectors.shape == (1, 2, 2)
    w = found.vectors[0] / found.vectors[0, 1, 0]
    assert np.allclose(w, [[-0.9, 0.9], [1, -2]], atol=1e-12)
    signals = PolynomialMatrix(w[:, None]) @ io.H.beside(-io.G, io.Gf.select(columns=[1]))
    whole = rs.linear.primitive_part(signals)
    assert np.allclose(whole.roots, [0.5], atol=1e-9)
    assert np.allclose(newest_first(whole.matrix, 2), np.transpose([Y1, Y2, U, [0, -3, 1.8]]), atol=1e-10)


def test_primary_residuals_in_both_forms(plant: rs.Plant) -> None:
    with_sensors = rs.library.gertler(sensor_faults=True)
    moving = rs.design.primary_residuals(with_sensors)
    assert moving.structure.tolist() == [[True, True, True, False], [True, True, False, True]]
    exact = rs.design.primary_residuals(with_sensors, form="arma")
    assert np.allclose(np.sort(exact.system.poles().real), [0.4, 0.5, 0.9])
    w = np.linspace(0.1, 3, 20)
    z = np.exp(1j * w)
    H = np.array([[np.polyval(np.poly([0.4, 0.5]), z) / z**2], [np.polyval(np.poly([0.5, 0.9]), z) / z**2]])
    assert np.allclose(
        moving.system.frequency_response(w), exact.system.frequency_response(w) * H.transpose(2, 0, 1), atol=1e-12
    )
    found = moving.equivalent_to(exact)
    assert found
    assert found.kind == "poles"


def test_the_attainable_rows_with_sensor_faults() -> None:
    """Five rows, by relations of order at most two."""
    plant = rs.library.gertler(sensor_faults=True)
    attainable = []
    for number in range(1, 16):
        row = f"{number:04b}"
        try:
            bank = rs.design.structured_parity(plant, [row])
        except DesignError:
            continue
        attainable.append(row)
        assert bank.generator.relations is not None
        assert bank.generator.relations.orders[0] <= 2
        assert bank.structure[0].tolist() == [digit == "1" for digit in row]
    assert attainable == ["0111", "1011", "1101", "1110", "1111"]


@pytest.mark.parametrize("through", ["plant", "input-output model"])
def test_all_four_designs_of_example_2_are_one(plant: rs.Plant, through: str) -> None:
    source = plant if through == "plant" else rs.InputOutputModel.from_plant(plant)
    designs = {
        "A": rs.design.structured_parity(source, ["01"]).generator,
        "B": rs.design.parity_relations(source, insensitive_to="p1"),
        "C": rs.design.eigenstructure_assignment(plant, side="right", poles=[0, 0.25, 0.3], insensitive_to=["p1"]),
        "D": rs.design.decoupled_residual(plant, insensitive_to=["p1"], poles=[0.25, 0.3]),
    }
    for first in designs.values():
        for second in designs.values():
            found = first.equivalent_to(second)
            assert found
            assert found.kind in ("identical", "scale", "poles")
            assert found.error < 1e-9
    for made in designs.values():
        relations = made.to_parity()
        assert np.allclose(newest_first(relations.output_rows, 2), np.transpose([Y1, Y2]), atol=1e-9)


def test_poles_are_assigned_by_division(plant: rs.Plant) -> None:
    """(z - 0.25)(z - 0.3) r = (0.7 z - 0.54) u + (z - 0.4)(z - 0.9) y1 - (2 z - 0.9)(z - 0.9) y2."""
    made = rs.design.parity_relations(plant, insensitive_to="p1").with_poles([0.25, 0.3])
    z = np.exp(1j * np.linspace(0.1, 3, 20))
    d = (z - 0.25) * (z - 0.3)
    expected = np.array([0.7 * z - 0.54, (z - 0.4) * (z - 0.9), -(2 * z - 0.9) * (z - 0.9)]) / d
    assert np.allclose(made.system.frequency_response(np.linspace(0.1, 3, 20))[:, 0].T, expected, atol=1e-12)
    assert np.allclose(np.sort(made.system.poles().real), [0.25, 0.3], atol=1e-15)
