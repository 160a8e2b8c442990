"""Gertler's survey, section 5.2: Example 3 B, and its place among all relations with these directions."""

from __future__ import annotations

import numpy as np
import pytest

import residua as rs
from residua.design.parity.directional_parity import directional_parity
from residua.errors import DesignError

#: Example 3: the directions of Example 3, and the paper's solution of part B, highest power first: on y1, y2 and u.
DIRECTIONS = {"p1": [2, 1], "p2": [1, 2]}
PAPER = [
    (3.5 * np.poly([0.4, 47 / 70]), -np.poly([0.35, 0.9]), [0, -4.15, 4.15 * 239 / 415]),
    (np.poly([0.4, 0.5]), np.poly([0.5, 0.9]), [0, -2.6, 2.6 * 8 / 13]),
]


@pytest.fixture(scope="module")
def plant() -> rs.Plant:
    return rs.library.gertler()


def solutions(plant: rs.Plant, order: int) -> np.ndarray:
    """Return orthonormal rows [w1, w2] of all pairs of parity vectors of an order with the directions of the example.

    With the matrices of Chow and Willsky, and the coefficients of gamma as further unknowns: no pencil, no states.
    """
    R, Q = rs.design.chow_willsky_matrices(plant, order)
    length, k = len(R), order + 1
    columns = [np.vstack([np.kron([[1.0], [0]], R), np.zeros((2 * k, R.shape[1]))])]
    columns += [np.vstack([np.kron([[0.0], [1]], R), np.zeros((2 * k, R.shape[1]))])]
    for i in range(2):
        for j, direction in enumerate(DIRECTIONS.values()):
            block = np.zeros((2 * length + 2 * k, k))
            block[i * length : (i + 1) * length] = Q["fault"][:, j::2]
            block[2 * length + j * k : 2 * length + (j + 1) * k] = -direction[i] * np.eye(k)
            columns.append(block)
    M = np.hstack(columns)
    U, s, _ = np.linalg.svd(M)
    rank = int(np.count_nonzero(s > 1e-12 * s[0]))
    found = U[:, rank:].T[:, : 2 * length]
    return np.linalg.svd(found, full_matrices=False)[2]


def vectors(relations: rs.design.ParityRelations, order: int) -> np.ndarray:
    """Return [w1, w2], the oldest sample first, with leading zeros up to an order."""
    w = relations.parity_vectors
    assert max(relations.orders) <= order
    return np.hstack([w, np.zeros((2, 2 * (order + 1) - w.shape[1]))]).ravel()


def outside(space: np.ndarray, w: np.ndarray) -> float:
    """Return which share of a vector lies outside a space."""
    return float(np.linalg.norm(w - space.T @ (space @ w)) / np.linalg.norm(w))


def test_responses_keep_the_directions_of_example_3(plant: rs.Plant) -> None:
    made = directional_parity(plant, directions=DIRECTIONS)
    assert made.relations is not None
    assert made.relations.orders == (2, 2)
    response = made.relations.fault_rows.coefficients
    for j, direction in enumerate(DIRECTIONS.values()):
        gamma = response[:, :, j] @ np.array(direction) / 5
        np.testing.assert_allclose(response[:, :, j], np.outer(gamma, direction), atol=1e-12)
        assert np.abs(gamma).max() > 0.1
    np.testing.assert_allclose(made.directions["p1"], np.array([2, 1]) / np.sqrt(5), atol=1e-12)
    assert abs(made.directions["p2"] @ np.array([1, 2]) / np.sqrt(5)) == pytest.approx(1, abs=1e-12)


def test_the_printed_solution_is_one_of_the_family(plant: rs.Plant) -> None:
    """Responses (6, 3)(z - 0.6) and (1.5, 3)(z - 0.6), with w11 = 3.5 (z - 47/70): with the corrected signs."""
    space = solutions(plant, 2)
    printed = np.array([[y1, y2] for y1, y2, _ in PAPER])[:, :, ::-1].transpose(0, 2, 1)  # the oldest sample first
    assert outside(space, printed.ravel()) < 1e-12
    made = directional_parity(plant, directions=DIRECTIONS)
    assert made.relations is not None
    assert outside(space, vectors(made.relations, 2)) < 1e-12
    # it is not the only one: what the design found is another
    assert len(space) == 2
    # what the family says about the inputs and the faults is what is printed: both solutions and their sums
    A, B = vectors(made.relations, 2), printed.ravel()
    z = 0.3 + 0.8j
    S = plant.system(("control", "fault")).evaluate(np.array([z]))[0]
    W = (printed * np.array([1, z, z**2])[:, None]).sum(axis=1)
    np.testing.assert_allclose(-(W @ S)[:, 0], [np.polyval(u, z) for _, _, u in PAPER], atol=1e-12)
    np.testing.assert_allclose((W @ S)[:, 1:], np.array([[6, 1.5], [3, 3]]) * (z - 0.6), atol=1e-12)
    assert np.linalg.matrix_rank(np.vstack([A, B]), tol=1e-6) == 2


def test_the_detection_filter_of_part_a_is_one_of_the_family(plant: rs.Plant) -> None:
    """Part A has the poles 0.25, 0.3 and 0.6: relations of order three, of which all responses have (z - 0.6)."""
    filter_ = rs.design.detection_filter(plant, poles=[0.25, 0.3, 0.6])
    relations = filter_.to_parity()
    space = solutions(plant, 3)
    assert outside(space, vectors(relations, 3)) < 1e-12
    # and not because everything is
    assert len(space) < 8
    assert outside(space, np.random.default_rng(0).standard_normal(16)) > 0.5
    # one more sample makes room for it and for the shorter ones, at two places
    made = directional_parity(plant, directions=DIRECTIONS)
    assert made.relations is not None
    assert outside(space, vectors(made.relations, 3)) < 1e-12


def test_m_plus_one_directions_and_no_more() -> None:
    plant = rs.library.gertler(sensor_faults=True)
    wanted = {**DIRECTIONS, "y1 sensor": [1, -1]}
    made = directional_parity(plant, directions=wanted)
    assert set(made.directions) == set(wanted)
    for name, direction in wanted.items():
        unit = np.array(direction) / np.linalg.norm(direction)
        assert abs(made.directions[name] @ unit) == pytest.approx(1, abs=1e-12)
    message = r"4 directions of 2 residuals are 4 conditions; 2 independent relations leave 3 .* at most 3 directions"
    with pytest.raises(DesignError, match=message):
        directional_parity(plant, directions={**wanted, "y2 sensor": [3, 1]})


def test_through_the_equations_as_well(plant: rs.Plant) -> None:
    io = rs.InputOutputModel.from_plant(plant)
    made = directional_parity(io, directions=DIRECTIONS)
    assert made.relations is not None
    assert outside(solutions(plant, 2), vectors(made.relations, 2)) < 1e-10
