"""A store in one SQLite file, with a write-ahead log: the default."""

from __future__ import annotations

import sqlite3
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import ClassVar

from residua.files import check_output
from residua.live.store import Store, StoreAwayError, StoreError

#: Seconds for which a writer waits for another one.
_BUSY = 30.0
#: Pages of the log, of 4 kB, from which on it is copied into the file: several of the largest transactions.
_LOG_PAGES = 4000


class SqliteStore(Store):
    """A store in one file, with two more beside it while it is open.

    A commit is on the disk when it returns (``synchronous=FULL``). One run at a time has the file.

    Parameters
    ----------
    path : str or Path
        Made if absent; its folder must exist.

    Raises
    ------
    StoreError
        When it is opened: if the file is not a store, another run has it, or the folder does not exist.
    """

    types: ClassVar = {"bytes": "BLOB", "real": "REAL", "without_rowid": " WITHOUT ROWID"}

    def __init__(self, path: str | Path) -> None:
        super().__init__()
        self.path = Path(path)
        self._writing = threading.Lock()

    def open(self, *, own: bool = True) -> None:
        """Open the file, or create it."""
        try:
            check_output(self.path)
        except ValueError as error:
            raise StoreError(str(error)) from error
        super().open(own=own)

    def _owned(self) -> sqlite3.Connection:
        """Return the lock of the owner: on a separate file, released when the process is killed."""
        lock = sqlite3.connect(f"{self.path}.lock", timeout=0.0, isolation_level=None, check_same_thread=False)
        try:
            lock.execute("BEGIN EXCLUSIVE")
        except sqlite3.OperationalError as error:
            lock.close()
            raise StoreError(f"{self.path}: another run uses this store: stop it, or name another file") from error
        return lock

    def _connect(self) -> sqlite3.Connection:
        connection = sqlite3.connect(self.path, timeout=_BUSY, isolation_level=None, check_same_thread=False)
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("PRAGMA synchronous = FULL")
        connection.execute(f"PRAGMA wal_autocheckpoint = {_LOG_PAGES}")
        return connection

    @contextmanager
    def _errors(self) -> Iterator[None]:
        """Classify errors as temporary or permanent."""
        try:
            yield
        except sqlite3.OperationalError as error:
            text = str(error)
            if "locked" in text or "busy" in text:
                raise StoreAwayError(f"{self.path}: {text}") from error
            if "full" in text:
                raise StoreError(f"{self.path}: no space is left on the disk: make room, then start again") from error
            raise StoreError(f"{self.path}: {text}") from error
        except sqlite3.Error as error:
            raise StoreError(f"{self.path}: this is not a store of residua, or it is damaged: {error}") from error

    @contextmanager
    def _transaction(self) -> Iterator[sqlite3.Cursor]:
        with self._writing, self._connection() as connection:  # commits at the end, or rolls back
            yield connection.execute("BEGIN IMMEDIATE")


__all__ = ["SqliteStore"]
