"""What is promised of the word of a verdict is in its table, and a part of the campaign comes out."""

from __future__ import annotations

import csv
import importlib
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture
def campaign(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    return importlib.import_module("verdicts")


def test_the_table_keeps_what_is_promised(campaign: ModuleType) -> None:
    with (ROOT / "docs" / "data" / "verdicts.csv").open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    assert tuple(header) == campaign.HEADER
    counts = {row[2]: int(row[3]) for row in rows if row[:2] == ["both", "after 200"]}
    assert set(counts) == {*campaign.MIX, "mix"}
    assert counts["mix"] > 3000
    for when in ("after 50", "after 200"):
        shares = campaign.shares(rows, "both", when)
        assert shares["good matches wrong"] <= 1, when
        assert shares["eithers wrong"] <= 2, when
    assert 155 < 100 / campaign.shares(rows, "both", "after 200")["good matches wrong"] < 185  # as README says
    assert 5 < 100 / campaign.shares(rows, "both", "before")["good matches wrong"] < 7
    assert campaign.shares(rows, "both", "after 200")["listed faults with a good match"] >= 75


def test_a_part_of_the_campaign_comes_out(campaign: ModuleType) -> None:
    counts = campaign.counted(["heater"], 3, 30)
    rows = list(campaign.table(counts))
    assert {row[0] for row in rows} == {"both", *campaign.MODELS}
    for row in rows:
        assert sum(float(row[k]) for k in (4, 6, 8, 9)) == pytest.approx(100, abs=0.05)
    said, wrong = counts["given", "after 200", "listed"]
    assert said.sum() >= 8
    assert said[0] >= 0.75 * said.sum()
    assert not wrong.any()
    before = campaign.shares(rows, "both", "before")["verdicts with a wrong good match"]
    assert campaign.shares(rows, "both", "after 200")["verdicts with a wrong good match"] < before


def test_a_word_is_wrong_where_the_cause_is_not_in_it(campaign: ModuleType) -> None:
    fault, none, pair = frozenset({"a"}), frozenset[str](), frozenset({"a", "c"})
    one, two = (("a", "b"),), (("b",), ("a",))
    for said, truth, wrong in [
        (campaign.Said("good match", one), fault, False),
        (campaign.Said("good match", (("b",),)), fault, True),
        (campaign.Said("good match", one), pair, False),
        (campaign.Said("good match", one), none, True),
        (campaign.Said("either", two), fault, False),
        (campaign.Said("either", two), frozenset({"c"}), True),
        (campaign.Said("either", one, "state x"), none, False),
        (campaign.Said("either", one, "state x"), frozenset({"c"}), True),
        (campaign.Said("either", two), none, True),
        (campaign.Said("poor match", one), none, False),
        (campaign.Said("too early", one), none, False),
    ]:
        assert campaign.is_wrong(said, truth) is wrong, (said, truth)


def test_causes_weigh_in_the_mix_as_they_are_there(campaign: ModuleType) -> None:
    assert sum(campaign.MIX.values()) == pytest.approx(1)
    counts = {
        ("given", "after 200", "listed"): np.array([[8, 2, 0, 0], [0, 1, 0, 0]]),
        ("given", "after 200", "left out"): np.array([[50, 0, 50, 0], [50, 0, 0, 0]]),
    }
    shares = campaign.shares(list(campaign.table(counts)), "given", "after 200")
    assert shares["listed faults with a good match"] == 80
    good = 0.55 * 80 + 0.08 * 50
    assert shares["good matches wrong"] == pytest.approx(100 * 0.08 * 50 / good, rel=1e-3)
    assert shares["verdicts with a wrong either"] == pytest.approx(0.55 * 10 / 0.63, rel=1e-3)


def test_dynamics_are_off_by_a_share(campaign: ModuleType) -> None:
    rng = np.random.default_rng(0)
    A = np.diag(np.exp([-0.001, -0.2]))
    rates = np.real(np.array([np.log(np.linalg.eigvals(one)) for one in campaign.off(A, 0.05, rng, 2000)]))
    assert np.allclose(np.sort(rates, axis=1).std(axis=0), [0.05 * 0.2, 0.05 * 0.001], rtol=0.1)
