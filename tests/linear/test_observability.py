"""The observability staircase finds what was planted, in any units, and never calls a hidden integrator stable."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

from residua.errors import DesignError, ModelError
from residua.linear.poles.placement import place_observer_margin
from residua.linear.poles.spectrum import match_poles
from residua.linear.poles.stability import is_stable_mode
from residua.linear.subspaces.observability import detectability, observability_form


def planted(rng, n, k, p):
    """A pair with exactly ``n - k`` unobservable modes, in random orthogonal coordinates."""
    A, C = rng.normal(size=(n, n)), rng.normal(size=(p, n))
    A[:k, k:] = 0
    C[:, k:] = 0
    hidden = np.linalg.eigvals(A[k:, k:])
    T = np.linalg.qr(rng.normal(size=(n, n)))[0]
    return T @ A @ T.T, C @ T.T, hidden


@pytest.mark.parametrize("seed", range(40))
def test_planted_unobservable_modes_are_found(seed):
    rng = np.random.default_rng(seed)
    n, p = int(rng.integers(2, 25)), int(rng.integers(1, 4))
    k = int(rng.integers(0, n))
    A, C, hidden = planted(rng, n, k, p)
    form = observability_form(A, C)
    Q = form.transformation
    assert form.n_observable == k
    np.testing.assert_allclose(Q.T @ Q, np.eye(n), atol=1e-13)
    np.testing.assert_allclose(Q @ form.A @ Q.T, A, atol=1e-11 * np.linalg.norm(A))
    np.testing.assert_allclose(C @ Q, form.C, atol=1e-11 * np.linalg.norm(C))
    assert not form.A[:k, k:].any()
    assert not form.C[:, k:].any()
    modes = form.unobservable_modes[match_poles(hidden, form.unobservable_modes)]
    np.testing.assert_allclose(modes, hidden, atol=1e-8)


@pytest.mark.parametrize("seed", range(30))
def test_decision_does_not_depend_on_units(seed):
    rng = np.random.default_rng(seed)
    n, p = int(rng.integers(3, 9)), 2
    k = int(rng.integers(1, n))
    A, C = rng.normal(size=(n, n)), rng.normal(size=(p, n))
    A[:k, k:] = 0
    C[:, k:] = 0
    s, y = 10.0 ** rng.uniform(-4, 4, n), 10.0 ** rng.uniform(-6, 6, p)
    form = observability_form(A * s[:, None] / s, y[:, None] * C / s)
    assert form.n_observable == k
    assert form.residual < 1e-9
    np.testing.assert_allclose(np.sort_complex(form.unobservable_modes), np.sort_complex(np.linalg.eigvals(A[k:, k:])))


def test_plant_sampled_fast_stays_observable():
    A = scipy.linalg.expm(np.array([[0.0, 1, 0], [0, 0, 1], [-1, -2, -3]]) * 1e-6)
    assert observability_form(A, [[1.0, 0, 0]]).n_observable == 3


@pytest.mark.parametrize("dt", [0, 0.1])
def test_hidden_double_integrator_is_not_stable(dt):
    rng = np.random.default_rng(3)
    A = np.zeros((5, 5))
    A[:3, :3] = rng.normal(size=(3, 3)) - 4 * np.eye(3)
    A[3, 4] = 1
    A[3:, :3] = rng.normal(size=(2, 3))
    if dt:
        A = scipy.linalg.expm(A * dt)
    T = np.linalg.qr(rng.normal(size=(5, 5)))[0]
    found = detectability(T @ A @ T.T, np.eye(1, 5) @ T.T, dt=dt)
    assert not found
    assert found.unstable_modes.size == 2


def test_detectable_pair_is_true_as_a_condition():
    found = detectability([[-1.0, 0], [1, -2]], [[1.0, 0]])
    assert found
    np.testing.assert_allclose(found.unobservable_modes, [-2])


@pytest.mark.parametrize(("n", "p"), [(0, 0), (0, 2), (3, 0)])
def test_empty_systems(n, p):
    form = observability_form(-np.eye(n), np.zeros((p, n)))
    assert form.n_observable == 0
    assert bool(detectability(-np.eye(n), np.zeros((p, n))))


def test_margin_is_the_same_decay_rate_in_both_times():
    s = np.array([-0.9, -1.1, -1.1 + 5j])
    np.testing.assert_array_equal(is_stable_mode(s, 0, 1.0), is_stable_mode(np.exp(0.01 * s), 0.01, 1.0))


def test_malformed_pairs_are_refused():
    with pytest.raises(ModelError, match="A must be"):
        observability_form(np.ones((2, 3)), np.ones((1, 3)))
    with pytest.raises(ModelError, match="finite"):
        observability_form([[np.nan]], [[1.0]])


def test_hidden_integrators_are_not_taken_for_stable() -> None:
    """Rounding of the whole matrix decides, not that of the small hidden block."""
    A = np.array([[0.0, 2, 0], [0, 2, -1], [0, -2, 2]])
    assert not detectability(A, [[0, 1, 1]])
    rng = np.random.default_rng(0)
    for _ in range(200):
        n = int(rng.integers(3, 7))
        Q = np.linalg.qr(rng.standard_normal((n, n)))[0]
        block = np.zeros((n, n))
        block[1:, 1:] = rng.standard_normal((n - 1, n - 1))
        block[0, 1:] = rng.standard_normal(n - 1)  # an integrator that nothing sees
        C = np.hstack([np.zeros((2, 1)), rng.standard_normal((2, n - 1))]) @ Q.T
        assert not detectability(Q @ block @ Q.T, C)


@pytest.mark.parametrize("dt", [0, 0.1])
@pytest.mark.parametrize("size", [1.0, 1e4])
def test_a_hidden_mode_next_to_the_boundary_does_not_count_as_stable(dt: float, size: float) -> None:
    """Half a million years at ten samples a second are no decay."""

    def pair(distance: float) -> tuple[np.ndarray, np.ndarray]:
        hidden, seen = (1.0 - distance, 0.5) if dt else (-size * distance, -size)
        return np.diag([seen, hidden]), np.array([[1.0, 0.0]])

    for distance, stable in ((2e-12, False), (5e-11, False), (2e-10, True), (1e-3, True)):
        A, C = pair(distance)
        found = detectability(A, C, dt=dt)
        assert bool(found) is stable
        assert found.unstable_modes.size == (not stable)
        if stable:
            assert place_observer_margin(A, C, 0.1, dt=dt).fixed.size == 1
        else:
            with pytest.raises(DesignError, match="not detectable"):
                place_observer_margin(A, C, 0.1, dt=dt)
