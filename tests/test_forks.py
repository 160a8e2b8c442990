"""A process that is forked while threads hold locks goes on, with what these guard in one piece."""

from __future__ import annotations

import gc
import os
import signal
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest

import residua as rs
from residua import forks
from residua.errors import DataError
from residua.forks import forkable_lock
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


def are_free(*locks: forks.RLock) -> bool:
    """Return whether another thread gets all locks."""
    got: list[bool] = []

    def take() -> None:
        for lock in locks:
            got.append(lock.acquire(timeout=1))
            if got[-1]:
                lock.release()

    thread = threading.Thread(target=take)
    thread.start()
    thread.join()
    return got == [True] * len(locks)


@contextmanager
def held_by_another_thread(lock: forks.RLock, seconds: float) -> Iterator[None]:
    has_it = threading.Event()

    def hold() -> None:
        with lock:
            has_it.set()
            time.sleep(seconds)

    thread = threading.Thread(target=hold)
    thread.start()
    has_it.wait()
    yield
    thread.join()


@contextmanager
def handled(handler: Callable[[], object], first: float, then: float = 0.0) -> Iterator[None]:
    """Let a signal come after so many seconds, and then again and again; not within its handler."""
    is_under_way = [False]

    def once(*_: object) -> None:
        if not is_under_way[0]:
            is_under_way[0] = True
            try:
                handler()
            finally:
                is_under_way[0] = False

    before = signal.signal(signal.SIGALRM, once)
    signal.setitimer(signal.ITIMER_REAL, first, then)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def test_a_handler_of_a_signal_may_make_a_lock_while_one_is_made() -> None:
    """In a process of its own, which waited for itself."""

    def makes() -> bool:
        end = time.monotonic() + 0.5
        with handled(forkable_lock, 1e-4, 1e-4):
            while time.monotonic() < end:
                forkable_lock()
        return True

    ends: list[int] = []
    thread = threading.Thread(target=lambda: ends.append(os.waitpid(child, 0)[1]))
    child = os.fork()
    if child == 0:
        try:
            os._exit(0 if makes() else 1)
        finally:
            os._exit(2)
    thread.start()
    thread.join(30)
    if not ends:
        os.kill(child, signal.SIGKILL)
    thread.join()
    assert ends == [0]


def test_a_handler_of_a_signal_may_fork_while_a_fork_waits() -> None:
    """In a process without ``concurrent.futures``, whose own lock no such fork gets."""
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", FORK_IN_A_HANDLER], capture_output=True, text=True, timeout=60
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "inner 0\nouter 0\n", "")


FORK_IN_A_HANDLER = """
import os, signal, threading
from residua.forks import forkable_lock

def fork(name):
    child = os.fork()
    if child == 0:
        os._exit(0 if lock.acquire(timeout=1) else 1)
    print(name, os.waitpid(child, 0)[1], flush=True)

def handler(*_):
    end.set()
    fork("inner")

def hold():
    with lock:
        begun.set()
        end.wait()

lock, begun, end = forkable_lock(), threading.Event(), threading.Event()
thread = threading.Thread(target=hold)
thread.start()
begun.wait()
signal.signal(signal.SIGALRM, handler)
signal.setitimer(signal.ITIMER_REAL, 0.1)
fork("outer")
thread.join()
"""


def test_a_fork_that_is_interrupted_lets_go_of_what_it_has(monkeypatch: pytest.MonkeyPatch) -> None:
    """And of nothing else: Python writes down what came, and forks."""
    lock, other = forkable_lock(), forkable_lock()
    told: list[object] = []
    monkeypatch.setattr(sys, "unraisablehook", lambda one: told.append(one.exc_type))

    def interrupts() -> None:
        raise KeyboardInterrupt

    with held_by_another_thread(lock, 0.5), handled(interrupts, 0.1):
        assert status_of_child(lambda: are_free(other, forks._listing, forks._forking)) == 0
    assert told == [KeyboardInterrupt]
    assert are_free(lock, other, forks._listing, forks._forking)


def test_a_fork_ends_while_locks_are_made_all_the_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """It began anew whenever there was another one, and took longer each time."""
    listed, made = forks._listed, []

    def listed_and_made() -> dict:
        found = listed()
        if not forks._listing.acquire(blocking=False):
            return found
        forks._listing.release()
        thread = threading.Thread(target=lambda: made.append(forkable_lock()))
        thread.start()
        thread.join(0.05)  # it waits for the list, if that is in hand
        return found

    monkeypatch.setattr(forks, "_listed", listed_and_made)
    assert status_of_child(lambda: True) == 0
    assert 0 < len(made) < 5
    assert are_free(*made, forks._listing, forks._forking)


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


def test_a_fork_waits_for_no_thread_that_waits_for_it() -> None:
    """One that holds a lock and wants another, which the fork has taken before."""
    first, then = forkable_lock(), forkable_lock()
    has_first, is_done = threading.Event(), threading.Event()

    def both() -> None:
        with first:
            has_first.set()
            while then.acquire(blocking=False):  # until the fork has the other one
                then.release()
                time.sleep(0.001)
            with then:
                is_done.set()

    thread = threading.Thread(target=both)
    thread.start()
    has_first.wait()
    end = status_of_child(lambda: is_done.is_set() and first.acquire(timeout=1) and then.acquire(timeout=1))
    thread.join()
    assert end == 0
    assert are_free(first, then)


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
