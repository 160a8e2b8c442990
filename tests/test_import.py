"""Importing the package is cheap: what only some users need is imported when it is used."""

from __future__ import annotations

import importlib
import json
import pickle
import subprocess
import sys

import pytest

import residua

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
    "clarabel",
    "cvxpy",
    "pyspark",
    "ray",
    "dask",
    "distributed",
    "joblib",
)


def test_import_brings_nothing_heavy() -> None:
    assert set(HEAVY) & set(_loaded("[getattr(residua, name) for name in residua.__all__]")) == set()


def test_names_are_imported_when_they_are_first_asked_for() -> None:
    loaded = _loaded("residua.__all__, dir(residua)")
    assert {name for name in loaded if name.startswith("residua")} == {"residua"}
    assert not {"numpy", "scipy"} & set(loaded)
    assert "residua.analysis.coding" in _loaded("residua.coding.choose")
    loaded = _loaded("residua.Plant")
    assert "residua.plant" in loaded
    assert not {"residua.design", "residua.monitor", "residua.identify"} & set(loaded)


def test_a_room_can_be_the_first_that_is_imported() -> None:
    assert "residua.design" in _loaded("None", "residua.monitor")  # files of monitors hold what any method has made


def test_the_names_of_the_package_are_what_it_says() -> None:
    assert set(residua.__all__) | {"cluster", "export", "report", "testing"} <= set(dir(residua))
    assert {*residua._PLACES, *residua._ROOMS, "coding"} == set(residua.__all__)
    assert residua.Plant is importlib.import_module("residua.plant").Plant
    assert residua.diagnosability is importlib.import_module("residua.analysis").diagnosability
    assert residua.design is importlib.import_module("residua.design")
    assert pickle.loads(pickle.dumps(residua.suggest)) is residua.suggest
    with pytest.raises(AttributeError, match="'residua' has no attribute 'no_such_name'"):
        residua.no_such_name  # noqa: B018


def _loaded(use: str, module: str = "residua") -> list[str]:
    """Return the modules that a new process has after importing one and using it."""
    code = f"import json, sys, {module}; {use}; print(json.dumps(sorted(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return list(json.loads(done.stdout))


def test_a_former_place_still_works_and_says_where_to_look() -> None:
    sys.modules.pop("residua.linear.recursion", None)
    with pytest.warns(DeprecationWarning, match=r"residua\.linear\.systems\.recursion"):
        former = importlib.import_module("residua.linear.recursion")
    assert former.run_filter is importlib.import_module("residua.linear.systems.recursion").run_filter
