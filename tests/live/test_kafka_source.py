"""Messages from Kafka: librdkafka's mock of a cluster, which groups, assigns and keeps offsets as one does."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from typing import Any

import pytest

kafka = pytest.importorskip("confluent_kafka", reason="confluent-kafka is not installed")

from live.brokers import Run, wait_for  # noqa: E402
from residua.live.source import LARGEST  # noqa: E402
from residua.live.sources.kafka import Kafka, Settings  # noqa: E402


@pytest.fixture
def cluster() -> Iterator[str]:
    """The address of a broker; it lives as long as its producer."""
    producer = kafka.Producer({"test.mock.num.brokers": 1, "bootstrap.servers": "none", "log_level": 0})
    brokers = producer.list_topics(timeout=20).brokers
    yield str(next(iter(brokers.values()))).split("/")[0]
    producer.flush(1)
    del producer


def send(
    cluster: str, values: list[Any], topic: str = "plants", keys: list[Any] | None = None, partition: int = -1
) -> None:
    producer = kafka.Producer({"bootstrap.servers": cluster, "log_level": 0, "message.max.bytes": 20_000_000})
    for k, value in enumerate(values):
        producer.produce(topic, value=value, key=keys[k] if keys else None, partition=partition)
    assert producer.flush(30) == 0


def numbers(first: int, count: int) -> list[bytes]:
    return [json.dumps({"t": k}).encode() for k in range(first, first + count)]


def times(run: Run) -> list[int]:
    return [json.loads(m.payload)["t"] for m in run.messages]


def settings(cluster: str, *topics: str, **more: Any) -> Settings:
    return Settings((cluster,), "residua", topics or ("plants",), **more)


def committed(cluster: str, partition: int, group: str = "residua") -> int:
    consumer = kafka.Consumer({"bootstrap.servers": cluster, "group.id": group, "log_level": 0})
    try:
        return consumer.committed([kafka.TopicPartition("plants", partition)], timeout=20)[0].offset
    finally:
        consumer.close()


def test_every_message_comes_once_in_the_order_of_its_partition(cluster: str) -> None:
    source = Kafka(settings(cluster))
    keys = [f"plant {k % 5}" for k in range(1000)]
    send(cluster, numbers(0, 500), keys=keys[:500])
    with Run(source) as run:
        run.wait_for(500)
        send(cluster, numbers(500, 500), keys=keys[500:])
        run.wait_for(1000)
        time.sleep(0.3)
        assert source.health.good, source.health
    assert sorted(times(run)) == list(range(1000))
    for name in set(keys):
        mine = [k for k in times(run) if keys[k] == name]
        assert mine == sorted(mine)
    assert {(m.plant, m.channel, m.refused) for m in run.messages} == {("", "", "")}


def test_offsets_are_those_of_what_is_safe(cluster: str) -> None:
    send(cluster, numbers(0, 30), partition=0)
    with Run(Kafka(settings(cluster)), acknowledges=False) as run:
        run.wait_for(30)
        run.source.acknowledge(run.messages[:10])
        wait_for(lambda: committed(cluster, 0) == 10)
        run.source.acknowledge(run.messages[10:12])
    assert committed(cluster, 0) == 12  # when it ends, what was safe is committed
    with Run(Kafka(settings(cluster))) as run:
        run.wait_for(18)
        time.sleep(0.5)
    assert times(run) == list(range(12, 30))
    with Run(Kafka(settings(cluster))) as run:
        time.sleep(4.0)
    assert run.messages == []


def test_where_to_begin_when_the_group_is_new(cluster: str) -> None:
    send(cluster, numbers(0, 5), partition=0)
    source = Kafka(settings(cluster, start="latest"))
    with Run(source) as run:
        wait_for(lambda: source.health.good)
        time.sleep(2.0)
        send(cluster, numbers(5, 5), partition=0)
        run.wait_for(5)
    assert times(run) == list(range(5, 10))


def test_of_partitions_that_were_taken_away_nothing_is_acknowledged(cluster: str) -> None:
    for partition in range(4):
        send(cluster, numbers(100 * partition, 50), partition=partition)
    one, other = Kafka(settings(cluster)), Kafka(settings(cluster, name="other"))
    with Run(one, acknowledges=False) as first:
        first.wait_for(200)
        with Run(other, acknowledges=False) as second:
            second.wait_for(50, 60.0)
            wait_for(lambda: len(one._ours) == len(other._ours) == 2, 60.0)
            first.source.acknowledge(first.messages[:200])  # as they were before: of nobody's partitions now
            time.sleep(1.0)
            mine = set(other._ours)
            assert [committed(cluster, part) for _, part in mine] == [kafka.OFFSET_INVALID] * 2
            taken = [m for m in second.messages if m.token[0] in mine]
            assert sorted({m.token[0] for m in taken}) == sorted(mine)
            second.source.acknowledge(taken)
            wait_for(lambda: all(committed(cluster, part) == 50 for _, part in mine))
        wait_for(lambda: len(one._ours) == 4, 60.0)
        first.wait_for(300)  # its own again, from where they are safe
        repeated = [m.token[0] for m in first.messages[200:]]
        assert not set(repeated) & mine


def test_a_run_that_takes_nothing_holds_up_the_cluster_and_keeps_its_partitions(
    cluster: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("residua.live.sources.kafka._MOST", 50)
    monkeypatch.setattr("residua.live.sources.kafka._BURST", 20)
    source = Kafka(settings(cluster, session_timeout=6))
    with Run(source, most=10) as run:
        run.takes.clear()
        send(cluster, numbers(0, 2000), partition=0)
        wait_for(lambda: len(source.queue) >= 50)
        ours = dict(source._ours)
        time.sleep(8.0)
        assert len(source.queue) + run.waiting <= 100
        assert source._ours == ours
        assert source.health.good
        run.takes.set()
        run.wait_for(2000)
    assert times(run) == list(range(2000))


def test_topics_with_named_parts_keys_and_what_is_refused(cluster: str) -> None:
    send(cluster, [b"1.5"], "tags.north.level")
    send(cluster, [b"{}"], "plants.south.data")
    send(
        cluster,
        [b"a", b"b", b"c", None, b"x" * (LARGEST + 1), b"last"],
        "keyed",
        keys=["east", None, b"\xff", "east", "east", "east"],
        partition=0,
    )
    topics = ("tags.{plant}.{channel}", "plants.{plant}.data", "keyed")
    with Run(Kafka(settings(cluster, *topics, key_is_plant=True))) as run:
        run.wait_for(8, 60.0)
    came = {(m.plant, m.channel, m.payload, m.refused) for m in run.messages if m.token[0][0] != "keyed"}
    assert came == {("north", "level", b"1.5", ""), ("south", "", b"{}", "")}
    times = {m.time is None for m in run.messages if not m.channel}, [m.time for m in run.messages if m.channel]
    assert times[0] == {True}
    assert times[1][0] == pytest.approx(time.time(), abs=120)
    keyed = [(m.plant, m.payload, m.refused) for m in run.messages if m.token[0][0] == "keyed"]
    assert keyed == [
        ("east", b"a", ""), ("", b"", "plant"), ("", b"", "plant"), ("east", b"", "null"), ("east", b"", "size"),
        ("east", b"last", ""),
    ]  # fmt: skip


def test_a_cluster_or_a_topic_that_is_not_there_is_said(cluster: str) -> None:
    source = Kafka(settings("127.0.0.1:9"))
    with Run(source):
        wait_for(lambda: "tries again" in source.health.text)
        assert not source.health.good
    source = Kafka(settings(cluster, "absent"))
    with Run(source) as run:
        wait_for(lambda: "absent" in source.health.text, 30.0, lambda: source.health.text)
        assert not source.health.good
        send(cluster, [b"a"], "absent")
        run.wait_for(1, 60.0)
        assert source.health.good


def test_a_password_stays_out_of_what_is_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PLANT_WORD", "right secret")
    more = {"mechanism": "PLAIN", "username": "plant", "password_env": "PLANT_WORD"}
    source = Kafka(settings("127.0.0.1:9", **more))
    assert source._settings.consumer("right secret")["security.protocol"] == "sasl_plaintext"
    with Run(source):
        wait_for(lambda: "tries again" in source.health.text)
        assert "secret" not in source.health.text + source.name + repr(source._settings)
