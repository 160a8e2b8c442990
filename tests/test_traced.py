"""Coverage watches the first cases of a test, and stops where it is to: this file is one of those that it watches."""

from __future__ import annotations

import sys
import threading

import pytest

from traced import TRACED


@pytest.mark.parametrize("case", range(TRACED + 1))
def test_the_first_cases_are_watched_and_no_other(case: int, request: pytest.FixtureRequest) -> None:
    if not request.config.pluginmanager.hasplugin("_cov") or request.config.getoption("no_cov"):
        pytest.skip("coverage is not measured")
    assert [trace() is not None for trace in (sys.gettrace, threading.gettrace)] == 2 * [case < TRACED]
