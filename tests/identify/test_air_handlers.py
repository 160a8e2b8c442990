"""Air-handling units: the simulated one by relations for each operating mode, nothing chosen by a day with a fault."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]


def test_faults_show_and_fault_free_days_do_not(shared_data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By hand 10 of 13 days were detected; the names are those of the rule that the benchmark has."""
    folder = shared_data / "lbnl_ahu"
    if not folder.is_dir():
        pytest.skip("the recordings of air-handling units are not present")
    monkeypatch.syspath_prepend(str(REPOSITORY / "benchmarks"))
    bench = import_module("air_handlers")
    files = bench.UNITS["MZVAV-2-2"]
    data, truth = bench.days(folder, files), bench.schedule(folder, files)
    healthy = [day for day in data if truth[day][0] == "none"]
    model = bench.learnt(data, healthy)
    found = {day: bench.verdict(model, data[day]) for day in truth}
    faulty = [day for day in truth if day not in healthy]
    assert sum(found[day][0] for day in faulty) >= 10
    assert not any(found[day][0] for day in healthy)
    assert sum(found[day][1] == truth[day][0] for day in faulty) >= 6
