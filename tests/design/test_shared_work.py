"""What the designs for one plant share, and what of their checks is left out since nothing depends on it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import residua as rs
from residua.design.core.internal_form import frequency_grid
from residua.design.detection_filters import directional_gain
from residua.linear import StateSpace


def _plant(n: int = 6, outputs: int = 4) -> rs.Plant:
    rng = np.random.default_rng([n, outputs, 2616])
    A = rng.standard_normal((n, n)) / np.sqrt(n) - 2 * np.eye(n)
    plant = rs.Plant(A, rng.standard_normal((n, 2)), rng.standard_normal((outputs, n)))
    plant = plant.with_faults({"f1": rng.standard_normal(n), "f2": rng.standard_normal(n)})
    return plant.with_noise(process=1.0, measurement=0.1)


def _filter(*poles: float) -> StateSpace:
    n = len(poles)
    return StateSpace(np.diag(poles), np.ones((n, 1)), np.ones((1, n)))


@pytest.mark.parametrize("seed", range(10))
def test_frequencies_go_from_far_below_all_poles_to_far_above_them_in_every_unit_of_time(seed: int) -> None:
    poles = -np.exp(np.random.default_rng(seed).uniform(-9, 9, 5))
    w = frequency_grid(_filter(*poles))
    assert w[0] <= 0.0104 * np.abs(poles).min()
    assert w[-1] >= 103.7 * np.abs(poles).max()
    for power in (-20, -1, 7, 20):
        np.testing.assert_allclose(frequency_grid(_filter(*2.0**power * poles)), 2.0**power * w, rtol=1e-12)


def test_poles_at_round_numbers_that_rounding_moves_have_the_same_frequencies_to_rounding() -> None:
    for pole in (0.25, 1.0, 8.0):
        grids = [frequency_grid(_filter(-1.0, -pole * (1 + e))) for e in (-1e-12, 0.0, 1e-12)]
        np.testing.assert_allclose(grids[0], grids[1], rtol=1e-10)
        np.testing.assert_allclose(grids[2], grids[1], rtol=1e-10)


def _count_points(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Count the points at which systems are evaluated from now on."""
    points: list[int] = []
    own = StateSpace.evaluate

    def counted(self: StateSpace, at: Any) -> NDArray[np.complex128]:
        points.append(np.size(at))
        return own(self, at)

    monkeypatch.setattr(StateSpace, "evaluate", counted)
    return points


def test_all_frequencies_tell_that_residuals_are_copies(monkeypatch: pytest.MonkeyPatch) -> None:
    plant = rs.Plant([[-1.0, 2.0], [0.0, -3.0]], [[1.0], [1.0]], [[1.0, 0.0], [1.0, 0.0]])
    plant = plant.with_faults({"f1": [1.0, 0.0], "f2": [0.0, 1.0]})
    generator = rs.design.luenberger_observer(plant).residual_generator()
    points = _count_points(monkeypatch)
    assert generator.n_residuals == 2
    assert generator.residual_rank == 1
    assert sum(points) >= 60


def test_faults_that_one_filter_keeps_apart_are_tried_once(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []
    own = directional_gain.obstacle

    def counted(A: Any, C: Any, events: Any, *options: Any) -> str | None:
        asked.append(len(events))
        return own(A, C, events, *options)

    monkeypatch.setattr(directional_gain, "obstacle", counted)
    rs.design.detection_filter(_plant())
    assert asked == [2]


def test_a_fault_far_from_the_outputs_is_marked_where_it_answers() -> None:
    """Its response falls by powers of frequency, and what rounding leaves of another residual by fewer."""
    n = 6
    A = np.diag(np.ones(n - 1), 1) + np.diag(np.ones(n - 1), -1)
    A -= np.diag(A.sum(1) + np.linspace(1, 1.5, n))
    plant = rs.Plant(A, np.eye(n)[:, [2, 5]], np.eye(n)[[2, 0, 1]]).with_actuator_faults()
    assert rs.design.detection_filter(plant).structure.tolist() == [[True, True], [False, False], [False, False]]


def test_an_input_that_no_output_sees_leaks_nothing() -> None:
    A, B, C = [[-1, 1, 0], [0, -2, 0], [0, 0, -3]], [[1, 0], [0, 0], [0, 1]], [[1, 0, 0], [0, 1, 0]]
    plant = rs.Plant(A, B, C).with_disturbances([[1], [1], [1]]).with_actuator_faults()
    assert rs.design.parity_relations(plant).structure.tolist() == [[True, False]]


def test_what_is_not_seen_does_not_hide_a_lasting_response() -> None:
    plant = rs.Plant([[-1, 0, 0], [1, -2, 0], [0, 0, -3]], [[1], [0], [0.5]], [[0, 0, 1]]).with_actuator_faults()
    made = rs.design.kalman_filter(plant.with_noise(process=1, measurement=1))
    np.testing.assert_allclose(made.steady_directions["u1 actuator"], [0.5 / np.sqrt(10)], rtol=1e-6)
