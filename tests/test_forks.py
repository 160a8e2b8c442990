"""A process that is forked while threads run monitors goes on with whole blocks."""

from __future__ import annotations

import os
import signal
import threading
import time
import warnings
from collections.abc import Callable
from typing import Any

import pytest

import residua as rs
from residua.errors import DataError
from residua.monitor.fleet_block import FleetBlock
from running_examples import plant, recording

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are not forked here")


def status_of_child(work: Callable[[], bool], seconds: int = 60) -> int:
    """Return how a forked process ends that does some work: 0 if that is true, more if it hangs, or is not."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # that there are threads
        child = os.fork()
    if child == 0:
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.alarm(seconds)
        try:
            os._exit(0 if work() else 1)
        finally:
            os._exit(2)
    return os.waitpid(child, 0)[1]


def test_a_child_goes_on_with_whole_blocks() -> None:
    """Its first step waited for a thread that it does not have, on a state that was half changed."""
    monitor = rs.Monitor(rs.design.kalman_filter(plant()))
    u, y = recording(200_000)
    monitor.step(u[0], y[0])
    is_over = threading.Event()

    def blocks() -> None:
        while not is_over.is_set():
            monitor.update(u, y, keep=("alarm",))

    def goes_on() -> bool:
        before = monitor._online.state
        assert before is not None
        count = int(before.count[0])
        monitor.step(u[0], y[0])
        return (count - 1) % len(y) == 0 and monitor._online.state.count[0] == count + 1  # pyright: ignore

    thread = threading.Thread(target=blocks)
    thread.start()
    try:
        time.sleep(0.05)
        ends = [status_of_child(goes_on) for _ in range(6)]
    finally:
        is_over.set()
        thread.join()
    assert ends == [0] * 6


def test_a_fleet_that_is_forked_in_the_middle_of_a_block_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    fleet = rs.Fleet(rs.Monitor(rs.design.kalman_filter(plant())), plants=["north"])
    u, y = recording(3)
    is_within, ends = threading.Event(), threading.Event()
    follow = FleetBlock._follow_block

    def waits(*block: Any) -> None:
        is_within.set()
        ends.wait()
        follow(*block)

    def refuses() -> bool:
        monkeypatch.undo()
        with pytest.raises(DataError, match="forked in the middle of a block"):
            fleet.tick(None, u[:1], y[:1])
        return True

    monkeypatch.setattr(FleetBlock, "_follow_block", waits)
    thread = threading.Thread(target=fleet.update, args=(u[None], y[None]))
    thread.start()
    is_within.wait()
    try:
        assert status_of_child(refuses) == 0
    finally:
        ends.set()
        thread.join()
    monkeypatch.undo()
    assert fleet.tick(None, u[:1], y[:1]).statistic.shape == (1,)
