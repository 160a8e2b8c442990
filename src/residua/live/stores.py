"""The store named by a configuration."""

from __future__ import annotations

from importlib import import_module

from residua.live.config import StoreSettings
from residua.live.sqlite_store import SqliteStore
from residua.live.store import Store


def store_of(settings: StoreSettings) -> Store:
    """Return the store, not yet open."""
    if settings.kind == "sqlite":
        return SqliteStore(settings.file)
    return import_module("residua.live.postgresql_store").PostgresqlStore.of(settings)


__all__ = ["store_of"]
