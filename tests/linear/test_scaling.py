"""Balanced units: what is left of zeros moves none of them."""

from __future__ import annotations

import numpy as np
import pytest

from residua.linear.systems.scaling import scaling


@pytest.mark.parametrize("seed", range(10))
def test_residue_of_zeros_moves_no_unit(seed: int) -> None:
    """Two parts that 1e-21 to 1e-32 of a linearisation connect, in any units of powers of two."""
    rng = np.random.default_rng(seed)
    n, m, p = 8, 2, 4
    A, B, C = rng.standard_normal((n, n)), rng.standard_normal((n, m)), rng.standard_normal((p, n))
    A[:4, 4:] = A[4:, :4] = B[:4, 1] = B[4:, 0] = C[:2, 4:] = C[2:, :4] = 0.0
    D = np.zeros((p, m))
    alone = scaling(A, B, C, D, sampled=False)
    residue = 10.0 ** rng.uniform(-32, -21, (n, n)) * (rng.random((n, n)) < 0.5)
    X = np.exp2(rng.integers(-20, 21, n).astype(float))
    whole = (A + np.where(A == 0, residue, 0.0)) / X[:, None] * X
    with_residue = scaling(whole, B / X[:, None], C * X, D, sampled=False)
    balanced = with_residue.equations[:, None] * (A / X[:, None] * X) * with_residue.states / with_residue.rate
    expected = alone.equations[:, None] * A * alone.states / alone.rate
    assert np.abs(balanced).max() < 4
    assert np.abs(np.log2(np.abs(balanced[A != 0]) / np.abs(expected[A != 0]))).max() <= 3
