"""Locks that stay usable after a fork.

A process that is forked while another thread holds a lock has a copy of it that nobody lets go, and of what is half
changed. So a fork waits until it holds all of them. An error that comes while it waits, as of Ctrl-C, is only written
to standard error by Python, which then forks all the same, without waiting any longer.
"""

from __future__ import annotations

import os
from itertools import count
from threading import RLock, local
from weakref import WeakValueDictionary

#: First wait of a fork for one lock while holding others: a thread may hold that one and want these.
_PATIENCE = 0.1

_numbers = count()
_locks: WeakValueDictionary[int, RLock] = WeakValueDictionary()
#: Reentrant, since Python may call a signal handler meanwhile, which makes a lock, or forks.
_listing, _forking = RLock(), RLock()


class _Own(local):
    """Locks held by the forks that a thread is about to make: one, or another one of a handler within it."""

    def __init__(self) -> None:
        self.held: list[list[RLock]] = []


_own = _Own()


def forkable_lock() -> RLock:
    """Return a reentrant lock that stays usable after a fork."""
    lock = RLock()
    with _listing:
        _locks[next(_numbers)] = lock
    return lock


def _listed() -> dict[int, RLock]:
    with _listing:
        return {one.key: lock for one in _locks.valuerefs() if (lock := one()) is not None}


def _take_all() -> None:
    """Take all locks, and that of the list of them; one thread at a time."""
    held: list[RLock] = []
    _own.held.append(held)
    _forking.acquire()
    held.append(_forking)
    patience = _PATIENCE
    first: int | None = None
    while True:
        locks = _listed()
        first = _take(locks, held, patience, first)
        if first is None:
            _listing.acquire()
            held.append(_listing)
            first = _take({n: lock for n, lock in _listed().items() if n not in locks}, held, patience)
            if first is None:
                return
        _let_go(held, but=1)
        patience *= 2


def _take(locks: dict[int, RLock], held: list[RLock], patience: float, first: int | None = None) -> int | None:
    """Take locks one after the other; return the number of one that could not be taken, if any."""
    # The latest first, as threads do: a monitor's, and within it the shared ones.
    for number in sorted(locks, key=lambda number: (number != first, -number)):
        if not locks[number].acquire(timeout=patience if len(held) > 1 else -1):
            return number
        held.append(locks[number])
    return None


def _let_go(held: list[RLock], but: int = 0) -> None:
    """Release the last of these locks, except for so many."""
    while len(held) > but:
        held.pop().release()


def _let_all_go() -> None:
    if _own.held:  # unless an interruption came before all else
        _let_go(_own.held.pop())


if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_take_all, after_in_parent=_let_all_go, after_in_child=_let_all_go)
