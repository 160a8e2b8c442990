"""A design reaches SciPy within eight frames of the package."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

FOLDER = str(Path(__file__).resolve().parents[2] / "benchmarks")
sys.path.insert(0, FOLDER)
depth: Any = import_module("call_depth")
sys.path.remove(FOLDER)


@pytest.mark.parametrize("name", depth.DESIGNS)
def test_scipy_is_near(name: str) -> None:
    depth.DESIGNS[name](depth.plant(1))  # imports
    subject = depth.plant(2)
    _, _, first, _ = depth.counted(lambda: depth.DESIGNS[name](subject))
    assert 0 < first <= 8
