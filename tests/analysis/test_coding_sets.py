"""Coding sets: how well they isolate, and why."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

import residua as rs
from residua.analysis.coding import CodingSet, isolation_quality
from residua.errors import DesignError, SettingError
from residua.linear.subspaces.rank import decide_rank, null_basis

EXAMPLE_1 = {"none": ["110", "111", "111"], "weak": ["110", "101", "111"], "strong": ["110", "101", "011"]}


@pytest.mark.parametrize("quality", EXAMPLE_1)
def test_example_1_of_gertler(quality: str) -> None:
    rows = EXAMPLE_1[quality]
    matrix = np.array([[int(digit) for digit in row] for row in rows])
    assert isolation_quality(rows) == isolation_quality(matrix) == isolation_quality(matrix.astype(bool)) == quality


def by_definition(codes: list[tuple[int, ...]]) -> str:
    """Return the quality by turning ones into zeros, one subset after the other."""
    if any(not any(code) for code in codes) or len(set(codes)) < len(codes):
        return "none"
    for k, code in enumerate(codes):
        others = set(codes[:k] + codes[k + 1 :])
        ones = [i for i, one in enumerate(code) if one]
        for kept in product((0, 1), repeat=len(ones)):
            degraded = [0] * len(code)
            for i, stays in zip(ones, kept, strict=True):
                degraded[i] = stays
            if tuple(degraded) in others:
                return "weak"
    return "strong"


def test_all_structures_of_three_residuals_and_three_faults() -> None:
    counts = {"none": 0, "weak": 0, "strong": 0}
    for codes in product(product((0, 1), repeat=3), repeat=3):
        expected = by_definition(list(codes))
        assert isolation_quality(np.array(codes).T) == expected
        counts[expected] += 1
    assert min(counts.values()) > 0


def test_it_tells_what_is_wrong() -> None:
    found = CodingSet.of({"a": ["leak", "clog", "jam"], "b": ["clog"]}, ["leak", "jam", "clog", "drift"])
    assert found.quality == "none"
    assert found.undetected == ("drift",)
    assert found.equal == (("leak", "jam"),)
    assert found.degradations == {"clog": ("leak", "jam")}
    text = str(found)
    for part in ("not isolating", "seen by no residual: drift", "same code: leak, jam", "'leak' or 'jam'"):
        assert part in text


def test_inseparable_faults_count_as_one() -> None:
    S = np.array([[1, 1, 0, 0], [0, 0, 1, 0]], dtype=bool)
    found = CodingSet(S, ("a", "b", "c", "d"), ("r1", "r2"), undetectable=("d",), inseparable=(("a", "b"),))
    assert (found.quality, found.quality_of_groups) == ("none", "strong")
    assert found.distance == 2
    assert found.canonical
    assert "no method distinguishes: a, b" in str(found)
    assert "seen by no residual of any method: d" in str(found)


@pytest.mark.parametrize(
    ("structure", "canonical", "distance"),
    [(["110", "101", "011"], True, 2), (["100", "010", "001"], True, 2), (["110", "011"], False, 1), (["1"], True, 1)],
)
def test_evenness_and_distance(structure: list[str], canonical: bool, distance: int) -> None:
    found = CodingSet.of(structure)
    assert (found.canonical, found.distance) == (canonical, distance)


@pytest.mark.parametrize("wrong", [["12"], ["10", "1"], [[1, 2]], [[[1]]], 3, ["1x"], [["a", "b"]]])
def test_what_is_no_structure_is_refused(wrong: object) -> None:
    with pytest.raises(DesignError):
        isolation_quality(wrong)  # pyright: ignore


def test_a_bank_takes_a_coding_set_whatever_the_order_of_its_faults() -> None:
    plant = rs.library.gertler(sensor_faults=True)
    rows = {"one": ["p1", "y1 sensor", "y2 sensor"], "two": ["p2", "y1 sensor", "y2 sensor"]}
    other = CodingSet.of(rows, ["y2 sensor", "p2", "p1", "y1 sensor"])
    bank = rs.design.structured_bank(plant, other)
    assert bank.members == ("one", "two")
    np.testing.assert_array_equal(bank.structure, [[1, 0, 1, 1], [0, 1, 1, 1]])
    with pytest.raises(DesignError, match="other faults"):
        rs.design.structured_bank(rs.library.gertler(), other)


@pytest.mark.parametrize("empty", [[], [[]], "", {}, {"a": []}, {"a": [], "b": []}])
def test_what_has_nothing_to_isolate_is_refused(empty: object) -> None:
    with pytest.raises(DesignError, match="there is nothing to isolate"):
        isolation_quality(empty)  # pyright: ignore


def test_rows_of_unequal_length_are_told_in_words() -> None:
    for wrong, words in (([[1, 0], [1]], "the rows have 2 and 1 entries"), ([[1, [2]]], "with rows of one length")):
        with pytest.raises(DesignError, match=words) as caught:
            isolation_quality(wrong)
        assert "inhomogeneous" not in str(caught.value)
    assert CodingSet.of({"a": "pump", "b": ["valve"]}).faults == ("pump", "valve")


def test_attainable_rows_are_a_structure() -> None:
    plant = rs.library.gertler(sensor_faults=True)
    found = rs.coding.attainable(plant, ["0111", "0011", "1101"])
    assert CodingSet.of(found).digits == ("0111", "1101")
    assert rs.design.structured_bank(plant, found).members == ("r1", "r3")
    assert isolation_quality(found) == isolation_quality(["0111", "1101"])


@pytest.mark.parametrize("wrong", [-1e-12, -1, 1, 5.0, float("inf"), float("nan"), "x", None])
def test_a_tolerance_below_zero_or_over_one_is_refused(wrong: object) -> None:
    with pytest.raises(SettingError, match="rtol must be"):
        decide_rank(np.eye(2), rtol=wrong)  # pyright: ignore
    with pytest.raises(SettingError, match="rtol must be"):
        null_basis(np.eye(2), rtol=wrong)  # pyright: ignore
