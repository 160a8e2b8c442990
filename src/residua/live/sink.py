"""Interface of sinks, which deliver events to their receivers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar

from residua.live.events import Event


class DeliveryError(Exception):
    """A receiver is away, or refuses an event: it is tried again later. The text is shown, and has no secret in it."""


#: Seconds after which a call of ``deliver`` begins no further event, so that the run can end.
LONGEST_CALL = 10.0


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
