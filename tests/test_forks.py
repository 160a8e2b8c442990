"""A process that is forked while threads hold locks goes on, with what these guard in one piece."""

from __future__ import annotations

import gc
import os
import signal
import threading
import time
import warnings
from collections.abc import Callable

import pytest

import residua as rs
from residua import forks
from residua.forks import forkable_lock
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
        before = monitor._live.state
        assert before is not None
        count = int(before.count[0])
        monitor.step(u[0], y[0])
        return (count - 1) % len(y) == 0 and monitor._live.state.count[0] == count + 1  # pyright: ignore

    thread = threading.Thread(target=blocks)
    thread.start()
    try:
        time.sleep(0.05)
        ends = [status_of_child(goes_on) for _ in range(6)]
    finally:
        is_over.set()
        thread.join()
    assert ends == [0] * 6


def test_a_fork_waits_for_no_thread_that_waits_for_it() -> None:
    """One that holds a lock and wants another, which the fork has taken before."""
    first, then = forkable_lock(), forkable_lock()
    has_first, is_done = threading.Event(), threading.Event()

    def both() -> None:
        with first:
            has_first.set()
            while not forks._held:  # until the fork has the other one
                time.sleep(0.001)
            with then:
                is_done.set()

    thread = threading.Thread(target=both)
    thread.start()
    has_first.wait()
    end = status_of_child(lambda: is_done.is_set() and first.acquire(timeout=1) and then.acquire(timeout=1))
    thread.join()
    assert end == 0
    assert first.acquire(timeout=1)
    assert then.acquire(timeout=1)
    assert forks._held == []


def test_a_thread_may_fork_that_holds_a_lock_itself() -> None:
    lock = forkable_lock()
    with lock:
        assert status_of_child(lambda: lock.acquire(timeout=1)) == 0


def test_locks_of_what_is_no_more_are_not_kept() -> None:
    gc.collect()
    before = len(forks._listed())
    locks = [forkable_lock() for _ in range(5)]
    assert len(forks._listed()) == before + 5
    del locks
    assert len(forks._listed()) == before
