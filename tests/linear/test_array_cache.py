"""Functions that keep their results: the same results, computed once."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from residua.linear.poles.matrix_poles import explicit_poles
from residua.linear.systems import array_cache
from residua.linear.systems.array_cache import UnkeyedError, cached_by_contents, cached_by_entries, contents, forget
from residua.linear.systems.balancing import balance_system
from residua.linear.systems.units import _origins, matrix_units, pencil_units


def counting():
    calls = []

    @cached_by_entries
    def function(A, B):
        calls.append((A.shape, B.shape))
        return A.sum() + np.arange(3.0), B.copy()

    return function, calls


def test_the_same_entries_are_computed_once_and_others_are_not_taken_for_them():
    function, calls = counting()
    first = function(np.ones((2, 3)), np.eye(2))
    assert function(np.ones((2, 3), order="F"), np.eye(2, dtype=int)) is first
    assert len(calls) == 1
    function(np.ones((3, 2)), np.eye(2))  # the same bytes, another shape
    function(np.ones((2, 3)), np.diag([1.0, np.nextafter(1.0, 2.0)]))
    assert calls == [((2, 3), (2, 2)), ((3, 2), (2, 2)), ((2, 3), (2, 2))]


def test_a_kept_result_cannot_be_written_to_and_does_not_follow_its_arguments():
    function, _ = counting()
    B = np.eye(2)
    kept = function(np.ones((1, 1)), B)
    B[0, 0] = 5.0
    assert np.array_equal(kept[1], np.eye(2))
    with pytest.raises(ValueError, match="read-only"):
        kept[0][0] = 1.0


def test_large_matrices_are_kept_too_but_only_so_many_bytes_of_them(monkeypatch):
    monkeypatch.setattr(array_cache, "_MOST_BYTES", 3 * 100 * 100 * 8)
    calls = []

    @cached_by_entries
    def function(A):
        calls.append(A[0, 0])
        return A + 1.0

    for value in (1.0, 2.0, 1.0, 3.0, 1.0, 4.0, 2.0, 1.0):
        assert np.array_equal(function(np.full((100, 100), value)), np.full((100, 100), value + 1.0))
    assert calls == [1.0, 2.0, 3.0, 4.0, 2.0]
    for _ in range(2):
        function(np.zeros((200, 200)))  # too large to be kept at all
    assert calls[5:] == [0.0, 0.0]
    changed = np.ones((100, 100))
    changed[-1, -1] = np.nextafter(1.0, 2.0)  # large matrices too are told apart by their last bit
    function(changed)
    assert calls[7:] == [1.0]


def test_errors_are_not_kept():
    tries = []

    @cached_by_entries
    def failing(A):
        tries.append(A)
        raise ValueError("no")

    for _ in range(2):
        with pytest.raises(ValueError, match="no"):
            failing(np.eye(1))
    assert len(tries) == 2


@pytest.mark.parametrize("seed", range(5))
def test_kept_results_are_those_of_the_function_itself(seed):
    rng = np.random.default_rng(seed)
    A, B, C, D = (rng.normal(size=shape) for shape in ((4, 4), (4, 2), (3, 4), (3, 2)))
    for cached, matrices in (
        (balance_system, (A, B, C, D)),
        (pencil_units, (A, np.diag([1.0, 1.0, 0.0, 0.0]))),
        (matrix_units, (D,)),
        (explicit_poles, (A,)),
    ):
        again, plain = (cached(*matrices), cached(*matrices)), cached.__wrapped__(*matrices)
        assert again[0] is again[1]
        parts = [vars(x) if hasattr(x, "__dict__") else dict(enumerate(x)) for x in (again[0], plain)]
        assert all(np.array_equal(parts[0][name], parts[1][name]) for name in parts[1])


def test_the_first_node_of_each_connected_part_is_that_of_scipy():
    rng = np.random.default_rng(3)
    for _ in range(300):
        count, edges = rng.integers(1, 12), rng.integers(0, 14)
        row, column = rng.integers(0, count, edges), rng.integers(0, count, edges)
        graph = coo_array((np.ones(edges), (row, column)), shape=(count, count))
        part = connected_components(graph, directed=False)[1]
        assert np.array_equal(_origins(row, column, count), np.sort(np.unique(part, return_index=True)[1]))


def test_contents_tell_types_signs_and_last_bits_apart():
    plain = [
        0.0,
        -0.0,
        0,
        False,
        None,
        "0",
        b"0",
        np.float64(0.0),
        np.zeros(1),
        np.zeros(1, dtype=int),
        (0,),
        [0],
        {0: 0},
    ]
    assert len({contents(value) for value in plain}) == len(plain)
    large = np.ones((60, 60))
    changed = large.copy()
    changed[-1, -1] = np.nextafter(1.0, 2.0)
    assert contents(large) == contents(large.copy()) != contents(changed)
    for unknown in (object(), {1, 2}, np.array([None])):
        with pytest.raises(UnkeyedError):
            contents(unknown)


def test_results_are_kept_by_what_arguments_hold_and_forgotten_when_asked():
    calls = []

    @cached_by_contents
    def function(A, margin=None):
        calls.append(margin)
        return A[:1], [A.sum(keepdims=True)]

    A = np.ones((2, 2))
    kept = function(A, 1.0)
    A[0, 0] = 7.0  # what is kept does not follow its arguments
    assert function(np.ones((2, 2)), 1.0) is kept
    assert np.array_equal(kept[0], [[1.0, 1.0]])
    for part in (kept[0], kept[1][0]):
        with pytest.raises(ValueError, match="read-only"):
            part[0, 0] = 2.0
    function(A, 1.0)
    function(np.ones((2, 2)), 1)
    assert len(calls) == 3
    for _ in range(2):
        function(np.ones((2, 2)), object())  # computed every time
    assert len(calls) == 5
    forget()
    assert function(np.ones((2, 2)), 1.0) is not kept
