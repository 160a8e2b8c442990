"""Functions that keep their results: the same results, computed once."""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

import residua as rs
from residua.design import ResidualGenerator
from residua.errors import DesignError
from residua.linear import StateSpace
from residua.linear.poles.matrix_poles import _kept_poles, explicit_poles
from residua.linear.systems import array_cache
from residua.linear.systems.array_cache import UnkeyedError, cached_by_contents, cached_by_entries, contents, forget
from residua.linear.systems.balancing import balance_system
from residua.linear.systems.units import _origins, matrix_units, pencil_units
from residua.words import rates_in, unit_of_rates


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
    forget()
    monkeypatch.setattr(array_cache, "_MOST_BYTES", 3 * (100 * 100 * 8 + 1000))
    monkeypatch.setattr(array_cache, "_LET_GO", 0.0)
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
        (_kept_poles, (A,)),
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
        assert np.array_equal(_origins(graph.toarray()), np.sort(np.unique(part, return_index=True)[1]))


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
        (),
        [],
        ("a", "b"),  # names alone are their own key
        ["a", "b"],
        ("ab",),
        (("a", "b"),),
        ("a", b"b"),
        ("a", None),
        {"a": "b"},
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


def test_a_result_is_kept_in_all_units_of_time_unless_a_text_in_it_has_a_rate():
    calls = []

    @cached_by_contents
    def inner(rate, worded):
        calls.append("inner")
        return f"{unit_of_rates() * rate:g} per second" if worded else "a rate"

    @cached_by_contents
    def outer(rate, worded):
        calls.append("outer")
        return (inner(rate, worded),)

    for worded, again in ((False, []), (True, ["outer", "inner"])):
        inner(1.0, worded)
        calls.clear()
        assert outer(1.0, worded)[0] == ("1 per second" if worded else "a rate")
        assert calls == ["outer"]
        calls.clear()
        with rates_in(4.0):
            assert outer(1.0, worded)[0] == ("4 per second" if worded else "a rate")
        assert calls == again
        calls.clear()
        assert outer(1.0, worded)[0] == ("1 per second" if worded else "a rate")
        assert calls == []


def test_a_unit_of_rates_says_whether_it_or_one_within_was_asked_for():
    with rates_in(4.0) as outer:
        with rates_in(1.0) as beside:
            pass
        with rates_in(2.0) as inner:
            assert not inner.asked
            assert unit_of_rates() == 8.0
    assert (inner.value, inner.asked) == (8.0, True)
    assert (outer.value, outer.asked) == (4.0, True)  # which the inner one is a multiple of
    assert not beside.asked


def test_refusals_are_kept_each_raised_as_its_own():
    calls = []

    @cached_by_contents
    def refusing(A):
        calls.append(A)
        raise (DesignError("no such thing") if len(A) else ValueError("crash"))

    refusals = []
    for _ in range(3):
        with pytest.raises(DesignError, match="no such thing") as refused:
            refusing(np.ones(1))
        refusals.append(refused.value)
    assert len(calls) == 1
    assert len({id(error) for error in refusals}) == 3
    for _ in range(2):
        with pytest.raises(ValueError, match="crash"):
            refusing(np.ones(0))
    assert len(calls) == 3  # what is none of the package's own is no answer


def test_all_functions_have_one_limit_and_what_was_used_least_recently_goes_first(monkeypatch):
    forget()
    monkeypatch.setattr(array_cache, "_MOST_BYTES", 100_000)
    calls = []

    def made(number):
        @cached_by_entries
        def function(A):
            calls.append((number, A[0]))
            return np.zeros(1000)

        return function

    first, second = made(1), made(2)
    for k in range(6):
        first(np.array([float(k)]))
        second(np.array([float(k)]))
    first(np.array([0.0]))  # used again
    second(np.array([6.0]))
    assert array_cache.kept_bytes() <= 100_000
    calls.clear()
    first(np.array([0.0]))
    assert calls == []
    second(np.array([0.0]))
    assert calls == [(2, 0.0)]
    forget()
    assert array_cache.kept_bytes() == 0


def test_keys_and_properties_that_are_kept_later_count_too():
    forget()
    latest = array_cache.Latest()
    latest.of((b"0" * 5000,), lambda: 1.0)
    assert 5000 < latest.bytes < 5500
    system = StateSpace(-np.eye(2), np.ones((2, 1)), np.ones((1, 2)))
    latest.of("system", lambda: system)
    before = latest.bytes
    vars(system)["_poles"] = np.zeros(1000)  # as a cached property keeps it
    latest.of("another", lambda: 1.0)
    assert latest.bytes - before > 8000
    latest.forget()
    assert latest.bytes == 0


def test_what_a_result_grows_by_counts_when_another_is_asked_for_again():
    forget()
    latest = array_cache.Latest()
    first, second = (StateSpace(-np.eye(2), np.ones((2, 1)), np.ones((1, 2))) for _ in range(2))
    for name, system in (("first", first), ("second", second)):
        latest.of(name, lambda system=system: system)
    before = latest.bytes
    latest.of("first", lambda: first)
    vars(first)["_poles"] = np.zeros(1000)
    latest.of("second", lambda: second)  # a hit, after which the first is no more the last that was used
    latest.of("another", lambda: 1.0)
    assert latest.bytes - before > 8000
    latest.forget()


def test_matrices_that_products_round_otherwise_are_told_apart():
    """In parts of arguments; arguments that are matrices themselves are brought to one order first."""
    seen = []

    @cached_by_contents
    def function(A, parts=()):
        seen.append((A.flags.c_contiguous, [M.flags.c_contiguous for M in parts]))
        return A

    M = np.arange(6.0).reshape(2, 3)
    turned, part = np.asfortranarray(M), np.repeat(M, 2, axis=1)[:, ::2]
    assert function(M) is function(turned) is function(part) is function(M)
    function(M, (M,))
    function(turned, (M,))
    function(M, (turned,))
    function(M, (part,))
    assert seen == [(True, []), (True, [True]), (True, [False]), (True, [False])]
    assert contents(np.ones(3)) == contents(np.ones(6)[::2])  # of one dimension nothing is summed in another order


def test_threads_share_the_limit(monkeypatch):
    forget()
    monkeypatch.setattr(array_cache, "_MOST_BYTES", 50_000)
    functions = [cached_by_entries(lambda A, k=k: np.full(500, A[0] + k)) for k in range(3)]

    def asked(seed):
        for value in np.random.default_rng(seed).integers(0, 20, 200):
            for k, function in enumerate(functions):
                assert function(np.array([float(value)]))[0] == value + k

    with ThreadPoolExecutor(4) as threads:
        list(threads.map(asked, range(4)))
    assert 0 < array_cache.kept_bytes() <= 50_000
    forget()
    assert array_cache.kept_bytes() == 0


@dataclass(frozen=True, eq=False)
class Holder:
    A: np.ndarray
    parts: dict


def test_results_do_not_share_memory_with_any_argument():
    @cached_by_contents
    def function(*values, **options):
        holder = values[1]
        return values[0][0][1:], options["A"].T, options["names"], holder, holder.A[:, :1], Holder(holder.A, {}), values

    def asked():
        listed, A, names = [np.arange(3.0)], np.ones((2, 2)), ["a"]
        holder = Holder(np.ones((2, 3)), {"x": np.zeros(2)})
        return function(listed, holder, A=A, names=names), listed, A, names, holder

    kept, listed, A, names, holder = asked()
    listed[0][:] = A[:] = holder.A[:] = holder.parts["x"][:] = 7.0  # the arrays of the caller can be written to
    names.append("b")
    listed.append(np.zeros(1))
    again = asked()[0]
    assert again is kept
    assert np.array_equal(kept[0], [1.0, 2.0])
    assert np.array_equal(kept[1], np.ones((2, 2)))
    assert kept[2] == ["a"]
    for one in (kept[3].A, kept[4], kept[5].A):
        assert np.all(one == 1.0)
    assert np.all(kept[3].parts["x"] == 0.0)
    assert len(kept[6][0]) == 1


def test_arguments_that_nobody_writes_to_stay_the_same_objects():
    system = StateSpace(-np.eye(2), np.ones((2, 1)), np.ones((1, 2)))
    kept = cached_by_contents(lambda system: (system, system.A[:1]))(system)
    assert kept[0] is system
    assert np.shares_memory(kept[1], system.A)


def _writable(value, path="it"):
    """Yield the arrays in a value, by where they are."""
    if isinstance(value, np.ndarray):
        yield path, value
    elif isinstance(value, dict):
        for name, part in value.items():
            yield from _writable(part, f"{path}[{name!r}]")
    elif isinstance(value, tuple):
        for k, part in enumerate(value):
            yield from _writable(part, f"{path}[{k}]")
    elif hasattr(value, "__dataclass_fields__"):
        for name in value.__dataclass_fields__:
            yield from _writable(getattr(value, name), f"{path}.{name}")


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_what_is_handed_out_can_be_changed_and_what_is_kept_does_not_follow(dt):
    plant = rs.Plant(0.5 * np.eye(2) - np.eye(2) * (dt == 0), np.ones((2, 1)), [[1, 0], [0, 1], [1, 1]], dt=dt)
    plant = plant.with_sensor_faults()
    relations = rs.design.parity_relations(plant).relations
    assert relations is not None

    def generator(made):
        return made.evidence, made.subspaces, made.state_map, made.static_map, made.steady

    for ask in (
        lambda: generator(rs.design.decoupled_residual(plant)),
        lambda: generator(relations.with_poles()),
        lambda: rs.linear.detectability(plant.A, plant.C, dt=dt),
    ):
        first, untouched = ask(), ask()
        before = [(path, array.copy()) for path, array in _writable(untouched)]
        assert before
        for path, array in _writable(first):
            assert array.flags.writeable, path
            array[...] = 1
        after = list(_writable(ask()))
        assert [path for path, _ in after] == [path for path, _ in before]
        assert all(np.array_equal(one, other) for (_, one), (_, other) in zip(after, before, strict=True))


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_mappings_of_evidence_that_are_handed_out_are_the_users_own(dt):
    plant = rs.Plant(0.5 * np.eye(2) - np.eye(2) * (dt == 0), np.ones((2, 1)), [[1, 0], [0, 1], [1, 1]], dt=dt)
    plant = plant.with_sensor_faults()
    relations = rs.design.parity_relations(plant).relations
    assert relations is not None

    def mappings(made: ResidualGenerator) -> list[dict[str, Any]]:
        evidence = made.evidence
        found = [evidence.decoupling, evidence.conditions, evidence.ranks, made.subspaces]
        assert all(isinstance(one, dict) for one in found)
        return cast("list[dict[str, Any]]", found)

    for ask in (lambda: rs.design.decoupled_residual(plant), relations.with_poles):
        for mapping in mappings(ask()):
            mapping["changed"] = 1.0
        assert not any("changed" in mapping for mapping in mappings(ask()))


@pytest.mark.parametrize(
    "design",
    [
        rs.design.luenberger_observer,
        rs.design.unknown_input_observer,
        lambda plant: rs.design.perfect_observer(plant, least_order=True),
        lambda plant: rs.design.fault_estimator(plant).observer,
    ],
)
def test_mappings_of_observers_that_are_handed_out_are_the_users_own(design: Callable[[rs.Plant], Any]) -> None:
    """What was written into the observer of a fault estimator was in that of the next one."""
    plant = rs.Plant([[-1, 1], [0, -2]], [[0], [1]], np.eye(2)).with_actuator_faults()
    for name in ("decoupling", "conditions", "ranks"):
        getattr(design(plant).evidence, name)["changed"] = 1.0
        assert "changed" not in getattr(design(plant).evidence, name)


class Interrupted(array_cache.Latest[np.ndarray]):
    """Lets go of its results, but for their count."""

    is_interrupted = False

    def _count(self, size: int) -> None:
        if self.is_interrupted and size < 0:
            raise KeyboardInterrupt
        super()._count(size)


def test_interruptions_between_results_and_their_count_let_the_next_one_end():
    """The results of all functions were looked through without end for what was to go, and none was there."""
    forget()
    latest, numbers = Interrupted(), array_cache._MOST_BYTES * 3 // 4 // 8
    latest.of("large", lambda: np.zeros(numbers))
    latest.is_interrupted = True
    with pytest.raises(KeyboardInterrupt):
        latest.forget()
    with pytest.raises(KeyboardInterrupt):
        latest.of("large", lambda: np.zeros(numbers))
    latest.is_interrupted = False
    assert latest.of("small", lambda: np.ones(1)) == 1.0
    assert latest.bytes == 0


def test_the_handler_of_a_signal_may_ask_for_results():
    """It waited for the lock of the very thread that it had interrupted."""
    function, calls = counting()
    asked: list[object] = []

    def in_the_middle() -> None:
        with array_cache._lock:
            asked.append(function(np.eye(1), np.eye(1)))

    thread = threading.Thread(target=in_the_middle, daemon=True)
    thread.start()
    thread.join(20)
    assert len(asked) == len(calls) == 1


@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are not forked here")
def test_a_forked_process_goes_on_keeping_results():
    function, calls = counting()
    function(np.eye(1), np.eye(1))
    with multiprocessing.get_context("fork").Pool(1) as pool:
        assert pool.apply(array_cache.kept_bytes) == array_cache.kept_bytes() > 0
        assert pool.apply(explicit_poles, (-np.eye(1),)) == [-1.0]
    assert len(calls) == 1
