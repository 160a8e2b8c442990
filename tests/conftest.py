"""Fixtures shared by every test."""

from __future__ import annotations

import os
import signal
import threading
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

# Before NumPy is imported: with matrices of ten rows the threads of the linear algebra do nothing but wait for each
# other, which takes twice the time on two cores.
for _library in ("OPENBLAS", "OMP", "MKL"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")

import pytest  # noqa: E402

from guards import reached_guards  # noqa: E402, F401
from refusals import pytest_configure, refused  # noqa: E402, F401
from residua.linear.systems.array_cache import forget  # noqa: E402

REPOSITORY = Path(__file__).resolve().parent.parent
#: Of one test, the cases whose coverage is measured, and for how many seconds of processor time.
TRACED, TRACED_SECONDS = 2, 0.2


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


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    """Measure the coverage of a test as it begins: what a long one does later, it does again and again."""
    plugin = item.config.pluginmanager.getplugin("_cov")
    controller = getattr(plugin, "cov_controller", None)
    alone = threading.current_thread() is threading.main_thread()
    if controller is None or item.get_closest_marker("no_cover") or not (alone and hasattr(signal, "setitimer")):
        return (yield)
    stopped = False

    def stop(*_: object) -> None:
        nonlocal stopped
        stopped = True
        controller.cov.stop()

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, TRACED_SECONDS)
    try:
        return (yield)
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)
        if stopped:
            controller.cov.start()


def _without_case(item: pytest.Item) -> str:
    return item.nodeid.partition("[")[0]


class _Forgetful(pytest.MonkeyPatch):  # pyright: ignore[reportGeneralTypeIssues]
    """Patches, after each of which functions compute again what they have kept of before."""

    def setattr(self, *args: Any, **options: Any) -> None:
        """Set it, and let go of what functions have kept."""
        super().setattr(*args, **options)
        forget()

    def undo(self) -> None:
        """Undo all, and let go of what functions have kept since."""
        super().undo()
        forget()


@pytest.fixture
def monkeypatch() -> Iterator[pytest.MonkeyPatch]:
    """Patches of a test, which no result that was kept hides and none that is kept outlives."""
    patch = _Forgetful()
    yield patch
    patch.undo()


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of recordings that others made; tests that need it are skipped where it is absent."""
    folder = Path(os.environ.get("RESIDUA_SHARED_DATA", REPOSITORY.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip("the folder of recordings is not present (set RESIDUA_SHARED_DATA)")
    return folder
