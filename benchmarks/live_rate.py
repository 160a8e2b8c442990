"""The rate of a live run from MQTT, against a bare client that subscribes to the same topics.

Both subscribe to one broker in turn, with what is published kept for each of them by the broker, so that neither waits
for a publisher. The bare client is paho's, which counts messages and leaves them acknowledged by itself. The rate is
that from the first message to the last; rounds alternate, and the median counts.
"""

from __future__ import annotations

import csv
import json
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import paho.mqtt.client as paho
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tests"))

from live.brokers import Mosquitto  # noqa: E402
from live_examples import monitor, recording  # noqa: E402
from live_runs import configuration, running  # noqa: E402

TABLE = ROOT / "docs" / "data" / "live_rate.csv"
#: What is published: name, plants, messages, rows of each.
LOADS = (
    ("single samples, 1 plant", 1, 20_000, 1),
    ("single samples, 1,000 plants", 1000, 20_000, 1),
    ("packed by 100, 1 plant", 1, 2_000, 100),
    ("packed by 100, 100 plants", 100, 2_000, 100),
)
ROUNDS = 3
BROKER = "max_queued_messages 0\nmax_inflight_messages 2000\nmax_inflight_bytes 0\n"


def messages(plants: int, count: int, rows: int) -> Iterator[tuple[str, bytes]]:
    """Yield topic and payload of fault-free samples."""
    data = recording(2000)[:600]
    for k in range(count):
        plant, step = f"p{k % plants}", k // plants
        part = data[np.arange(step * rows, (step + 1) * rows) % len(data)].tolist()
        if rows == 1:
            content: dict[str, Any] = {"t": float(step), "u": part[0][:2], "y": part[0][2:]}
        else:
            content = {
                "t0": float(step * rows),
                "dt": 1.0,
                "u": [one[:2] for one in part],
                "y": [one[2:] for one in part],
            }
        yield f"plants/{plant}/data", json.dumps(content).encode()


def connected(client: paho.Client, port: int) -> None:
    """Connect with a session that the broker keeps, and as much on its way as residua takes."""
    properties = Properties(PacketTypes.CONNECT)
    properties.SessionExpiryInterval, properties.ReceiveMaximum = 3600, 2000
    client.connect("127.0.0.1", port, clean_start=False, properties=properties)


def subscribe(port: int, name: str) -> None:
    """Make a session, so that the broker keeps what is published for it."""
    client, done = paho.Client(paho.CallbackAPIVersion.VERSION2, name, protocol=paho.MQTTv5), threading.Event()
    client.on_subscribe = lambda *_: done.set()
    connected(client, port)
    client.loop_start()
    client.subscribe("plants/+/data", qos=1)
    assert done.wait(10)
    client.disconnect()
    client.loop_stop()


def publish(port: int, load: tuple[str, int, int, int]) -> None:
    """Publish everything, and wait until the broker has it."""
    client = paho.Client(paho.CallbackAPIVersion.VERSION2)
    client.max_inflight_messages_set(1000)
    client.connect("127.0.0.1", port)
    client.loop_start()
    last = None
    for topic, payload in messages(*load[1:]):
        last = client.publish(topic, payload, qos=1)
    assert last is not None
    last.wait_for_publish(300)
    client.disconnect()
    client.loop_stop()


def bare(port: int, count: int) -> float:
    """Return the messages per second of a client that only counts."""
    client, done, seen = (
        paho.Client(paho.CallbackAPIVersion.VERSION2, "bare", protocol=paho.MQTTv5),
        threading.Event(),
        [0],
    )
    times = [0.0, 0.0]

    def on_message(*_: Any) -> None:
        if not seen[0]:
            times[0] = time.perf_counter()
        seen[0] += 1
        if seen[0] == count:
            times[1] = time.perf_counter()
            done.set()

    client.on_message = on_message
    connected(client, port)
    client.loop_start()
    assert done.wait(300)
    client.disconnect()
    client.loop_stop()
    return (count - 1) / (times[1] - times[0])


@contextmanager
def broker(folder: Path) -> Iterator[Mosquitto]:
    """A broker that drops nothing."""
    one = Mosquitto(folder, BROKER)
    one.start()
    try:
        yield one
    finally:
        one.kill()


def live(folder: Path, port: int, load: tuple[str, int, int, int]) -> float:
    """Return the messages per second of a run, from its first row to the last one that is committed."""
    _, plants, count, rows = load
    source = f"""[[sources]]
kind = "mqtt"
client_id = "residua"
host = "127.0.0.1"
port = {port}
topics = ["plants/{{plant}}/data"]"""
    path = configuration(folder, source, plants=[f"p{k}" for k in range(plants)])
    with running(path) as run:
        while not run.numbers.messages.total():
            time.sleep(0.0005)
        begin = time.perf_counter()
        while sum(one.count for one in run.watch.plants.values()) < count * rows:
            time.sleep(0.002)
        return count / (time.perf_counter() - begin)


def measured(load: tuple[str, int, int, int]) -> tuple[float, float]:
    """Return the median rates of the bare client and of a run."""
    rates: tuple[list[float], list[float]] = ([], [])
    for _ in range(ROUNDS):
        with tempfile.TemporaryDirectory() as name, broker(Path(name)) as one:
            for client in ("bare", "residua"):
                subscribe(one.port, client)
            publish(one.port, load)
            rates[0].append(bare(one.port, load[2]))
            rates[1].append(live(Path(name), one.port, load))
    return median(rates[0]), median(rates[1])


def main() -> None:
    """Measure all loads, and write the table."""
    monitor()
    table = [["what is published, at QoS 1", "bare client, messages/s", "residua live, messages/s", "ratio", "rows/s"]]
    for load in LOADS:
        plain, ours = measured(load)
        table.append([load[0], f"{plain:,.0f}", f"{ours:,.0f}", f"{ours / plain:.2f}", f"{ours * load[3]:,.0f}"])
        print(*table[-1], sep="; ", flush=True)
    with TABLE.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows(table)


if __name__ == "__main__":
    main()
