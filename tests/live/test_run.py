"""A run in parts: what fails is not put down as done, and what is away is waited for."""

from __future__ import annotations

import math
import re
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from live.brokers import wait_for
from live_examples import recording, told
from live_runs import Nobody, configuration, line
from residua.errors import DataError
from residua.live.config import load_settings
from residua.live.delivery import Delivery, Sink
from residua.live.events import Event
from residua.live.run import MOST_BYTES, Run
from residua.live.source import Message, MessageQueue, RunStoppedError
from residua.live.store import Changes, StoreAwayError, StoreError
from residua.live.watched_plant import Steps

SOURCE = '[[sources]]\nkind = "stdin"\npath = "rows.jsonl"'


def made(folder: Path, lines: Sequence[str] = (), more: str = "") -> Run:
    (folder / "rows.jsonl").write_text("\n".join(lines))
    return Run(load_settings(configuration(folder, SOURCE, more=more)))


def messages(rows: np.ndarray, first: int, count: int) -> list[Message]:
    source = Nobody()
    return [Message(source, line("north", float(k), rows[k]).encode(), 0.0) for k in range(first, first + count)]


def test_a_batch_that_could_not_be_stored_is_not_put_down_as_done(tmp_path: Path) -> None:
    rows = recording(2000)
    run = made(tmp_path, [line("north", float(k), rows[k]) for k in range(300)])
    commits = run.store.commit
    count = 0

    def full(changes: Changes) -> None:
        nonlocal count
        count += bool(changes.rows)
        if count > 0:
            raise StoreError("no space is left")
        commits(changes)

    run.store.commit = full  # type: ignore[method-assign]
    with pytest.raises(StoreError, match="no space"):
        run.work()
    run.close()
    again = made(tmp_path, [line("north", float(k), rows[k]) for k in range(300)])
    assert again.watch.plants["north"].count == 0
    again.work()
    assert again.watch.plants["north"].count == 300
    assert not again.numbers.dropped
    again.close()


def test_a_store_that_is_away_is_waited_for(tmp_path: Path) -> None:
    rows = recording(2000)
    run = made(tmp_path, [line("north", float(k), rows[k]) for k in range(300)])
    meta, commit, left = run.store.meta, run.store.commit, [3, 3]

    def away(which: int, act: Any, *given: Any) -> Any:
        if left[which]:
            left[which] -= 1
            raise StoreAwayError("nobody answers")
        return act(*given)

    run.store.meta = lambda: away(0, meta)  # type: ignore[method-assign]
    run.store.commit = lambda changes: away(1, commit, changes)  # type: ignore[method-assign]
    run.work()
    assert left == [0, 0]
    assert run.watch.plants["north"].count == 300
    run.close()


def test_infinite_values_are_missing(tmp_path: Path) -> None:
    run = made(tmp_path)
    source, rows = Nobody(), recording(2000)
    run.apply(messages(rows, 0, 1))
    for name, value in (("Q1", 21.0), ("Q2", math.inf), ("h1", 41.0), ("h2", -math.inf), ("h3", 36.0)):
        run.apply([Message(source, value, 0.0, "north", name, 1.0)])
    assert run.watch.plants["north"].count == 2
    _, values = run.watch.last_rows(run.watch.plants["north"], 1)
    assert values[0, [0, 2, 4]].tolist() == [21.0, 41.0, 36.0]
    assert np.isnan(values[0, [1, 3]]).all()
    run.close()


def test_an_alarm_is_raised_before_it_is_renamed_and_ends_last(tmp_path: Path) -> None:
    run, rows = made(tmp_path), recording(2000)
    rng = np.random.default_rng(3)
    for begin in range(60, 600, 170):  # short and long faults of all channels, some over before they are looked at
        rows[begin : begin + int(rng.integers(8, 30)), 2 + int(rng.integers(3))] += rng.choice([-1.0, 1.0])
    for k in range(0, 1900, 100):
        run.apply(messages(rows, k, 100))
    events = told(run.watch, "north")
    known: set[float] = set()
    for one in events:
        if one["kind"] == "raised":
            known.add(one["raised"])
        elif one["kind"] in ("renamed", "ended"):
            assert one["raised"] in known, one
        if one["kind"] == "ended":
            known.discard(one["raised"])
    assert sum(one["kind"] == "ended" for one in events) >= 3
    run.close()


def test_an_alarm_that_stands_is_told_once_however_often_it_is_begun_again(tmp_path: Path) -> None:
    rows = recording(2000)
    lines = [line("north", float(k), row) for k, row in enumerate(rows)]
    for _ in range(3):
        run = made(tmp_path, lines)
        run.work()
        events = told(run.watch, "north") if run.store.last_place() else []
        run.close()
    store = made(tmp_path)
    events = told(store.watch, "north")
    store.close()
    assert [one["kind"] for one in events].count("standing") == 1
    assert "clock" not in {one["kind"] for one in events}


def test_a_source_that_cannot_go_on_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "wrong.csv").write_text("time,a\n0,1\n1,2\n")
    path = configuration(tmp_path, '[[sources]]\nkind = "replay"\nfile = "wrong.csv"\nspeed = 0')
    run = Run(load_settings(path))
    with pytest.raises(DataError, match=r"replay wrong\.csv: .*column"):
        run.work()
    run.close()


class Failing(Sink):
    """Is wrong itself, a few times."""

    kind, name = "failing", "failing"

    def __init__(self) -> None:
        self.left, self.got = 2, 0

    def deliver(self, events: Sequence[Event]) -> int:
        if self.left:
            self.left -= 1
            raise ZeroDivisionError("a defect")
        self.got += len(events)
        return len(events)


def test_a_sink_that_is_wrong_itself_does_not_end_in_silence(tmp_path: Path) -> None:
    run, sink = made(tmp_path), Failing()
    event = Event(1, "north", 1, "missing", 0.0, content={"channels": ["h1"]})
    run.store.commit(Changes(events=[event]))
    run.committed = 1
    delivery = Delivery(sink, run.store, run.wait_for_event)
    delivery.start()
    wait_for(lambda: not delivery.health.good)
    assert "ZeroDivisionError" in delivery.health.text
    wait_for(lambda: sink.got == 1)
    delivery.stop()
    assert delivery.failures == 2
    run.close()


def test_waiting_for_events_waits_after_the_end_too(tmp_path: Path) -> None:
    run = made(tmp_path)
    run.stop()
    begin = time.monotonic()
    assert not run.wait_for_event(0, 0.3)
    assert time.monotonic() - begin > 0.25
    run.close()


def test_another_step_than_that_of_the_monitor_is_said(tmp_path: Path) -> None:
    run, source = made(tmp_path), Nobody()
    rows = recording(2000)
    for k in range(40):
        run.apply([Message(source, line("north", 2.0 * k, rows[k]).encode(), 0.0)])
    (problem,) = run.problems
    assert "north sends every 2 s, its monitor runs at 1 s" in problem
    run.close()
    right = Steps()
    assert not any(right.odd([float(k)], 1.0) for k in range(100))
    lost = Steps()
    assert not any(lost.odd([float(k)], 1.0) for k in range(1000) if k % 5)


def test_a_full_queue_waits_and_a_closed_one_refuses() -> None:
    inbox, over = MessageQueue(2, MOST_BYTES), threading.Event()

    def put() -> None:
        try:
            for k in range(5):
                inbox.put(Message(None, b"x", float(k)))
        except RunStoppedError:
            over.set()

    thread = threading.Thread(target=put)
    thread.start()
    wait_for(lambda: len(inbox) == 2)
    assert inbox.oldest() == 0.0
    assert [one.arrived for one in inbox.take(1, 1.0)] == [0.0]
    wait_for(lambda: len(inbox) == 2)
    inbox.close()
    assert over.wait(5)
    thread.join()


def test_a_queue_is_full_of_messages_or_of_bytes_and_forgets_those_that_come_again() -> None:
    queue = MessageQueue(10, 5000)
    queue.give(Message(None, b"x" * 1000, float(k)) for k in range(5))  # without waiting for room
    assert queue.full
    assert queue.heavy
    queue.drop(lambda message: message.arrived % 2 == 0.0)
    assert not queue.full
    assert [one.arrived for one in queue.take(10, 0.0, 2000)] == [1.0, 3.0]  # bounded in bytes too
    queue.give(Message(None, b"x" * 1000, float(k)) for k in range(3))
    assert [one.arrived for one in queue.take(10, 0.0, 1)] == [0.0]  # one alone, however large
    assert len(queue.take(10, 0.0)) == 2
    queue.give([Message(None, 1.0, 0.0)] * 10)
    assert queue.full
    assert not queue.heavy


BROKEN = {
    "json": ('{"plant": "north", "t": 3.0, "u": [', r"json \(line 2: not JSON: .*; got "),
    "shape": ('{"plant": "north", "t": 3.0, "y": [1, 2]}', r"shape \(line 2: u must have as many rows as y"),
    "keys": ('{"plant": "north", "time": 3.0}', r"shape \(line 2: keys must be plant, t, u, y"),
    "number": ('{"plant": "north", "t": 3.0, "values": {"h1": "Bad"}}', r"number \(line 2: values must be numbers"),
    "channel": (
        '{"plant": "north", "t": 3.0, "values": {"H1": 2}}',
        r"channel \(line 2: no channel 'H1' \(did you mean 'h1'\?\); the plant has Q1, Q2, h1, h2, h3; got ",
    ),
    "plant": ('{"plant": "south", "t": 3.0, "u": [1, 2], "y": [1]}', r"plant \(line 2: plant 'south' is not watched"),
    "time": ('{"plant": "north", "t": "noon", "u": [1, 2], "y": [1, 2, 3]}', r"time \(line 2: t must be seconds"),
}


@pytest.mark.parametrize("kind", BROKEN)
def test_a_broken_line_is_quoted_with_a_right_one(tmp_path: Path, kind: str, caplog: pytest.LogCaptureFixture) -> None:
    text, message = BROKEN[kind]
    rows = recording(2000)
    run = made(tmp_path, [line("north", 0.0, rows[0]), text, *(line("north", float(k), rows[k]) for k in range(1, 40))])
    run.work()
    (warning,) = [record.getMessage() for record in caplog.records if record.name == "residua.live"]
    assert re.search(message, warning)
    assert repr(text) in warning
    assert run.watch.plants["north"].count == 40
    run.close()
    sample = warning[warning.index("expected such as ") + len("expected such as ") : -1]
    (tmp_path / "again").mkdir()
    again = made(tmp_path / "again", [sample])
    again.work()
    assert again.numbers.rows
    assert not again.numbers.dropped
    again.close()
