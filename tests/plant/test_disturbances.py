"""Disturbance matrices: factoring, parameter perturbations, steady states (Chen, Patton and Zhang 1996)."""

from __future__ import annotations

import numpy as np
import pytest

from residua.errors import DataError, ModelError
from residua.library import E_HAT, jet_engine_steady_state
from residua.library.jet_engine import A, B
from residua.plant import (
    disturbance_from_parameters,
    disturbance_from_perturbations,
    disturbance_from_steady_states,
    factor_disturbance,
    quadratic_terms,
)


def test_factor_of_the_papers_disturbance_matrix() -> None:
    E1, decision = factor_disturbance(E_HAT)
    assert decision.rank == 2
    np.testing.assert_allclose(decision.singular_values[:2], [7.43618, 5.18826], atol=5e-6)
    assert decision.singular_values[2] < 1e-12
    printed = np.array([[6.2006, 2.8639], [4.1048, -4.3262], [0, 0]])
    signs = np.sign(np.sum(E1 * printed, axis=0))
    np.testing.assert_allclose(E1 * signs, printed, atol=5e-5)
    U, s, _ = np.linalg.svd(np.array(E_HAT))
    np.testing.assert_allclose(np.abs(E1), np.abs(U[:, :2] * s[:2]), atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_factor_has_the_same_range_and_full_rank(seed: int) -> None:
    rng = np.random.default_rng(seed)
    E = rng.standard_normal((5, 2)) @ rng.standard_normal((2, 7))
    E1, decision = factor_disturbance(E)
    assert E1.shape == (5, 2)
    assert decision.rank == 2
    E2 = np.linalg.lstsq(E1, E, rcond=None)[0]
    np.testing.assert_allclose(E1 @ E2, E, atol=1e-12)


def test_factor_of_nothing() -> None:
    assert factor_disturbance(np.zeros((3, 2)))[0].shape == (3, 0)
    assert factor_disturbance(np.zeros((3, 0)))[1].rank == 0


@pytest.mark.parametrize("seed", range(5))
def test_perturbations_give_back_the_model_error(seed: int) -> None:
    rng = np.random.default_rng(seed)
    A_parts, B_parts = rng.standard_normal((3, 4, 4)), rng.standard_normal((2, 4, 2))
    a, b, x, u = rng.standard_normal(3), rng.standard_normal(2), rng.standard_normal(4), rng.standard_normal(2)
    E = disturbance_from_perturbations(A_parts, B_parts)
    d = np.concatenate([*(a_i * x for a_i in a), *(b_i * u for b_i in b)])
    error = np.tensordot(a, A_parts, 1) @ x + np.tensordot(b, B_parts, 1) @ u
    np.testing.assert_allclose(E @ d, error, atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_parameters_give_back_the_model_error_to_first_order(seed: int) -> None:
    rng = np.random.default_rng(seed)
    base, slopes = rng.standard_normal((3, 5)), rng.standard_normal((2, 3, 5))

    def matrices(alpha: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        M = base + np.tensordot(np.sin(alpha), slopes, 1)
        return M[:, :3], M[:, 3:]

    alpha = rng.standard_normal(2)
    E = disturbance_from_parameters(matrices, alpha)
    x, u, change = rng.standard_normal(3), rng.standard_normal(2), rng.standard_normal(2)
    v = np.concatenate([x, u])
    expected = np.tensordot(np.cos(alpha) * change, slopes, 1) @ v
    np.testing.assert_allclose(E @ np.kron(change, v), expected, atol=1e-8)


def test_steady_states_of_the_second_order_engine_give_back_its_matrix() -> None:
    commands = np.linspace(-0.3, 0.3, 200)
    states = np.array([jet_engine_steady_state(command) for command in commands])
    estimate = disturbance_from_steady_states(A, B, states, commands)
    assert np.abs(estimate - np.array(E_HAT)).max() < 2e-10  # 2e-11 here


@pytest.mark.parametrize("seed", range(3))
def test_driven_in_every_equation_the_estimate_is_exact(seed: int) -> None:
    rng = np.random.default_rng(seed)
    drive = np.hstack([np.array(B), np.eye(3)])
    x = rng.standard_normal((60, 3))
    forces = -(x @ np.array(A).T + quadratic_terms(x) @ np.array(E_HAT).T)
    estimate = disturbance_from_steady_states(A, drive, x, np.hstack([np.zeros((60, 1)), forces]))
    assert np.abs(estimate - np.array(E_HAT)).max() < 1e-12


def test_quadratic_terms_come_in_the_papers_order() -> None:
    np.testing.assert_array_equal(quadratic_terms([2.0, 3.0, 5.0]), [4, 9, 25, 6, 10, 15])


@pytest.mark.parametrize(
    ("states", "inputs", "message"),
    [
        (np.ones((3, 3)), np.ones(3), "3 steady states cannot determine 6 terms"),
        (np.ones((10, 2)), np.ones(10), r"states must be \(N, 3\)"),
        (np.full((10, 3), np.nan), np.ones(10), "finite"),
        (np.ones((10, 3)), np.ones(10), "do not excite every term"),
        (np.zeros((10, 3)), np.ones(10), "zero in every steady state"),
    ],
)
def test_poor_steady_states_are_refused(states: np.ndarray, inputs: np.ndarray, message: str) -> None:
    with pytest.raises(DataError, match=message):
        disturbance_from_steady_states(A, B, states, inputs)


def test_bad_perturbations_are_refused() -> None:
    with pytest.raises(ModelError, match="at least one"):
        disturbance_from_perturbations()
    with pytest.raises(ModelError, match="one row per state"):
        disturbance_from_perturbations([np.eye(2), np.eye(3)])
