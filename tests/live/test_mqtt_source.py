"""Messages from a real MQTT broker: each once where all goes well, none lost where it does not."""

from __future__ import annotations

import json
import subprocess
import threading
import time
from pathlib import Path
from typing import Any

import pytest

paho = pytest.importorskip("paho.mqtt.client", reason="paho-mqtt is not installed")

from certificates import certificates  # noqa: E402
from live.brokers import Mosquitto, Run, free_port, publisher, running, wait_for  # noqa: E402
from residua.live.source import LARGEST  # noqa: E402
from residua.live.sources import mqtt  # noqa: E402
from residua.live.sources.mqtt import Mqtt, Settings  # noqa: E402

VERSIONS = pytest.mark.parametrize("version", ["5", "3.1.1"])


def settings(port: int, *topics: str, **more: Any) -> Settings:
    return Settings("run", topics or ("plants/{plant}/data",), host="127.0.0.1", port=port, **more)


def send(client: Any, first: int, count: int, qos: int = 1, topic: str = "plants/north/data") -> None:
    for k in range(first, first + count):
        info = client.publish(topic, json.dumps({"t": k}), qos=qos)
    info.wait_for_publish(30)


def times(run: Run) -> list[int]:
    return [json.loads(m.payload)["t"] for m in run.messages]


@VERSIONS
@pytest.mark.parametrize("qos", [0, 1, 2])
def test_every_message_comes_once_in_order(mosquitto: Mosquitto, version: str, qos: int) -> None:
    source = Mqtt(settings(mosquitto.port, version=version))
    with Run(source) as run:
        run.connected()
        with publisher(mosquitto.port) as client:
            send(client, 0, 500, qos)
        run.wait_for(500)
        time.sleep(0.2)
    assert times(run) == list(range(500))
    assert {(m.plant, m.channel, m.refused) for m in run.messages} == {("north", "", "")}
    assert all(isinstance(m.payload, bytes) and abs(m.arrived - time.time()) < 60 for m in run.messages)


@VERSIONS
def test_what_was_acknowledged_does_not_come_again_and_the_rest_does(mosquitto: Mosquitto, version: str) -> None:
    with Run(Mqtt(settings(mosquitto.port, version=version))) as run:
        run.connected()
        with publisher(mosquitto.port) as client:
            send(client, 0, 10)
        run.wait_for(10)
    with publisher(mosquitto.port) as client:
        send(client, 10, 30)  # while the run is away
    with Run(Mqtt(settings(mosquitto.port, version=version)), acknowledges=False) as run:
        run.wait_for(20)
        first = run.messages[:5]
        run.source.acknowledge(first)
        time.sleep(0.3)
    with Run(Mqtt(settings(mosquitto.port, version=version))) as run:
        run.wait_for(25)
        time.sleep(0.3)
    assert times(run) == list(range(15, 40))


@VERSIONS
def test_no_message_is_lost_when_the_broker_stops_and_starts(tmp_path: Path, version: str) -> None:
    with running(tmp_path, "max_queued_messages 0") as mosquitto:  # it drops those over a thousand else
        _interrupted(mosquitto, Mqtt(settings(mosquitto.port, version=version)))


def _interrupted(mosquitto: Mosquitto, source: Mqtt) -> None:
    with Run(source) as run, publisher(mosquitto.port) as client:
        run.connected()
        stop = threading.Event()
        sent: list[int] = []

        def publish() -> None:
            while not stop.is_set():
                client.publish("plants/north/data", json.dumps({"t": len(sent)}), qos=1)
                sent.append(len(sent))
                time.sleep(0.001)

        thread = threading.Thread(target=publish)
        thread.start()
        for k in range(3):
            run.wait_for(100 * (k + 1))
            mosquitto.stop()
            wait_for(lambda: not source.health.good, 20.0, "a word about the connection")
            time.sleep(0.1)
            mosquitto.start()
            run.connected()
        stop.set()
        thread.join()
        wait_for(lambda: len(set(times(run))) == len(sent), 10.0, lambda: f"{set(sent) - set(times(run))}")
    assert sorted(set(times(run))) == sent  # the publisher does not keep the order over an interruption


@pytest.mark.parametrize(("version", "qos"), [("5", 0), ("5", 1), ("3.1.1", 1)])
def test_a_run_that_takes_nothing_holds_up_the_broker_and_keeps_the_connection(
    mosquitto: Mosquitto,
    version: str,
    qos: int,
) -> None:
    source = Mqtt(settings(mosquitto.port, version=version, qos=qos, keepalive=5, receive_maximum=50))
    with Run(source, most=10) as run:
        run.connected()
        run.takes.clear()
        with publisher(mosquitto.port) as client:
            send(client, 0, 5000, qos)
        time.sleep(12.0)  # keepalive ends a connection after 10 s without an answer
        assert source.health.good
        assert not (mosquitto.folder / "mosquitto.log").read_text().count("timeout")
        assert (mosquitto.folder / "mosquitto.log").read_text().count("as run ") == 1  # connected once
        held = run.waiting + len(source.queue)
        # QoS 1: 50 (before version 5: 20) may be in flight; mosquitto 2.0.11 sends up to some hundred more when
        # acknowledgements reach it while it is published to.
        assert held <= (500 if qos else 1600), held
        run.takes.set()
        with publisher(mosquitto.port) as client:
            wait_for(lambda: not (source.queue or run.waiting or source._dropping))  # room again, and known
            send(client, 5000, 1, qos)
        wait_for(lambda: 5000 in times(run))
        assert ("messages of QoS 0 dropped: the queue was full" in source.health.text) == (not qos)
    came = times(run)
    assert came == sorted(set(came))
    if qos:  # mosquitto itself keeps 1000 and those on their way, and drops what comes then
        assert len(came) > 1000


def test_large_messages_that_wait_are_bounded_and_come_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mqtt, "_MOST_BYTES", 5_000_000)
    monkeypatch.setattr(mqtt, "_BURST_BYTES", 1_000_000)
    with running(tmp_path, "max_queued_messages 0") as mosquitto:
        source = Mqtt(settings(mosquitto.port, keepalive=5))
        with Run(source, most=1) as run:
            run.connected()
            run.takes.clear()
            with publisher(mosquitto.port) as client:
                for k in range(40):
                    client.publish("plants/north/data", str(k).encode() + b" " * 1_000_000, qos=1)
                wait_for(lambda: len(source.queue) >= 5)
                for _ in range(120):  # in which the connection ends, for want of an answer that is not read
                    assert len(source.queue) < 10
                    time.sleep(0.1)
                run.takes.set()
                wait_for(lambda: len({int(m.payload) for m in run.messages}) == 40, 60.0)  # pyright: ignore


# paho leaves the socket of a handshake that failed to the garbage collector, which closes it.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_tls_with_a_certificate_that_is_checked(tmp_path: Path) -> None:
    certificate, key = certificates(tmp_path)
    secured, plain = free_port(), free_port()
    lines = f"listener {plain} 127.0.0.1\nlistener {secured} 127.0.0.1\ncertfile {certificate}\nkeyfile {key}"
    with running(tmp_path, lines, plain):
        source = Mqtt(settings(secured, tls=True, ca_file=str(certificate)))
        with Run(source) as run:
            run.connected()
            with publisher(plain) as client:
                send(client, 0, 500)
                client.publish("plants/north/data", json.dumps({"t": 500}) + " " * 200_000, qos=1)
                send(client, 501, 500)
            run.wait_for(1001)
        assert times(run) == list(range(1001))
        for wrong in (settings(secured, tls=True), settings(secured)):  # another authority; no TLS
            source = Mqtt(wrong)
            with Run(source) as run:
                wait_for(lambda source=source: "tries again" in source.health.text)


def test_one_channel_to_a_topic(mosquitto: Mosquitto) -> None:
    source = Mqtt(settings(mosquitto.port, "plants/{plant}/data", "plants/{plant}/{channel}"))
    with Run(source) as run:
        run.connected()
        with publisher(mosquitto.port) as client:
            for topic, text in [("level", "1.5"), ("data", "{}"), ("flow", '{"t": 3, "value": null}')]:
                client.publish(f"plants/north/{topic}", text, qos=1).wait_for_publish(10)
        wait_for(lambda: run.messages and run.messages[-1].channel == "flow")
    came = [(m.plant, m.channel, m.payload) for m in run.messages]
    assert list(dict.fromkeys(came)) == [  # what fits two patterns may come twice
        ("north", "level", b"1.5"), ("north", "", b"{}"), ("north", "flow", b'{"t": 3, "value": null}'),
    ]  # fmt: skip


@VERSIONS
def test_foreign_topics_large_payloads_and_what_was_kept_are_refused_in_their_turn(
    mosquitto: Mosquitto,
    version: str,
) -> None:
    with publisher(mosquitto.port) as client:
        client.publish("plants/old/data", "{}", qos=1, retain=True).wait_for_publish(10)
        client.publish("plants/kept/data", "{}", qos=1, retain=True).wait_for_publish(10)
    with Run(Mqtt(settings(mosquitto.port, "plants/#", "plants/{plant}/data", version=version, retained=True))) as run:
        run.wait_for(2)  # the session now has another subscription than the next one
    source = Mqtt(settings(mosquitto.port, version=version))
    with Run(source) as run:
        run.connected()
        with publisher(mosquitto.port) as client:
            client.publish("plants/north/other", b"\xff\x00", qos=1)
            client.publish("plants/north/data", b"\xff\x00", qos=1)
            client.publish("plants/north/data", b"x" * (LARGEST + 1), qos=1)
            client.publish("plants/north/data", b"", qos=1)
            client.publish("plants/north/data", b"last", qos=1).wait_for_publish(10)
        wait_for(lambda: run.messages and run.messages[-1].payload == b"last")
    came = [(m.payload, m.refused) for m in run.messages if m.refused != "retained"]
    assert list(dict.fromkeys(came)) == [(b"", "topic"), (b"\xff\x00", ""), (b"", "size"), (b"", ""), (b"last", "")]
    assert sum(m.refused == "retained" for m in run.messages) == (0 if version == "5" else 2)
    with Run(Mqtt(settings(mosquitto.port, version=version))) as run:
        time.sleep(0.3)
    assert not [m for m in run.messages if m.refused != "retained"]  # they were acknowledged


def test_a_broker_that_is_not_there_is_waited_for(tmp_path: Path) -> None:
    broker = Mosquitto(tmp_path)
    source = Mqtt(settings(broker.port))
    with Run(source) as run:
        wait_for(lambda: "refused" in source.health.text)
        assert not source.health.good
        broker.start()
        try:
            run.connected()
        finally:
            broker.kill()


def test_passwords_come_from_a_file_and_a_wrong_one_is_said_without_it(tmp_path: Path) -> None:
    users = tmp_path / "users"
    users.touch()
    try:
        subprocess.run(["mosquitto_passwd", "-b", str(users), "plant", "right secret"], check=True, capture_output=True)
    except FileNotFoundError:
        pytest.skip("mosquitto_passwd is not installed")
    users.chmod(0o644)
    with running(tmp_path, f"allow_anonymous false\npassword_file {users}") as broker:
        for word, said in (("wrong secret", "Not authorized"), ("right secret", "connected")):
            file = tmp_path / "word"
            file.write_text(f"{word}\n")
            file.chmod(0o600)
            for version in ("5", "3.1.1"):
                source = Mqtt(settings(broker.port, username="plant", password_file=str(file), version=version))
                with Run(source):
                    wait_for(lambda source=source, said=said: said in source.health.text)
                    assert "secret" not in source.health.text


def test_topics_that_a_broker_refuses_are_said() -> None:
    """Mosquitto takes every subscription, and leaves out what is forbidden: its answer is put together here."""
    from paho.mqtt.packettypes import PacketTypes
    from paho.mqtt.reasoncodes import ReasonCode

    source = Mqtt(settings(1, "allowed/{plant}", "other/{plant}"))
    connection = mqtt._Connection(source)
    answers = [ReasonCode(PacketTypes.SUBACK, identifier=code) for code in (1, 0x87)]
    connection._on_subscribe(connection._client, None, 1, answers, None)
    with pytest.raises(ConnectionError, match=r"^the broker refuses the topics other/\+$"):
        connection._check(paho.MQTT_ERR_SUCCESS)
    source.stop()


def test_a_session_that_the_broker_has_lost_is_said(mosquitto: Mosquitto) -> None:
    source = Mqtt(settings(mosquitto.port))
    with Run(source) as run:
        run.connected()
        other = paho.Client(paho.CallbackAPIVersion.VERSION2, client_id="run")  # takes it over, and begins anew
        other.connect("127.0.0.1", mosquitto.port)
        other.loop_start()
        wait_for(lambda: "the broker has not kept the session" in source.health.text)
        other.disconnect()
        other.loop_stop()
