"""Fixtures shared by every test."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

# Before NumPy is imported: with matrices of ten rows the threads of the linear algebra do nothing but wait for each
# other, which takes twice the time on two cores.
for _library in ("OPENBLAS", "OMP", "MKL"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")

import pytest  # noqa: E402

import refusals  # noqa: E402
from collected import Collected  # noqa: E402
from guards import reached_guards  # noqa: E402, F401
from refusals import refused  # noqa: E402, F401
from traced import Traced  # noqa: E402

if TYPE_CHECKING:
    from chromium import Chromium

REPOSITORY = Path(__file__).resolve().parent.parent


def pytest_configure(config: pytest.Config) -> None:
    """Have what concerns the run as a whole, the doctests of the package included."""
    refusals.pytest_configure(config)
    config.pluginmanager.register(Traced(config), "traced")
    config.pluginmanager.register(Collected(config), "collected")


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Chromium]:
    """A browser for the tests of a module, which are skipped where there is none."""
    from chromium import BROWSER, Chromium

    if BROWSER is None:
        pytest.skip("no Chromium on this machine")
    with Chromium(tmp_path_factory.mktemp("chromium")) as made:
        yield made


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of recordings that others made; tests that need it are skipped where it is absent."""
    folder = Path(os.environ.get("RESIDUA_SHARED_DATA", REPOSITORY.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip("the folder of recordings is not present (set RESIDUA_SHARED_DATA)")
    return folder
