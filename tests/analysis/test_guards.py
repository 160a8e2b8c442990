"""Guards of the searches for structures and equations, and of what demonstrations and models promise."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from guards import changed, trips
from residua.analysis.coding_choice import ChoiceTask
from residua.analysis.cover import Cover, _greedy, fewest
from residua.demos.outcome import Outcome
from residua.errors import AccuracyError
from residua.library import jet_engine_steady_state
from residua.robust.parity.select_equations import _cheapest


def cover() -> Cover:
    """Three rows, of which the first two are needed."""
    rows = np.array([[True, False, True], [False, True, True], [False, False, True]])
    return ChoiceTask(rows, [("a",), ("b",), ("c",)], {0, 1, 2}).cover(strong=False)[0]


def nothing(result: Any) -> Any:
    """A program that chooses no row."""
    return SimpleNamespace(x=np.zeros(64), status=0, mip_dual_bound=0.0)


@trips("analysis.cover:fewest")
def test_rows_that_do_not_meet_the_demands_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    assert len(fewest(cover(), 10.0).chosen)
    changed(monkeypatch, "analysis.cover:integer_program", nothing)
    with pytest.raises(AccuracyError, match="do not meet the demands"):
        fewest(cover(), 10.0)


@trips("analysis.cover:_greedy")
def test_a_demand_that_no_row_meets_is_refused() -> None:
    assert _greedy(np.array([[True, False]])).tolist() == [0]
    with pytest.raises(AccuracyError, match="no row meets"):
        _greedy(np.zeros((1, 2), dtype=bool))


@trips("robust.parity.select_equations:_cheapest")
def test_equations_that_do_not_isolate_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    costs, allowed = np.ones(3), np.ones(3, dtype=bool)
    assert len(_cheapest(cover(), costs, allowed, 10.0)[0])
    changed(monkeypatch, "robust.parity.select_equations:integer_program", nothing)
    with pytest.raises(AccuracyError, match="do not isolate"):
        _cheapest(cover(), costs, allowed, 10.0)


@trips("library.jet_engine:jet_engine_steady_state")
def test_an_engine_without_a_steady_state_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    changed(monkeypatch, "library.jet_engine:_jacobian", lambda J: J / 2)  # steps of twice the length go to and fro
    with pytest.raises(AccuracyError, match="no steady state"):
        jet_engine_steady_state(0.2)


@trips("cli.demo_command:present")
def test_a_demo_that_comes_out_otherwise_says_so() -> None:
    from residua.cli.demo_command import present

    with pytest.raises(AccuracyError, match="did not come out as it should: no alarm"):
        present(Outcome((), (), Path("page.html"), ("no alarm",)))
