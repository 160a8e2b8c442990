"""The table of designs that exist: a part comes out again, and it keeps what its page promises."""

from __future__ import annotations

import csv
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import residua as rs
import textbook_filters

REPOSITORY = Path(__file__).resolve().parent.parent
DATA = REPOSITORY / "docs" / "data"
sys.path.insert(0, str(REPOSITORY / "benchmarks"))
table: Any = import_module("designs_that_exist")
sys.path.remove(str(REPOSITORY / "benchmarks"))

#: Made anew: small ones of each family, and some that are stiff, unstable, integrating, or hardly seen.
ANEW = (
    "tanks 5",
    "tanks 30",
    "rod 20",
    "chain 20",
    "sampled rod 10",
    "integrators 4",
    "tape drive",
    "jet engine",
    "missile",
    "aircraft, cruise",
    "chemical reactor",
    "sampled reactor",
    "turbo-generator",
    "gas turbine",
    "beam 20",
    "line 20",
)
MADE = ("made", "near")


def published() -> list[dict[str, Any]]:
    with (DATA / "designs_that_exist_all.csv").open(encoding="utf-8", newline="") as file:
        return [{**row, "states": int(row["states"])} for row in csv.DictReader(file)]


@pytest.mark.parametrize("name", ANEW)
def test_decisions_come_out_again(name: str) -> None:
    family, plain = next(one for one in table.plants(None) if one[1].name == name)
    known = {one["design"]: one for one in published() if one["plant"] == name}
    assert list(known) == list(table.DESIGNS)
    for design, row in known.items():
        again = table.row(family, table.with_roles(plain), design)
        assert again["textbook"] == row["textbook"], design
        assert again["outcome"] in (MADE if row["outcome"] in MADE else (row["outcome"],)), (design, again["reason"])
        assert again["outcome"] in MADE or again["textbook"] != "works", (design, again["reason"])


def test_tables_are_those_of_all_rows(tmp_path: Path) -> None:
    table.tables(published(), tmp_path)
    for path in tmp_path.glob("*.csv"):
        assert path.read_text(encoding="utf-8") == (DATA / path.name).read_text(encoding="utf-8"), path.name


#: Of larger plants nothing is promised: one has 421 states, with rates that span eleven decades.
LARGEST = 300


def test_little_is_refused_where_the_textbook_works() -> None:
    rows = published()
    assert len({row["plant"] for row in rows}) > 100
    assert len(rows) == 11 * len({row["plant"] for row in rows})
    assert [row for row in rows if row["outcome"] == "crash"] == []
    rows = [row for row in rows if row["states"] <= LARGEST]
    assert len({row["plant"] for row in rows}) > 100
    assert [row for row in rows if row["textbook"] == "works" and row["outcome"] not in MADE] == []
    assert [row for row in rows if row["outcome"] == "too long"] == []
    assert sum(row["outcome"] == "refused" for row in rows) <= 0.005 * len(rows)


@pytest.mark.parametrize(("parity", "most"), [(True, 0.11), (False, 0.03)])
def test_near_is_rare(parity: bool, most: float) -> None:
    rows = [row for row in published() if (row["design"] == "parity_relations") == parity]
    assert sum(row["outcome"] == "near" for row in rows) <= most * len(rows)


def test_only_banks_to_100_states_take_longer_than_a_second() -> None:
    """Of three or four filters; measured on a busy machine."""
    slow = [row for row in published() if row["states"] <= table.STATES and float(row["ms"]) > 1000]
    assert {row["design"] for row in slow} <= {"sensor_fault_bank", "structured_bank"}
    assert len(slow) <= 4
    assert max(float(row["ms"]) for row in slow) < 6000


def test_a_filter_of_the_textbook_that_leaks_does_not_work(monkeypatch: pytest.MonkeyPatch) -> None:
    plant = table.with_roles(rs.Plant(*table.tanks(5)))
    assert textbook_filters.verdict("unknown_input_observer", plant) == "works"
    (system, of, T, estimate), *_ = textbook_filters.unknown_input_observer(plant)
    assert estimate is not None
    for off, said in ((1e-4, "leaks"), (1e-9, "works")):
        moved = rs.StateSpace(system.A, system.B * (1 + off), system.C, system.D)
        read = rs.StateSpace(estimate.A, estimate.B * (1 + off), estimate.C, estimate.D)
        for pair in ((moved, estimate), (system, read)):
            made = [(pair[0], of, T, pair[1])]
            monkeypatch.setitem(textbook_filters.FILTERS, "unknown_input_observer", lambda _, x=made: x)
            assert textbook_filters.verdict("unknown_input_observer", plant) == said
    unstable = rs.StateSpace(system.A + 10 * np.eye(5), system.B, system.C, system.D)
    monkeypatch.setitem(textbook_filters.FILTERS, "unknown_input_observer", lambda _: [(unstable, of, T, estimate)])
    assert textbook_filters.verdict("unknown_input_observer", plant) == "none"
    blind = plant.without_faults(plant.faults[1:]).with_disturbances({"same": plant.Bf[:, 0]})
    assert textbook_filters.verdict("decoupled_residual", blind) == "none"
