"""Minimal hitting sets: against every set of faults tried one by one, and the examples of the papers."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations

import numpy as np
import pytest

import residua as rs
from residua.errors import DataError, SettingError

sets_of = rs.decide.minimal_hitting_sets

POLYBOX = {  # what each of de Kleer and Williams' parts does: output, kind, inputs
    "M1": ("x", "times", "a", "c"),
    "M2": ("y", "times", "b", "d"),
    "M3": ("z", "times", "c", "e"),
    "A1": ("f", "plus", "x", "y"),
    "A2": ("g", "plus", "y", "z"),
}


def by_hand(conflicts: list[set[str]]) -> set[frozenset[str]]:
    """All subsets, by size."""
    names = sorted(set().union(*conflicts)) if conflicts else []
    out: list[frozenset[str]] = []
    for size in range(len(names) + 1):
        for one in map(frozenset, combinations(names, size)):
            if all(one & c for c in conflicts) and not any(other <= one for other in out):
                out.append(one)
    return set(out)


def explains(broken: frozenset[str]) -> bool:
    """Whether values exist for which all other parts of the polybox do what they should, and f = 10 and g = 12."""
    known = {"a": 3, "b": 2, "c": 2, "d": 3, "e": 3}
    return any(
        all(
            values[out] == (values[p] * values[q] if kind == "times" else values[p] + values[q])
            for name, (out, kind, p, q) in POLYBOX.items()
            if name not in broken
        )
        for x in range(-2, 15)
        for y in range(-2, 15)
        for z in range(-2, 15)
        for values in [known | {"x": x, "y": y, "z": z, "f": 10, "g": 12}]
    )


def test_the_polybox() -> None:
    """The conflicts are in the paper; that their hitting sets are the diagnoses is computed from the circuit."""
    found = sets_of([["M1", "M2", "A1"], ["M1", "M3", "A1", "A2"]])
    diagnoses: list[frozenset[str]] = []
    for size in range(6):
        for one in map(frozenset, combinations(POLYBOX, size)):
            if not any(other <= one for other in diagnoses) and explains(one):
                diagnoses.append(one)
    assert {frozenset(one.faults) for one in found.sets} == set(diagnoses)
    assert found.complete


def test_the_example_of_reiter() -> None:
    """Reiter (1987), section 4.2: the collection of his figure 2."""
    found = sets_of([[2, 4, 5], [1, 2, 3], [1, 3, 5], [2, 4, 6], [2, 4], [2, 3, 5], [1, 6]])  # pyright: ignore
    assert {frozenset(one.faults) for one in found.sets} == by_hand(
        [{2, 4, 5}, {1, 2, 3}, {1, 3, 5}, {2, 4, 6}, {2, 4}, {2, 3, 5}, {1, 6}]  # type: ignore[list-item]
    )


@pytest.mark.parametrize("seed", range(30))
def test_all_minimal_sets_and_no_others(seed: int) -> None:
    rng = np.random.default_rng(seed)
    names = [f"f{i}" for i in range(8)]
    conflicts = [
        {names[j] for j in rng.choice(8, rng.integers(1, 5), replace=False)} for _ in range(rng.integers(0, 7))
    ]
    wanted = by_hand(conflicts)
    found = sets_of([sorted(c) for c in conflicts])
    assert {frozenset(one.faults) for one in found.sets} == wanted
    assert found.complete
    assert [len(one.faults) for one in found.sets] == sorted(len(one) for one in wanted)
    for most in (1, 2, 3):
        cut = sets_of([sorted(c) for c in conflicts], most_faults=most)
        assert {frozenset(one.faults) for one in cut.sets} == {one for one in wanted if len(one) <= most}
        assert not cut.complete or len(cut.sets) == len(wanted)
        assert cut.complete or "larger ones may explain it too" in str(cut)


def test_the_order_is_size_then_prior_then_what_stayed_silent() -> None:
    conflicts = [["a", "b", "c"], ["a", "b", "d"]]
    rare = sets_of(conflicts, prior_rates={"a": 1e-3, "b": 1e-2})
    assert [one.faults for one in rare.sets] == [("b",), ("a",), ("c", "d")]
    assert rare.sets[0].log_prior == pytest.approx(np.log(1e-2 / 0.99))
    silent = sets_of(conflicts, silent=[["a", "x"]])
    assert [one.faults for one in silent.sets] == [("b",), ("a",), ("c", "d")]
    assert "silent" in str(silent.sets[1])
    assert silent.sets[1].silent == 1


def test_nothing_fired() -> None:
    assert [one.faults for one in sets_of([]).sets] == [()]


@pytest.mark.parametrize(
    ("make", "kind", "words"),
    [
        (lambda: sets_of([["a"], []]), DataError, "conflict set 1 is empty"),
        (lambda: sets_of([["a"]], most_faults=0), SettingError, "at least 1"),
        (lambda: sets_of([["a"]], most_faults=1.5), SettingError, "whole number"),  # pyright: ignore
        (lambda: sets_of([["a"]], prior_rates=1.0), SettingError, "between 0 and 1"),
        (lambda: sets_of([["a"]], prior_rates={"b": 0.1}), SettingError, "no residual is sensitive"),
        (lambda: sets_of([[f"{i} {j}" for j in range(8)] for i in range(7)]), DataError, "most_faults"),
    ],
)
def test_bad_input(make: Callable[[], object], kind: type[Exception], words: str) -> None:
    with pytest.raises(kind, match=words):
        make()


def test_a_name_is_no_set_of_letters() -> None:
    for wrong in (["pump", "valve"], [None], "pump", {"pump": 1}, None):
        with pytest.raises(SettingError, match="conflicts must"):
            rs.decide.minimal_hitting_sets(wrong)  # pyright: ignore[reportArgumentType]
