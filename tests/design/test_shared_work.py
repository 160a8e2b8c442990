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
