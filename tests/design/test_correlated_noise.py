"""Kalman filters and other observers of plants whose states and outputs share noise."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

import residua as rs
from generated import random_plant, singular_plant
from residua.errors import DesignError

SIZE = 40_000
#: Four deviations of a correlation estimated from that many samples, a few hundred of which are looked at.
CHANCE = 5 / np.sqrt(SIZE)


def shared(seed: int, dt: float = 0.1, *, stable: bool = False) -> rs.Plant:
    rng = np.random.default_rng(seed)
    plant = random_plant(rng, outputs=2, faults=1, dt=dt)
    n, poles = plant.n_states, np.linalg.eigvals(plant.A)
    if stable and dt:
        plant = plant._with(A=plant.A * 0.9 / np.abs(poles).max())
    elif stable:
        plant = plant._with(A=plant.A - (poles.real.max() + 0.5) * np.eye(n))
    return plant.with_noise_input(rng.standard_normal((n, n + 2)), rng.standard_normal((2, n + 2)))


def measured(plant: rs.Plant, seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    u = rng.standard_normal((SIZE, len(plant.inputs)))
    w = rng.standard_normal((SIZE, len(plant.noises)))
    return u, plant.system(("control", "noise")).simulate(np.hstack([u, w]))


@pytest.mark.parametrize("seed", range(8))
def test_the_gain_against_other_solutions(seed: int) -> None:
    """SciPy's equation with the cross term, and the usual filter of the plant with the shared noise measured away."""
    plant = shared(seed)
    A, C, Q, R, S = plant.A, plant.C, plant.process_noise, plant.measurement_noise, plant.cross_noise
    kalman = rs.design.kalman_filter(plant)
    P = scipy.linalg.solve_discrete_are(A.T, C.T, Q, R, s=S)
    K = np.linalg.solve(C @ P @ C.T + R, (A @ P @ C.T + S).T).T
    np.testing.assert_allclose(kalman.observer.K, K, atol=1e-8 * np.abs(K).max())
    np.testing.assert_allclose(kalman.covariance, C @ P @ C.T + R, rtol=1e-8)
    J = np.linalg.solve(R, S.T).T
    rest = rs.Plant(A - J @ C, plant.B, C, plant.D, dt=plant.dt)
    rest = rest.with_noise(process=Q - J @ S.T, measurement=R)
    apart = rs.design.kalman_filter(rest)
    np.testing.assert_allclose(kalman.observer.K, apart.observer.K + J, atol=1e-7 * np.abs(K).max())
    np.testing.assert_allclose(kalman.covariance, apart.covariance, rtol=1e-7)


@pytest.mark.parametrize("seed", range(4))
def test_the_gain_in_continuous_time(seed: int) -> None:
    plant = shared(seed, dt=0.0)
    A, C, Q, R, S = plant.A, plant.C, plant.process_noise, plant.measurement_noise, plant.cross_noise
    P = scipy.linalg.solve_continuous_are(A.T, C.T, Q, R, s=S)
    K = np.linalg.solve(R, (P @ C.T + S).T).T
    np.testing.assert_allclose(rs.design.kalman_filter(plant).observer.K, K, atol=1e-8 * np.abs(K).max())


@pytest.mark.parametrize("seed", range(3))
def test_innovations_are_white(seed: int) -> None:
    """On simulated data; those of a filter that does not know what the noises share are not."""
    plant = shared(seed, stable=True)
    u, y = measured(plant, seed + 100)
    kalman = rs.design.kalman_filter(plant)
    blind = rs.design.kalman_filter(plant.with_noise(process=plant.process_noise, measurement=plant.measurement_noise))

    def correlations(generator: rs.ResidualGenerator) -> tuple[float, np.ndarray]:
        r = generator.run(u, y)[1000:]
        covariance = r.T @ r / len(r)
        w = r @ np.linalg.inv(np.linalg.cholesky(covariance)).T
        lagged = [np.abs(w[k:].T @ w[:-k] / len(w)).max() for k in range(1, 20)]
        return float(max(lagged)), covariance

    worst, covariance = correlations(kalman)
    assert worst < CHANCE
    np.testing.assert_allclose(covariance, kalman.covariance, atol=0.05 * np.trace(covariance))
    other, larger = correlations(blind)
    assert other > 2 * CHANCE
    assert np.trace(larger) > np.trace(covariance)


KINDS = {
    "a gain": lambda p: {"gain": rs.design.luenberger_observer(p).K},
    "a gain and a weight": lambda p: {"gain": rs.design.luenberger_observer(p).K, "weight": [[1.0, -1.0]]},
    "the general form": lambda p: general(p),
    "the general form with T": lambda p: general(p, "T"),
}


def general(plant: rs.Plant, *more: str) -> dict[str, object]:
    form = rs.design.general_form(rs.design.luenberger_observer(plant).residual_generator())
    names = ("M", "J", "N", "Ls", "Lu", "Ly", *more)
    return {"decouples": False} | {name: getattr(form, name) for name in names}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(3))
def test_a_generator_from_an_observer_has_the_covariance_of_its_residual(seed: int, kind: str) -> None:
    """Against simulated data, for noise that states and outputs share."""
    plant = shared(seed, stable=True)
    generator = rs.residual_generator_from_observer(plant, **KINDS[kind](plant))
    assert generator.covariance is not None
    u, y = measured(plant, seed + 200)
    r = generator.run(u, y)[1000:]
    scale = np.trace(generator.covariance)
    np.testing.assert_allclose(r.T @ r / len(r), generator.covariance, atol=0.15 * scale)
    sums = r[: len(r) // 10 * 10].reshape(-1, 10, r.shape[1]).sum(axis=1)
    expected = generator.covariance_of_sums(10)
    np.testing.assert_allclose(sums.T @ sums / len(sums) / 10, expected, atol=0.25 * np.trace(expected))
    watch = rs.Monitor(generator)
    assert watch.is_fitted  # the noise model gives a threshold
    found = watch.run(u[:5000], y[:5000])
    assert isinstance(found, rs.Diagnosis)


def test_an_unstable_plant_and_a_singular_one_have_it_too() -> None:
    plant = rs.Plant([[1.1, 0.1], [0, 1.0]], [[1], [0]], [[1, 0]], dt=1).with_sensor_faults()
    plant = plant.with_noise(process=0.01, measurement=0.02, cross=[[0.005], [0.0]])
    kalman = rs.design.kalman_filter(plant)
    again = rs.residual_generator_from_observer(plant, gain=kalman.observer.K)
    np.testing.assert_allclose(again.covariance, kalman.covariance, rtol=1e-9)
    singular = singular_plant(np.random.default_rng(4), dt=0.1).with_noise(process=0.1, measurement=0.2)
    made = rs.design.decoupled_residual(singular)
    form = rs.design.general_form(made)
    matrices = {name: getattr(form, name) for name in ("M", "J", "N", "Ls", "Lu", "Ly")}
    again = rs.residual_generator_from_observer(singular, **matrices)
    np.testing.assert_allclose(again.covariance, made.covariance, rtol=1e-7, atol=1e-12)


def test_a_continuous_observer_has_it_once_it_is_sampled() -> None:
    plant = shared(1, dt=0.0, stable=True)
    generator = rs.residual_generator_from_observer(plant, gain=rs.design.luenberger_observer(plant).K)
    assert generator.covariance is None
    sampled = generator.discretize(0.01)
    assert sampled.covariance is not None
    assert rs.Monitor(generator, dt=0.01).is_fitted


def test_sampled_measurements_without_noise_have_a_filter_where_the_innovations_differ() -> None:
    plant = rs.Plant([[0.9, 0.2], [0, 0.7]], [[1], [1]], np.eye(2), dt=1)
    made = rs.design.kalman_filter(plant.with_noise(process=0.1, measurement=0))
    np.testing.assert_allclose(made.covariance, 0.1 * np.eye(2), rtol=1e-9)
    np.testing.assert_allclose(made.observer.K, plant.A, rtol=1e-9)
    twice = rs.Plant(plant.A, plant.B, [[1, 0], [2, 0]], dt=1)
    with pytest.raises(DesignError, match="innovations have a singular covariance"):
        rs.design.kalman_filter(twice.with_noise(process=0.1, measurement=0))
    with pytest.raises(DesignError, match="measurement noise is singular"):
        rs.design.kalman_filter(rs.Plant([[-1]], [[1]], [[1]]).with_noise(process=0.1, measurement=0))
