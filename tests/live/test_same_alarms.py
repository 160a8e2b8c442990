"""A recording that comes by any source has the alarms of ``residua run``: onsets, names and scores to the last bit."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from live.brokers import Mosquitto, free_port, publisher, wait_for
from live_examples import alarms_of_run, monitor, recording
from live_runs import alarms_in, command, configuration, line, running

SAMPLES = 2200
TIMES = np.arange(SAMPLES, dtype=float)
CHANNELS = ("Q1", "Q2", "h1", "h2", "h3")


@pytest.fixture(scope="module")
def rows() -> np.ndarray:
    return recording(SAMPLES)


@pytest.fixture(scope="module")
def wanted(rows: np.ndarray, tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, Any]]:
    """What `residua run` writes of the recording."""
    folder = tmp_path_factory.mktemp("recorded")
    monitor().save(folder / "tank.json")
    csv, out = folder / "run.csv", folder / "alarms.jsonl"
    table = np.column_stack([TIMES, rows]).tolist()
    lines = [",".join("" if v != v else repr(v) for v in values) for values in table]
    csv.write_text("\n".join(["time,Q1,Q2,h1,h2,h3", *lines]))
    program = [sys.executable, "-m", "residua", "run", folder / "tank.json", csv, "--alarms", out, "-q"]
    assert subprocess.run(program, check=False).returncode == 1
    alarms = [json.loads(one) for one in out.read_text().splitlines()]
    assert len(alarms) >= 2
    assert alarms == json.loads(json.dumps(alarms_of_run(monitor(), rows, TIMES)))
    return alarms


def messages(rows: np.ndarray) -> list[str]:
    return [line("north", time, row) for time, row in zip(TIMES.tolist(), rows, strict=True)]


def test_lines_of_standard_input(tmp_path: Path, rows: np.ndarray, wanted: list[dict[str, Any]]) -> None:
    path = configuration(tmp_path, '[[sources]]\nkind = "stdin"', '[[sinks]]\nkind = "jsonl"\npath = "events.jsonl"')
    made = command(path, input="\n".join(messages(rows)))
    assert made.returncode == 1, made.stderr
    assert f"{SAMPLES:,} rows" in made.stdout
    assert alarms_in(tmp_path / "live.db") == wanted
    sent = [json.loads(one) for one in (tmp_path / "events.jsonl").read_text().splitlines()]
    assert [one["number"] for one in sent] == list(range(1, len(sent) + 1))
    assert sent[-1]["kind"] == "standing"


def test_a_replay(tmp_path: Path, rows: np.ndarray, wanted: list[dict[str, Any]]) -> None:
    np.savez(tmp_path / "run.npz", time=TIMES, **dict(zip(CHANNELS, rows.T, strict=True)))
    source = '[[sources]]\nkind = "replay"\nfile = "run.npz"\nspeed = 0\nrows = 37'
    made = command(configuration(tmp_path, source))
    assert made.returncode == 1, made.stderr
    assert alarms_in(tmp_path / "live.db") == wanted


def by_channels(rows: np.ndarray) -> Iterator[tuple[str, str]]:
    for time, row in zip(TIMES.tolist(), rows.tolist(), strict=True):
        for c in (4, 0, 2, 1, 3):
            value = None if row[c] != row[c] else row[c]
            yield f"plants/north/{CHANNELS[c]}", json.dumps({"t": time, "value": value})


def whole_rows(rows: np.ndarray) -> Iterator[tuple[str, str]]:
    return (("plants/north/data", one) for one in messages(rows))


@pytest.mark.parametrize(
    ("topic", "published", "wait"), [("data", whole_rows, 2), ("{channel}", by_channels, 30)], ids=["rows", "channels"]
)
def test_mqtt(
    tmp_path: Path,
    mosquitto: Mosquitto,
    rows: np.ndarray,
    wanted: list[dict[str, Any]],
    topic: str,
    published: Callable[[np.ndarray], Iterator[tuple[str, str]]],
    wait: float,
) -> None:
    pytest.importorskip("paho.mqtt.client")
    source = f"""[[sources]]
kind = "mqtt"
client_id = "residua"
host = "127.0.0.1"
port = {mosquitto.port}
topics = ["plants/{{plant}}/{topic}"]
[sampling]
wait = {wait}"""
    with running(configuration(tmp_path, source)) as run, publisher(mosquitto.port) as client:
        wait_for(lambda: run.sources[0].health.good)
        for message in published(rows):
            client.publish(*message, qos=1)
        wait_for(lambda: run.watch.plants["north"].count == SAMPLES)
    assert alarms_in(tmp_path / "live.db") == wanted


def test_kafka(tmp_path: Path, rows: np.ndarray, wanted: list[dict[str, Any]]) -> None:
    kafka = pytest.importorskip("confluent_kafka")
    cluster = kafka.Producer({"test.mock.num.brokers": 1, "bootstrap.servers": "none", "log_level": 0})
    address = str(next(iter(cluster.list_topics(timeout=20).brokers.values()))).split("/")[0]
    source = f'[[sources]]\nkind = "kafka"\nservers = ["{address}"]\ngroup = "residua"\ntopics = ["plants"]'
    producer = kafka.Producer({"bootstrap.servers": address, "log_level": 0})
    for one in messages(rows):
        producer.produce("plants", one, key="north")
    assert producer.flush(30) == 0
    with running(configuration(tmp_path, source)) as run:
        wait_for(lambda: run.watch.plants["north"].count == SAMPLES)
    assert alarms_in(tmp_path / "live.db") == wanted


def test_opc_ua(tmp_path: Path, rows: np.ndarray, wanted: list[dict[str, Any]]) -> None:
    pytest.importorskip("asyncua")
    from live.opcua_server import OpcUaServer

    readings = [
        [(name, value, time) for name, value in zip(CHANNELS, row, strict=True)]
        for time, row in zip(TIMES.tolist(), rows.tolist(), strict=True)
    ]
    with OpcUaServer(free_port(), dict.fromkeys(CHANNELS, 0.0)) as server:
        server.set_all(readings[0])  # what is there when the run connects
        nodes = "\n".join(f'{name} = "ns=2;s={name}"' for name in CHANNELS)
        source = f'[[sources]]\nkind = "opcua"\nurl = "{server.url}"\nqueue = 10000\n[sources.nodes.north]\n{nodes}'
        with running(configuration(tmp_path, source, "[sampling]\nwait = 60")) as run:
            wait_for(lambda: run.sources[0].health.good)
            for k in range(1, SAMPLES, 100):
                server.set_all([one for row in readings[k : k + 100] for one in row])
            wait_for(lambda: run.watch.plants["north"].count == SAMPLES)
    assert alarms_in(tmp_path / "live.db") == wanted
