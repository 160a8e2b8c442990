"""The tables of sizes on the page about clusters follow from each other, and say what the page says of them."""

from __future__ import annotations

import csv
import importlib.util
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]


def table(name: str) -> list[dict[str, str]]:
    with (REPOSITORY / "docs" / "data" / name).open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_the_table_of_a_hundred_million_follows_from_the_measurements() -> None:
    path = REPOSITORY / "benchmarks" / "cluster_shards.py"
    spec = importlib.util.spec_from_file_location("cluster_shards", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert module.hundred_million(table("cluster_sizes.csv")) == table("cluster_hundred_million.csv")


def test_a_stream_keyed_by_shard_is_three_times_as_fast_as_by_plant() -> None:
    """In the larger of the measured streams."""
    assert float(table("cluster_keys.csv")[-2]["times as fast"]) >= 3
