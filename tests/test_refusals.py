"""Refusals are added up over the parameters of a test and over processes."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

import refusals

CONFTEST = "from refusals import pytest_configure, refused\n"
TESTS = """
import pytest

@pytest.mark.parametrize("seed", range(10))
@pytest.mark.refusals(at_most={most})
def test_some(seed, refused):
    if seed % 3 == 0:
        refused.skip(f"no observer for {{seed}}")

@pytest.mark.refusals(at_most=5)
def test_many_in_one(refused):
    for seed in range(5):
        refused("none")
"""


def run(folder: Path, tests: str, *options: str) -> tuple[int, str]:
    (folder / "conftest.py").write_text(CONFTEST, encoding="utf-8")
    (folder / "test_them.py").write_text(tests, encoding="utf-8")
    (folder / "pytest.ini").write_text("[pytest]\nmarkers = refusals: x\n", encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "xdist", *options],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(Path(refusals.__file__).parent), "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    return done.returncode, done.stdout


@pytest.mark.parametrize("processes", [(), ("-n", "2")], ids=["one process", "two"])
def test_up_to_the_bound_is_fine_and_one_more_fails(tmp_path: Path, processes: tuple[str, ...]) -> None:
    status, printed = run(tmp_path, TESTS.format(most=4), *processes)
    assert status == 0, printed
    assert "7 passed, 4 skipped" in printed
    status, printed = run(tmp_path, TESTS.format(most=3), *processes)
    assert status == pytest.ExitCode.TESTS_FAILED
    assert "1 failed, 7 passed, 4 skipped" in printed
    assert "test_some[refusals]" in printed
    assert "4 refusals, expected at most 3" in printed
    assert "no observer for 0" in printed


def test_a_test_without_a_bound_is_an_error(tmp_path: Path) -> None:
    status, printed = run(tmp_path, "def test_it(refused):\n    refused('none')\n")
    assert status != 0
    assert "say @pytest.mark.refusals(at_most=...)" in printed
