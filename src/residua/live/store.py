"""The store: what a run must not lose, in the tables of a database, each change in one transaction."""

from __future__ import annotations

import json
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, ClassVar, NamedTuple, TypeVar

from residua.errors import ResiduaError
from residua.files import other_version
from residua.live.config import StoreSettings
from residua.live.events import Event
from residua.live.source import Backoff, Health, RunStoppedError
from residua.live.watched_plant import WatchedPlant

T = TypeVar("T")

#: The version of the tables.
SCHEMA = 1
TABLES = (
    "CREATE TABLE IF NOT EXISTS meta (name TEXT PRIMARY KEY, value TEXT NOT NULL)",
    "CREATE TABLE IF NOT EXISTS plants (number INTEGER PRIMARY KEY, plant TEXT NOT NULL UNIQUE, model TEXT NOT NULL, "
    "record TEXT NOT NULL, running {bytes}, running_at BIGINT, anchor {bytes}, anchor_at BIGINT, mark {bytes}, "
    "mark_at BIGINT)",
    "CREATE TABLE IF NOT EXISTS samples (number INTEGER NOT NULL, first BIGINT NOT NULL, content {bytes} NOT NULL, "
    "PRIMARY KEY (number, first)){without_rowid}",
    "CREATE TABLE IF NOT EXISTS events (place BIGINT PRIMARY KEY, plant TEXT NOT NULL, number BIGINT NOT NULL, "
    "kind TEXT NOT NULL, time {real} NOT NULL, clock TEXT NOT NULL, content TEXT NOT NULL, UNIQUE (plant, number))",
    "CREATE TABLE IF NOT EXISTS sinks (name TEXT PRIMARY KEY, position BIGINT NOT NULL)",
)
_STATES = ("running", "running_at", "anchor", "anchor_at", "mark", "mark_at")
_PLANT = (
    f"INSERT INTO plants (number, plant, model, record, {', '.join(_STATES)}) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?) "
    "ON CONFLICT (number) DO UPDATE SET record = excluded.record, model = excluded.model, "
    + ", ".join(f"{name} = COALESCE(excluded.{name}, plants.{name})" for name in _STATES)
)
_SAMPLES = (
    "INSERT INTO samples (number, first, content) VALUES (?, ?, ?) "
    "ON CONFLICT (number, first) DO UPDATE SET content = excluded.content"
)
_FORGOTTEN = "DELETE FROM samples WHERE number = ? AND first < ?"
_EVENT = (
    "INSERT INTO events (place, plant, number, kind, time, clock, content) VALUES (?, ?, ?, ?, ?, ?, ?) "
    "ON CONFLICT (place) DO NOTHING"
)
_EVENTS = "SELECT place, plant, number, kind, time, clock, content FROM events WHERE"
_META = "INSERT INTO meta (name, value) VALUES (?, ?) ON CONFLICT (name) DO UPDATE SET value = excluded.value"
_POSITION = (
    "INSERT INTO sinks (name, position) VALUES (?, ?) ON CONFLICT (name) DO UPDATE SET position = excluded.position"
)


class StoreAwayError(ResiduaError, OSError):
    """The store cannot be reached now: the operation is tried again later. The text has no secret in it."""


class StoreError(ResiduaError, OSError):
    """The store cannot be used: it is full, damaged, or not a store of this kind; the message names a remedy."""


class PlantUpdate(NamedTuple):
    """Update of a plant in the store, with its columns in their order; ``None`` leaves a value unchanged.

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


@dataclass(slots=True)
class Changes:
    """Changes written by one transaction; writing them twice has the same effect.

    Attributes
    ----------
    rows : list of (key, first, bytes)
        Rows of plants from a row number on, see :func:`residua.live.records.rows_to_bytes`.
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
    """Tables of a database that keep everything a run must not lose. Every method may be called from any thread.

    Methods raise :class:`StoreAwayError` where a retry may succeed, and :class:`StoreError` where it will not. Each
    thread has its own connection. Everything is written by :meth:`_write`, as the run that owns the store.

    Attributes
    ----------
    types : mapping of str to str
        The words of the dialect for the types in :data:`TABLES`.
    placeholder : str
        Of a value in a statement.
    """

    types: ClassVar[Mapping[str, str]]
    placeholder: ClassVar[str] = "?"

    def __init__(self) -> None:
        self._local = threading.local()
        self._connections: list[Any] = []
        self._guard = threading.Lock()
        self._owner: Any = None

    # ------------------------------------------------------------------ the database

    @abstractmethod
    def _connect(self) -> Any:
        """Return a new connection."""

    @abstractmethod
    def _owned(self) -> Any:
        """Return a connection with the lock of the owner, which ends with the connection or its process."""

    @abstractmethod
    def _errors(self) -> AbstractContextManager[None]:
        """Classify errors of the database as temporary or permanent."""

    @abstractmethod
    def _transaction(self) -> AbstractContextManager[Any]:
        """Return a transaction of this thread: a cursor, committed at the end, rolled back after an error."""

    def _check_owner(self, cursor: Any) -> None:  # noqa: B027 (a lock that cannot be lost needs no check)
        """Raise in a transaction if another run owns the store now."""

    def _connection(self) -> Any:
        connection = getattr(self._local, "connection", None)
        if connection is None or _is_closed(connection):
            connection = self._local.connection = self._connect()
            with self._guard:
                self._connections = [*(one for one in self._connections if not _is_closed(one)), connection]
        return connection

    def open(self, *, own: bool = True) -> None:
        """Open the store, or create it; only one run at a time has it as its ``own``."""
        with self._errors():
            self._owner = self._owned() if own else None
            try:
                with self._transaction() as cursor:
                    for text in TABLES:
                        cursor.execute(text.format_map(self.types))
            except BaseException:  # else the next try would find this run's own lock
                self.close()
                raise
        known = self.meta().get("schema")
        if known is None:
            self._write((_META, [("schema", str(SCHEMA))]))
        elif known != str(SCHEMA):
            found = int(known) if known.isdecimal() else known
            raise StoreError(other_version("the store", found, SCHEMA, "name another store"))

    def close(self) -> None:
        """Close all connections."""
        with self._guard:
            for connection in (*self._connections, self._owner):
                if connection is not None:
                    connection.close()
            self._connections, self._owner = [], None
            self._local = threading.local()

    def _query(self, text: str, values: Sequence[Any] = ()) -> list[Any]:
        with self._errors():
            return self._connection().execute(text.replace("?", self.placeholder), values).fetchall()

    def _write(self, *statements: tuple[str, Iterable[Sequence[Any]]]) -> None:
        """Execute statements, each for several tuples of values, in one transaction: the one way to write."""
        with self._errors(), self._transaction() as cursor:
            self._check_owner(cursor)
            for text, values in statements:
                if values:
                    cursor.executemany(text.replace("?", self.placeholder), values)

    # ------------------------------------------------------------------------ writing

    def commit(self, changes: Changes) -> None:
        """Write changes in one transaction; when this returns, they survive a kill and a power cut."""
        self._write(
            (_PLANT, list(changes.plants.values())),
            (_SAMPLES, changes.rows),
            (_FORGOTTEN, list(changes.forgotten.items())),
            (_EVENT, [_event_to_row(event) for event in changes.events]),
            (_META, list(changes.meta.items())),
        )

    def delivered(self, sink: str, place: int) -> None:
        """Record that a sink has delivered everything up to a place."""
        self._write((_POSITION, [(sink, place)]))

    def drop_events(self, before: int) -> None:
        """Drop events before a place that all sinks have delivered; their places are not given again."""
        last = self.last_place()
        self._write((_META, [("dropped", str(last))]), ("DELETE FROM events WHERE place < ?", [(before,)]))

    # ------------------------------------------------------------------------ reading

    def meta(self) -> Mapping[str, str]:
        """Return facts about the whole: the fingerprints of monitors, requests to a run."""
        return dict(self._query("SELECT name, value FROM meta"))

    def plants(self) -> list[tuple[WatchedPlant, str, bytes | None]]:
        """Return all plants with their records and running states, which the caller takes over."""
        out = []
        columns = ", ".join(("number", "plant", "model", "record", *_STATES))
        for row in self._query(f"SELECT {columns} FROM plants ORDER BY number"):
            key, plant, model, record, running, running_at, anchor, anchor_at, mark, mark_at = row
            one = WatchedPlant(int(key), plant, model, running_at=running_at or 0)
            one.anchor, one.anchor_at = _bytes(anchor), anchor_at or 0
            one.mark, one.mark_at = _bytes(mark), mark_at or 0
            out.append((one, record, _bytes(running)))
        return out

    def rows(self, key: int, first: int = 0) -> list[tuple[int, bytes]]:
        """Return the stored rows of a plant, from the block that holds row ``first`` on, in order."""
        text = (
            "SELECT first, content FROM samples WHERE number = ? AND first >= COALESCE((SELECT MAX(first) FROM samples "
            "WHERE number = ? AND first <= ?), 0) ORDER BY first"
        )
        return [(int(number), bytes(content)) for number, content in self._query(text, (key, key, first))]

    def events(self, after: int, limit: int, plant: str | None = None) -> list[Event]:
        """Return events after a place in the order of all, the oldest first."""
        of_plant, values = (" AND plant = ?", (after, plant, limit)) if plant is not None else ("", (after, limit))
        return [_event_of(row) for row in self._query(f"{_EVENTS} place > ?{of_plant} ORDER BY place LIMIT ?", values)]

    def last_events(self, plant: str, limit: int) -> list[Event]:
        """Return the last events of a plant, the oldest first."""
        rows = self._query(f"{_EVENTS} plant = ? ORDER BY place DESC LIMIT ?", (plant, limit))
        return [_event_of(row) for row in reversed(rows)]

    def last_place(self) -> int:
        """Return the place of the last event, dropped ones included; 0 without any."""
        ((last,),) = self._query("SELECT COALESCE(MAX(place), 0) FROM events")
        return max(int(last), int(self.meta().get("dropped", "0")))

    def position(self, sink: str) -> int:
        """Return the place of the last event that a sink has delivered."""
        rows = self._query("SELECT position FROM sinks WHERE name = ?", (sink,))
        return int(rows[0][0]) if rows else 0


class Retry:
    """Retry with backoff, for as long as the store is away.

    Parameters
    ----------
    stopping : threading.Event
        Set when the run is to end: there are no more retries then.

    Attributes
    ----------
    health : Health
        Of the store.
    """

    def __init__(self, stopping: threading.Event) -> None:
        self._stopping = stopping
        self.health = Health(True, "")

    def __call__(self, operation: Callable[..., T], *arguments: Any) -> T:
        """Return the result of an operation of the store.

        Raises
        ------
        RunStoppedError
            If the run is to end while the store is away: nothing was acknowledged then.
        """
        backoff = Backoff(0.1, 10.0)
        while True:
            try:
                result = operation(*arguments)
            except StoreAwayError as error:
                self.health = Health(False, f"{error}; trying again")
                if backoff.wait(self._stopping):
                    raise RunStoppedError from error
            else:
                if not self.health.good:
                    self.health = Health(True, "")
                return result


def store_of(settings: StoreSettings) -> Store:
    """Return the store of a configuration, not yet open.

    Raises
    ------
    SettingError
        If the connection string of a database cannot be read.
    """
    if settings.kind == "sqlite":
        return import_module("residua.live.sqlite_store").SqliteStore(settings.file)
    return import_module("residua.live.postgresql_store").PostgresqlStore.of(settings)


def _is_closed(connection: Any) -> bool:
    return getattr(connection, "closed", False)  # only a connection to a server is closed by anything but the store


def _event_to_row(event: Event) -> tuple[Any, ...]:
    content = json.dumps(dict(event.content), allow_nan=False)
    return event.place, event.plant, event.number, event.kind, event.time, event.clock, content


def _event_of(row: Sequence[Any]) -> Event:
    place, plant, number, kind, time, clock, content = row
    return Event(int(place), plant, int(number), kind, float(time), clock, json.loads(content))


def _bytes(content: Any) -> bytes | None:
    return None if content is None else bytes(content)


__all__ = ["Changes", "PlantUpdate", "Retry", "Store", "StoreAwayError", "StoreError", "store_of"]
