"""The guarantee of every design: zero residual without faults, for any input and any decoupled disturbance."""

from __future__ import annotations

import numpy as np
import pytest

import residua as rs
from generated import random_plant, simulate
from refusals import Refused
from residua.errors import DesignError

SEEDS = range(40)


def largest_residual(generator: rs.design.ResidualGenerator, u: np.ndarray, y: np.ndarray) -> float:
    """Return the largest residual relative to the largest term it is the difference of."""
    r = generator.run(u, y)
    size = max(np.abs(u).max(), np.abs(y).max()) * (1 + np.abs(generator.system.D).max())
    return float(np.abs(r).max() / size)


@pytest.mark.parametrize("seed", SEEDS)
def test_unknown_input_observer(seed: int) -> None:
    rng = np.random.default_rng(seed)
    q = int(rng.integers(1, 3))
    plant = random_plant(rng, disturbances=q, dt=0.1, feedthrough=bool(seed % 2))
    if rs.analysis.unknown_input_observer_existence(plant):
        generator = rs.design.unknown_input_observer(plant).residual_generator()
        assert largest_residual(generator, *simulate(plant, rng, 60)) < 1e-9
    else:
        with pytest.raises(DesignError, match=r"rank|detectable"):
            rs.design.unknown_input_observer(plant)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.refusals(at_most=0)
def test_disturbances_in_the_outputs_are_decoupled_too(seed: int, refused: Refused) -> None:
    rng = np.random.default_rng(100 + seed)
    plant = random_plant(rng, n=5, outputs=4, dt=0.1, faults=1)
    plant = plant.with_disturbances(
        {"both": (rng.standard_normal(5), rng.standard_normal(4)), "state": rng.standard_normal(5)}
    )
    existence = rs.analysis.unknown_input_observer_existence(plant)
    if not existence:
        refused.skip(existence)
    generator = rs.design.unknown_input_observer(plant).residual_generator()
    assert largest_residual(generator, *simulate(plant, rng, 60)) < 1e-9
    assert generator.n_residuals == 3


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("robust", [False, True])
@pytest.mark.refusals(at_most=0)
def test_detection_filters(seed: int, robust: bool, refused: Refused) -> None:
    rng = np.random.default_rng(200 + seed)
    plant = random_plant(rng, disturbances=1 if robust else 0, faults=2, dt=0.1, sensors=seed % 3 == 0)
    design = rs.design.robust_detection_filter if robust else rs.design.detection_filter
    try:
        generator = design(plant)
    except DesignError as error:
        refused.skip(error)
    assert generator.system.is_stable()
    assert largest_residual(generator, *simulate(plant, rng, 60)) < 1e-9


@pytest.mark.parametrize("seed", range(20))
def test_kalman_filter(seed: int) -> None:
    rng = np.random.default_rng(300 + seed)
    plant = random_plant(rng, dt=0.1).with_noise(process=1.0, measurement=0.1)
    generator = rs.design.kalman_filter(plant)
    assert largest_residual(generator, *simulate(plant, rng, 60)) < 1e-9


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.refusals(at_most=0)
def test_continuous_designs_by_their_internal_form(seed: int, refused: Refused) -> None:
    """In continuous time the statement is about transfer matrices: zero from every control and disturbance."""
    rng = np.random.default_rng(400 + seed)
    plant = random_plant(rng, disturbances=1, dt=0.0)
    if not (existence := rs.analysis.unknown_input_observer_existence(plant)):
        refused.skip(existence)
    generator = rs.design.unknown_input_observer(plant).residual_generator()
    form = generator.internal_form(plant)
    d = [i for i, name in enumerate(form.inputs) if name in plant.disturbances]
    w = np.logspace(-2, 2, 25)
    whole = np.abs(form.frequency_response(w)).max()
    assert np.abs(form.frequency_response(w)[:, :, d]).max() < 1e-9 * whole
    assert form.n_states <= plant.n_states  # the hidden states of the plant are gone
    other = generator.internal_form(plant, controls=True)
    assert np.abs(other.frequency_response(w)[:, :, -len(plant.inputs) :]).max() < 1e-8 * whole


def test_a_plant_without_control_inputs_has_an_internal_form_with_controls_too() -> None:
    rng = np.random.default_rng(0)
    plant = rs.Plant(-np.eye(3), np.zeros((3, 0)), np.eye(3)).with_faults({"f": rng.standard_normal(3)})
    generator = rs.design.detection_filter(plant)
    both = (generator.internal_form(plant, controls=c).frequency_response([1.0]) for c in (False, True))
    np.testing.assert_array_equal(*both)
