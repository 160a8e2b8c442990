"""Fixtures shared by every test."""

from __future__ import annotations

import os
from collections import Counter
from pathlib import Path

# Before NumPy is imported: with matrices of ten rows the threads of the linear algebra do nothing but wait for each
# other, which takes twice the time on two cores.
for _library in ("OPENBLAS", "OMP", "MKL"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")

import pytest  # noqa: E402

from guards import reached_guards  # noqa: E402, F401
from refusals import pytest_configure, refused  # noqa: E402, F401

REPOSITORY = Path(__file__).resolve().parent.parent
#: Of the cases of one test, those whose coverage is measured, as long as none of them took so many seconds.
TRACED, CHEAP = 2, 0.1
#: Tests of which a case took longer than that.
_DEAR: set[str] = set()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Measure coverage in the first cases of each test: the others walk the same lines, and tracing costs half as much
    again as what is traced.
    """
    begun: Counter[str] = Counter()
    for item in items:
        name = _without_case(item)
        begun[name] += 1
        if begun[name] > TRACED:
            item.add_marker("no_cover")


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Measure no coverage in further cases of a test of which one took its time: there tracing costs most."""
    if _without_case(item) in _DEAR:
        item.add_marker("no_cover")


def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> None:
    """Note the tests of which a case took its time."""
    if call.when == "call" and call.duration > CHEAP:
        _DEAR.add(_without_case(item))


def _without_case(item: pytest.Item) -> str:
    return item.nodeid.partition("[")[0]


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of recordings that others made; tests that need it are skipped where it is absent."""
    folder = Path(os.environ.get("RESIDUA_SHARED_DATA", REPOSITORY.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip("the folder of recordings is not present (set RESIDUA_SHARED_DATA)")
    return folder
