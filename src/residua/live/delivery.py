"""Delivery of events from the store to one sink, in their order, repeated until they have arrived."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

from residua.live.sink import DeliveryError, Sink
from residua.live.source import Health, Pauses
from residua.live.store import Store, StoreAwayError, StoreError

#: Events that are handed to a sink at once at most.
_AT_ONCE = 100
_LOG = logging.getLogger("residua.live")


class Delivery:
    """Delivery of events to a sink, in its own thread.

    Deliveries are recorded after each success; a kill between the two delivers those events again.

    Parameters
    ----------
    sink : Sink
    store : Store
    wait : callable
        Waits for an event after a place, some seconds at most; returns whether there is one.
    """

    def __init__(self, sink: Sink, store: Store, wait: Callable[[int, float], bool]) -> None:
        self.sink, self._store, self._wait = sink, store, wait
        self.health = Health(True, "nothing to deliver yet")
        self.delivered = self.failures = 0
        self.position = store.position(sink.name)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._work, name=f"sink {sink.name}", daemon=True)

    def start(self) -> None:
        """Start delivering."""
        self._thread.start()

    def stop(self, seconds: float = 10.0) -> None:
        """Stop after the current delivery."""
        self._stopping.set()
        self._thread.join(seconds)
        self.sink.close()

    def finish(self, place: int, seconds: float) -> bool:
        """Wait until everything up to a place has been delivered, for a limited time; return whether it has."""
        waited = threading.Event()
        step = 0.05
        for _ in range(int(seconds / step)):
            if self.position >= place or not self._thread.is_alive():
                break
            waited.wait(step)
        return self.position >= place

    def _work(self) -> None:
        pauses = Pauses()
        while not self._stopping.is_set():
            try:
                if self._some():
                    pauses.reset()
            except (DeliveryError, StoreAwayError) as error:
                self.failures += 1
                if self.health.good:
                    _LOG.warning("sink %s: %s", self.sink.name, error)
                self.health = Health(False, f"{error}; trying again")
                if pauses.wait(self._stopping):
                    return
            except StoreError as error:
                self.health = Health(False, str(error))
                _LOG.error("sink %s: %s", self.sink.name, error)
                return
            except Exception as error:  # of a sink that is wrong itself: it must not end in silence
                self.failures += 1
                self.health = Health(False, f"{type(error).__name__}: {error}; trying again")
                _LOG.exception("sink %s", self.sink.name)
                if pauses.wait(self._stopping):
                    return

    def _some(self) -> bool:
        """Deliver some events; return whether there were any."""
        if not self._wait(self.position, 1.0):
            return False
        events = self._store.events(self.position, _AT_ONCE)
        if not events:
            return False
        done = self.sink.deliver(events)
        if done:
            self.position = events[done - 1].place
            self._store.delivered(self.sink.name, self.position)
            self.delivered += done
            if not self.health.good:
                _LOG.info("sink %s delivers again", self.sink.name)
            self.health = Health(True, "delivers")
        return done > 0


__all__ = ["Delivery"]
