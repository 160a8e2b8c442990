"""Whole runs of `residua live`, in this process or in one of their own, for tests."""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import residua as rs
from live_examples import alarms_of, monitor, recording
from residua.live.config import load_settings
from residua.live.run import AT_ONCE, BYTES_AT_ONCE, MOST_BYTES, MOST_MESSAGES, Run
from residua.live.source import Message, MessageQueue
from residua.live.sqlite_store import SqliteStore


def configuration(folder: Path, *tables: str, plants: Sequence[str] = ("north",), more: str = "") -> Path:
    """Write a monitor and a configuration with some tables, and return its path."""
    if not (folder / "tank.json").exists():
        monitor().save(folder / "tank.json")
    ids = ", ".join(f'"{plant}"' for plant in plants)
    path = folder / "live.toml"
    head = f'[[monitors]]\nfile = "tank.json"\nplants = [{ids}]\n{more}\n'
    store = "" if any("[store]" in one for one in tables) else '[store]\nfile = "live.db"\n'
    path.write_text("\n".join([head, store, *tables]), encoding="utf-8")
    return path


def line(plant: str, time: float, row: NDArray[np.float64], inputs: int = 2) -> str:
    """Return one row as a message."""
    values = [None if value != value else value for value in row.tolist()]
    return json.dumps({"plant": plant, "t": time, "u": values[:inputs], "y": values[inputs:]})


@contextmanager
def running(path: Path) -> Iterator[Run]:
    """A run that works in a thread, and is stopped in order."""
    run = Run(load_settings(path))
    errors: list[BaseException] = []

    def work() -> None:
        try:
            run.work()
        except BaseException as error:
            errors.append(error)

    thread = threading.Thread(target=work)
    thread.start()
    try:
        yield run
    finally:
        run.stop()
        thread.join(30)
        run.close()
    assert not thread.is_alive()
    assert not errors, errors


def alarms_in(path: Path, plant: str = "north") -> list[dict[str, Any]]:
    """Return the alarms that a store holds of a plant, those that stand included."""
    from live_examples import opened
    from residua.live.watched_model import WatchedModel

    watch = opened(path, WatchedModel("tank", rs.Monitor.load(path.parent / "tank.json")))
    changes = watch.standing()
    events = [one.to_dict() for one in watch.store.events(0, 10**6, plant)]
    if not events or events[-1]["kind"] != "standing":
        events += [one.to_dict() for one in changes.events]
    watch.store.close()
    return alarms_of([one for one in events if one["plant"] == plant])


def events_in(path: Path) -> list[dict[str, Any]]:
    """Return all events of a store."""
    store = SqliteStore(path)
    store.open()
    try:
        return [one.to_dict() for one in store.events(0, 10**7)]
    finally:
        store.close()


def command(*arguments: object, **more: Any) -> subprocess.CompletedProcess[str]:
    """Run `residua live` in a process of its own."""
    return subprocess.run(
        [sys.executable, "-m", "residua", "live", *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=120,
        **more,
    )


class Nobody:
    """Stands for the source of messages that are handed over directly."""

    name, finite, rereads = "nobody", False, False

    def __init__(self) -> None:
        self.acknowledged = 0

    def acknowledge(self, messages: list[Message]) -> None:
        self.acknowledged += len(messages)


def resident() -> float:
    """Return the megabytes of memory that this process has now."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 1e6


def memory_by_hour(run: Run, plants: int, hours: int) -> tuple[list[float], int, float]:
    """Replay hours of plants at one sample a second; return the memory after each, the rows, and the seconds.

    Messages are packed by 100 rows; each plant is at another place of the recording: their alarms come by turns.
    """
    rows, source = recording(6000, seed=5), Nobody()
    rows = np.concatenate([rows[:500], rows[2200:5400]])
    blocks = []
    for part in np.split(rows, len(rows) // 100):
        columns: dict[str, Any] = {"u": part[:, :2].tolist(), "y": part[:, 2:].tolist()}
        blocks.append(json.dumps({"dt": 1.0} | columns).encode()[1:])
    memory: list[float] = []
    begin = time.monotonic()
    inbox = MessageQueue(MOST_MESSAGES, MOST_BYTES)
    for k in range(hours * 36):
        for p in range(plants):
            text = b'{"plant": "p%d", "t0": %d, ' % (p, 100 * k) + blocks[(k + p) % len(blocks)]
            inbox.put(Message(source, text, 0.0))
        while messages := inbox.take(AT_ONCE, 0.0, BYTES_AT_ONCE):
            run.apply(messages)
        if k % 36 == 35:
            memory.append(resident())
    return memory, hours * 3600 * plants, time.monotonic() - begin
