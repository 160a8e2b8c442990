"""A store in a PostgreSQL database."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, ClassVar

from residua.errors import SettingError, missing_extra
from residua.live.config import StoreSettings
from residua.live.secrets import secret
from residua.live.store import Changes, Store, StoreAwayError, StoreError

try:
    import psycopg
except ImportError as error:
    raise missing_extra("psycopg", "postgresql") from error

#: The number of the lock that the run holds, for as long as its connection lives.
_LOCK = 7_236_845_112
#: Seconds for a server to notice that a run which has just ended is gone, and between two attempts.
_LONGEST_WAIT, _PAUSE = 3.0, 0.05
#: Seconds, and milliseconds, after which a host that does not answer is away.
_LIMITS: dict[str, Any] = {
    **{"connect_timeout": 10, "tcp_user_timeout": 20_000},
    **{"keepalives": 1, "keepalives_idle": 10, "keepalives_interval": 5, "keepalives_count": 3},
}
#: Temporary errors of a server, by their classes of SQLSTATE; a full disk is none.
_TEMPORARY = ("08", "40", "57", "53")
_FULL = "53100"


class PostgresqlStore(Store):
    """A store in tables of a database, owned by one run at a time.

    A commit is as safe as the server makes it (``synchronous_commit`` on, as it is by default). While the server is
    away the run waits; its changes are written again, with the same effect.

    Parameters
    ----------
    dsn : str
        The connection string; it is never shown.
    """

    types: ClassVar = {"bytes": "BYTEA", "real": "DOUBLE PRECISION", "without_rowid": ""}
    placeholder = "%s"

    def __init__(self, dsn: str) -> None:
        super().__init__()
        self._dsn = dsn
        self._guard_of_owner = threading.Lock()
        self._epoch = ""

    @classmethod
    def of(cls, settings: StoreSettings) -> PostgresqlStore:
        """Return the store of some settings.

        Raises
        ------
        SettingError
            If the connection string cannot be read.
        """
        dsn = secret(settings, "dsn")
        if dsn is None:
            raise SettingError("dsn_file or dsn_env: where the database is")
        return cls(dsn)

    def open(self, *, own: bool = True) -> None:
        """Connect, and create the tables if they are absent; a new epoch tells earlier owners that they are none."""
        super().open(own=own)
        if own:
            epoch = str(int(self.meta().get("epoch", "0")) + 1)
            self.commit(Changes(meta={"epoch": epoch}))
            self._epoch = epoch

    def _connect(self) -> psycopg.Connection[Any]:
        """Connect, with time limits on each step and later query."""
        return psycopg.connect(self._dsn, autocommit=True, **_LIMITS)

    def _owned(self) -> psycopg.Connection[Any]:
        """Return a connection with the lock of the owner; a run that was restarted at once waits for the old one's."""
        connection, until = self._connect(), time.monotonic() + _LONGEST_WAIT
        while not _locks(connection):
            if time.monotonic() > until:
                connection.close()
                raise StoreError("another run uses this database: stop it, or name another one")
            time.sleep(_PAUSE)
        return connection

    def _take_lock_again(self) -> None:
        """Take the lock of the owner again, if the connection that held it was lost."""
        try:
            self._owner.execute("SELECT 1")
        except psycopg.Error:
            self._owner.close()
            connection = self._connect()
            if not _locks(connection):
                connection.close()
                raise StoreAwayError("the database still holds the lock of a connection that was lost") from None
            self._owner = connection

    @contextmanager
    def _errors(self) -> Iterator[None]:
        """Classify errors as temporary or permanent; never with the connection string."""
        try:
            yield
        except psycopg.Error as error:
            state = error.sqlstate or ""
            fatal = str(error).rpartition("FATAL:")  # of the server; other texts may have the connection string in them
            reason = (error.diag.message_primary or (fatal[2] if fatal[1] else "")).strip()
            lost = isinstance(error, (psycopg.OperationalError, psycopg.InterfaceError))
            if state == _FULL or not (lost or state[:2] in _TEMPORARY):
                raise StoreError(f"the database refuses: {reason or type(error).__name__}") from None
            connection = getattr(self._local, "connection", None)
            if connection is not None and not state:
                connection.close()  # its state is not to be trusted
            raise StoreAwayError(f"the database cannot be reached: {reason or 'no answer'}") from None

    @contextmanager
    def _transaction(self) -> Iterator[Any]:
        if self._owner is not None:
            with self._guard_of_owner:
                self._take_lock_again()
        connection = self._connection()
        with connection.transaction(), connection.cursor() as cursor:
            yield cursor

    def _check_owner(self, cursor: Any) -> None:
        """Raise if another run has taken the database over since, which makes the knowledge of this one old."""
        if self._epoch:
            row = cursor.execute("SELECT value FROM meta WHERE name = 'epoch' FOR SHARE").fetchone()
            if row is None or row[0] != self._epoch:
                raise StoreError("another run has taken this database over meanwhile: this one ends")


def _locks(connection: psycopg.Connection[Any]) -> bool:
    row = connection.execute("SELECT pg_try_advisory_lock(%s)", (_LOCK,)).fetchone()
    return row is not None and bool(row[0])


__all__ = ["PostgresqlStore"]
