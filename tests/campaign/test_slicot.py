"""All 37 systems of the SLICOT benchmarks, every function, in processes of their own.

Run with ``make campaign``. The same as ``benchmarks/observer_table.py``, which writes the tables of the documentation.
"""

from __future__ import annotations

import importlib
import os
import sys
from collections import Counter
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.mark.campaign
def test_every_observer_on_every_system_holds_or_is_refused(shared_data: Path) -> None:
    sys.path.insert(0, str(BENCHMARKS))
    table = importlib.import_module("observer_table")
    sys.path.remove(str(BENCHMARKS))
    folder = shared_data / "slicot_benchmarks"
    tasks = table.all_tasks(folder)
    assert len({task.system for task in tasks}) == 37
    outcomes = list(table.run_all(tasks, folder, os.cpu_count() or 1))
    print(dict(Counter(outcome.outcome for outcome in outcomes)))
    assert len(outcomes) == len(tasks)
    assert [outcome for outcome in outcomes if outcome.outcome == "third"] == []
    assert all(len(outcome.reason) > 40 for outcome in outcomes if outcome.outcome == "refused")
    assert sum(outcome.outcome == "ok" for outcome in outcomes) > len(tasks) / 2
