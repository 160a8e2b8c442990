"""Tennessee Eastman: what the default monitor of canonical variates misses, with nothing chosen by a test file."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import pytest

import residua as rs

REPOSITORY = Path(__file__).resolve().parents[2]


def test_the_default_misses_less_than_is_published(shared_data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Published for canonical variates: .056 and .185 (Russell, Chiang and Braatz 2000)."""
    folder = shared_data / "tep"
    if not folder.is_dir():
        pytest.skip("the Tennessee Eastman recordings are not present")
    monkeypatch.syspath_prepend(str(REPOSITORY / "benchmarks"))
    bench = import_module("tennessee_eastman")
    made = rs.identify.canonical_variates(bench.recording(folder, "d00"))
    normal = bench.recording(folder, "d00_te")
    monitor = rs.Monitor(made, isolate=None).fit(None, normal, false_alarm_rate=bench.RATE, held_out=0)
    false, missed = bench.rates(monitor, folder)
    eighteen, all_of_them = bench.means(missed)
    assert false <= 0.01
    assert eighteen <= 0.045
    assert all_of_them <= 0.165
