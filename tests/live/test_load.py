"""Messages of any kind do not stop a run, and its memory does not grow with time."""

from __future__ import annotations

import json
import logging
import random
from collections.abc import Iterator
from pathlib import Path

import pytest

from live_examples import recording
from live_runs import Nobody, configuration, line, memory_by_hour, resident
from residua.live.config import load_settings
from residua.live.run import Run
from residua.live.source import Message

SOURCE = '[[sources]]\nkind = "stdin"\npath = "rows.jsonl"'


@pytest.fixture
def made(tmp_path: Path) -> Iterator[Run]:
    (tmp_path / "rows.jsonl").touch()
    more = "accept_new = true\nmax_plants = 1100"
    run = Run(load_settings(configuration(tmp_path, SOURCE, more=more, plants=["north"])))
    yield run
    run.close()


def damaged(rng: random.Random, good: list[bytes]) -> bytes:
    """Return a message with something wrong, or nothing."""
    content = bytearray(rng.choice(good))
    how = rng.randrange(8)
    if how == 0:
        return rng.randbytes(rng.randrange(200))
    if how == 1:
        return bytes(content[: rng.randrange(len(content))])
    if how == 2:
        for _ in range(rng.randrange(1, 6)):
            content[rng.randrange(len(content))] = rng.randrange(256)
        return bytes(content)
    if how == 3:
        word = rng.choice([b"NaN", b"Infinity", b'"1"', b"true", b"[]", b"{}", b"1e999", b"-0.0", b"null", b"1e308"])
        values = json.loads(content)
        key = rng.choice(list(values))
        if type(values[key]) is list and rng.random() < 0.5:
            values[key][0] = "@"
        else:
            values[key] = "@"
        return json.dumps(values).encode().replace(b'"@"', word)
    if how == 4:
        k, n = rng.randrange(len(content)), rng.randrange(20)
        return bytes(content[:k] + content[k : k + n] * rng.randrange(3) + content[k + n :])
    if how == 5:
        return b"[" * rng.randrange(3000) + bytes(content)
    if how == 6:
        values = json.loads(content)
        values["t"] = rng.choice([rng.uniform(-1e13, 1e13), rng.randrange(-100, 100), "2026-11-24T00:00:00Z", 1e308])
        return json.dumps(values).encode()
    return bytes(content)


@pytest.mark.parametrize("count", [10_000, pytest.param(1_000_000, marks=pytest.mark.campaign)])
def test_fuzzed_messages_stop_nothing(made: Run, count: int, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.ERROR)
    rows, source, rng = recording(2000), Nobody(), random.Random(count)
    good = [line(f"p{k % 7}", float(k % 300), rows[k]).encode() for k in range(600)]
    good += [json.dumps({"plant": "north", "t": k, "values": {"h1": 1.5, "Q2": k}}).encode() for k in range(300)]
    memory = 0.0
    for k in range(0, count, 1000):
        some = [Message(source, damaged(rng, good), 0.0) for _ in range(1000)]  # type: ignore[arg-type]
        made.apply(some)
        if k == count // 5:
            memory = resident()
    assert source.acknowledged == count
    assert resident() < 1.05 * memory + 5
    assert {"json", "shape", "number", "time", "plant"} <= set(made.numbers.dropped)
    assert not caplog.records
    before = made.watch.plants["north"].count
    row = line("north", made.watch.plants["north"].sampling.last + 1.0, rows[0])
    made.apply([Message(source, row.encode(), 0.0)])  # type: ignore[arg-type]
    assert made.watch.plants["north"].count > before or made.watch.plants["north"].sampling.back


def test_memory_does_not_grow_after_the_first_hour(made: Run) -> None:
    memory, samples, _ = memory_by_hour(made, 20, 4)
    assert sum(one.count for one in made.watch.plants.values()) == samples
    pages = 8  # megabytes that the database holds, which so few plants fill later
    assert max(memory[2:]) <= 1.05 * memory[1] + pages
