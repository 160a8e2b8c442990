"""Processes that collect the tests at the same time do it with less work: each begins with modules of its own.

What one of them compiles, with its assertions rewritten, the others find on the disk. And what is there after the
collection, millions of objects, stays: the search for garbage leaves it out.
"""

from __future__ import annotations

import gc
from collections.abc import Generator
from contextlib import suppress

import pytest


class Collected:
    """Orders the imports of a collection, not what is collected, and keeps the search for garbage short."""

    def __init__(self, config: pytest.Config) -> None:
        worker = getattr(config, "workerinput", {"workerid": "gw0", "workercount": 1})
        self._share = int(worker["workerid"].removeprefix("gw")) / worker["workercount"]

    @pytest.hookimpl(wrapper=True)
    def pytest_make_collect_report(
        self, collector: pytest.Collector
    ) -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
        """Import the modules of a folder, from this process's share on; one that cannot be says so in its turn."""
        report = yield
        modules = [one for one in report.result or () if isinstance(one, pytest.Module)]
        begin = int(len(modules) * self._share)
        for module in modules[begin:] + modules[:begin] if begin else ():
            with suppress(Exception, pytest.skip.Exception):
                _ = module.obj
        return report

    def pytest_collection(self) -> None:
        """Nothing is garbage yet."""
        gc.disable()

    def pytest_collection_finish(self) -> None:
        """Leave out what is there now, and search after as many new objects as a test makes, not after 700."""
        gc.freeze()
        gc.set_threshold(20_000)
        gc.enable()
