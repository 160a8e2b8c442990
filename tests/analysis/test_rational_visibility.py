"""Who is seen, and told from whom, of plants whose rates are decades apart: against exact answers."""

from __future__ import annotations

import numpy as np
import pytest

import residua as rs
from exact import questions
from exact.plants import exact_plant
from exact_campaign.cases import Case, plant_of
from exact_campaign.kinds import case_of
from residua.analysis.fault_space import fault_space
from residua.analysis.rational_visibility import are_rational, least_degree
from residua.linear.subspaces.rank import DEFAULT_RTOL
from residua.plant import Plant


def with_far_rates(case: Case) -> Plant:
    """Return a plant whose states move at rates 2^-20 to 2^20 times those of a case."""
    plant, rng = plant_of(case), np.random.default_rng([7, case.seed])
    rates = 2.0 ** rng.integers(-20, 21, plant.n_states)
    made = rs.Plant(rates[:, None] * plant.A, plant.B, plant.C, plant.D, dt=plant.dt)
    for role, B, D in (("disturbances", plant.Bd, plant.Dd), ("faults", plant.Bf, plant.Df)):
        columns = {name: (B[:, i], D[:, i]) for i, name in enumerate(getattr(plant, role))}
        made = getattr(made, f"with_{role}")(columns)
    return made


@pytest.mark.parametrize("seed", range(60))
@pytest.mark.parametrize("kind", ["sparse", "integrators"])
def test_rates_that_are_decades_apart_hide_nothing(kind: str, seed: int) -> None:
    plant = with_far_rates(case_of(kind, seed))
    if not plant.faults:
        pytest.skip("without faults")
    exact, found = exact_plant(plant), rs.diagnosability(plant)
    assert found.detectable.tolist() == questions.visible(exact)
    assert found.strongly_detectable.tolist() == questions.lasting(exact)
    assert found.isolable.tolist() == questions.isolable(exact)
    assert found.strongly_isolable.tolist() == questions.lasting_isolable(exact)
    for constant in (False, True):
        for row in rs.coding.attainable(plant, constant=constant).structure:
            assert questions.attainable(exact, row.tolist(), constant=constant)
        rows = [[bool(code >> j & 1) for j in range(len(plant.faults))] for code in range(1, 2 ** len(plant.faults))]
        digits = ["".join("01"[one] for one in row) for row in rows]
        said = rs.coding.attainable(plant, digits, constant=constant).attainable
        assert said.tolist() == [questions.attainable(exact, row, constant=constant) for row in rows]


def test_numbers_that_may_be_rounded_are_not_taken_for_exact() -> None:
    plant = rs.Plant([[-0.1]], [[1.0]], [[1.0], [3.0]]).with_faults({"leak": [1.0]}).with_sensor_faults()
    assert not are_rational(plant, DEFAULT_RTOL)
    exact = rs.Plant([[-0.125]], [[1.0]], [[1.0], [3.0]]).with_faults({"leak": [1.0]}).with_sensor_faults()
    assert are_rational(exact, DEFAULT_RTOL)
    assert not are_rational(exact, 1e-3)
    assert fault_space(exact, rtol=1e-3).rational is None


def test_a_slight_angle_counts_unless_the_tolerance_is_wide() -> None:
    # the second sensor tells the leak from the drift by 2^-28 of either
    plant = rs.Plant([[-1.0, 0.0], [0.0, -1.0]], [[1.0], [0.0]], [[1.0, 1.0], [1.0, 1.0 + 2.0**-28]])
    plant = plant.with_faults({"leak": [1.0, 0.0], "drift": [0.0, 1.0]})
    assert rs.diagnosability(plant).isolable[0, 1]
    assert not rs.diagnosability(plant, rtol=1e-3).isolable[0, 1]


@pytest.mark.parametrize("kind", ["sparse", "integrators", "dense", "singular E"])
def test_the_shortest_relation_is_as_long_as_in_exact_numbers(kind: str) -> None:
    for seed in range(40):
        plant = plant_of(case_of(kind, seed))
        exact = exact_plant(plant)
        indices = questions.residual_indices(exact)
        assert least_degree(plant.without_faults(), range(plant.n_outputs)) == (min(indices) if indices else None)
