"""Continuous designs that are sampled: what faults and noise do to them, and whether noise has a spread there."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

import residua as rs
from exact.responses import paths
from generated import random_plant
from guards import trips
from residua.design.core.internal_form import internal_form
from residua.errors import AccuracyError

STEPS = (0.1, 0.001)


def integrating(seed: int, chain: int, *, turned: bool = False) -> rs.Plant:
    """Return a plant with a chain of integrators, of which the first output reads the end, and two slower modes."""
    rng = np.random.default_rng([chain, seed])
    n = chain + 2
    A = np.zeros((n, n))
    A[np.arange(1, chain), np.arange(chain - 1)] = rng.integers(1, 4, chain - 1)
    A[[-2, -1], [-2, -1]] = -rng.integers(1, 5, 2)
    A[-2:, :chain] = rng.integers(-2, 3, (2, chain))
    A[:1, -1] = rng.integers(0, 3)
    C = rng.integers(-2, 3, (3, n)).astype(float)
    C[0], C[1, chain - 1] = np.eye(n)[chain - 1], 0.0
    A[:chain, -2:] = 0.0
    B = np.vstack([[1.0, 0], rng.integers(-2, 3, (n - 1, 2))])
    B[1, 1] = 1.0
    if turned:
        Q = np.linalg.qr(rng.standard_normal((n, n)))[0]
        A, B, C = Q.T @ A @ Q, Q.T @ B, C @ Q
    plant = rs.Plant(A, B, C).with_sensor_faults().with_actuator_faults()
    return plant.with_noise(process=10.0 ** rng.uniform(-3, 0), measurement=10.0 ** rng.uniform(-3, 0))


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("chain", [1, 2, 3, 4])
def test_noise_has_a_spread_with_two_integrators_in_a_row_and_none_with_three(chain: int, turned: bool) -> None:
    answers = []
    for seed in range(2):
        plant = integrating(seed, chain, turned=turned)
        for design in (rs.design.luenberger_observer, rs.design.detection_filter, rs.design.parity_relations):
            try:
                made = design(plant)
            except rs.errors.ResiduaError:
                continue
            made = made.residual_generator() if isinstance(made, rs.design.Observer) else made
            answers += [made.discretize(step).covariance is not None for step in STEPS]
    assert len(answers) >= 8
    assert set(answers) == {chain <= 2}


@pytest.mark.parametrize("hold", ["linear", "zero"])
@pytest.mark.parametrize("seed", range(6))
def test_it_is_the_filter_driven_by_the_plant(seed: int, hold: str) -> None:
    plant = random_plant(np.random.default_rng(seed), n=4, outputs=3, dt=0.0, disturbances=1)
    plant = plant.with_noise(process=0.1, measurement=0.2)
    made = rs.design.decoupled_residual(plant)
    for step in STEPS:
        sampled = made.discretize(step, hold_outputs=hold)
        driven = internal_form(sampled.system, sampled.plant)
        w = np.geomspace(1e-2, 0.9 * np.pi / step, 20)
        found, wanted = sampled.internal_form().frequency_response(w), driven.frequency_response(w)
        np.testing.assert_allclose(found, wanted, rtol=1e-6, atol=1e-8 * np.abs(wanted).max())
        # and controls, which the continuous filter does not see, come through between the samples
        controls = sampled.internal_form(controls=True).frequency_response(w)
        np.testing.assert_allclose(
            controls[:, :, : found.shape[2]], wanted, rtol=1e-6, atol=1e-8 * np.abs(wanted).max()
        )
        assert step < 0.1 or np.any(controls[:, :, found.shape[2] :])


def test_the_spread_is_what_a_double_integrator_shows() -> None:
    """Noise moves position and speed without end; the residual, simulated over plant and filter, stays what is said."""
    plant = rs.Plant([[0, 1.0], [0, 0]], [[0.0], [1]], [[1.0, 0]]).with_noise(process=0.3, measurement=0.1)
    made = rs.design.luenberger_observer(plant.with_sensor_faults()).residual_generator().discretize(0.2)
    p, f, n = made.plant, made.system, 2
    A = np.block([[p.A, np.zeros((n, f.n_states))], [f.B[:, 1:] @ p.C, f.A]])
    B = np.vstack([p.Bw, f.B[:, 1:] @ p.Dw])
    C, D = np.hstack([f.D[:, 1:] @ p.C, f.C]), f.D[:, 1:] @ p.Dw
    spread, power = D @ D.T, B
    for _ in range(600):  # impulse responses: what integrates cancels in C
        spread, power = spread + C @ power @ (C @ power).T, A @ power
    assert made.covariance is not None
    np.testing.assert_allclose(made.covariance, spread, rtol=1e-8)


def test_an_oscillator_is_seen_between_samples() -> None:
    plant = rs.Plant([[0, 1.0], [-1, 0]], [[0.0], [1]], [[1.0, 0]]).with_noise(process=0.3, measurement=0.1)
    made = rs.design.luenberger_observer(plant.with_sensor_faults()).residual_generator().discretize(0.2)
    assert scipy.linalg.norm(made.internal_form().A[2:, :2]) > 0


@trips("design.core.internal_form:refuse_growth")
def test_a_step_is_refused_in_which_the_plant_outgrows_the_digits() -> None:
    """A mode at 256 1/s grows by exp(25.6) in a tenth of a second: responses were wrong without a word."""
    plant = rs.Plant([[256.0, 1], [0, -1]], [[1.0], [1]], np.eye(2)).with_sensor_faults().with_actuator_faults()
    made = rs.design.parity_relations(plant)
    with pytest.raises(AccuracyError, match=r"grows by exp\(26\).*at most 0\.078 s"):
        made.discretize(0.1)
    sampled, w = made.discretize(0.077), [0.1, 1.0, 10.0]
    wanted = paths(sampled.system, sampled.plant, np.ones(2), w)  # with 200 bits
    found = sampled.internal_form().frequency_response(w)
    terms = wanted.terms[:, :, wanted.to_faults]  # none where a residual does not answer a fault at all
    assert np.all(np.abs(found - wanted.total[:, :, wanted.to_faults]) <= 1e-6 * terms)
    assert np.count_nonzero(terms) > 0
