"""Kills of a run from MQTT to a webhook at random moments, with what came of it in the end."""

from __future__ import annotations

import http.server
import json
import random
import subprocess
import sys
import threading
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from live.brokers import Mosquitto, wait_for
from live_examples import fed, monitor, opened, recording
from live_runs import configuration, line
from residua.live.watched_model import WatchedModel

#: Part of the requests that the receiver refuses to answer.
REFUSED = 0.03


class Receiver(http.server.ThreadingHTTPServer):
    """Takes events by POST, and keeps the bodies of each plant and number; says 503 now and then."""

    daemon_threads = True

    def __init__(self, seed: int) -> None:
        self.bodies: dict[tuple[str, int], set[bytes]] = defaultdict(set)
        self.order: dict[str, list[int]] = defaultdict(list)
        self._random, self._lock = random.Random(seed), threading.Lock()
        super().__init__(("127.0.0.1", 0), _Handler)
        threading.Thread(target=self.serve_forever, daemon=True).start()

    def take(self, body: bytes) -> int:
        """Keep one event, and return the status of the answer."""
        event = json.loads(body)
        with self._lock:
            if self._random.random() < REFUSED:
                return 503
            self.bodies[event["plant"], event["number"]].add(body)
            self.order[event["plant"]].append(event["number"])
        return 204


class _Handler(http.server.BaseHTTPRequestHandler):
    server: Receiver

    def do_POST(self) -> None:
        self.send_response(self.server.take(self.rfile.read(int(self.headers["Content-Length"]))))
        self.end_headers()

    def log_message(self, format: str, *arguments: Any) -> None:
        pass


def expected(folder: Path, plants: dict[str, NDArray[np.float64]]) -> dict[tuple[str, int], dict[str, Any]]:
    """Return the events of a run that nobody disturbs, by plant and number."""
    folder.mkdir()
    watch = opened(folder / "live.db", WatchedModel("tank", monitor(), history=500.0), list(plants))
    for plant, rows in plants.items():
        fed(watch, [plant], np.arange(len(rows), dtype=float), rows)
    events = watch.store.events(0, 10**6)
    watch.store.close()
    return {(one.plant, one.number): json.loads(one.to_json()) for one in events}


class Campaign:
    """A run that is killed again and again while rows are published.

    Parameters
    ----------
    folder : Path
    broker : Mosquitto
        Running, with persistence and without limits of what waits.
    store : str
        The table ``[store]`` of the configuration.
    kills : int
    samples : int
        Of each of three plants.
    seed : int
    """

    def __init__(self, folder: Path, broker: Mosquitto, store: str, kills: int, samples: int, seed: int = 0) -> None:
        self.folder, self.broker, self.kills = folder, broker, kills
        self.random = random.Random(seed)
        self.plants = {name: recording(samples, seed=k + 1) for k, name in enumerate(("north", "south", "east"))}
        self.receiver = Receiver(seed)
        source = f"""[[sources]]
kind = "mqtt"
client_id = "residua"
host = "127.0.0.1"
port = {broker.port}
topics = ["plants/{{plant}}/data"]
[sampling]
wait = 3600
silence = 1e6
[[sinks]]
kind = "webhook"
url = "http://127.0.0.1:{self.receiver.server_port}/events"
unsigned = true"""
        self.path = configuration(folder, store, source, plants=list(self.plants))
        self.done = self.restarts = 0
        self._published = threading.Event()

    def run(self) -> dict[tuple[str, int], dict[str, Any]]:
        """Publish, kill, let the last run come to its end, and return what should have come."""
        process = self._start()
        self._subscribed()
        publisher = threading.Thread(target=self._publish)
        publisher.start()
        every = max(2, self.kills // 20)
        while self.done < self.kills:
            self._wait(self.random.uniform(0.0, 0.6))
            process.kill()
            process.communicate()
            self.done += 1
            if self.done % every == every // 2:
                self.broker.stop()
                self.broker.start()
                self.restarts += 1
            process = self._start()
        self._published.set()
        publisher.join()
        wanted = expected(self.folder / "undisturbed", self.plants)
        try:
            wait_for(lambda: len(self.receiver.bodies) >= len(wanted), 300.0)
            self._wait(1.0)  # for what should not come
        finally:
            process.terminate()
            output, errors = process.communicate(timeout=60)
        assert process.returncode == 0, (process.returncode, output, errors)
        self.receiver.shutdown()
        self.receiver.server_close()
        return wanted

    def _wait(self, seconds: float) -> None:
        threading.Event().wait(seconds)

    def _start(self) -> subprocess.Popen[str]:
        program = [sys.executable, "-m", "residua", "live", str(self.path)]
        process = subprocess.Popen(program, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        last = self.done == self.kills
        if last or self.random.random() < 0.9:  # the others are killed while they begin
            assert process.stdout is not None
            for text in process.stdout:
                if text.startswith("watching"):
                    return process
            raise AssertionError(process.communicate()[1])
        return process

    def _subscribed(self) -> None:
        """Wait until the broker knows the session, so that it keeps what is published from now on."""
        log = self.broker.folder / "mosquitto.log"
        wait_for(lambda: "residua 1 plants/" in log.read_text())

    def _publish(self) -> None:
        """Publish all rows in order, in pieces between the kills, the last ones when these are over."""
        import paho.mqtt.client as paho

        client = paho.Client(paho.CallbackAPIVersion.VERSION2, client_id="publisher", clean_session=False)
        client.reconnect_delay_set(1, 1)
        arrived: list[int] = []  # what is published while the broker is away is said to have failed, and is sent later
        client.on_publish = lambda *given: arrived.append(given[2])
        client.connect("127.0.0.1", self.broker.port)
        client.loop_start()
        samples = len(next(iter(self.plants.values())))
        for k in range(samples):
            while k / samples > (self.done + 1) / (self.kills + 1) and not self._published.is_set():
                time.sleep(0.002)
            for plant, rows in self.plants.items():
                client.publish(f"plants/{plant}/data", line(plant, float(k), rows[k]), qos=1)
        wait_for(lambda: len(arrived) >= samples * len(self.plants), 120.0)
        client.disconnect()
        client.loop_stop()

    def check(self, wanted: dict[tuple[str, int], dict[str, Any]]) -> None:
        """Check that every event came, each with one number and one content, and none that should not be."""
        got = self.receiver.bodies
        assert sorted(got) == sorted(wanted)
        assert {key: len(bodies) for key, bodies in got.items() if len(bodies) != 1} == {}
        came = {key: json.loads(next(iter(bodies))) for key, bodies in got.items()}
        others = [(came[key], wanted[key]) for key in sorted(wanted) if came[key] != wanted[key]]
        assert not others, others
        for numbers in self.receiver.order.values():  # what comes again comes again from there on
            first = list(dict.fromkeys(numbers))
            assert first == sorted(first)


#: Of the broker: nothing is dropped, and enough is on its way.
BROKER = "max_queued_messages 0\nmax_inflight_messages 1000\nautosave_interval 1\nlog_type subscribe\n"
