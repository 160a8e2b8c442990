"""What one robust estimator promises: sizes of faults that are certain to be seen, at every frequency of its band."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import pytest

import residua as rs
from residua.linear import StateSpace, peak_input, peak_norm, smallest_gain
from residua.plant import UncertainPlant, residual_over_set
from residua.robust.estimators.certified_threshold import certified_threshold
from residua.robust.estimators.robust_estimator import RobustEstimator

DT = 0.1


def estimator(band: float) -> tuple[rs.Plant, RobustEstimator]:
    """Return a filter with a certificate, that nobody searched: its response falls with the frequency."""
    plant = rs.Plant([[0.9]], np.zeros((1, 0)), [[1.0]], dt=DT).with_disturbances([[0.1]], output=[[0.1]])
    plant = plant.with_sensor_faults()
    loop = UncertainPlant(plant)
    made, T = StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.5]], dt=DT), np.zeros((1, 1))
    certificate = certified_threshold(loop, made, T)
    sensitivity = smallest_gain(residual_over_set(loop, made, T, signals=["y1 sensor"]), band=band)
    nothing = cast(Any, None)
    return plant, RobustEstimator("y1 sensor", (), made, T, certificate, sensitivity, 1.0, nothing, ())


def largest(plant: rs.Plant, one: RobustEstimator, fault: np.ndarray, disturbance: np.ndarray) -> float:
    both = StateSpace(plant.A, np.hstack([plant.Bd, plant.Bf]), plant.C, np.hstack([plant.Dd, plant.Df]), dt=DT)
    r = one.filter.simulate(both.simulate(np.column_stack([disturbance, fault])))
    return float(np.abs(r[len(r) // 2 :]).max())


@pytest.mark.parametrize("part", [0.05, 1 / 3, 0.5, 2 / 3, 0.9])
def test_sampled_sinusoids_of_the_smallest_fault_are_seen(part):
    """Of part x half the sample rate: the crest falls between samples, and still one of them is high enough."""
    band = part * np.pi / DT
    plant, one = estimator(band)
    k, none = np.arange(2400), np.zeros(2400)
    found = []
    for omega in (band, band / 2, 0.97 * band):
        for phase in np.linspace(0, np.pi, 25):
            wave = np.sin(omega * DT * k + phase)
            found.append(largest(plant, one, one.undisturbed_fault * wave, none) / one.threshold)
    assert min(found) >= 1 - 1e-6
    # without the cosine it would not be so
    if part in (1 / 3, 0.5):
        assert min(found) * np.cos(band * DT / 2) < 1


def test_the_worst_disturbance_does_not_hide_it():
    plant, one = estimator(np.pi / 2 / DT)
    own = StateSpace(plant.A, plant.Bd, plant.C, plant.Dd, dt=DT).series(one.filter)
    w = peak_input(own, peak_norm(own), 600)[:, 0]
    k = np.arange(600)
    for phase in np.linspace(0, np.pi, 9):
        wave = one.smallest_fault * np.sin(np.pi / 2 * k + phase)
        assert min(largest(plant, one, wave, s * w) for s in (1, -1)) >= one.threshold * (1 - 1e-6)


def test_constant_faults_and_half_the_sample_rate():
    _, one = estimator(0.0)
    assert one.smallest_fault == pytest.approx(2 * one.threshold / one.sensitivity.bound)
    assert one.undisturbed_fault == pytest.approx(one.smallest_fault / 2)
    _, one = estimator(np.pi / DT)
    assert one.smallest_fault == one.undisturbed_fault == np.inf
