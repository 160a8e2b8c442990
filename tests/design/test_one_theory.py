"""Ranks, subspaces, polynomials and eigenvectors find the same residuals, or none, on generated plants.

The long run is in ``campaign/test_parity_and_observers.py``.
"""

from __future__ import annotations

import numpy as np
import pytest

import residua as rs
from one_theory import ONE_FILTER, Findings, compare, generated, ignored_sets, visible
from refusals import Refused


@pytest.mark.parametrize("seed", range(200, 225))
@pytest.mark.refusals(at_most=68)
def test_every_method_agrees_with_the_exact_ranks_and_with_the_others(seed: int, refused: Refused) -> None:
    plant, out = generated(seed), Findings()
    for ignored in ignored_sets(plant, np.random.default_rng([21, seed]), 3):
        compare(plant, ignored, f"plant {seed}", out)
    assert out.wrong == []
    assert out.refused == []
    assert out.counts["bank: reached"] == out.counts["parity: reached"] == out.counts["attainable"]
    for words in out.without:
        refused(words)


def test_plants_hide_faults_for_other_reasons_than_counting() -> None:
    """The sparse ones have rows that fail although fewer faults are ignored than there are residuals."""
    hidden = 0
    for seed in range(2, 60, 3):
        plant = generated(seed)
        for ignored in ignored_sets(plant, np.random.default_rng(seed), 4):
            few = len(ignored) < plant.n_outputs - len(plant.disturbances)
            hidden += few and len(visible(plant, ignored)) < len(plant.faults) - len(ignored)
    assert hidden >= 10


def test_an_input_whose_fault_is_ignored_is_not_read_and_does_not_keep_generators_apart() -> None:
    """What rounding leaves of the response to it has no units."""
    plant = rs.Plant(
        [[0.5, 0.2, 0], [0, 0.7, 0.3], [0.1, 0, 0.4]], [[1], [0.3], [-0.7]], [[1, 0.4, 0], [0.2, -1, 1]], dt=1.0
    ).with_faults({"leak": [0.3, 1, 0.2]})
    plant = plant.with_actuator_faults()
    bank = rs.design.structured_bank(plant, ["10"]).generator
    parity = rs.design.structured_parity(plant, ["10"]).generator
    assert np.abs(bank.system.frequency_response([0.1, 1.0])[:, :, 0]).max() < 1e-12
    assert bank.equivalent_to(parity).kind in ONE_FILTER
    assert parity.equivalent_to(bank).kind in ONE_FILTER
    other = rs.design.structured_bank(plant, ["01"]).generator
    assert bank.equivalent_to(other).kind == "different"


@pytest.mark.parametrize("copies", [2, 3, 5])
def test_multiple_poles_do_not_hide_relations(copies: int) -> None:
    """Chains of equal poles: a basis on them has no sizes of rounding."""
    n = 2 * copies
    A = np.diag(np.repeat([-0.25, -0.75], copies)) + np.diag(np.full(n - 1, 0.5), -1)
    C = np.eye(n)[[n - 1, copies]]
    plant = rs.Plant(A, np.eye(n)[:, :1], C, dt=0.5).with_faults({"f": np.eye(n)[1]}).with_sensor_faults()
    for row in ("101", "110", "111"):
        assert rs.coding.attainable(plant, [row]).attainable[0]
        made = rs.design.structured_parity(plant, [row]).generator
        assert rs.design.structured_bank(plant, [row]).generator.equivalent_to(made).kind in (*ONE_FILTER, "part")


@pytest.mark.parametrize(("seed", "row"), [(10, "100111"), (28, "110011")])
def test_a_fast_observer_written_as_a_relation_keeps_its_smallest_coefficients(seed: int, row: str) -> None:
    """They are ten orders of magnitude below the others, in a basis on its poles; what is lost looks like a factor."""
    plant = generated(seed)
    bank = rs.design.structured_bank(plant, [row]).generator
    parity = rs.design.structured_parity(plant, [row]).generator
    assert bank.n_residuals == 1
    assert bank.system.n_states == plant.n_states
    assert bank.to_parity().orders == parity.to_parity().orders == (plant.n_states,)
    found = bank.equivalent_to(parity)
    assert found.kind == "poles"
    assert found.error < 1e-9
    (one,) = found.rows
    assert len(one.zeros) == len(one.poles) == plant.n_states
