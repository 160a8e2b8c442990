"""A store keeps what was committed, all of it or none, and belongs to one run at a time."""

from __future__ import annotations

import sqlite3
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import pytest

from residua.live.records import rows_from_bytes
from residua.live.sqlite_store import SqliteStore
from residua.live.store import Changes, PlantUpdate, Store, StoreAwayError, StoreError
from residua.live.watched_plant import WatchedPlant
from store_writer import changes
from stores import STORES, Database, made_store


@pytest.fixture(params=STORES)
def store(request: pytest.FixtureRequest, tmp_path: Path):
    with made_store(request.param, tmp_path) as one:
        yield one


def test_what_is_committed_is_there_and_twice_leaves_the_same(store: Store) -> None:
    for _ in range(2):
        store.commit(changes())
    store.commit(changes(first=3, place=2))
    (plant, record, running), *more = store.plants()
    assert not more
    assert (plant.key, plant.plant, running) == (1, "p1", None)
    plant.take_record(record, 5.0)
    assert plant.count == 6
    times, values = rows_from_bytes(store.rows(1, 4), 2, 4)
    assert times.tolist() == [4.0, 5.0]
    assert values[0].tolist() == [3.0, 3.0]
    assert [one.place for one in store.events(0, 10)] == [1, 2]
    assert store.events(1, 10) == store.last_events("p1", 1)
    assert store.events(0, 10, "p2") == []
    assert store.events(0, 1)[0].content == {"name": "leak", "candidates": [1, None]}
    assert store.meta()["a"] == "b"
    assert store.last_place() == 2


def test_states_that_are_not_given_stay(store: Store) -> None:
    record = WatchedPlant(1, "p", "m").to_record()
    update = PlantUpdate(1, "p", "m", record, b"run", 4, b"anchor", 2, b"mark", 3)
    store.commit(Changes(plants={1: update}))
    store.commit(Changes(plants={1: PlantUpdate(1, "p", "m", record, running=b"later", running_at=9)}))
    (plant, _, running), *_ = store.plants()
    assert running == b"later"
    assert (plant.running_at, plant.anchor, plant.anchor_at, plant.mark, plant.mark_at) == (9, b"anchor", 2, b"mark", 3)


def test_rows_and_events_are_dropped_but_no_place_comes_again(store: Store) -> None:
    for k in range(10):
        store.commit(changes(first=3 * k, place=k + 1))
    store.commit(Changes(forgotten={1: 12}))
    assert store.rows(1)[0][0] == 12
    store.drop_events(11)
    assert store.events(0, 10) == []
    assert store.last_place() == 10


def test_positions_of_sinks(store: Store) -> None:
    assert store.position("x") == 0
    store.delivered("x", 7)
    store.delivered("x", 9)
    assert store.position("x") == 9


def test_another_thread_reads_and_notes_while_one_writes(store: Store) -> None:
    errors: list[BaseException] = []

    def note() -> None:
        try:
            for k in range(50):
                store.delivered("x", k)
                store.events(0, 5)
        except BaseException as error:
            errors.append(error)

    thread = threading.Thread(target=note)
    thread.start()
    for k in range(50):
        store.commit(changes(first=3 * k, place=k + 1))
    thread.join()
    assert not errors
    assert store.position("x") == 49


def test_one_run_at_a_time(store: Store) -> None:
    other = store.again()  # type: ignore[attr-defined]
    with pytest.raises(StoreError, match="another run uses"):
        other.open()
    other.close()
    beside = store.again()  # type: ignore[attr-defined]
    beside.open(own=False)
    beside.commit(Changes(meta={"reset p": "asked"}))
    assert store.meta()["reset p"] == "asked"
    beside.close()


# ------------------------------------------------------------------------------ SQLite alone


def test_a_file_that_is_no_store(tmp_path: Path) -> None:
    path = tmp_path / "x.db"
    path.write_bytes(b"no database at all, but long enough to be looked at" * 100)
    with pytest.raises(StoreError, match="not a store of residua"):
        SqliteStore(path).open()
    with pytest.raises(StoreError, match="does not exist"):
        SqliteStore(tmp_path / "absent" / "x.db").open()


def test_a_store_that_was_busy_opens_later(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("residua.live.sqlite_store._BUSY", 0.05)
    SqliteStore(tmp_path / "x.db").open(own=False)
    other = sqlite3.connect(tmp_path / "x.db", isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    store = SqliteStore(tmp_path / "x.db")
    with pytest.raises(StoreAwayError, match="locked"):
        store.open()
    other.execute("ROLLBACK")
    other.close()
    store.open()  # its own lock of the first time is free
    store.close()


def test_tables_of_another_version(tmp_path: Path) -> None:
    store = SqliteStore(tmp_path / "x.db")
    store.open()
    store.commit(Changes(meta={"schema": "99"}))
    store.close()
    with pytest.raises(StoreError, match=r"version 99, .*: upgrade residua"):
        SqliteStore(tmp_path / "x.db").open()


def test_a_full_disk_commits_nothing(tmp_path: Path) -> None:
    store = SqliteStore(tmp_path / "x.db")
    store.open()
    store.commit(changes())
    pages = store._query("PRAGMA page_count")[0][0]
    store._query(f"PRAGMA max_page_count = {pages}")
    with pytest.raises(StoreError, match="no space is left"):
        store.commit(changes(first=3, count=100_000, place=2))
    assert store.last_place() == 1
    assert len(store.rows(1)) == 1
    store.close()


def test_a_kill_leaves_whole_transactions(tmp_path: Path) -> None:
    path, last = tmp_path / "x.db", 0
    for pause in (0.3, 0.17, 0.41):
        with subprocess.Popen(
            [sys.executable, str(Path(__file__).parent.parent / "store_writer.py"), str(path)]
        ) as writer:
            try:
                while not _places(path) > last and writer.poll() is None:
                    time.sleep(0.02)
                time.sleep(pause)
                assert writer.poll() is None
            finally:
                writer.kill()
        store = SqliteStore(path)
        store.open()
        places = [one.place for one in store.events(0, 10**6)]
        assert places == list(range(1, len(places) + 1))
        assert [first for first, _ in store.rows(1)] == [3 * k for k in range(len(places))]
        assert len(places) > last
        last = len(places)
        store.close()


def _places(path: Path) -> int:
    if not path.exists():
        return 0
    connection = sqlite3.connect(path)
    try:
        return connection.execute("SELECT COUNT(*) FROM events").fetchone()[0]
    except sqlite3.OperationalError:
        return 0
    finally:
        connection.close()


@pytest.fixture
def database() -> Iterator[Database]:
    one = Database()
    one.start()
    try:
        yield one
    finally:
        one.stop()


def postgresql(database: Database) -> Store:
    return import_module("residua.live.postgresql_store").PostgresqlStore(database.dsn)


def test_a_database_that_comes_back_goes_on_and_is_still_owned(database: Database) -> None:
    store = postgresql(database)
    store.open()
    store.commit(changes())
    database.kill()
    with pytest.raises(StoreAwayError, match="cannot be reached"):
        store.commit(changes(first=3, place=2))
    database.start()
    for _ in range(100):
        try:
            store.commit(changes(first=3, place=2))
            break
        except StoreAwayError:
            time.sleep(0.1)
    assert store.last_place() == 2
    other = postgresql(database)
    with pytest.raises(StoreError, match="another run uses"):
        other.open()
    other.close()
    store.close()
    with pytest.raises(StoreAwayError) as error:
        type(store)("host=/nowhere user=residua password=hidden dbname=x").open()
    assert "hidden" not in str(error.value)


def test_a_run_waits_for_the_end_of_the_one_before_it(database: Database) -> None:
    first, second = postgresql(database), postgresql(database)
    try:
        first.open()
        ending = threading.Timer(0.5, first.close)  # a server needs a while to see that a client has gone
        ending.start()
        second.open()
        ending.join()
        second.commit(changes())
    finally:
        first.close()
        second.close()


def test_a_run_whose_database_another_has_taken_over_ends(database: Database) -> None:
    first, second = postgresql(database), postgresql(database)
    first.open()
    first.commit(changes())
    first._owner.close()  # lost, as by a server that was started again
    second.open()
    second.commit(changes(first=3, place=2))
    second.close()
    with pytest.raises(StoreError, match="another run has taken this database over"):
        first.commit(changes(first=3, place=2))
    with pytest.raises(StoreError, match="another run has taken this database over"):
        first.delivered("x", 2)  # nor does it write anything else
    first.close()
