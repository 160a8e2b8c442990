"""Reading codes: against plain definitions, for any codes and any pattern."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations, product

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from residua.decide import CodeReading, Structured, read_code, read_codes
from residua.decide.alarm import Alarm
from residua.decide.code_reading import UNKNOWN
from residua.decide.structured import candidates_of_code, code_test, column_read
from residua.errors import DataError, SettingError
from residua.recording.clock import Clock

GENERALIZED = ~np.eye(4, dtype=bool)
FAULTS = ("a", "b", "c", "d")


@st.composite
def cases(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray, int]:
    members, faults = draw(st.integers(1, 5)), draw(st.integers(1, 5))
    bits = st.lists(st.booleans(), min_size=members, max_size=members)
    codes = np.array([draw(bits) for _ in range(faults)], dtype=bool).T.reshape(members, faults)
    return np.array(draw(bits), dtype=bool), codes, draw(st.integers(0, 2))


def by_definition(fired: np.ndarray, codes: np.ndarray, distance: int) -> tuple[str, set[int]]:
    """The rules as sets of members, without arrays."""
    p = frozenset(np.flatnonzero(fired))
    code = {j: frozenset(np.flatnonzero(codes[:, j])) for j in range(codes.shape[1]) if codes[:, j].any()}
    different = set(code.values())
    if not p:
        return "none", set()
    if p in different:
        return "exact", {j for j in code if code[j] == p}
    if all(len(c) == 1 for c in different) and p == frozenset().union(*(c for c in different if c <= p)):
        return "several", {j for j in code if code[j] <= p}
    antichain = all(not a < b for a in different for b in different)
    above = [c for c in different if p < c]
    if antichain and len(above) == 1:
        return "degraded", {j for j in code if code[j] == above[0]}
    if len(p) < len(fired) and different:
        least = min(len(p ^ c) for c in different)
        near = [c for c in different if len(p ^ c) == least]
        if len(near) == 1 and least <= distance and all(c == near[0] for c in above):
            return "nearest", {j for j in code if code[j] == near[0]}
    return "unknown", set()


@settings(max_examples=400, deadline=None)
@given(cases())
def test_it_is_read_as_defined(case: tuple[np.ndarray, np.ndarray, int]) -> None:
    fired, codes, distance = case
    faults = [f"f{j}" for j in range(codes.shape[1])]
    reading = read_code(fired, codes, faults, distance=distance)
    answer, named = by_definition(fired, codes, distance)
    told = {name for group in reading.named for name in group}
    assert (reading.answer, told) == (answer, {faults[j] for j in named})
    assert reading.fired == tuple(str(i + 1) for i in np.flatnonzero(fired))
    assert bool(reading.together) == (answer == "several")
    if answer == "several":
        assert (reading.faults, reading.distance, len(reading.together)) == ((), 0, np.count_nonzero(fired))
    elif named:
        assert reading.distance == np.count_nonzero(codes[:, min(named)] != fired)
    pairs = {frozenset((a[0], b[0])) for a, b in reading.pairs}
    for i, j in combinations(range(len(faults)), 2):
        both = np.array_equal(codes[:, i] | codes[:, j], fired) and codes[:, i].any() and codes[:, j].any()
        alone = np.array_equal(codes[:, i], fired) or np.array_equal(codes[:, j], fired)
        first = [next(k for k in range(len(faults)) if np.array_equal(codes[:, k], codes[:, m])) for m in (i, j)]
        if first == [i, j] and fired.any():
            assert (frozenset((faults[i], faults[j])) in pairs) == (both and not alone)


@settings(max_examples=60, deadline=None)
@given(cases(), st.integers(0, 2**32 - 1))
def test_many_at_once_are_read_like_one_by_one(case: tuple[np.ndarray, np.ndarray, int], seed: int) -> None:
    _, codes, distance = case
    faults = [f"f{j}" for j in range(codes.shape[1])]
    fired = np.random.default_rng(seed).random((3, 7, len(codes))) < 0.5
    index, readings = read_codes(fired, codes, faults, distance=distance)
    for p, k in product(range(3), range(7)):
        assert readings[index[p, k]] == read_code(fired[p, k], codes, faults, distance=distance)


def test_a_wide_bank_is_read_too() -> None:
    codes = ~np.eye(70, dtype=bool)
    faults = [f"y{j}" for j in range(70)]
    index, readings = read_codes(codes.T, codes, faults)
    assert [readings[k].faults for k in index] == [(f,) for f in faults]
    assert read_codes(np.zeros((0, 70), dtype=bool), codes, faults)[1] == ()


def test_a_generalized_bank_reads_single_faults_and_calls_two_unknown() -> None:
    for j, fault in enumerate(FAULTS):
        assert read_code(GENERALIZED[:, j], GENERALIZED, FAULTS).faults == (fault,)
    reading = read_code([True] * 4, GENERALIZED, FAULTS)
    assert reading.answer == "unknown"
    assert len(reading.pairs) == 6
    assert "more than one fault, or one that the bank does not know" in str(reading)
    assert str(reading).endswith("would fire the same members: 6 pairs"), "most pairs do: their names say nothing"
    missing = read_code([False, False, True, True], GENERALIZED, FAULTS)
    assert missing.answer == "unknown"
    assert missing.nearest == (("a",), ("b",))
    assert missing.possible == (("a",), ("b",))
    assert str(missing).endswith("undecided: 'a' or 'b' with members silent, " + UNKNOWN)


def test_a_dedicated_bank_names_both_of_two_faults() -> None:
    reading = read_code([True, False, True, False], np.eye(4), FAULTS, members=["A", "B", "C", "D"])
    assert (reading.answer, reading.pairs) == ("several", ((("a",), ("c",)),))
    assert (reading.faults, reading.together) == ((), (("a",), ("c",)))
    assert str(reading) == "fired: A, C; several faults: 'a' and 'c'"


def test_a_dedicated_bank_names_all_of_many_faults_in_the_order_of_its_members() -> None:
    codes = np.eye(5)[:, [4, 0, 2, 2, 1]]  # the code of member D belongs to nobody, that of C to two
    faults = ["e", "a", "c", "d", "b"]
    reading = read_code([1, 1, 1, 0, 1], codes, faults)
    assert reading.together == (("a",), ("b",), ("c", "d"), ("e",))
    assert reading.meaning == "several faults: 'a', 'b', ('c' or 'd') and 'e'"
    assert read_code([1, 1, 1, 1, 1], codes, faults).answer == "unknown", "nobody fires the fourth member"
    mixed = np.array([[1, 0, 0], [0, 1, 1], [0, 0, 1]])
    assert read_code([1, 1, 0], mixed, "abc").answer == "unknown", "a bank with a longer code is read as before"


def test_texts_of_every_answer() -> None:
    def said(fired: list[int], codes: list[list[int]], distance: int = 1) -> str:
        return read_code(fired, np.array(codes).T, FAULTS[: len(codes)], distance=distance).meaning

    strong = [[1, 1, 1, 0, 0], [0, 0, 1, 1, 1]]
    assert said([0, 0, 0, 0, 0], strong) == "no fault"
    assert said([1, 1, 1, 0, 0], strong) == "code of 'a' (exact)"
    assert said([1, 1, 0, 0, 0], strong) == "code of 'a' with 1 member silent (degraded)"
    assert said([1, 1, 1, 1, 0], strong) == "nearest code: 'a', 1 member off (nearest)"
    assert said([1, 1, 1, 1, 0], strong, 0).startswith("nearest code: 'a', 1 member off; but it may be more than one")
    assert said([1, 0, 0, 1, 0], strong, 0).startswith("more than one fault")
    assert said([1, 1, 1, 1, 1], strong).endswith("fire the same members: 'a' and 'b'")
    assert said([1, 0], [[0, 0]]) == "more than one fault, or one that the bank does not know"
    assert said([1, 1], [[1, 1], [1, 1]]) == "code of 'a' or 'b' (exact)"
    assert said([1, 1], [[1, 0], [0, 1], [1, 1]]) == "code of 'c' (exact), or of two at once: 'a' and 'b'"


@settings(max_examples=300, deadline=None)
@given(cases(), st.data())
def test_a_fault_with_silent_members_is_not_read_as_another_by_a_near_code(
    case: tuple[np.ndarray, np.ndarray, int], data: st.DataObject
) -> None:
    """Settled codes too: of whatever part of a code fires, its fault is read, or possible."""
    _, codes, distance = case
    bits = st.lists(st.booleans(), min_size=codes.size, max_size=codes.size)
    settled = codes & np.array(data.draw(bits)).reshape(codes.shape)
    faults = [f"f{j}" for j in range(codes.shape[1])]
    test = code_test(Structured(distance=distance), codes, faults, settled=settled)
    j = data.draw(st.integers(0, len(faults) - 1))
    fired = codes[:, j] & np.array(data.draw(st.lists(st.booleans(), min_size=len(codes), max_size=len(codes))))
    reading = test.read(fired)
    if reading.answer in ("degraded", "nearest"):
        assert faults[j] in reading.faults
    if reading.answer == "exact":
        assert faults[j] in {*reading.faults, *(name for group in reading.possible for name in group)}
        assert not set(reading.faults) & {name for group in reading.possible for name in group}
    if reading.answer == "unknown":
        assert faults[j] in {name for group in reading.possible for name in group}
        assert not reading.close


def test_a_settled_code_that_is_near_does_not_hide_who_else_it_may_be() -> None:
    """Six residuals of a drive; the torque and the bearing fire two of them once they are constant."""
    codes = ["010111", "011110", "100111", "101101", "111001", "111010"]
    faults = ["torque", "brake", "motor speed", "load speed", "shaft", "bearing"]
    table = np.array([[digit == "1" for digit in row] for row in codes])
    settled = np.zeros_like(table)
    settled[[2, 4], 0] = settled[[2, 4], 5] = True
    reading = code_test(Structured(), table, faults, settled=settled).read([False] * 4 + [True, False])
    assert reading.answer == "unknown"
    assert reading.possible == (("torque", "bearing"), ("brake",), ("motor speed",))
    assert reading.meaning.startswith("undecided: 'torque' or 'bearing' or 'brake' or 'motor speed' with members")
    wide = read_code([1] + [0] * 11, 1 - np.eye(12), [f"y{j}" for j in range(12)])
    assert "'y8' or 3 more with members silent" in wide.meaning
    assert len(wide.possible) == 11


def test_a_settled_fault_has_a_second_code() -> None:
    codes, settled = np.array([[1, 0], [1, 1], [1, 1], [1, 0]], bool), np.array([[0, 0], [1, 1], [1, 1], [0, 0]], bool)
    test = code_test(Structured(), codes, ["a", "b"], settled=settled)
    assert (test.groups, test.settled) == ((("a",), ("b", "a")), ((), ("a",)))
    assert test.labels == ("a", "b or a, settled")
    assert not test.strongly_isolating
    both = test.read([False, True, True, False])
    assert (both.answer, both.faults, both.settled) == ("exact", ("b", "a"), ("a",))
    assert both.meaning == "code of 'b', or of 'a' once constant (exact)"
    assert test.read([True] * 4).faults == ("a",)
    assert test.read([True] * 4).pairs == (), "a fault makes no pair with itself"
    named = candidates_of_code(test.read([True] * 4), test)
    assert [(c.faults, c.score) for c in named] == [(("a",), 1.0), (("b",), 0.5)], "each fault once, by its better code"
    assert [c.faults for c in candidates_of_code(both, test)] == [("b", "a")]
    own = code_test(Structured(), codes[:, :1], ["a"], settled=settled[:, :1])
    assert own.labels == ("a", "a, settled")
    half = own.read([True, True, True, False])
    assert (half.answer, half.faults) == ("degraded", ("a",)), (
        "part of its own settled code too, and of no other fault's"
    )
    assert own.read([False, True, True, False]).meaning == "code of 'a' once constant (exact)"
    assert column_read(own.read([False, True, True, False]), own) == 1
    none = code_test(Structured(), codes, ["a", "b"], settled=np.zeros_like(codes))
    assert (none.groups, none.settled) == ((("a",), ("b",)), ((), ())), "a fault that leaves no trace has no such code"
    with pytest.raises(DataError):
        code_test(Structured(), codes, ["a", "b"], settled=settled[:3])


def test_a_pair_of_groups_does_not_name_one_fault_twice() -> None:
    codes = np.array([[1, 0, 0], [0, 1, 0], [0, 1, 1], [0, 0, 0]], bool)
    settled = codes.copy()
    settled[:, 1] = [0, 0, 1, 0]
    test = code_test(Structured(), codes, ["a", "b", "c"], settled=settled)
    assert test.groups == (("a",), ("b",), ("c", "b"))
    assert test.read([True, True, True, False]).pairs == ((("a",), ("b",)),)
    assert test.read([True, False, True, False]).pairs == ((("a",), ("c", "b")),)


def test_equal_codes_are_one_group() -> None:
    reading = read_code([1, 0], [[1, 1, 0], [0, 0, 0]], ["a", "b", "c"])
    assert reading.faults == ("a", "b")
    assert isinstance(reading, CodeReading)


@pytest.mark.parametrize(
    ("fired", "codes", "faults"),
    [([1], [[1, 0], [0, 1]], ["a", "b"]), ([1, 0], [[1, 0], [0, 1]], ["a"]), ([1, 0], [1, 0], ["a", "b"])],
)
def test_shapes_that_do_not_fit_are_refused(fired: list, codes: list, faults: list) -> None:
    with pytest.raises(DataError):
        read_code(fired, codes, faults)
    with pytest.raises(DataError):
        read_codes([fired], codes, faults)


@pytest.mark.parametrize("wrong", [{"window": 0}, {"share": 0.0}, {"share": 1.5}, {"distance": -1}, {"distance": 0.5}])
def test_settings_are_checked(wrong: dict) -> None:
    with pytest.raises(SettingError):
        Structured(**wrong)


@pytest.mark.parametrize("samples", [20, 200])
def test_the_faults_of_longer_codes_stand_in_the_headline(samples: int) -> None:
    test = code_test(Structured(window=50), np.array([[1, 1, 1], [0, 1, 1], [0, 0, 1]], dtype=bool), ["a", "b", "c"])
    reading = test.read([True, False, False])
    assert reading.answer == "exact"
    assert reading.possible == (("b",), ("c",))
    alarm = Alarm(0.0, 1.0, None, (), 0, samples, reading=reading)
    said = test.statement(alarm, Clock(), 50)
    if samples < 50:
        assert said.confidence == "too early"
        assert said.headline.endswith("that a name is judged by; so far a.")
    else:
        assert said.headline == "Fault found: either a, b or c, alarm raised at 1 s."
    assert "'b' or 'c' with members silent" in said.sentences[0]
    whole = test.statement(replace(alarm, reading=test.read([True, True, True])), Clock(), 50)
    assert "silent" not in whole.sentences[0]
