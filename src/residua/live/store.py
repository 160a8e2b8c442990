"""Interface of stores, in which a run commits its results in one transaction, and from which it continues."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from residua.errors import ResiduaError
from residua.live.events import Event
from residua.live.watched_plant import WatchedPlant


class StoreAwayError(ResiduaError, OSError):
    """The store cannot be reached now: the operation is tried again later. The text has no secret in it."""


class StoreError(ResiduaError, OSError):
    """The store cannot be used: it is full, damaged, or not a store of this kind; the message names a remedy."""


@dataclass(frozen=True, slots=True)
class PlantUpdate:
    """Update of a plant in the store; ``None`` leaves a value unchanged.

    Attributes
    ----------
    key : int
    plant, model, record : str
    running, anchor, mark : bytes or None
        With the rows that they belong to, ``running_at``, ``anchor_at``, ``mark_at``.
    """

    key: int
    plant: str
    model: str
    record: str
    running: bytes | None = None
    running_at: int | None = None
    anchor: bytes | None = None
    anchor_at: int | None = None
    mark: bytes | None = None
    mark_at: int | None = None

    def values(self) -> tuple[object, ...]:
        """Return the columns in their order."""
        states = (self.running, self.running_at, self.anchor, self.anchor_at, self.mark, self.mark_at)
        return (self.key, self.plant, self.model, self.record, *states)


@dataclass(slots=True)
class Changes:
    """Changes written by one transaction; writing them twice has the same effect.

    Attributes
    ----------
    rows : list of (key, first, bytes)
        Rows of plants from a row number on, see :func:`rows_to_bytes`.
    plants : dict of int to PlantUpdate
    forgotten : dict of int to int
        By key the row before which rows are dropped.
    events : list of Event
    meta : dict of str to str
    """

    rows: list[tuple[int, int, bytes]] = field(default_factory=list)
    plants: dict[int, PlantUpdate] = field(default_factory=dict)
    forgotten: dict[int, int] = field(default_factory=dict)
    events: list[Event] = field(default_factory=list)
    meta: dict[str, str] = field(default_factory=dict)

    def __bool__(self) -> bool:
        return bool(self.rows or self.plants or self.forgotten or self.events or self.meta)


class Store(ABC):
    """Interface to a store that keeps everything a run must not lose. Every method may be called from any thread.

    Methods raise :class:`StoreAwayError` where the same may go through later, and :class:`StoreError` where it will
    not.
    """

    @abstractmethod
    def open(self, *, own: bool = True) -> None:
        """Open the store, or create it; only one run at a time has it as its ``own``."""

    @abstractmethod
    def close(self) -> None:
        """Close it."""

    @abstractmethod
    def meta(self) -> Mapping[str, str]:
        """Return facts about the whole: the fingerprints of monitors."""

    @abstractmethod
    def plants(self) -> list[tuple[WatchedPlant, str, bytes | None]]:
        """Return all plants with their records and running states, which the caller takes over."""

    @abstractmethod
    def rows(self, key: int, first: int = 0) -> list[tuple[int, bytes]]:
        """Return the stored rows of a plant, from the block that holds row ``first`` on, in order."""

    @abstractmethod
    def commit(self, changes: Changes) -> None:
        """Write changes in one transaction; when this returns, they survive a kill and a power cut."""

    @abstractmethod
    def events(self, after: int, limit: int, plant: str | None = None) -> list[Event]:
        """Return events after a place in the order of all, the oldest first."""

    @abstractmethod
    def last_events(self, plant: str, limit: int) -> list[Event]:
        """Return the last events of a plant, the oldest first."""

    @abstractmethod
    def last_place(self) -> int:
        """Return the place of the last event; 0 without any."""

    @abstractmethod
    def position(self, sink: str) -> int:
        """Return the place of the last event that a sink has delivered."""

    @abstractmethod
    def delivered(self, sink: str, place: int) -> None:
        """Record that a sink has delivered everything up to a place."""

    @abstractmethod
    def drop_events(self, before: int) -> None:
        """Drop events before a place that all sinks have delivered."""


def rows_to_bytes(times: NDArray[np.float64], values: NDArray[np.float64]) -> bytes:
    """Return rows as bytes: the time and the channels of each, little-endian."""
    whole = np.empty((len(times), 1 + values.shape[1]), dtype="<f8")
    whole[:, 0], whole[:, 1:] = times, values
    return whole.tobytes()


def rows_from_bytes(
    parts: Sequence[tuple[int, bytes]], channels: int, first: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return times and values of the rows from a number on."""
    whole = np.frombuffer(b"".join(content for _, content in parts), dtype="<f8").reshape(-1, channels + 1)
    whole = whole[first - parts[0][0] :] if parts else whole
    return np.ascontiguousarray(whole[:, 0]), np.ascontiguousarray(whole[:, 1:])


__all__ = [
    "Changes",
    "PlantUpdate",
    "Store",
    "StoreAwayError",
    "StoreError",
    "rows_from_bytes",
    "rows_to_bytes",
]
