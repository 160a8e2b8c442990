"""Locks that are free in a process that was forked, and what they guard in one piece there.

A process that is forked while another thread holds a lock has a copy of it that nobody lets go, and of what is half
changed. So a fork waits until it holds all of them.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from itertools import count
from threading import Lock, RLock
from weakref import WeakValueDictionary

#: How long a fork waits for one lock with others in hand, at first: a thread may hold that one and want these.
_PATIENCE = 0.1

_numbers = count()
_locks: WeakValueDictionary[int, RLock] = WeakValueDictionary()
_listing, _forking = Lock(), Lock()
_held: list[RLock] = []


def forkable_lock() -> RLock:
    """Return a lock, for one thread at a time, which may take it again, that no fork leaves behind."""
    lock = RLock()
    with _listing:
        _locks[next(_numbers)] = lock
    return lock


def _listed() -> dict[int, RLock]:
    with _listing:
        return dict(_locks)


def _take_all() -> None:
    """Take all locks, and that of the list of them; one thread at a time."""
    _forking.acquire()
    patience = _PATIENCE
    first: int | None = None
    while True:
        locks = _listed()
        # The latest first, as threads do: a monitor's, and within that what everybody shares.
        order = sorted(locks, key=lambda number: (number != first, -number))
        first = _take((locks[number] for number in order), patience)
        if first is None:
            _listing.acquire()
            if locks.keys() == dict(_locks).keys():
                return
            _listing.release()
        else:
            first = order[first]
        _let_go()
        patience *= 2


def _take(locks: Iterable[RLock], patience: float) -> int | None:
    """Take locks one after the other; return the place of one that did not come free, if any."""
    for place, lock in enumerate(locks):
        if not lock.acquire(timeout=patience if _held else -1):
            return place
        _held.append(lock)
    return None


def _let_go() -> None:
    while _held:
        _held.pop().release()


def _let_all_go() -> None:
    _let_go()
    _forking.release()
    _listing.release()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_take_all, after_in_parent=_let_all_go, after_in_child=_let_all_go)


__all__ = ["forkable_lock"]
