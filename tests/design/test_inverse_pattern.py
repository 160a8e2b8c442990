"""The inverse of a sparse matrix has the zeros of its pattern, exactly, and is the inverse otherwise."""

from __future__ import annotations

import numpy as np
import pytest

from residua.design.observers.inverse_form_observer import _inverse


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
