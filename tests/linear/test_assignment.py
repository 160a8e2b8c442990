"""Pairs with the least sum of costs, as SciPy chooses them, and without importing it."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from residua.linear.poles.assignment import least_cost_columns
from residua.linear.poles.spectrum import match_poles


def _tables(rng: np.random.Generator, rows: int, columns: int) -> list[NDArray[np.float64]]:
    """Return costs without ties, with many, distances of poles and their conjugates, and all the same."""
    wanted = rng.integers(0, 5, rows) + 1j * rng.integers(-2, 3, rows)
    there = rng.integers(0, 5, columns) + 1j * rng.integers(-2, 3, columns)
    return [
        rng.random((rows, columns)),
        rng.integers(0, 4, (rows, columns)).astype(float),
        np.abs(wanted[:, None] - there),
        np.ones((rows, columns)),
    ]


@pytest.mark.parametrize("seed", range(50))
def test_the_same_columns_are_chosen_as_by_scipy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rows = int(rng.integers(0, 15))
    for costs in _tables(rng, rows, rows + int(rng.integers(0, 6))):
        np.testing.assert_array_equal(least_cost_columns(costs), linear_sum_assignment(costs)[1])


def test_poles_at_the_ends_of_the_range_of_numbers_are_paired() -> None:
    order = match_poles(np.array([1e-300, 2e-300], complex), np.array([1e308, 2e-300, -1e308], complex))
    assert 1 in order
    assert len(set(order)) == 2


def test_a_design_does_not_wait_for_optimisers_and_graphs_to_be_imported() -> None:
    program = (
        "import sys, residua as rs; plant = rs.library.gertler(); rs.design.luenberger_observer(plant); "
        "rs.design.parity_relations(plant); "
        "assert not {'scipy.optimize', 'scipy.sparse'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", program], check=True)
