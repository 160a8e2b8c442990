"""Pairs of poles with the least sum of distances."""

from __future__ import annotations

import subprocess
import sys

import numpy as np

from residua.linear.poles.spectrum import match_poles


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
