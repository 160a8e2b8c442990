"""Whitening does not depend on the units of the residuals."""

from __future__ import annotations

import numpy as np
import pytest

from residua.decide import whitening_matrix


@pytest.mark.parametrize("decades", [0, 3, 6])
def test_norms_do_not_change_with_units(decades: float) -> None:
    rng = np.random.default_rng(0)
    L = rng.standard_normal((4, 4))
    r = rng.standard_normal((50, 4))
    units = 10.0 ** rng.uniform(-decades, decades, 4)
    first = np.linalg.norm(r @ whitening_matrix(L @ L.T), axis=1)
    second = np.linalg.norm((r * units) @ whitening_matrix(L @ L.T * np.outer(units, units)), axis=1)
    np.testing.assert_allclose(first, second, rtol=1e-6)


def test_a_residual_that_never_moved_does_not_turn_rounding_into_alarms() -> None:
    M = whitening_matrix(np.diag([1.0, 0.0]))
    assert np.isfinite(M).all()
    assert np.linalg.norm(np.array([0.0, 1e-12]) @ M) < 1e-6


def test_of_nothing_it_is_the_identity() -> None:
    np.testing.assert_array_equal(whitening_matrix(np.zeros((3, 3))), np.eye(3))
