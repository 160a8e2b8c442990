"""Whether the inverse form exists depends on no unit, and not on rates that are far apart."""

from __future__ import annotations

import numpy as np
import pytest

import residua as rs
from guards import trips
from residua.errors import AccuracyError, DesignError


def watched(A: np.ndarray, states: np.ndarray, unit_of_time: float) -> rs.Plant:
    """Return a plant with a state matrix in units of its states and of time, all states measured, and one fault."""
    n = len(A)
    A = A / states[:, None] * states * unit_of_time
    return rs.Plant(A, np.arange(1.0, n + 1)[:, None] / states[:, None], np.diag(states)).with_faults({"f": 1 / states})


@pytest.mark.parametrize("unit_of_time", [2.0**-20, 1.0, 2.0**20])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_rates_far_apart_and_units_make_no_matrix_singular(seed: int, unit_of_time: float) -> None:
    states = 2.0 ** np.round(np.random.default_rng(seed).uniform(-20, 20, 3))
    slow = watched(np.diag([-1e-10, -1.0, -2.0]), states, unit_of_time)
    coupled = watched(np.array([[-1e-10, 1.0, 0], [0, -1, 3], [0, 0, -2]]), states, unit_of_time)
    for plant in (slow, coupled):
        made = rs.design.inverse_form_observer(plant)
        assert made.evidence.conditions["T A - K C = F T"] < 1e-12
    integrating = watched(np.array([[0, 1.0, 0], [0, -1, 0], [0, 0, -2]]), states, unit_of_time)
    with pytest.raises(DesignError, match="A is singular, rank 2 < 3"):
        rs.design.inverse_form_observer(integrating)
    rounded = watched(np.array([[5e-17, 1.0, 0], [0, -1, 0], [0, 0, -2]]), states, unit_of_time)
    with pytest.raises(DesignError, match="A is singular, rank 2 < 3"):
        rs.design.inverse_form_observer(rounded)
    alike = watched(np.array([[1, 1.0, 0], [1, 1 + 1e-12, 0], [0, 0, -2]]), states, unit_of_time)
    with pytest.raises(DesignError, match=r"A is singular, rank 2 < 3, with a singular value of [1-9]e-1[34]"):
        rs.design.inverse_form_observer(alike)


@trips("design.observers.inverse_form_observer:_observer:1")
def test_poles_too_far_apart_for_working_precision_are_refused() -> None:
    plant = rs.Plant([[0, 1, 0], [0, 0, 1], [-6, -11, -6]], [[0], [0], [1]], np.eye(3)[:2]).with_disturbances(
        {"d": [1, 0, 0]}
    )
    with pytest.raises(AccuracyError, match="singular to working precision"):
        rs.design.inverse_form_observer(plant, poles=[-1e-9, -1e9, -1])
