"""The comparison of two states of the source sees the last bit, and says what differs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from same_results.compare import compare, relative_difference
from same_results.ledger import Ledger, digest
from same_results.monitors import Watch
from same_results.runs import measure_plants

PLANTS = 6


def measured(folder: Path, name: str, *, older: Path | None = None) -> Ledger:
    (folder / name).mkdir()
    ledger = Ledger()
    measure_plants(Watch(ledger, folder / name, older), PLANTS)
    return ledger


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Ledger]:
    folder = tmp_path_factory.mktemp("measured")
    ledger = measured(folder, "first")
    ledger.write(folder / "before")
    return folder, ledger


def test_the_last_bit_of_an_array_counts() -> None:
    x = np.linspace(0, 1, 7)
    assert digest("a", x) == digest("a", x.copy())
    for other in (np.nextafter(x, 2), x.astype(np.float32), x[None]):
        assert digest("a", x) != digest("a", other)
    assert digest("ab", "c") != digest("a", "bc")


def test_all_kinds_are_measured_and_a_second_time_alike(first: tuple[Path, Ledger]) -> None:
    folder, ledger = first
    kinds = {key.rpartition(" | ")[2] for key in ledger.hashes}
    assert kinds >= {
        *("design", "evidence", "structure", "refusal", "residuals", "threshold", "alarm", "alarms", "times", "named"),
        *("str", "page", "charts", "test", "fitted", "readings", "settings", "columns"),
    }
    again = measured(folder, "again", older=folder / "first")
    assert again.hashes == ledger.hashes


def test_what_differs_is_named(first: tuple[Path, Ledger], capsys: pytest.CaptureFixture[str]) -> None:
    folder, ledger = first
    changed = Ledger()
    changed.hashes, changed.numbers = dict(ledger.hashes), dict(ledger.numbers)
    key = next(key for key in sorted(changed.numbers) if key.endswith("| residuals"))
    changed.hashes[key] = digest("another")
    changed.numbers[key] = changed.numbers[key] * (1 + 1e-9)
    changed.write(folder / "after")
    assert compare(folder / "before", folder / "before") == 0
    assert capsys.readouterr().out.endswith("the same\n")
    assert compare(folder / "before", folder / "after") == 1
    out = capsys.readouterr().out
    assert f"residuals: 1 of {sum(k.endswith('| residuals') for k in ledger.hashes)} differ, such as {key}" in out
    assert "largest relative difference of residuals: 1e-09" in out
    assert "largest relative difference of threshold: 0\n" in out


def test_relative_differences() -> None:
    x = np.array([2.0, np.nan, -4.0])
    assert relative_difference(x, x) == 0
    assert relative_difference(x, x + [0, 0, 1.0]) == 0.25
    assert relative_difference(x, x[:2]) == np.inf
    assert relative_difference(x, np.nan_to_num(x)) == np.inf
    assert relative_difference(np.zeros(2), np.ones(2)) == np.inf
