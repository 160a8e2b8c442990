"""The campaign of damaged files, which lies beside the other programs that make tables of the documentation."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from typing import Any

_BENCHMARKS = str(Path(__file__).resolve().parents[1] / "benchmarks")

sys.path.insert(0, _BENCHMARKS)
FILES: Any = importlib.import_module("damaged_files")
sys.path.remove(_BENCHMARKS)


def assert_nothing_wrong(outcome: Any, count: int) -> None:
    """Raise unless every file was read or refused, and the campaign damages what it is to damage."""
    assert outcome.wrong == [], outcome.wrong[0][0]
    assert sum(outcome.counts.values()) == count
    assert outcome.counts["refused"] > count / 3
