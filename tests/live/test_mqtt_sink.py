"""Events to a real broker: acknowledged before they count as delivered, whatever becomes of the connection."""

from __future__ import annotations

import json
import shutil
import socket
import subprocess
import threading
import time

import pytest

from live.brokers import running
from receiver import events
from residua.errors import SettingError
from residua.live.delivery import DeliveryError
from residua.live.events import Event

paho = pytest.importorskip("paho.mqtt.client", reason="paho-mqtt, of the extra 'mqtt', is not installed")

from residua.live.sinks import mqtt as sink  # noqa: E402


class Subscriber:
    """Keeps what it gets of a broker."""

    def __init__(self, port: int) -> None:
        self.got: list[tuple[str, bytes]] = []
        self._ready = threading.Event()
        self._client = paho.Client(paho.CallbackAPIVersion.VERSION2, client_id="a subscriber", clean_session=False)
        self._client.on_connect = lambda client, *_: client.subscribe("#", qos=1)
        self._client.on_subscribe = lambda *_: self._ready.set()
        self._client.on_message = lambda client, data, message: self.got.append((message.topic, message.payload))
        self._client.connect("127.0.0.1", port)
        self._client.loop_start()
        assert self._ready.wait(10)

    def numbers(self, count: int) -> list[int]:
        """Return the numbers of the first events, once so many are there."""
        for _ in range(500):
            if len(self.got) >= count:
                break
            time.sleep(0.02)
        return [json.loads(payload)["number"] for _, payload in self.got]

    def close(self) -> None:
        self._client.disconnect()
        self._client.loop_stop()


@pytest.fixture
def broker(tmp_path):
    with running(tmp_path) as made:
        yield made


@pytest.mark.parametrize("version", ["5", "3.1.1"])
def test_events_arrive_in_order_under_the_topic_of_their_plant(broker, version):
    subscriber = Subscriber(broker.port)
    made = sink.Mqtt(sink.Settings("127.0.0.1", broker.port, version=version))
    assert made.name == f"mqtt 127.0.0.1:{broker.port}"
    assert made.deliver(events(3)) == 3
    assert made.deliver([Event(4, "hall 3/pump+#%", 1, "ended", 50.0)]) == 1
    assert subscriber.numbers(4) == [1, 2, 3, 1]
    assert [topic for topic, _ in subscriber.got] == ["residua/north/events"] * 3 + [
        "residua/hall 3%2Fpump%2B%23%25/events"
    ]
    assert subscriber.got[0][1].decode() == events(1)[0].to_json()
    made.close()
    subscriber.close()


def test_a_broker_that_goes_and_comes_loses_nothing(broker):
    subscriber = Subscriber(broker.port)
    made = sink.Mqtt(sink.Settings("127.0.0.1", broker.port, timeout=2.0))
    assert made.deliver(events(2)) == 2
    assert subscriber.numbers(2) == [1, 2]
    broker.stop()
    for _ in range(2):
        with pytest.raises(DeliveryError, match=f"the broker at 127.0.0.1:{broker.port}"):
            made.deliver(events(4)[2:])
    broker.start()
    assert made.deliver(events(4)[2:]) == 2
    numbers = subscriber.numbers(4)
    assert sorted(set(numbers)) == [1, 2, 3, 4]
    made.close()
    subscriber.close()


def test_a_long_backlog_goes_in_pieces(broker):
    many, done = events(350), 0
    made = sink.Mqtt(sink.Settings("127.0.0.1", broker.port))
    while done < len(many):
        count = made.deliver(many[done:])
        assert 0 < count <= sink.WINDOW
        done += count
    made.close()


def test_passwords_and_what_a_broker_does_not_allow(tmp_path, monkeypatch):
    passwords, allowed = tmp_path / "passwords", tmp_path / "allowed"
    tool = shutil.which("mosquitto_passwd")
    if tool is None:
        pytest.skip("no mosquitto_passwd on this machine")
    subprocess.run([tool, "-c", "-b", str(passwords), "residua", "right and secret"], check=True, capture_output=True)
    allowed.write_text("user residua\ntopic write residua/north/events\n")
    lines = f"allow_anonymous false\npassword_file {passwords}\nacl_file {allowed}"
    monkeypatch.setenv("RIGHT", "right and secret")
    monkeypatch.setenv("WRONG", "wrong and secret")
    with running(tmp_path, lines) as broker:
        here = {"host": "127.0.0.1", "port": broker.port, "timeout": 3.0}
        made = sink.Mqtt(sink.Settings(**here, username="residua", password_env="RIGHT"))
        assert made.deliver(events(1)) == 1
        with pytest.raises(DeliveryError, match=r"refuses the event \(Not authorized\)"):
            made.deliver(events(1, "south"))
        assert made.deliver([*events(1), *events(1, "south")]) == 1
        made.close()
        for wrong in ({}, {"username": "residua", "password_env": "WRONG"}):
            made = sink.Mqtt(sink.Settings(**here, **wrong))
            with pytest.raises(DeliveryError, match=r"does not let this sink in \((Not authorized|Bad)") as caught:
                made.deliver(events(1))
            assert "secret" not in str(caught.value)


def test_a_broker_that_never_answers_is_left_in_time():
    with socket.create_server(("127.0.0.1", 0)) as listening:
        made = sink.Mqtt(sink.Settings("127.0.0.1", listening.getsockname()[1], timeout=0.5))
        begun = time.monotonic()
        with pytest.raises(DeliveryError, match="did not answer in time"):
            made.deliver(events(1))
        assert time.monotonic() - begun < 5.0
        made.close()


def test_what_cannot_be_read_is_said_before_anything_is_opened(tmp_path):
    with pytest.raises(SettingError, match="NO_SUCH"):
        sink.Mqtt(sink.Settings("b", username="u", password_env="NO_SUCH"))
    with pytest.raises(SettingError, match="ca_file"):
        sink.Mqtt(sink.Settings("b", tls=True, ca_file=str(tmp_path / "none")))
