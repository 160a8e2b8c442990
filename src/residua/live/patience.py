"""A store with retries while it is away."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from typing import TypeVar

from residua.live.source import Health, Pauses, RunStoppedError
from residua.live.store import Changes, Store, StoreAwayError

T = TypeVar("T")


class Patience:
    """Retries, with growing pauses, for as long as the store is away.

    Parameters
    ----------
    store : Store
    stopping : threading.Event
        Set when the run is to end: it is not waited for any longer then.
    """

    def __init__(self, store: Store, stopping: threading.Event) -> None:
        self.store, self._stopping = store, stopping
        self.health = Health(True, "")

    def rows(self, key: int, first: int = 0) -> list[tuple[int, bytes]]:
        """Return the stored rows of a plant."""
        return self._again(lambda: self.store.rows(key, first))

    def meta(self) -> Mapping[str, str]:
        """Return facts about the whole."""
        return self._again(self.store.meta)

    def drop_events(self, before: int) -> None:
        """Drop events before a place."""
        self._again(lambda: self.store.drop_events(before))

    def commit(self, changes: Changes) -> None:
        """Write changes in one transaction.

        Raises
        ------
        RunStoppedError
            If the run is to end while the store is away: nothing was acknowledged then.
        """
        if changes:
            self._again(lambda: self.store.commit(changes))

    def _again(self, act: Callable[[], T]) -> T:
        pauses = Pauses(0.1, 10.0)
        while True:
            try:
                done = act()
            except StoreAwayError as error:
                self.health = Health(False, f"{error}; trying again")
                if pauses.wait(self._stopping):
                    raise RunStoppedError from error
            else:
                if not self.health.good:
                    self.health = Health(True, "")
                return done


__all__ = ["Patience"]
