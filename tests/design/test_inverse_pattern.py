"""The inverse of a sparse matrix has the zeros of its pattern; whether there is one depends on no unit."""

from __future__ import annotations

import numpy as np
import pytest

import residua as rs
from residua.design.observers.inverse_form_observer import _inverse
from residua.errors import DesignError


@pytest.mark.parametrize("seed", range(40))
def test_zeros_of_the_pattern(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 7))
    mask = rng.random((n, n)) < 0.4
    np.fill_diagonal(mask, True)
    A = np.where(mask, rng.standard_normal((n, n)), 0.0)[rng.permutation(n)]
    found = _inverse(A)
    np.testing.assert_allclose(found, np.linalg.inv(A), atol=1e-12 * np.abs(np.linalg.inv(A)).max())
    # an entry that is zero whatever the values are is zero for others too
    others = [np.linalg.inv(np.where(A != 0, rng.standard_normal((n, n)), 0.0)) for _ in range(3)]
    silent = np.all([np.abs(M) < 1e-13 * np.abs(M).max() for M in others], axis=0)
    assert not np.any(found[silent])


def watched(A: np.ndarray, states: np.ndarray, unit_of_time: float) -> rs.Plant:
    """Return a plant with a state matrix in units of its states and of time, all states measured, and one fault."""
    n = len(A)
    A = A / states[:, None] * states * unit_of_time
    return rs.Plant(A, np.ones((n, 1)), np.diag(states)).with_faults({"f": 1 / states})


@pytest.mark.parametrize("unit_of_time", [2.0**-20, 1.0, 2.0**20])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_rates_far_apart_and_units_make_no_matrix_singular(seed: int, unit_of_time: float) -> None:
    states = 2.0 ** np.round(np.random.default_rng(seed).uniform(-20, 20, 3))
    slow = watched(np.diag([-1e-11, -1.0, -2.0]), states, unit_of_time)
    coupled = watched(np.array([[-1e-11, 1.0, 0], [0, -1, 3], [0, 0, -2]]), states, unit_of_time)
    for plant in (slow, coupled):
        made = rs.design.inverse_form_observer(plant)
        assert made.evidence.conditions["T A - K C = F T"] < 1e-12
    integrating = watched(np.array([[0, 1.0, 0], [0, -1, 0], [0, 0, -2]]), states, unit_of_time)
    with pytest.raises(DesignError, match="A is singular, rank 2 < 3, whatever the values"):
        rs.design.inverse_form_observer(integrating)
    rounded = watched(np.array([[5e-17, 1.0, 0], [0, -1, 0], [0, 0, -2]]), states, unit_of_time)
    with pytest.raises(DesignError, match="what rounding leaves of zero"):
        rs.design.inverse_form_observer(rounded)
    alike = watched(np.array([[1, 1.0, 0], [1, 1 + 1e-12, 0], [0, 0, -2]]), states, unit_of_time)
    with pytest.raises(DesignError, match="a block of 2 states has rank 1: a singular value is 3e-13 of the largest"):
        rs.design.inverse_form_observer(alike)
