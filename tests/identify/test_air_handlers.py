"""Air-handling units: the simulated one by relations for each operating mode, nothing chosen by a day with a fault."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]


VALVES = {"heating coil valve", "cooling coil valve"}


@pytest.mark.parametrize(
    ("unit", "judged", "detected", "named"),
    [("MZVAV-2-2", VALVES | {"OA damper"}, 10, 8), ("SZCAV and SZVAV", VALVES, 14, 14)],
)
def test_faults_show_and_fault_free_days_do_not(
    shared_data: Path, monkeypatch: pytest.MonkeyPatch, unit: str, judged: set[str], detected: int, named: int
) -> None:
    """By hand 10 of 13 days were detected of the one, and 15 of 15 of the other; each fault-free day is left out."""
    folder = shared_data / "lbnl_ahu"
    if not folder.is_dir():
        pytest.skip("the recordings of air-handling units are not present")
    monkeypatch.syspath_prepend(str(REPOSITORY / "benchmarks"))
    bench = import_module("air_handlers")
    files = bench.UNITS[unit]
    data, truth = bench.days(folder, files), bench.schedule(folder, files)
    healthy = [day for day in data if truth[day][0] == "none"]
    model = bench.learnt(data, healthy)
    found = {day: bench.verdict(model, data[day]) for day in truth if truth[day][0] in judged}
    assert sum(seen for seen, _, _ in found.values()) >= detected
    assert sum(name == truth[day][0] for day, (_, name, _) in found.items()) >= named
    few = healthy if len(healthy) < 10 else healthy[::12]  # what is learnt anew for each of them takes its time
    without = {day: bench.learnt(data, [one for one in healthy if one != day]) for day in few}
    assert not any(bench.verdict(without[day], data[day])[0] for day in few)
