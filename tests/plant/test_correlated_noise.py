"""Noise that states and outputs share: kept by plants, sampling and files, refused where it cannot be."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

import residua as rs
from generated import random_plant
from residua.errors import ModelError
from residua.plant import loads_plant


def joint(plant: rs.Plant) -> np.ndarray:
    return np.block([[plant.process_noise, plant.cross_noise], [plant.cross_noise.T, plant.measurement_noise]])


def drawn(seed: int, *, dt: float = 0.1, rank: int | None = None) -> tuple[rs.Plant, np.ndarray]:
    """A plant and a joint covariance of noise on its states and outputs."""
    rng = np.random.default_rng(seed)
    plant = random_plant(rng, outputs=2, faults=1, dt=dt)
    size = plant.n_states + 2
    L = rng.standard_normal((size, size if rank is None else rank))
    return plant, L @ L.T


def with_joint(plant: rs.Plant, J: np.ndarray) -> rs.Plant:
    n = plant.n_states
    return plant.with_noise(process=J[:n, :n], measurement=J[n:, n:], cross=J[:n, n:])


@pytest.mark.parametrize("rank", [None, 1])
@pytest.mark.parametrize("dt", [0.0, 0.1])
@pytest.mark.parametrize("seed", range(6))
def test_the_joint_covariance_comes_back(seed: int, dt: float, rank: int | None) -> None:
    plant, J = drawn(seed, dt=dt, rank=rank)
    noisy = with_joint(plant, J)
    np.testing.assert_allclose(joint(noisy), J, atol=1e-12 * np.abs(J).max())
    by_factors = plant.with_noise_input(noisy.Bw, noisy.Dw)
    np.testing.assert_array_equal(joint(by_factors), joint(noisy))
    assert noisy.Bw.shape[1] == (len(J) if rank is None else rank)


@pytest.mark.parametrize("exponent", [-20, -7, 13, 20])
@pytest.mark.parametrize("seed", range(4))
def test_units_change_nothing(seed: int, exponent: int) -> None:
    """Scaled by powers of two the covariances come back as accurately, entry by entry, and what is refused stays so."""
    plant, J = drawn(seed)
    units = np.exp2(exponent * np.random.default_rng(seed).integers(-1, 2, len(J)))
    bound = np.sqrt(np.outer(np.diag(J), np.diag(J)))
    scaled = J * np.outer(units, units)
    found = joint(with_joint(plant, scaled)) / np.outer(units, units)
    np.testing.assert_allclose(found / bound, J / bound, atol=1e-13)
    n = plant.n_states
    J = J.copy()
    J[0, n] = J[n, 0] = 1.001 * np.sqrt(J[0, 0] * J[n, n])
    with pytest.raises(ModelError, match="cannot have the covariance"):
        with_joint(plant, J * np.outer(units, units))


def test_what_is_no_covariance_is_refused() -> None:
    plant = rs.Plant(np.diag([0.5, 0.6]), [[1], [1]], np.eye(2), dt=1, states=["a", "b"], outputs=["y", "z"])
    for options, message in (
        ({"cross": [[0.1, 0], [0, 0]]}, "state 'a' and output 'y' cannot have the covariance 0.1: .* at most 0"),
        (
            {"process": 1.0, "measurement": 4.0, "cross": [[0, 0], [2.1, 0]]},
            "state 'b' and output 'y' cannot have the covariance 2.1: with the variances 1 and 4 it is at most 2",
        ),
        (
            {"process": 1.0, "measurement": 1.0, "cross": [[0.8, 0.8], [0, 0]]},
            r"cross: process, measurement and cross together are not a covariance: .* eigenvalue -0.13",
        ),
        ({"process": 1.0, "measurement": 1.0, "cross": [[0.1, 0.1]]}, r"cross must be 2 x 2 \(states x outputs\)"),
        ({"process": 1.0, "measurement": 1.0, "cross": {("a", "x"): 0.1}}, "unknown cross: output 'x'; known: y, z"),
        ({"process": 1.0, "measurement": 1.0, "cross": {"a": 0.1}}, r"expected pairs \(state, output\) as keys"),
        ({"process": 1.0, "measurement": 1.0, "cross": {("a", "y"): "0.1"}}, "expected a number, got '0.1'"),
        ({"process": 1.0, "measurement": 1.0, "cross": [[np.nan, 0], [0, 0]]}, "must be finite"),
    ):
        with pytest.raises(ModelError, match=message):
            plant.with_noise(**options)
    for arguments, message in (
        ((), "needs Bw, Dw or both"),
        (([[1.0], [0.0]], [[1.0, 0.0], [0.0, 1.0]]), "Bw has 1 columns and Dw has 2"),
        (([[1.0]],), "Bw must be 2 x any"),
        ((None, [[1.0]]), "Dw must be 2 x any"),
        (([[np.inf], [0]],), "must be finite"),
    ):
        with pytest.raises(ModelError, match=message):
            plant.with_noise_input(*arguments)
    named = plant.with_noise(process=1.0, measurement=1.0, cross={("b", "z"): 0.5})
    np.testing.assert_allclose(named.cross_noise, [[0, 0], [0, 0.5]], atol=1e-15)
    assert plant.with_noise_input(Dw=np.eye(2)).process_noise.tolist() == [[0, 0], [0, 0]]
    assert named.with_noise(process=1.0).cross_noise.tolist() == [[0, 0], [0, 0]]  # replaced, not added


@pytest.mark.parametrize("seed", range(8))
def test_sampling_keeps_what_they_share(seed: int) -> None:
    """Against Van Loan's formula for the plant with integrators that average the measurement noise over a step."""
    plant, J = drawn(seed, dt=0.0)
    n, h = plant.n_states, 0.3
    A = np.zeros((n + 2, n + 2))
    A[:n, :n] = plant.A
    M = np.block([[-A, J], [np.zeros_like(A), A.T]]) * h
    X = scipy.linalg.expm(M)
    Phi = X[n + 2 :, n + 2 :].T
    both = Phi @ X[: n + 2, n + 2 :]
    average = np.concatenate([np.ones(n), np.full(2, 1 / h)])
    expected = both * np.outer(average, average)
    found = joint(with_joint(plant, J).discretize(h))
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())


def test_a_file_says_it() -> None:
    text = """
    format = "residua-plant/1"
    dt = 1.0
    matrices = {A = [[0.9, 0.1], [0.0, 0.8]], C = [[1.0, 0.0]]}
    noise = {process = 0.04, measurement = 0.01, cross = [[0.015], [-0.005]]}
    """
    plant = loads_plant(text)
    np.testing.assert_allclose(plant.cross_noise, [[0.015], [-0.005]], rtol=1e-12)
    np.testing.assert_allclose(plant.process_noise, 0.04 * np.eye(2), rtol=1e-12, atol=1e-15)
