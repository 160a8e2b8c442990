"""Importing the package is cheap: what only some users need is imported when it is used."""

from __future__ import annotations

import importlib
import json
import subprocess
import sys

import pytest

HEAVY = (
    "scipy.signal",
    "scipy.stats",
    "scipy.optimize",
    "scipy.sparse",
    "scipy.special",
    "matplotlib",
    "pandas",
    "polars",
    "pyarrow",
    "narwhals",
    "typer",
    "control",
    "clarabel",
    "cvxpy",
    "pyspark",
    "ray",
    "dask",
    "distributed",
    "joblib",
)


def test_import_brings_nothing_heavy() -> None:
    code = "import json, sys, residua; print(json.dumps(sorted(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert set(HEAVY) & set(json.loads(done.stdout)) == set()


def test_a_former_place_still_works_and_says_where_to_look() -> None:
    sys.modules.pop("residua.linear.recursion", None)
    with pytest.warns(DeprecationWarning, match=r"residua\.linear\.systems\.recursion"):
        former = importlib.import_module("residua.linear.recursion")
    assert former.run_filter is importlib.import_module("residua.linear.systems.recursion").run_filter
