"""The filter Riccati equation: it holds, python-control agrees, and what has no solution is refused by name."""

from __future__ import annotations

import json

import numpy as np
import pytest
import scipy.io
import scipy.linalg

from residua.errors import DesignError, ModelError
from residua.linear.poles.riccati import filter_riccati


def generated(seed, dt):
    rng = np.random.default_rng(seed)
    n, p = int(rng.integers(1, 12)), int(rng.integers(1, 4))
    A, C = rng.normal(size=(n, n)), rng.normal(size=(p, n))
    W = rng.normal(size=(n + p, n + p))
    N = W @ W.T
    return (scipy.linalg.expm(A * dt) if dt else A), C, N[:n, :n], N[n:, n:], N[:n, n:]


def residual(A, C, Q, R, S, P, K, dt):
    if dt:
        return A @ P @ A.T - P + Q - K @ (C @ P @ C.T + R) @ K.T
    return A @ P + P @ A.T + Q - K @ R @ K.T


@pytest.mark.parametrize("dt", [0, 0.1])
@pytest.mark.parametrize("seed", range(30))
def test_solution_is_stabilising_and_does_not_depend_on_units(seed, dt):
    A, C, Q, R, S = generated(seed, dt)
    found = filter_riccati(A, C, Q, R, S, dt=dt)
    P, K = found.covariance, found.gain
    innovation = C @ P @ C.T + R if dt else R
    cross = A @ P @ C.T + S if dt else P @ C.T + S
    np.testing.assert_allclose(K @ innovation, cross, atol=1e-8 * np.linalg.norm(cross))
    np.testing.assert_allclose(
        residual(A, C, Q, R, S, P, K, dt), 0, atol=1e-8 * (np.linalg.norm(P) + np.linalg.norm(Q))
    )
    assert np.linalg.eigvalsh(P).min() > -1e-8 * np.linalg.norm(P)
    poles = np.linalg.eigvals(A - K @ C)
    assert np.all(np.abs(poles) < 1) if dt else np.all(poles.real < 0)
    rng = np.random.default_rng(seed)
    s, y = 10.0 ** rng.uniform(-4, 4, len(A)), 10.0 ** rng.uniform(-4, 4, len(C))
    again = filter_riccati(
        A * s[:, None] / s, y[:, None] * C / s, Q * s[:, None] * s, R * y[:, None] * y, S * s[:, None] * y, dt=dt
    )
    np.testing.assert_allclose(again.gain / s[:, None] * y, K, rtol=1e-5, atol=1e-7 * np.linalg.norm(K))


@pytest.mark.parametrize("seed", range(10))
def test_agrees_with_python_control(seed):
    control = pytest.importorskip("control")
    A, C, Q, R, S = generated(seed, 0)
    P, _, _ = control.care(A.T, C.T, Q, R, S, np.eye(len(A)))
    np.testing.assert_allclose(filter_riccati(A, C, Q, R, S).covariance, P, atol=1e-7 * np.linalg.norm(P))
    A, C, Q, R, S = generated(seed, 0.1)
    P, _, _ = control.dare(A.T, C.T, Q, R, S, np.eye(len(A)))
    np.testing.assert_allclose(filter_riccati(A, C, Q, R, S, dt=0.1).covariance, P, atol=1e-7 * np.linalg.norm(P))


def test_undisturbed_unstable_mode_is_reflected():
    np.testing.assert_allclose(filter_riccati([[1.0]], [[1.0]], [[0.0]], [[1.0]]).poles, [-1], rtol=1e-9)
    np.testing.assert_allclose(filter_riccati([[2.0]], [[1.0]], [[0.0]], [[1.0]], dt=1).poles, [0.5], rtol=1e-9)


@pytest.mark.parametrize(("boundary", "dt"), [(0.0, 0), (1.0, 1.0)])
def test_undisturbed_boundary_mode_is_refused(boundary, dt):
    A, Q = np.diag([boundary, -0.5]), np.diag([0.0, 1.0])
    with pytest.raises(DesignError, match=rf"mode {boundary:.5g} on the stability boundary.*process noise"):
        filter_riccati(A, np.eye(2), Q, np.eye(2), dt=dt)


def test_what_has_no_solution_is_named():
    eye = np.eye(2)
    with pytest.raises(DesignError, match="not detectable: mode 1 "):
        filter_riccati(np.diag([1.0, -1.0]), [[0.0, 1.0]], eye, [[1.0]])
    with pytest.raises(DesignError, match=r"R is singular: rank 1 of 2.*output number 2"):
        filter_riccati(-eye, eye, eye, np.diag([1.0, 0.0]))
    with pytest.raises(ModelError, match="not a covariance"):
        filter_riccati(-eye, eye, -eye, eye)
    with pytest.raises(ModelError, match="symmetric"):
        filter_riccati(-eye, eye, np.triu(np.ones((2, 2))), eye)
    with pytest.raises(DesignError, match="at least one output"):
        filter_riccati(-eye, np.zeros((0, 2)), eye, np.zeros((0, 0)))


def test_no_noise_on_a_stable_plant_needs_no_gain():
    found = filter_riccati(-np.eye(2), np.eye(2), np.zeros((2, 2)), np.eye(2))
    np.testing.assert_allclose(found.gain, 0, atol=1e-12)


def test_slicot_benchmarks(shared_data):
    """Noise on the inputs; outputs of very different sizes; every equation is solved."""
    folder = shared_data / "slicot_benchmarks"
    for entry in json.loads((folder / "index.json").read_text()):
        if entry["n"] > 60:
            continue
        data = scipy.io.loadmat(folder / f"{entry['name']}.mat")
        A, B, C, E = (np.atleast_2d(data[key]).astype(float) for key in "ABCE")
        A, B = np.linalg.solve(E, A), np.linalg.solve(E, B)
        found = filter_riccati(A, C, B @ B.T, np.eye(len(C)), dt=1.0 if entry["discrete"] else 0)
        assert found.residual < 1e-8, entry["name"]


def test_parts_that_nothing_couples_have_no_gain_in_common() -> None:
    A, C = [[1, 0, 0], [0, 1, 0.1], [0, 0, 1]], [[1, 0, 0], [1, 0, 0], [0, 1, 0], [0, 1, 0]]
    found = filter_riccati(A, C, 1e-6 * np.eye(3), 1e-4 * np.eye(4), dt=0.1)
    assert not np.any(found.gain[0, 2:])
    assert not np.any(found.gain[1:, :2])
    assert np.all(found.gain[0, :2] > 0)
