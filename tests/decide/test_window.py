"""The moving sum: right, and the same bits for any cutting."""

from __future__ import annotations

import numpy as np
import pytest

from residua.decide.window import empty_window, moving_sum


@pytest.mark.parametrize("window", [1, 2, 7, 40])
def test_it_is_the_sum_over_the_window(window: int) -> None:
    rng = np.random.default_rng(window)
    x = rng.standard_normal((2, 100, 3))
    sums, _ = moving_sum(x, empty_window(2, window, 3))
    for k in range(100):
        np.testing.assert_allclose(sums[:, k], x[:, max(0, k - window + 1) : k + 1].sum(axis=1), atol=1e-12)


@pytest.mark.parametrize("window", [1, 3, 10, 64])
def test_any_cutting_gives_the_same_bits(window: int) -> None:
    rng = np.random.default_rng(window)
    x = rng.standard_normal((2, 150, 2)) * 10.0 ** rng.integers(-8, 8, (2, 150, 2))
    whole, _ = moving_sum(x, empty_window(2, window, 2))
    for cuts in (np.arange(1, 150), *(np.sort(rng.integers(0, 151, 12)) for _ in range(5))):
        state, parts = empty_window(2, window, 2), []
        for piece in np.split(x, cuts, axis=1):
            sums, state = moving_sum(piece, state)
            parts.append(sums)
        assert np.array_equal(np.concatenate(parts, axis=1), whole)


def test_there_is_no_drift() -> None:
    x = np.zeros((1, 5000, 1))
    x[0, 10] = 1e16
    sums, _ = moving_sum(x + 0.1, empty_window(1, 50, 1))
    np.testing.assert_allclose(sums[0, 200:], 5.0, rtol=1e-13)
