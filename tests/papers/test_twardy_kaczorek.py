"""Procedure 1 of Twardy and Kaczorek, part I, with a pair that is only detectable."""

from __future__ import annotations

import numpy as np
import pytest

import residua as rs
from residua.errors import DesignError


def procedure_1(zero: float) -> rs.Plant:
    """Return a plant whose disturbance has the invariant zero ``s = zero``: (C, T A) is not observable there."""
    A = np.array([[0.0, 1, 0], [0, 0, 1], [-1, -2, -3]])
    # d reaches y through (s - zero) s / det(s - A), with a first derivative: rank(CE) = rank(E) = 1
    return rs.Plant(A, np.zeros((3, 0)), [[0.0, -zero, 1.0]]).with_disturbances({"d": [0.0, 0, 1]})


def test_steps_5_to_10_the_canonical_decomposition() -> None:
    """y = x3 - zero x2 sees neither the integrator of d nor the mode at the zero: both are fixed."""
    with pytest.raises(DesignError, match="not detectable: the invariant zero"):
        rs.design.unknown_input_observer(procedure_1(-2.0))  # the zero at 0 is on the boundary
    plant = rs.Plant([[0.0, 1], [-2, -3]], np.zeros((2, 0)), [[2.0, 1]]).with_disturbances({"d": [0, 1.0]})
    observer = rs.design.unknown_input_observer(plant, poles=[-7.0])
    np.testing.assert_allclose(observer.evidence.fixed_poles, [-2], atol=1e-12)
    np.testing.assert_allclose(np.sort(observer.poles.real), [-7, -2], atol=1e-9)
    np.testing.assert_allclose(rs.linear.invariant_zeros(plant.A, plant.Bd, plant.C).zeros, [-2], atol=1e-12)
    with pytest.raises(DesignError, match="not observable and stay where they are"):
        rs.design.unknown_input_observer(plant, poles=[-7.0, -8.0])


def test_step_6_an_unstable_zero_is_named() -> None:
    plant = rs.Plant([[0.0, 1], [-2, -3]], np.zeros((2, 0)), [[-2.0, 1]]).with_disturbances({"d": [0, 1.0]})
    with pytest.raises(DesignError, match=r"invariant zero 2[+.\d]* ?.*of \(A, E, C\)"):
        rs.design.unknown_input_observer(plant)


def test_step_1_the_rank_condition() -> None:
    plant = rs.Plant([[0.0, 1], [-2, -3]], np.zeros((2, 0)), [[1.0, 0]]).with_disturbances({"d": [0, 1.0]})
    with pytest.raises(DesignError, match=r"rank\(CE\)=0 < rank\(E\)=1"):
        rs.design.unknown_input_observer(plant)
