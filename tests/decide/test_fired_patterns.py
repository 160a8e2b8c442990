"""Faults that explain a pattern: against probabilities computed another way, and all sets of faults one by one."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations, product

import numpy as np
import pytest

from residua.decide.fired_patterns import code_likelihoods, consistent_faults, minimal_hitting_sets
from residua.errors import DataError, SettingError

CODES = np.array([[1, 1, 0, 0], [1, 1, 0, 0], [1, 0, 1, 0], [1, 0, 1, 0], [1, 0, 0, 0]], dtype=bool)
FAULTS = ["pump", "valve", "sensor", "hidden"]


@pytest.mark.parametrize("missed", [None, 0.3, (0.1, 0.2, 0.3, 0.4, 0.5)])
def test_the_patterns_of_a_fault_have_probabilities_that_add_up_to_one(missed: object) -> None:
    patterns = np.array(list(product((0, 1), repeat=len(CODES))))
    own, none = code_likelihoods(patterns, CODES, false_alarm=(0.01, 0.02, 0.1, 0.3, 0.5), missed=missed)  # pyright: ignore
    np.testing.assert_allclose(np.exp(own).sum(axis=0), 1.0, rtol=1e-12)
    np.testing.assert_allclose(np.exp(none).sum(), 1.0, rtol=1e-12)
    np.testing.assert_allclose(own[:, 3], none)  # a fault without a code is as good as none


def test_probabilities_of_simulated_faults() -> None:
    """Draw fault, chance to fire and alarms; among the draws of a pattern count the faults."""
    rng = np.random.default_rng(0)
    n, q = 400_000, 0.05
    true = rng.integers(0, 3, n)
    p = rng.random((n, 1))
    fired = rng.random((n, len(CODES))) < np.where(CODES[:, true].T, p, q)
    for pattern in ([1, 1, 0, 0, 0], [1, 0, 0, 0, 0], [1, 1, 1, 0, 0], [0, 0, 1, 1, 1]):
        same = (fired == np.array(pattern, dtype=bool)).all(axis=1)
        counts = np.bincount(true[same], minlength=3) / same.sum()
        found = consistent_faults(pattern, CODES, FAULTS, false_alarm=q)
        share = {one.faults[0]: one.probability for one in found.candidates}
        spread = 4 * np.sqrt(0.25 / same.sum())
        np.testing.assert_allclose([share[name] for name in FAULTS[:3]], counts, atol=spread)


@pytest.mark.parametrize("pattern", list(product((0, 1), repeat=5)))
def test_without_false_alarms_the_fault_is_among_the_consistent(pattern: tuple[int, ...]) -> None:
    found = consistent_faults(pattern, CODES, FAULTS)
    on = np.array(pattern, dtype=bool)
    expected = {name for name, code in zip(FAULTS, CODES.T, strict=True) if (code | ~on).all() and code.any()}
    assert {one.faults[0] for one in found.consistent} == (expected if on.any() else set())
    assert [one.probability for one in found.candidates] == sorted(
        (o.probability for o in found.candidates), reverse=True
    )
    if on.any():
        assert sum(one.probability for one in found.candidates) == pytest.approx(1)
        assert sum(one.probability for one in found.credible(0.9)) >= 0.9


def test_equal_codes_are_one_candidate_and_texts_tell_it() -> None:
    found = consistent_faults([1, 0], [[1, 1, 0], [0, 0, 1]], ["a", "b", "c"], members=["left", "right"])
    assert found.candidates[0].faults == ("a", "b")
    assert "'a' or 'b'" in str(found)
    assert "fired: left" in str(found)
    assert str(consistent_faults([0, 0], [[1], [1]], ["a"])) == "no member fired: no fault"


def test_one_alarm_among_many_members_is_rather_a_false_one() -> None:
    codes = np.ones((40, 1), dtype=bool)
    one = np.arange(40) == 3
    assert consistent_faults(one, codes, ["a"]).evidence < 0
    assert consistent_faults(np.arange(40) < 4, codes, ["a"]).evidence > 0


def test_what_does_not_fit_is_refused() -> None:
    with pytest.raises(DataError, match="one entry per member"):
        consistent_faults([1, 0], CODES, FAULTS)
    with pytest.raises(DataError, match="column per fault"):
        consistent_faults([1] * 5, CODES, ["a"])
    with pytest.raises(DataError, match="names of members"):
        consistent_faults([1] * 5, CODES, FAULTS, members=["a"])
    with pytest.raises(DataError, match="last axis"):
        code_likelihoods([[1, 0]], CODES)
    for wrong in (0, 1, -0.1, [0.1, 0.2], "x"):
        with pytest.raises(SettingError, match="false_alarm"):
            code_likelihoods([1] * 5, CODES, false_alarm=wrong)
    with pytest.raises(SettingError, match="level"):
        consistent_faults([1] * 5, CODES, FAULTS).credible(1.0)


@pytest.mark.parametrize("fired", [[np.nan, 0, 1, 1], ["0", "1", "0", "0"], [0.5, 0, 0, 0], [2, 0, 0, 0]])
def test_what_is_neither_zero_nor_one_is_refused(fired) -> None:
    codes = [[1, 1, 0], [1, 1, 0], [1, 0, 1], [1, 0, 1]]
    with pytest.raises(DataError, match="0 or 1"):
        consistent_faults(fired, codes, ["a", "b", "c"])
    with pytest.raises(DataError, match="0 or 1"):
        consistent_faults([1, 0, 0, 0], 7 * np.array(codes), ["a", "b", "c"])


def test_prior_rates_weigh_the_likelihoods() -> None:
    codes, faults = [[1, 1, 0], [1, 1, 0], [1, 0, 1], [1, 0, 1]], ["pump", "valve", "sensor"]
    even = consistent_faults([1, 1, 0, 0], codes, faults)
    pump = consistent_faults([1, 1, 0, 0], codes, faults, prior_rates={"pump": 0.1})
    ratio = {one.faults[0]: one.probability for one in even.candidates}
    odds = ratio["pump"] / ratio["valve"] * 0.1 / 1e-4
    assert pump.candidates[0].faults == ("pump",)
    assert pump.candidates[0].probability / pump.candidates[1].probability == pytest.approx(odds)
    assert pump.evidence == even.evidence  # of the pattern alone
    twins = consistent_faults(
        [1, 0], [[1, 1, 0], [0, 0, 1]], ["a", "b", "c"], prior_rates={"a": 0.01, "b": 0.03, "c": 0.01}
    )
    first, second = twins.candidates[:2]
    assert first.faults == ("a", "b")
    plain = consistent_faults([1, 0], [[1, 1, 0], [0, 0, 1]], ["a", "b", "c"]).candidates
    base = plain[0].probability / plain[1].probability / 2  # of two faults together
    assert first.probability / second.probability == pytest.approx(base * 4)
    with pytest.raises(SettingError, match="prior_rates"):
        consistent_faults([1, 0], [[1], [0]], ["a"], prior_rates={"b": 0.1})


def test_several_faults_at_once_are_the_smallest_sets() -> None:
    codes, faults = [[1, 0, 0], [0, 1, 0], [0, 1, 1], [0, 0, 0]], ["a", "b", "c"]
    made = consistent_faults([1, 1, 0, 1], codes, faults)
    assert [one.faults for one in made.together.sets] == [("a", "b")]
    assert "together do a and b" in str(made)
    assert consistent_faults([0, 0, 0, 0], codes, faults).together is None
    alone = consistent_faults([0, 1, 1, 0], codes, faults)
    assert "together" not in str(alone)


# ------------------------------------------------------------------ several faults at once

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
    found = minimal_hitting_sets([["M1", "M2", "A1"], ["M1", "M3", "A1", "A2"]])
    diagnoses: list[frozenset[str]] = []
    for size in range(6):
        for one in map(frozenset, combinations(POLYBOX, size)):
            if not any(other <= one for other in diagnoses) and explains(one):
                diagnoses.append(one)
    assert {frozenset(one.faults) for one in found.sets} == set(diagnoses)
    assert found.complete


def test_the_example_of_reiter() -> None:
    """Reiter (1987), section 4.2: the collection of his figure 2."""
    found = minimal_hitting_sets([[2, 4, 5], [1, 2, 3], [1, 3, 5], [2, 4, 6], [2, 4], [2, 3, 5], [1, 6]])  # pyright: ignore
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
    found = minimal_hitting_sets([sorted(c) for c in conflicts])
    assert {frozenset(one.faults) for one in found.sets} == wanted
    assert found.complete
    assert [len(one.faults) for one in found.sets] == sorted(len(one) for one in wanted)
    for most in (1, 2, 3):
        cut = minimal_hitting_sets([sorted(c) for c in conflicts], most_faults=most)
        assert {frozenset(one.faults) for one in cut.sets} == {one for one in wanted if len(one) <= most}
        assert not cut.complete or len(cut.sets) == len(wanted)
        assert cut.complete or "larger ones may explain it too" in str(cut)


def test_the_order_is_size_then_prior_then_what_stayed_silent() -> None:
    conflicts = [["a", "b", "c"], ["a", "b", "d"]]
    rare = minimal_hitting_sets(conflicts, prior_rates={"a": 1e-3, "b": 1e-2})
    assert [one.faults for one in rare.sets] == [("b",), ("a",), ("c", "d")]
    assert rare.sets[0].log_prior == pytest.approx(np.log(1e-2 / 0.99))
    silent = minimal_hitting_sets(conflicts, silent=[["a", "x"]])
    assert [one.faults for one in silent.sets] == [("b",), ("a",), ("c", "d")]
    assert "silent" in str(silent.sets[1])
    assert silent.sets[1].silent == 1


def test_nothing_fired() -> None:
    assert [one.faults for one in minimal_hitting_sets([]).sets] == [()]


@pytest.mark.parametrize(
    ("make", "kind", "words"),
    [
        (lambda: minimal_hitting_sets([["a"], []]), DataError, "conflict set 1 is empty"),
        (lambda: minimal_hitting_sets([["a"]], most_faults=0), SettingError, "at least 1"),
        (lambda: minimal_hitting_sets([["a"]], most_faults=1.5), SettingError, "whole number"),  # pyright: ignore
        (lambda: minimal_hitting_sets([["a"]], prior_rates=1.0), SettingError, "between 0 and 1"),
        (lambda: minimal_hitting_sets([["a"]], prior_rates={"b": 0.1}), SettingError, "no residual is sensitive"),
        (lambda: minimal_hitting_sets([[f"{i} {j}" for j in range(8)] for i in range(7)]), DataError, "most_faults"),
    ],
)
def test_bad_input(make: Callable[[], object], kind: type[Exception], words: str) -> None:
    with pytest.raises(kind, match=words):
        make()


def test_a_name_is_no_set_of_letters() -> None:
    for wrong in (["pump", "valve"], [None], "pump", {"pump": 1}, None):
        with pytest.raises(SettingError, match="conflicts must"):
            minimal_hitting_sets(wrong)  # pyright: ignore[reportArgumentType]
