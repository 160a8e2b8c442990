"""Rows of JSON numbers into arrays: the same in C and in NumPy."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from residua.live import readings as module

VALUES = (
    st.floats(allow_nan=False, allow_infinity=False)
    | st.integers(-(2**70), 2**70)
    | st.none()
    | st.sampled_from([True, "1", [], {}, 10**400, -1, -1.0])
)
ROWS = st.lists(st.lists(st.one_of(VALUES, st.floats(-9, 9)), max_size=3) | VALUES, max_size=4)


@pytest.mark.skipif(module._kernel is None, reason="built without a C compiler")
@settings(max_examples=400, deadline=None)
@given(ROWS | VALUES, st.integers(0, 4), st.integers(0, 3), st.integers(0, 2))
def test_c_and_numpy_say_and_write_the_same(rows: Any, count: int, width: int, first: int) -> None:
    ours, plain = np.full((count, 5), 7.0), np.full((count, 5), 7.0)
    wrong = module.fill_rows(ours, rows, first, width)
    assert bool(wrong) == bool(module._fill_rows(plain, rows, first, width))
    if not wrong:
        np.testing.assert_array_equal(ours.view(np.int64), plain.view(np.int64))


@settings(max_examples=100, deadline=None)
@given(st.lists(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=2, max_size=2), min_size=1))
def test_numbers_arrive_to_the_last_bit(rows: list[list[float]]) -> None:
    values = np.zeros((len(rows), 3))
    assert module.fill_rows(values, json.loads(json.dumps(rows)), 1, 2) == ""
    np.testing.assert_array_equal(values[:, 1:].copy().view(np.int64), np.array(rows).view(np.int64))
    assert not values[:, 0].any()


@pytest.mark.skipif(module._kernel is None, reason="built without a C compiler")
@pytest.mark.parametrize(
    ("values", "first", "width"),
    [
        (np.zeros((2, 3)), 2, 2),
        (np.zeros((2, 3)), -1, 1),
        (np.zeros((2, 3), dtype=np.float32), 0, 3),
        (np.zeros((2, 3), dtype=np.int64), 0, 3),
        (np.zeros(3), 0, 1),
    ],
)
def test_no_row_is_written_where_there_is_no_room(values: Any, first: int, width: int) -> None:
    with pytest.raises(ValueError, match="with room for the rows"):
        module._kernel.fill(values, [[1.0] * 3] * 2, first, width)
    assert not values.any()
