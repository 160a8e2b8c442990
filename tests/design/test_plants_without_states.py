"""A plant of algebra alone, measurements with known relations and no states: every design works, or says why not."""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import residua as rs
from refusals import Refused
from residua.errors import ResiduaError
from residua.testing import check_residual_generator

D = rs.design


def members(plant: rs.Plant) -> rs.design.ResidualGenerator:
    return D.structured_parity(plant, ["1" * len(plant.faults)]).generator


def thresholds(plant: rs.Plant) -> object:
    return D.certified_thresholds(D.decoupled_residual(plant), rs.UncertainPlant(plant))


FUNCTIONS: dict[str, Callable[[rs.Plant], Any]] = {
    "actuator_fault_bank": D.actuator_fault_bank,
    "certified_thresholds": thresholds,
    "chow_willsky_matrices": lambda p: D.chow_willsky_matrices(p, 1),
    "closed_loop": lambda p: D.closed_loop(p, D.luenberger_observer(p), np.zeros((1, 0))),
    "compensation_gain": D.compensation_gain,
    "decoupled_residual": D.decoupled_residual,
    "descriptor_observer": D.descriptor_observer,
    "detection_filter": D.detection_filter,
    "diagnosability": rs.analysis.diagnosability,
    "directional_parity": lambda p: D.directional_parity(p, directions={p.faults[0]: [1, 0]}),
    "eigenstructure_assignment": D.eigenstructure_assignment,
    "fault_estimator": lambda p: D.fault_estimator(p, faults=p.faults[:1]),
    "general_form": lambda p: D.general_form(D.decoupled_residual(p)),
    "insensitive_parity": lambda p: D.insensitive_parity(lambda **values: p, {"a": 1.0}),
    "inverse_form_observer": D.inverse_form_observer,
    "kalman_filter": D.kalman_filter,
    "luenberger_observer": D.luenberger_observer,
    "matched_filters": D.matched_filters,
    "model_spread": lambda p: D.model_spread(D.parity_relations(p), [p]),
    "multi_model_parity": lambda p: D.multi_model_parity([p], order=0),
    "optimal_parity": lambda p: D.optimal_parity(p, order=0),
    "parity_orders": D.parity_orders,
    "parity_relations": D.parity_relations,
    "perfect_observer": D.perfect_observer,
    "perfect_observer, least order": lambda p: D.perfect_observer(p, least_order=True),
    "primary_residuals": D.primary_residuals,
    "reduced_order_observer": D.reduced_order_observer,
    "reduced_order_observer, one output": lambda p: D.reduced_order_observer(p, outputs=[0]),
    "residual_generator_from_observer": D.residual_generator_from_observer,
    "robust_detection_filter": D.robust_detection_filter,
    "robust_l1_bank": lambda p: D.robust_l1_bank(rs.UncertainPlant(p)),
    "select_equations": lambda p: D.select_equations(members(p), lambda **values: p, {"a": 1.0}),
    "sensor_fault_bank": D.sensor_fault_bank,
    "sensor_fault_estimators": D.sensor_fault_estimators,
    "structured_bank": lambda p: D.structured_bank(p, ["1" * len(p.faults)]),
    "structured_parity": members,
    "suggest": rs.suggest,
    "unknown_input_observer": D.unknown_input_observer,
    "unknown_input_observer_existence": rs.analysis.unknown_input_observer_existence,
}


def plants() -> dict[str, rs.Plant]:
    """Return two or three sensors of one input, without states, in what a plant may have."""
    out = {}
    for dt in (0.0, 0.1):
        two = rs.Plant(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((2, 0)), [[1], [2]], dt=dt).with_sensor_faults()
        three = rs.Plant(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((3, 0)), [[1], [2], [3]], dt=dt)
        kind = "sampled" if dt else "continuous"
        out[f"two sensors, {kind}"] = two
        out[f"a disturbance in one, {kind}"] = two.with_disturbances({"d": ([], [1, 0])})
        out[f"a disturbance in all, {kind}"] = three.with_sensor_faults().with_disturbances({"d": ([], [1, 1, 1])})
        out[f"noise, {kind}"] = two.with_noise(measurement=1.0)
    return out


PLANTS = plants()


def test_every_public_design_and_analysis_is_tried() -> None:
    public = {name for module in (rs.design, rs.analysis) for name in module.__all__}
    functions = {name for name in public if inspect.isfunction(getattr(rs.design, name, getattr(rs.analysis, name, 0)))}
    functions.remove("method")  # takes no plant: it declares a design function
    assert functions <= {name.split(",")[0] for name in FUNCTIONS}


@pytest.mark.parametrize("kind", PLANTS)
@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.refusals(at_most=85)
def test_it_works_or_is_refused_with_a_reason(name: str, kind: str, refused: Refused) -> None:
    plant = PLANTS[kind]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            made = FUNCTIONS[name](plant)
            made = made.residual_generator() if hasattr(made, "residual_generator") else made
        except ResiduaError as error:
            assert len(str(error)) > 30  # noqa: PT017
            refused(f"{name}: {error}")
            return
    if isinstance(made, rs.design.ResidualGenerator):
        check_residual_generator(made)


@pytest.mark.parametrize("dt", [0.0, 0.1])
@pytest.mark.parametrize(
    "name",
    [
        "decoupled_residual",
        "detection_filter",
        "luenberger_observer",
        "parity_relations",
        "primary_residuals",
        "reduced_order_observer",
        "robust_detection_filter",
        "unknown_input_observer",
    ],
)
def test_both_sensors_are_watched_by_what_they_should_read(name: str, dt: float) -> None:
    plant = PLANTS[f"two sensors, {'sampled' if dt else 'continuous'}"]
    made = FUNCTIONS[name](plant)
    generator = made.residual_generator() if hasattr(made, "residual_generator") else made
    assert generator.system.n_states == 0
    np.testing.assert_array_equal(generator.structure.any(axis=0), [True, True])
    r = generator.run([[1.0], [2.0]], [[1.0, 2.0], [2.0, 4.5]], dt=None if dt else 0.1)
    np.testing.assert_allclose(r[0], 0.0, atol=1e-15)
    # a residual of the quotient has a scale of its own, the others that of the outputs
    assert np.abs(r[1]).max() > 0.1 if name == "decoupled_residual" else np.abs(r[1]).max() == pytest.approx(0.5)
