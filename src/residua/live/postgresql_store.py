"""A store in a PostgreSQL database."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from residua.errors import SettingError, missing_extra
from residua.live.config import StoreSettings
from residua.live.secrets import secret
from residua.live.sql_store import META, TABLES, SqlStore
from residua.live.store import Changes, StoreAwayError, StoreError

try:
    import psycopg
except ImportError as error:
    raise missing_extra("psycopg", "postgresql") from error

#: The number of the lock that the run holds, for as long as its connection lives.
_LOCK = 7_236_845_112
#: Seconds for a server to see that a run which has just ended is gone, and between two questions.
_PATIENCE, _PAUSE = 3.0, 0.05
#: Seconds, and milliseconds, after which a host that does not answer is away.
_LIMITS: dict[str, Any] = {
    **{"connect_timeout": 10, "tcp_user_timeout": 20_000},
    **{"keepalives": 1, "keepalives_idle": 10, "keepalives_interval": 5, "keepalives_count": 3},
}
#: Temporary errors of a server, by their classes of SQLSTATE.
_PASSING = ("08", "40", "57", "53")
_FULL = "53100"


class PostgresqlStore(SqlStore):
    """A store in tables of a database, owned by one run at a time.

    A commit is as safe as the server makes it (``synchronous_commit`` on, as it is by default). While the server is
    away the run waits; its changes are written again, with the same effect.

    Parameters
    ----------
    dsn : str
        The connection string; it is never shown.
    """

    def __init__(self, dsn: str) -> None:
        self._dsn = dsn
        self._local = threading.local()
        self._all: list[psycopg.Connection[Any]] = []
        self._guard, self._guard_of_owner = threading.Lock(), threading.Lock()
        self._owner: psycopg.Connection[Any] | None = None
        self._epoch = 0

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
        """Connect, and create the tables if they are absent."""
        with self._errors():
            if own:
                self._take()
            with self._connection().transaction():
                for text in TABLES:
                    self._connection().execute(text.format(bytes="BYTEA", real="DOUBLE PRECISION", without_rowid=""))
        self._check_schema()
        if own:
            self._epoch = int(self.meta().get("epoch", "0")) + 1
            with self._transaction() as cursor:
                cursor.execute(self._worded(META), ("epoch", str(self._epoch)))

    def _connect(self) -> psycopg.Connection[Any]:
        """Connect, with time limits on each step and later query."""
        return psycopg.connect(self._dsn, autocommit=True, **_LIMITS)

    def _take(self, *, again: bool = False) -> None:
        """Take the lock of the owner; ``again``: after the server has dropped a lost connection."""
        connection = self._connect()
        until = time.monotonic() + _PATIENCE
        while not self._takes(connection):
            if again or time.monotonic() > until:
                connection.close()
                if again:
                    raise StoreAwayError("the database still holds the lock of a connection that was lost")
                raise StoreError("another run uses this database: stop it, or name another one")
            time.sleep(_PAUSE)  # a run that was started again at once finds the lock of the one before
        self._owner = connection

    @staticmethod
    def _takes(connection: psycopg.Connection[Any]) -> bool:
        row = connection.execute("SELECT pg_try_advisory_lock(%s)", (_LOCK,)).fetchone()
        return row is not None and bool(row[0])

    def _check_owned(self) -> None:
        """Take the lock again, if the connection that held it was lost."""
        owner = self._owner
        if owner is None:
            return
        try:
            owner.execute("SELECT 1")
        except psycopg.Error:
            owner.close()
            self._take(again=True)

    def close(self) -> None:
        """Close all connections."""
        with self._guard:
            for connection in (*self._all, *([self._owner] if self._owner else [])):
                connection.close()
            self._all, self._owner = [], None
            self._local = threading.local()

    def _connection(self) -> psycopg.Connection[Any]:
        connection = getattr(self._local, "connection", None)
        if connection is None or connection.closed:
            connection = self._connect()
            self._local.connection = connection
            with self._guard:
                self._all = [one for one in self._all if not one.closed]
                self._all.append(connection)
        return connection

    @contextmanager
    def _errors(self) -> Iterator[None]:
        """Classify errors as temporary or permanent; never with the connection string."""
        try:
            yield
        except psycopg.Error as error:
            state = error.sqlstate or ""
            fatal = str(error).rpartition("FATAL:")  # of the server; other texts may have the connection string in them
            said = (error.diag.message_primary or (fatal[2] if fatal[1] else "")).strip()
            passes = isinstance(error, (psycopg.OperationalError, psycopg.InterfaceError)) or state[:2] in _PASSING
            if state == _FULL or not passes:
                raise StoreError(f"the database refuses: {said or type(error).__name__}") from None
            connection = getattr(self._local, "connection", None)
            if connection is not None and not state:
                connection.close()  # its state is not to be trusted
            raise StoreAwayError(f"the database cannot be reached: {said or 'no answer'}") from None

    def commit(self, changes: Changes) -> None:
        """Write changes in one transaction, as the run that owns the database."""
        with self._errors(), self._guard_of_owner:
            self._check_owned()
        super().commit(changes)

    def _check_owner(self, cursor: Any) -> None:
        """Raise if another run has taken the database over since, which makes the knowledge of this one old."""
        if self._owner is None:
            return
        row = cursor.execute("SELECT value FROM meta WHERE name = 'epoch' FOR SHARE").fetchone()
        if row is None or row[0] != str(self._epoch):
            raise StoreError("another run has taken this database over meanwhile: this one ends")

    @contextmanager
    def _transaction(self) -> Iterator[Any]:
        with self._errors(), self._connection().transaction(), self._connection().cursor() as cursor:
            yield cursor

    def _query(self, text: str, values: Sequence[Any] = ()) -> list[Any]:
        with self._errors():
            return self._connection().execute(self._worded(text).encode(), values).fetchall()

    @staticmethod
    def _worded(text: str) -> str:
        """Return a statement with the placeholders of psycopg."""
        return text.replace("?", "%s")


__all__ = ["PostgresqlStore"]
