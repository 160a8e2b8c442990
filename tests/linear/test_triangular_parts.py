"""The block triangular form of a matrix, and the zeros of what it takes apart."""

from __future__ import annotations

import numpy as np
import pytest

from residua.linear import invariant_zeros
from residua.linear.subspaces.parts import triangular_parts


@pytest.mark.parametrize("seed", range(60))
def test_parts_are_block_triangular_and_their_ranks_are_that_of_the_whole(seed):
    rng = np.random.default_rng(seed)
    shape = rng.integers(0, 9, 2)
    M = rng.normal(size=shape) * (rng.random(shape) < rng.choice([0.15, 0.3, 0.6]))
    parts = triangular_parts(M != 0)
    for axis in (0, 1):
        found = np.concatenate([np.zeros(0, dtype=int), *(part[axis] for part in parts)])
        assert sorted(found) == list(range(shape[axis]))
    sizes = [len(rows) - len(columns) for rows, columns in parts]
    assert np.all(np.diff(np.sign(sizes)) >= 0)  # wide, square, tall
    assert np.linalg.matrix_rank(M) == sum(min(len(rows), len(columns)) for rows, columns in parts) if M.size else True
    # an order of the parts leaves nothing below its diagonal blocks: what couples them has no loop
    coupled = np.array([[M[np.ix_(rows, columns)].any() for _, columns in parts] for rows, _ in parts], dtype=float)
    coupled = coupled.reshape(len(parts), len(parts))
    np.fill_diagonal(coupled, 0)
    assert not np.linalg.matrix_power(coupled, len(parts) + 1).any()
    assert not any(coupled[i, j] for i in range(len(parts)) for j in range(i) if sizes[i] > 0 or sizes[j] < 0)


def test_where_entries_cancel_the_parts_are_no_system_of_their_own():
    """Two equal outputs see the same: the input is not determined, and only one of the two hidden modes is a zero."""
    A, B = np.diag([-1.0, -2.0, -3.0]), [[1.0], [1.0], [1.0]]
    C = [[1.0, 1, 0], [1, 1, 0]]
    found = invariant_zeros(A, B, C)
    assert found.normal_rank == 1
    np.testing.assert_allclose(found.zeros, [-3, -1.5], rtol=1e-12)
    two = invariant_zeros(A, [[1.0, 1], [1, 1], [1, 1]], C)  # the third mode is moved by the input that is free
    assert two.normal_rank == 1
    np.testing.assert_allclose(two.zeros, [-3, -1.5], rtol=1e-12)
