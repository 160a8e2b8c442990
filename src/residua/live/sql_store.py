"""A store in tables: common parts of SQLite and PostgreSQL."""

from __future__ import annotations

import json
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Any

from residua.files import other_version
from residua.live.events import Event
from residua.live.store import Changes, Store, StoreError
from residua.live.watched_plant import WatchedPlant

#: The version of the tables.
SCHEMA = 1
#: Rows of the tables that are dropped at once at most, so that no transaction is long.
_AT_ONCE = 10_000

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
_COLUMNS = ("running", "running_at", "anchor", "anchor_at", "mark", "mark_at")
_PLANT = (
    f"INSERT INTO plants (number, plant, model, record, {', '.join(_COLUMNS)}) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?) "
    "ON CONFLICT (number) DO UPDATE SET record = excluded.record, model = excluded.model, "
    + ", ".join(f"{name} = COALESCE(excluded.{name}, plants.{name})" for name in _COLUMNS)
)
_SAMPLES = (
    "INSERT INTO samples (number, first, content) VALUES (?, ?, ?) "
    "ON CONFLICT (number, first) DO UPDATE SET content = excluded.content"
)
_EVENT = (
    "INSERT INTO events (place, plant, number, kind, time, clock, content) VALUES (?, ?, ?, ?, ?, ?, ?) "
    "ON CONFLICT (place) DO NOTHING"
)
#: Writes a fact about the whole.
META = "INSERT INTO meta (name, value) VALUES (?, ?) ON CONFLICT (name) DO UPDATE SET value = excluded.value"
_POSITION = (
    "INSERT INTO sinks (name, position) VALUES (?, ?) ON CONFLICT (name) DO UPDATE SET position = excluded.position"
)


class SqlStore(Store):
    """A store in tables. Subclasses define the connection to a database, and the meaning of its errors."""

    @abstractmethod
    def _transaction(self) -> AbstractContextManager[Any]:
        """Return a transaction of this thread: a cursor-like object with ``execute`` and ``executemany``."""

    @abstractmethod
    def _query(self, text: str, values: Sequence[Any] = ()) -> list[Any]:
        """Return the rows of a query."""

    def _check_owner(self, cursor: Any) -> None:
        """Raise if another run owns the store now; never if the lock of a run cannot be lost."""

    @staticmethod
    def _worded(text: str) -> str:
        """Return a statement with the placeholders of the database."""
        return text

    def meta(self) -> Mapping[str, str]:
        """Return facts about the whole."""
        return dict(self._query("SELECT name, value FROM meta"))

    def plants(self) -> list[tuple[WatchedPlant, str, bytes | None]]:
        """Return all plants."""
        out = []
        names = ("number", "plant", "model", "record", *_COLUMNS)
        for row in self._query(f"SELECT {', '.join(names)} FROM plants ORDER BY number"):
            key, plant, model, record, running, running_at, anchor, anchor_at, mark, mark_at = row
            one = WatchedPlant(int(key), plant, model)
            one.running_at = running_at or 0
            one.anchor, one.anchor_at = (None if anchor is None else bytes(anchor)), anchor_at or 0
            one.mark, one.mark_at = (None if mark is None else bytes(mark)), mark_at or 0
            out.append((one, record, None if running is None else bytes(running)))
        return out

    def rows(self, key: int, first: int = 0) -> list[tuple[int, bytes]]:
        """Return the rows of a plant from a number on."""
        text = (
            "SELECT first, content FROM samples WHERE number = ? AND first >= COALESCE((SELECT MAX(first) FROM samples "
            "WHERE number = ? AND first <= ?), 0) ORDER BY first"
        )
        return [(int(row[0]), bytes(row[1])) for row in self._query(text, (key, key, first))]

    def commit(self, changes: Changes) -> None:
        """Write changes in one transaction."""
        with self._transaction() as cursor:
            self._check_owner(cursor)
            if changes.plants:
                cursor.executemany(self._worded(_PLANT), [one.values() for one in changes.plants.values()])
            if changes.rows:
                cursor.executemany(self._worded(_SAMPLES), changes.rows)
            if changes.forgotten:
                text = self._worded("DELETE FROM samples WHERE number = ? AND first < ?")
                cursor.executemany(text, list(changes.forgotten.items()))
            if changes.events:
                cursor.executemany(self._worded(_EVENT), [_event_out(one) for one in changes.events])
            if changes.meta:
                cursor.executemany(self._worded(META), list(changes.meta.items()))

    def events(self, after: int, limit: int, plant: str | None = None) -> list[Event]:
        """Return events after a place."""
        which, values = (" AND plant = ?", (after, plant, limit)) if plant is not None else ("", (after, limit))
        text = f"SELECT place, plant, number, kind, time, clock, content FROM events WHERE place > ?{which}"
        return [_event_in(row) for row in self._query(f"{text} ORDER BY place LIMIT ?", values)]

    def last_events(self, plant: str, limit: int) -> list[Event]:
        """Return the last events of a plant."""
        text = "SELECT place, plant, number, kind, time, clock, content FROM events WHERE plant = ?"
        return [_event_in(row) for row in self._query(f"{text} ORDER BY place DESC LIMIT ?", (plant, limit))][::-1]

    def last_place(self) -> int:
        """Return the place of the last event."""
        return max(
            int(self._query("SELECT COALESCE(MAX(place), 0) FROM events")[0][0]),
            int(self.meta().get("dropped", "0")),
        )

    def position(self, sink: str) -> int:
        """Return the place of the last event that a sink has delivered."""
        rows = self._query("SELECT position FROM sinks WHERE name = ?", (sink,))
        return int(rows[0][0]) if rows else 0

    def delivered(self, sink: str, place: int) -> None:
        """Record that a sink has delivered everything up to a place."""
        with self._transaction() as cursor:
            cursor.execute(self._worded(_POSITION), (sink, place))

    def drop_events(self, before: int) -> None:
        """Drop events before a place."""
        last = self.last_place()
        with self._transaction() as cursor:
            cursor.execute(self._worded(META), ("dropped", str(last)))
            cursor.execute(self._worded("DELETE FROM events WHERE place < ?"), (before,))

    def _check_schema(self) -> None:
        """Write the version of the tables, or raise if theirs differs."""
        known = self.meta().get("schema")
        if known is None:
            with self._transaction() as cursor:
                cursor.execute(self._worded(META), ("schema", str(SCHEMA)))
        elif known != str(SCHEMA):
            found = int(known) if known.isdecimal() else known
            raise StoreError(other_version("the store", found, SCHEMA, "name another store"))


def _event_out(one: Event) -> tuple[Any, ...]:
    content = json.dumps(dict(one.content), allow_nan=False)
    return one.place, one.plant, one.number, one.kind, one.time, one.clock, content


def _event_in(row: Any) -> Event:
    place, plant, number, kind, time, clock, content = row
    return Event(int(place), plant, int(number), kind, float(time), clock, json.loads(content))


__all__ = ["META", "SCHEMA", "TABLES", "SqlStore"]
