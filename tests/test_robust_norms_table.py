"""The table of bounds of the peak norm: small rows come out again, and it says what its page reads in it."""

from __future__ import annotations

import csv
import importlib
import importlib.util
from itertools import pairwise
from pathlib import Path

import pytest

from residua.linear import robust_peak_norm

REPOSITORY = Path(__file__).resolve().parent.parent
LMI = ("lifted", "popov-tsypkin", "quadratic")


def rows() -> dict[tuple[int, int], dict[str, tuple[float, float]]]:
    """Return ratio and seconds of each method, by states and parameters."""
    found: dict[tuple[int, int], dict[str, tuple[float, float]]] = {}
    with (REPOSITORY / "docs" / "data" / "robust_norms.csv").open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            assert row["outcome"] == "bound"
            size = int(row["states"]), int(row["parameters"])
            found.setdefault(size, {})[row["method"]] = float(row["bound / attained"]), float(row["seconds"])
    return found


def test_the_table_of_the_page_is_current() -> None:
    path = REPOSITORY / "docs" / "make_tables.py"
    spec = importlib.util.spec_from_file_location("make_tables", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert module.ROBUST_NORMS_BY_SIZE.read_text(encoding="utf-8") == module.robust_norms_by_size()


@pytest.mark.parametrize("size", [2, 4, 6])
def test_small_rows_come_out_again(size: int, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("clarabel")
    monkeypatch.syspath_prepend(str(REPOSITORY / "benchmarks"))
    benchmark = importlib.import_module("robust_norms")
    published = rows()[size, size]
    for name, options in benchmark.METHODS:
        found = robust_peak_norm(benchmark.system(size, size), **options)
        assert found.ratio == pytest.approx(published[name][0], rel=3e-3), name


def test_what_the_page_reads_in_the_table() -> None:
    table = rows()
    assert max(table) == (20, 20)
    for (states, parameters), row in table.items():
        bounds = {name: ratio for name, (ratio, _) in row.items()}
        assert min(bounds.values()) >= 1
        for less, more in (*pairwise(LMI), ("quadratic", "star"), ("star, 16 boxes", "star")):
            assert bounds[less] <= bounds[more] * (1 + 1e-3)
        others = min(bounds[name] for name in (*LMI, "star", "star, 16 boxes"))
        assert bounds["centred, 32 boxes"] <= bounds["centred"] < 1.01
        assert bounds["centred, 32 boxes"] < 1.0012 or (states, parameters) == (20, 20)
        assert others > 1.03 or states < 4
        assert bounds["popov-tsypkin"] >= bounds["quadratic"] * (1 - 1.1e-3)
        assert max(row["star"][1], row["centred"][1]) < 1
    assert min(table[12, 12][name][0] for name in LMI) == pytest.approx(1.23, abs=0.01)
