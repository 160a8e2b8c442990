"""What coverage watches of a run of the tests: enough to see the lines, for tracing costs half as much again.

That is, what modules do as one process imports them, and of each test the first cases as they begin: the others walk
the same lines, and what a long one does later, it does again and again. Nor does it watch pytest between tests.
"""

from __future__ import annotations

import signal
import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

#: Of one test, the cases whose coverage is measured, and for how many seconds of processor time.
TRACED, TRACED_SECONDS = 2, 0.2


class Traced:
    """Starts and stops the measurement of coverage, where there is one."""

    def __init__(self, config: pytest.Config) -> None:
        self._config = config
        self._items: set[pytest.Item] = set()

    @property
    def _coverage(self) -> Any:
        plugin = self._config.pluginmanager.getplugin("_cov")
        return getattr(getattr(plugin, "cov_controller", None), "cov", None)

    @property
    def _runs_tests(self) -> bool:
        """Whether this process does, and is not the one that hands them out."""
        return hasattr(self._config, "workerinput") or not self._config.pluginmanager.hasplugin("dsession")

    @pytest.hookimpl(tryfirst=True)
    def pytest_sessionstart(self) -> None:
        """End what pytest-cov begins before it knows that this is one process of several: it would never end."""
        if self._coverage is not None and hasattr(self._config, "workerinput"):
            self._coverage.stop()

    @pytest.hookimpl(tryfirst=True)
    def pytest_collection(self) -> None:
        """Watch the import of modules where tests run, in the first of several processes."""
        first = getattr(self._config, "workerinput", {}).get("workerid", "gw0") == "gw0"
        if self._coverage is not None and not (first and self._runs_tests):
            self._coverage.stop()

    def pytest_collection_finish(self, session: pytest.Session) -> None:
        """Choose the first cases of each test."""
        if self._coverage is not None and self._runs_tests:
            self._coverage.stop()
            begun: Counter[str] = Counter()
            for item in session.items:
                name = item.nodeid.partition("[")[0]
                begun[name] += 1
                if begun[name] <= TRACED:
                    self._items.add(item)

    @contextmanager
    def _watched(self, item: pytest.Item) -> Iterator[None]:
        """Measure coverage of one step of a test, for a while where the system can tell when it is over."""
        if item not in self._items:
            yield
            return
        coverage = self._coverage
        timed = hasattr(signal, "setitimer") and threading.current_thread() is threading.main_thread()
        before = signal.signal(signal.SIGPROF, lambda *_: coverage.stop()) if timed else None
        if timed:
            signal.setitimer(signal.ITIMER_PROF, TRACED_SECONDS)
        coverage.start()
        try:
            yield
        finally:
            if timed:
                signal.setitimer(signal.ITIMER_PROF, 0)
                signal.signal(signal.SIGPROF, before)
            coverage.stop()

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_setup(self, item: pytest.Item) -> Iterator[None]:
        """Watch the fixtures of a test."""
        with self._watched(item):
            return (yield)

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_call(self, item: pytest.Item) -> Iterator[None]:
        """Watch a test."""
        with self._watched(item):
            return (yield)

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_teardown(self, item: pytest.Item) -> Iterator[None]:
        """Watch how fixtures end."""
        with self._watched(item):
            return (yield)
