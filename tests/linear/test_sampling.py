"""Sampling: exact at the samples for held and for linear inputs; noise against fine simulation."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.integrate
import scipy.linalg

import residua as rs
from residua.errors import ModelError
from residua.linear import StateSpace, sample
from residua.linear.systems.sampling import noise_covariance


def system(seed: int = 0) -> StateSpace:
    rng = np.random.default_rng(seed)
    return StateSpace(rng.standard_normal((3, 3)) - np.eye(3), rng.standard_normal((3, 2)), rng.standard_normal((2, 3)))


@pytest.mark.parametrize("hold", ["zero", "linear", ("zero", "linear")])
def test_exact_at_the_samples(hold: str | tuple[str, str]) -> None:
    plant, h = system(), 0.3
    rng = np.random.default_rng(1)
    v = rng.standard_normal((8, 2))
    v[0] = 0  # a linear input starts from rest
    kinds = (hold, hold) if isinstance(hold, str) else hold

    def between(t: float) -> np.ndarray:
        k = min(int(t / h), 6)
        part = t / h - k
        return np.array(
            [v[k, i] if kind == "zero" else (1 - part) * v[k, i] + part * v[k + 1, i] for i, kind in enumerate(kinds)]
        )

    x, y = np.zeros(3), [plant.C @ np.zeros(3)]
    for k in range(7):
        x = scipy.integrate.solve_ivp(
            lambda t, x: plant.A @ x + plant.B @ between(min(t, (k + 1) * h - 1e-12)),  # noqa: B023
            (k * h, (k + 1) * h),
            x,
            rtol=1e-10,
            atol=1e-12,
        ).y[:, -1]
        y.append(plant.C @ x)
    np.testing.assert_allclose(sample(plant, h, hold=hold).simulate(v), y, atol=1e-7)


@pytest.mark.parametrize("method", ["zoh", "foh"])
def test_against_python_control(method: str) -> None:
    control = pytest.importorskip("control")
    plant = system()
    theirs = control.c2d(control.ss(plant.A, plant.B, plant.C, plant.D), 0.2, method)
    ours = sample(plant, 0.2, hold={"zoh": "zero", "foh": "linear"}[method])
    z = np.exp(1j * np.array([0.1, 1.0, 2.5]))
    np.testing.assert_allclose(ours.evaluate(z), np.stack([theirs(x) for x in z]), rtol=1e-9)


def test_noise_is_the_integral_also_for_stiff_plants() -> None:
    rng = np.random.default_rng(2)
    for A in (rng.standard_normal((3, 3)), np.diag([-1e3, -1.0, 0.0])):
        L = rng.standard_normal((3, 3))
        Q, h = L @ L.T, 0.7
        s = np.linspace(0, h, 40_001)
        values = np.stack([scipy.linalg.expm(A * x) @ L for x in s[::40]])
        if np.abs(A).max() < 10:
            integral = scipy.integrate.simpson(values @ values.transpose(0, 2, 1), x=s[::40], axis=0)
            np.testing.assert_allclose(noise_covariance(A, Q, h), integral, rtol=1e-6)
        else:
            expected = Q[0, 0] / 2e3
            assert noise_covariance(A, Q, h)[0, 0] == pytest.approx(expected, rel=1e-9)
            assert noise_covariance(A, Q, h)[2, 2] == pytest.approx(Q[2, 2] * h, rel=1e-9)


def test_a_sampled_plant_keeps_its_roles() -> None:
    plant = rs.library.jet_engine().with_noise(process=0.1, measurement=0.2)
    sampled = plant.discretize(0.05)
    assert sampled.faults == plant.faults
    assert sampled.disturbances == plant.disturbances
    np.testing.assert_allclose(sampled.measurement_noise, plant.measurement_noise / 0.05)
    np.testing.assert_allclose(sampled.Df, plant.Df)
    np.testing.assert_allclose(
        sampled.system("control").dc_gain(), plant.system("control").dc_gain(), rtol=1e-10, atol=1e-12
    )


def test_correlated_noise_stays_correlated() -> None:
    plant = rs.Plant([[-1.0]], [[1]], [[1]])
    plant = plant._with(Bw=np.array([[1.0, 0.0]]), Dw=np.array([[0.5, 1.0]]))
    sampled = plant.discretize(0.1)
    # the measurement averages v over the step: cov(w_k, v_k) = (1/h) int exp(-s) ds * 0.5
    np.testing.assert_allclose(sampled.cross_noise, (1 - np.exp(-0.1)) / 0.1 * 0.5, rtol=1e-9)
    np.testing.assert_allclose(sampled.measurement_noise, 1.25 / 0.1)


@pytest.mark.parametrize("dt", [0, -1, np.nan])
def test_bad_steps_are_refused(dt: float) -> None:
    with pytest.raises(ModelError, match="dt"):
        sample(system(), dt)
    with pytest.raises(ModelError, match="sampled already"):
        sample(sample(system(), 0.1), 0.1)
    with pytest.raises(ModelError, match="hold"):
        sample(system(), 0.1, hold="cubic")
