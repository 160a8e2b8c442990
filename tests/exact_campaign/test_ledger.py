"""Runs of the campaign that are added up, and the plants that failed in them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from exact_campaign.ledger import add, failed_plants
from exact_campaign.test_earlier_failures import EARLIER

TABLES = Path(__file__).parents[2] / "docs" / "data"


def entry(kind: str, first: int, *failures: str, commit: str = "aaa") -> dict:
    """Return a line of a record: five plants, two of them with answers, and failures of the first one."""
    found = [{"kind": kind, "seed": first, "outcome": "wrong", "function": f"{one} [0]"} for one in failures]
    counts = {"zeros | base | holds": 2, "filter [0] | base | wrong": len(failures)}
    one = {"key": f"{kind}/{first}/5", "kind": kind, "plants": 5, "seconds": 9.0, "commit": commit}
    return {**one, "counts": counts, "failures": found}


def record(folder: Path, *entries: dict) -> Path:
    path = folder / "record.jsonl"
    path.write_text("".join(json.dumps(one) + "\n" for one in entries))
    return path


def table(folder: Path, name: str) -> list[str]:
    return (folder / f"campaign_{name}.csv").read_text().splitlines()[1:]


def test_runs_are_added_and_failed_plants_named(tmp_path: Path) -> None:
    add(record(tmp_path, entry("dense", 100), entry("sparse", 100, "filter", "filter", "zeros")), tmp_path)
    add(record(tmp_path, entry("dense", 105, "filter", commit="bbb")), tmp_path)
    assert table(tmp_path, "runs") == ["aaa,100,104,10,1,0.01", "bbb,105,109,5,1,0.00"]
    assert table(tmp_path, "kinds") == [
        "dense,10,4,0,0,0,0,0,0,0,1,0",
        "sparse,5,2,0,0,0,0,0,0,0,3,0",
        "all,15,6,0,0,0,0,0,0,0,4,0",
    ]
    assert table(tmp_path, "functions") == ["filter,0,0,0,0,0,0,0,0,4,0", "zeros,6,0,0,0,0,0,0,0,0,0"]
    assert table(tmp_path, "failures") == ["sparse,100,aaa,wrong,filter; zeros", "dense,105,bbb,wrong,filter"]
    assert failed_plants(tmp_path) == [("sparse", 100), ("dense", 105)]


@pytest.mark.parametrize("first", [96, 100, 104])
def test_no_plant_is_counted_twice(tmp_path: Path, first: int) -> None:
    add(record(tmp_path, entry("dense", 100)), tmp_path)
    before = {path: path.read_text() for path in tmp_path.glob("*.csv")}
    with pytest.raises(ValueError, match="100 to 104 at aaa"):
        add(record(tmp_path, entry("sparse", first)), tmp_path)
    assert {path: path.read_text() for path in tmp_path.glob("*.csv")} == before


def test_a_run_is_of_one_commit(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="aaa, bbb; start a new record"):
        add(record(tmp_path, entry("dense", 100), entry("dense", 105, commit="bbb")), tmp_path)
    with pytest.raises(ValueError, match="no plants"):
        add(record(tmp_path), tmp_path)


def test_every_plant_that_failed_is_asked_again() -> None:
    asked = {(kind, seed) for kind, seed, _ in EARLIER}
    assert set(failed_plants(TABLES)) - asked == set()
