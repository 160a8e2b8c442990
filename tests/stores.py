"""Stores of every kind, for tests: SQLite in a file, and PostgreSQL where its programs are."""

from __future__ import annotations

import glob
import os
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from residua.live.sqlite_store import SqliteStore

STORES = ("sqlite", "postgresql")


def programs() -> Path:
    """Return the folder of PostgreSQL's programs; skip where there is none."""
    found = [shutil.which("initdb"), *sorted(glob.glob("/usr/lib/postgresql/*/bin/initdb"))[::-1]]
    for one in found:
        if one:
            return Path(one).resolve().parent
    pytest.skip("PostgreSQL is not installed")


class Database:
    """A server of PostgreSQL with a folder of its own, reached by a socket alone."""

    def __init__(self) -> None:
        pytest.importorskip("psycopg")
        self.programs = programs()
        self.socket = Path(tempfile.mkdtemp(prefix="residua-"))  # short enough for a socket
        self.data = self.socket / "data"
        self._user: dict[str, Any] = {}
        if os.geteuid() == 0:  # it does not run as root
            self._user = {"user": "nobody"}
            shutil.chown(self.socket, "nobody")
        self._call("initdb", "-D", self.data, "-A", "trust", "-U", "residua", "--no-sync", "-E", "UTF8")

    def _call(self, program: str, *arguments: object) -> None:
        command = [str(self.programs / program), *map(str, arguments)]
        made = subprocess.run(command, capture_output=True, text=True, cwd="/", **self._user)
        if made.returncode:
            raise RuntimeError(f"{program}: {made.stderr or made.stdout}")

    def start(self) -> None:
        """Start the server."""
        options = f"-k {self.socket} -h ''"
        self._call("pg_ctl", "-D", self.data, "-o", options, "-w", "-l", self.data / "log", "start")

    def kill(self) -> None:
        """Kill the server, as a power cut would."""
        pid = int((self.data / "postmaster.pid").read_text().splitlines()[0])
        os.kill(pid, signal.SIGQUIT)
        for _ in range(200):
            if not (self.data / "postmaster.pid").exists() or not Path(f"/proc/{pid}").exists():
                return
            time.sleep(0.05)

    def stop(self) -> None:
        """Stop the server, and remove what it had."""
        if (self.data / "postmaster.pid").exists():
            self._call("pg_ctl", "-D", self.data, "-m", "immediate", "-w", "stop")
        shutil.rmtree(self.socket, ignore_errors=True)

    @property
    def dsn(self) -> str:
        """The connection string."""
        return f"host={self.socket} user=residua dbname=postgres"


@contextmanager
def made_store(kind: str, folder: Path) -> Iterator[Any]:
    """Yield an open store of a kind; ``again`` of it makes another one on the same."""
    if kind == "sqlite":
        make = partial(SqliteStore, folder / "live.db")
        database = None
    else:
        database = Database()
        from residua.live.postgresql_store import PostgresqlStore

        database.start()
        make = partial(PostgresqlStore, database.dsn)
    store = make()
    store.again = make
    try:
        store.open()
        yield store
    finally:
        store.close()
        if database is not None:
            database.stop()
