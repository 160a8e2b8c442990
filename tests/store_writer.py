"""Writes to a store until it is killed: ``python store_writer.py FILE``."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from residua.live.events import Event
from residua.live.records import rows_to_bytes
from residua.live.sqlite_store import SqliteStore
from residua.live.store import Changes, PlantUpdate
from residua.live.watched_plant import WatchedPlant


def changes(key: int = 1, first: int = 0, count: int = 3, place: int = 1) -> Changes:
    rows = rows_to_bytes(np.arange(first, first + count, dtype=float), np.full((count, 2), float(first)))
    record = WatchedPlant(key, f"p{key}", "m", count=first + count).to_record()
    event = Event(place, f"p{key}", place, "raised", 1.5, "", {"name": "leak", "candidates": [1, None]})
    return Changes([(key, first, rows)], {key: PlantUpdate(key, f"p{key}", "m", record)}, {}, [event], {"a": "b"})


def write_for_ever(path: Path) -> None:
    """Commit one small transaction after the other."""
    store = SqliteStore(path)
    store.open()
    k = store.last_place()
    while True:
        store.commit(changes(first=3 * k, place=k + 1))
        k += 1


if __name__ == "__main__":
    write_for_ever(Path(sys.argv[1]))
