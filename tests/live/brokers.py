"""Real components for the tests of live data: started on free loopback ports, stopped by their process ids."""

from __future__ import annotations

import getpass
import queue
import shutil
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from residua.live.source import Message, RunStoppedError, Source


def free_port() -> int:
    """Return a port that is free now."""
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        return taken.getsockname()[1]


def wait_for(done: Callable[[], object], seconds: float = 60.0, what: str | Callable[[], str] = "it") -> None:
    """Wait until something is so; fail when it does not come to be."""
    until = time.monotonic() + seconds
    while not done():
        assert time.monotonic() < until, (
            f"{what if isinstance(what, str) else what()} did not come to be within {seconds} s"
        )
        time.sleep(0.01)


class Mosquitto:
    """A broker with persistence, which can be stopped and started again, or killed."""

    def __init__(self, folder: Path, settings: str = "", port: int | None = None) -> None:
        program = shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin")
        if program is None:
            pytest.skip("mosquitto is not installed")
        self.program, self.folder, self.port = program, folder, port or free_port()
        self._process: subprocess.Popen[bytes] | None = None
        self._file = folder / "mosquitto.conf"
        listener = "" if "listener" in settings else f"listener {self.port} 127.0.0.1\n"
        anonymous = "" if "allow_anonymous" in settings else "allow_anonymous true\n"
        self._file.write_text(
            f"{listener}{anonymous}user {getpass.getuser()}\nlog_dest file {folder}/mosquitto.log\n"
            f"persistence true\npersistence_location {folder}/\n{settings}\n"
        )

    def start(self) -> None:
        """Start it, and wait until it answers."""
        self._process = subprocess.Popen(
            [self.program, "-c", str(self._file)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        wait_for(self._answers, 20.0, "an answer of mosquitto")

    def _answers(self) -> bool:
        assert self._process is not None
        assert self._process.poll() is None, (self.folder / "mosquitto.log").read_text()
        try:
            socket.create_connection(("127.0.0.1", self.port), 1.0).close()
        except OSError:
            return False
        return True

    def stop(self) -> None:
        """Stop it in order: it writes what it holds."""
        if self._process is not None:
            self._process.terminate()
            self._process.wait(20)
            self._process = None

    def kill(self) -> None:
        """Kill it."""
        if self._process is not None:
            self._process.kill()
            self._process.wait(20)
            self._process = None


@contextmanager
def running(folder: Path, settings: str = "", port: int | None = None) -> Iterator[Mosquitto]:
    """A broker that is running, with lines of its configuration."""
    broker = Mosquitto(folder, settings, port)
    broker.start()
    try:
        yield broker
    finally:
        broker.kill()


@contextmanager
def publisher(port: int) -> Iterator[Any]:
    """A client of MQTT that publishes."""
    from paho.mqtt import client as paho

    client = paho.Client(paho.CallbackAPIVersion.VERSION2, client_id="publisher", clean_session=False)
    client.reconnect_delay_set(1, 1)
    client.max_inflight_messages_set(20)  # as many of QoS 2 as mosquitto takes
    client.connect("127.0.0.1", port)
    client.loop_start()
    try:
        yield client
    finally:
        client.disconnect()
        client.loop_stop()


class Run:
    """Stands for the run: a bounded queue, a thread that takes from it, acknowledging what it has taken.

    Parameters
    ----------
    source : Source
    most : int
        Messages that may wait.
    acknowledges : bool
    """

    def __init__(self, source: Source, most: int = 1000, acknowledges: bool = True) -> None:
        self.source, self.acknowledges = source, acknowledges
        self.messages: list[Message] = []
        self._queue: queue.Queue[Message] = queue.Queue(most)
        self._ended = threading.Event()
        self.takes = threading.Event()
        self.takes.set()
        self._before = set(threading.enumerate())
        self._thread = threading.Thread(target=self._run)

    def __enter__(self) -> Run:
        self.source.start(self.put)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self.takes.set()
        begin = time.monotonic()
        self._thread.join(10)
        self.source.stop()
        assert time.monotonic() - begin < 8.0
        wait_for(lambda: not self._left(), 5.0, lambda: f"the end of {self._left()}")  # libraries do not join theirs

    def _left(self) -> list[str]:
        """Return the threads that have begun since, but for those of a server in this process."""
        return [one.name for one in set(threading.enumerate()) - self._before if "server's helper" not in one.name]

    def put(self, message: Message) -> None:
        while not self._ended.is_set():
            try:
                return self._queue.put(message, timeout=0.1)
            except queue.Full:
                pass
        raise RunStoppedError

    @property
    def waiting(self) -> int:
        """Messages that wait to be taken."""
        return self._queue.qsize()

    def _run(self) -> None:
        while not self._ended.is_set():
            if not self.takes.wait(0.1):
                continue
            try:
                taken = [self._queue.get(timeout=0.05)]
            except queue.Empty:
                continue
            while len(taken) < 256 and not self._queue.empty():
                taken.append(self._queue.get())
            self.messages += taken
            if self.acknowledges:
                self.source.acknowledge(taken)

    def connected(self) -> None:
        """Wait until the source is connected."""
        wait_for(lambda: self.source.health.good, 30.0, lambda: f"a connection ({self.source.health.text})")

    def wait_for(self, count: int, seconds: float = 30.0) -> list[Message]:
        """Wait until that many messages have come, and return them all."""
        wait_for(lambda: len(self.messages) >= count, seconds, lambda: f"message {count} ({len(self.messages)} came)")
        return self.messages
