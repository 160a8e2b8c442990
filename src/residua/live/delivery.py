"""Delivery of events from the store to receivers: in their order, at least once, with retry and backoff."""

from __future__ import annotations

import logging
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import ClassVar

from residua.live.events import Event
from residua.live.source import Backoff, Health
from residua.live.store import Store, StoreAwayError, StoreError

#: Events that are handed to a sink at once at most.
_AT_ONCE = 100
#: Seconds after which a call of ``deliver`` begins no further event, so that the run can end.
LONGEST_CALL = 10.0
_LOG = logging.getLogger("residua.live")


class DeliveryError(Exception):
    """A receiver is away, or refuses an event: it is tried again later. The text is shown, and has no secret in it."""


class RefusedError(DeliveryError):
    """A receiver refuses an event for good, and would refuse it again."""


class Sink(ABC):
    """Interface to a receiver of events. One thread calls it, with events in their order.

    Attributes
    ----------
    kind : str
        As in the configuration.
    name : str
        Name under which the store records deliveries, so it must stay the same from run to run; never with a secret
        in it.
    dropped : int
        Events that the receiver refuses for good and that were given up, so that later ones follow; counted as
        delivered. Only where the settings of a sink say ``drop_refused``.

    Notes
    -----
    Events are delivered at least once: those of a call that raised, or whose success could not be noted before the
    process ended, come again. The pair (plant, number) of an event lets the receiver drop the second.
    """

    kind: ClassVar[str]
    name: str
    dropped: int = 0

    @abstractmethod
    def deliver(self, events: Sequence[Event]) -> int:
        """Deliver events, oldest first, and return the number delivered: those after them come again.

        Raises :class:`DeliveryError` where not even the first could be, within a time that the sink bounds.
        """

    def close(self) -> None:  # noqa: B027 (most have nothing to leave)
        """Disconnect; from any thread, even during a delivery, which then fails."""


class OneByOne(Sink):
    """A sink that sends events one after another.

    Attributes
    ----------
    drop_refused : bool
        Whether an event that the receiver refuses for good is given up.
    """

    drop_refused: bool = False

    @abstractmethod
    def send(self, event: Event) -> None:
        """Send an event; raise :class:`RefusedError` or another :class:`DeliveryError` if it was not taken."""

    def deliver(self, events: Sequence[Event]) -> int:
        """Send events one after another, and return the number delivered.

        Raises
        ------
        DeliveryError
            If the receiver did not take the first one.
        """
        over = time.monotonic() + LONGEST_CALL
        for k, event in enumerate(events):
            if k and time.monotonic() > over:
                return k
            try:
                self.send(event)
            except DeliveryError as error:
                if isinstance(error, RefusedError) and self.drop_refused:
                    self.dropped += 1
                elif k:
                    return k
                else:
                    raise
        return len(events)


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
        until = time.monotonic() + seconds
        while self.position < place and self._thread.is_alive() and time.monotonic() < until:
            self._thread.join(0.05)
        return self.position >= place

    def _work(self) -> None:
        backoff = Backoff()
        while not self._stopping.is_set():
            try:
                if self._deliver():
                    backoff.reset()
                continue
            except (DeliveryError, StoreAwayError) as error:
                text = str(error)
                if self.health.good:
                    _LOG.warning("sink %s: %s", self.sink.name, text)
            except StoreError as error:
                self.health = Health(False, str(error))
                _LOG.error("sink %s: %s", self.sink.name, error)
                return
            except Exception as error:  # a defect of a sink must not end its deliveries in silence
                text = f"{type(error).__name__}: {error}"
                _LOG.exception("sink %s", self.sink.name)
            self.failures += 1
            self.health = Health(False, f"{text}; trying again")
            if backoff.wait(self._stopping):
                return

    def _deliver(self) -> bool:
        """Deliver some events; return whether there were any."""
        events = self._store.events(self.position, _AT_ONCE) if self._wait(self.position, 1.0) else []
        done = self.sink.deliver(events) if events else 0
        if done:
            self.position = events[done - 1].place
            self._store.delivered(self.sink.name, self.position)
            self.delivered += done
            if not self.health.good:
                _LOG.info("sink %s delivers again", self.sink.name)
            self.health = Health(True, "delivers")
        return done > 0


__all__ = ["LONGEST_CALL", "Delivery", "DeliveryError", "OneByOne", "RefusedError", "Sink"]
