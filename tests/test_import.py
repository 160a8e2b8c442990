"""Importing the package is cheap: what only some users need is imported when it is used."""

from __future__ import annotations

import json
import subprocess
import sys

HEAVY = (
    "scipy.signal",
    "scipy.stats",
    "scipy.optimize",
    "matplotlib",
    "pandas",
    "polars",
    "pyarrow",
    "narwhals",
    "typer",
    "control",
    "cvxpy",
)


def test_import_brings_nothing_heavy() -> None:
    code = "import json, sys, residua; print(json.dumps(sorted(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert set(HEAVY) & set(json.loads(done.stdout)) == set()
