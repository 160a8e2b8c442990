"""Switching off a central guard turns a test red; ``make mutants`` does more, for every guard."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from effort import cases

TESTS = Path(__file__).resolve().parent
#: Decoupling, estimates of observers, the Riccati equation, directions, poles, and identities of maps and forms.
CENTRAL = (
    "design.core.decoupling:_accepted",
    "design.observers.observer:with_checked_estimate",
    "design.observers.perfect_observer:_estimate_off",
    "linear.poles.riccati:filter_riccati:2",
    "design.detection_filters.detection_filter:_stacked",
    "design.parity.directions:check_directions",
    "linear.poles.pole_assignment:assigned_gain",
    "design.detection_filters.directional_gain:with_poles_of_whole",
    "design.core.decoupling:_accept",
)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="each mutant runs in a process that forks")
@pytest.mark.parametrize("guards", cases((CENTRAL[::4], CENTRAL), 1), ids=len)
def test_switching_off_a_central_guard_turns_a_test_red(guards: tuple[str, ...]) -> None:
    """Among them none that was green: the first is run unchanged too."""
    command = [sys.executable, str(TESTS / "mutants.py"), *guards, "--off"]
    found = subprocess.run(command, capture_output=True, text=True, check=False, cwd=TESTS.parent)
    assert found.stdout == f"{len(guards)} mutants of {len(guards)} guards, 0 survive\n", found.stderr
    assert found.returncode == 0
