"""The table of the documentation on the engine's residuals is what the recordings give."""

from __future__ import annotations

import csv
import importlib
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

REPOSITORY = Path(__file__).resolve().parents[2]


@pytest.fixture
def benchmark_file(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(REPOSITORY / "benchmarks"))
    module = importlib.import_module("engine_residuals")
    yield module  # pyright: ignore
    sys.modules.pop("engine_residuals", None)


@pytest.fixture
def folder(shared_data: Path) -> Path:
    if not (shared_data / "engine_frisk_residuals" / "data.mat").exists():
        pytest.skip("the residuals of the engine are not present")
    return shared_data / "engine_frisk_residuals"


def test_the_table_is_what_the_recordings_give(benchmark_file: ModuleType, folder: Path) -> None:
    with (REPOSITORY / "docs" / "data" / "engine_residuals.csv").open(encoding="utf-8", newline="") as file:
        assert list(csv.reader(file)) == benchmark_file.table(folder)


def test_the_rates_the_long_way(benchmark_file: ModuleType, folder: Path) -> None:
    """Sample by sample, for the decision without any choice."""
    from residua.decide.fired_patterns import consistent_faults

    recording = benchmark_file.read(folder)
    faults = list(recording.faulty)
    told = {line[1]: line for line in benchmark_file.table(folder) if line[0] == "each sample"}
    for name in ("fyp_ic", "fyw_af"):
        j, alarms, consistent, likeliest, counts = faults.index(name), 0, 0, 0, []
        for sample in recording.faulty[name]:
            fired = np.abs(sample) > 1
            if not fired.any():
                continue
            found = consistent_faults(fired, recording.codes, faults)
            alarms += 1
            consistent += all(recording.codes[i, j] for i in np.flatnonzero(fired))
            likeliest += found.candidates[0].faults == (name,)
            counts.append(len(found.consistent))
        header = benchmark_file.HEADER
        cells = dict(zip(header, told[name], strict=True))
        assert cells["in alarm %"] == f"{100 * alarms / len(recording.faulty[name]):.0f}"
        assert cells["fault consistent %"] == f"{100 * consistent / alarms:.0f}"
        assert cells["consistent faults"] == f"{np.mean(counts):.1f}"
        assert abs(int(cells["likeliest %"]) - 100 * likeliest / alarms) <= 2  # here ties count for the first
