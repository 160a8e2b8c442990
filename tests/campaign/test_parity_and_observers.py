"""Ranks, subspaces, polynomials and eigenvectors on 200 generated plants: one theory.

Run with ``make campaign``.
"""

from __future__ import annotations

import numpy as np
import pytest

from one_theory import Findings, compare, generated, ignored_sets

PLANTS = 200
SETS = 5  # of ignored faults, for each plant


@pytest.mark.campaign
def test_every_method_agrees_with_the_exact_ranks_and_with_the_others() -> None:
    out = Findings()
    for seed in range(PLANTS):
        plant = generated(seed)
        for ignored in ignored_sets(plant, np.random.default_rng([21, seed]), SETS):
            compare(plant, ignored, f"plant {seed}", out)
    print(dict(out.counts), *out.refused, sep="\n")
    assert out.wrong == []
    attainable = out.counts["attainable"]
    assert attainable >= 500
    assert out.counts["rows"] - attainable >= 200
    for name in ("bank", "parity"):  # what is attainable and not reached was refused for accuracy, with the reason
        reached, refused = out.counts[f"{name}: reached"], out.counts[f"{name}: refused for accuracy"]
        assert reached + refused >= attainable
        assert reached >= 0.98 * attainable
    assert out.counts["right eigenvectors: exist"] >= 500
    assert out.counts["left eigenvectors: exist"] >= 150
