"""Messages from Kafka, with offsets committed once their results are saved."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from residua.errors import SettingError, missing_extra
from residua.live.secrets import check_secret, check_tls, secret
from residua.live.setting_checks import check_types, choice, needed, texts, whole
from residua.live.source import LARGEST, Message
from residua.live.sources.adapter import BrokerSource, reason_of
from residua.live.sources.topics import Topics

try:
    from confluent_kafka import TIMESTAMP_CREATE_TIME, Consumer, KafkaError, KafkaException, TopicPartition
except ImportError as error:
    raise missing_extra("confluent-kafka", "kafka") from error

#: Messages that are read at once, and that may wait for the run, with the bytes of them.
_BURST, _MOST, _MOST_BYTES = 1000, 10_000, 64_000_000
#: Kilobytes that librdkafka fetches ahead of the reading.
_AHEAD = 16_384
#: Seconds that a poll for messages takes, and between commits.
_POLL, _COMMIT_EVERY = 0.1, 0.2
#: Seconds between requests to a cluster that was away.
_ASK_EVERY = 2.0

#: A topic and a partition of it.
_Part = tuple[str, int]


@dataclass(frozen=True)
class Settings:
    """Settings of the cluster, and of its topics.

    Attributes
    ----------
    servers : list of str
        ``"host:port"`` of some of its brokers.
    group : str
        The consumer group: the name under which the cluster keeps the progress of this run. No other run may have it:
        each would get some of the partitions only.
    topics : list of str
        Such as ``"plants"`` or ``"plants.{plant}.data"`` for whole messages, and ``"plants.{plant}.{channel}"`` for one
        channel a topic.
    plant : str
        The plant of topics without ``{plant}``, where messages do not say it.
    key_is_plant : bool
        Whether the key of a message is its plant, where its topic does not say it.
    start : {"earliest", "latest"}
        Where to begin when the group is new, or its offset is gone.
    instance : str
        The name of this process in its group, if it shall have its partitions back at once after a kill; without one
        the cluster waits for ``session_timeout``.
    session_timeout : int
        Seconds after which the cluster takes this run for dead.
    tls : bool
    ca_file, cert_file, key_file : str
        As of MQTT.
    mechanism : {"", "PLAIN", "SCRAM-SHA-256", "SCRAM-SHA-512"}
        How to say who this is; empty: not at all.
    username : str
    password_file, password_env : str
    name : str
        Of the source; empty: ``"kafka "`` and the first of ``servers``.

    Raises
    ------
    SettingError
    """

    servers: tuple[str, ...]
    group: str
    topics: tuple[str, ...]
    plant: str = ""
    key_is_plant: bool = False
    start: str = "earliest"
    instance: str = ""
    session_timeout: int = 10
    tls: bool = False
    ca_file: str = ""
    cert_file: str = ""
    key_file: str = ""
    mechanism: str = ""
    username: str = ""
    password_file: str = ""
    password_env: str = ""
    name: str = ""

    def __post_init__(self) -> None:
        texts(self, "servers", needed="name at least one broker, host:port")
        if any("," in one or "@" in one or not one.rpartition(":")[2].isdigit() for one in self.servers):
            raise SettingError("servers: a list of host:port is expected")
        needed(self, "group", "the name under which the cluster keeps the progress of this run")
        texts(self, "topics", needed="name at least one topic")
        Topics(self.topics, self.plant, dotted=True)
        bare = [one for one in self.topics if "{channel}" in one and "{plant}" not in one]
        if bare and not self.plant and not self.key_is_plant:
            raise SettingError(
                f"topics: topic {bare[0]} does not identify the plant: add {{plant}} to it, or set plant or "
                "key_is_plant"
            )
        choice(self, "start", ("earliest", "latest"))
        whole(self, "session_timeout", 6, 300)
        check_tls(self)
        choice(self, "mechanism", ("", "PLAIN", "SCRAM-SHA-256", "SCRAM-SHA-512"))
        check_secret(self, "password")
        check_types(self)
        if bool(self.mechanism) != bool(self.username) or bool(self.mechanism) != bool(
            self.password_file or self.password_env
        ):
            raise SettingError("mechanism: with username and password_file or password_env, or none of them")

    def consumer(self, password: str | None) -> dict[str, Any]:
        """Return the settings in the form of librdkafka."""
        out: dict[str, Any] = {
            "bootstrap.servers": ",".join(self.servers),
            "group.id": self.group,
            "auto.offset.reset": self.start,
            "enable.auto.commit": False,
            "enable.auto.offset.store": False,
            "session.timeout.ms": 1000 * self.session_timeout,
            "heartbeat.interval.ms": min(3000, 300 * self.session_timeout),
            "queued.max.messages.kbytes": _AHEAD,
            "topic.metadata.refresh.interval.ms": 30_000,
            "client.id": "residua-live",
            "log_level": 3,
        }
        if self.instance:
            out["group.instance.id"] = self.instance
        protocol = ("sasl_" if self.mechanism else "") + ("ssl" if self.tls else "plaintext")
        out["security.protocol"] = protocol
        if self.mechanism:
            out |= {"sasl.mechanism": self.mechanism, "sasl.username": self.username, "sasl.password": password}
        for key, theirs in (("ca_file", "ca"), ("cert_file", "certificate"), ("key_file", "key")):
            if getattr(self, key):
                out[f"ssl.{theirs}.location"] = getattr(self, key)
        return out


class Kafka(BrokerSource):
    """Source that reads topics as the only member of a consumer group.

    An offset is committed when the message before it is safe, for each partition by itself. Of a partition that was
    taken away nothing is committed any more: its messages that are not safe come again, here or elsewhere, and the run
    drops what it has. While the run has no room the partitions are paused, and the group is kept.

    Parameters
    ----------
    settings : Settings

    Raises
    ------
    SettingError
        If the password cannot be read, or librdkafka refuses the settings.
    """

    kind: ClassVar[str] = "kafka"

    def __init__(self, settings: Settings) -> None:
        address = settings.servers[0]
        super().__init__(settings.name or f"kafka {address}", address, _MOST, _MOST_BYTES)
        self._settings = settings
        self._password = secret(settings, "password")
        self._topics = Topics(settings.topics, settings.plant, dotted=True)
        self._lock = threading.Lock()
        #: By partition: since which assignment it is ours, and the offset that is to be committed.
        self._ours: dict[_Part, int] = {}
        self._safe: dict[_Part, int] = {}
        self._assignments = 0
        self._paused = False
        self._away = ""
        self._asked = 0.0

    def acknowledge(self, messages: Sequence[Message]) -> None:
        """Note the safe offset of each partition; the reading thread commits it soon."""
        with self._lock:
            for message in messages:
                part, offset, assignment = message.token
                if assignment is not None and self._ours.get(part) == assignment:
                    self._safe[part] = offset + 1

    def comes_again(self, message: Message) -> bool:
        """Tell whether a message comes again with the next consumer: all that are not safe."""
        return True

    def serve(self) -> None:
        """Read as one consumer until the run ends, or librdkafka gives up."""
        self._away, self._paused = "no answer yet", False
        configuration = self._settings.consumer(self._password) | {"error_cb": self._note}
        consumer = Consumer(configuration, logger=logging.getLogger("residua.live.kafka"))
        try:
            consumer.subscribe(
                list(self._topics.filters), on_assign=self._assigned, on_revoke=self._revoked, on_lost=self._lost
            )
            committed = 0.0
            while not self.leaving:
                self._hold(consumer, self.queue.full)
                polled = consumer.consume(_BURST, _POLL)
                if polled:
                    self._take(polled)
                if self._safe and time.monotonic() - committed > _COMMIT_EVERY:
                    committed = time.monotonic()
                    self._commit(consumer, asynchronous=True)
                if self._away:
                    self._ask(consumer)
            self._commit(consumer, asynchronous=False)
        except KafkaException as error:
            raise ConnectionError(_reason_of(error)) from error
        finally:
            with self._lock:
                self._ours.clear()
                self._safe.clear()
            self.queue.drop(self.comes_again)  # before a rebalance
            consumer.close()

    def _hold(self, consumer: Consumer, full: bool) -> None:
        """Pause all partitions while there is no room, and resume when there is."""
        if full != self._paused:
            parts = consumer.assignment()
            if full:
                consumer.pause(parts)
            else:
                consumer.resume(parts)
            self._paused = full

    def _take(self, polled: list[Any]) -> None:
        burst, now, key_is_plant = [], time.time(), self._settings.key_is_plant
        for one in polled:
            if one.error() is not None:
                self._note(one.error())
                continue
            part = (one.topic(), one.partition())
            place = self._topics.place(part[0])
            payload, refused = one.value(), ""
            plant, channel = place or ("", "")
            if not plant and key_is_plant:
                plant = _key(one.key())
                refused = "" if plant else "plant"
            if place is None:
                refused = "topic"
            elif payload is None:
                refused = "null"
            elif len(payload) > LARGEST:
                refused = "size"
            moment = None
            if channel:
                kind, milliseconds = one.timestamp()
                moment = milliseconds / 1000 if kind == TIMESTAMP_CREATE_TIME else None
            token = (part, one.offset(), self._ours.get(part))
            burst.append(Message(self, b"" if refused else payload or b"", now, plant, channel, moment, token, refused))
        if burst:
            self._here()
            self.queue.give(burst)

    def _commit(self, consumer: Consumer, asynchronous: bool, only: set[_Part] | None = None) -> None:
        with self._lock:
            parts = [part for part in self._safe if only is None or part in only]
            offsets = [TopicPartition(*part, self._safe.pop(part)) for part in parts]
        if not offsets:
            return
        try:
            consumer.commit(offsets=offsets, asynchronous=asynchronous)
        except KafkaException as error:  # they come again, and the run drops repeats
            self.say(False, f"{self.address}: offsets could not be committed: {_reason_of(error)}")

    # ------------------------------------------------------------------ callbacks of librdkafka, while reading

    def _assigned(self, consumer: Consumer, parts: list[TopicPartition]) -> None:
        self._assignments += 1
        with self._lock:
            self._ours |= {(one.topic, one.partition): self._assignments for one in parts}
        self._paused = False  # those that are new are not: all are paused again if there is no room
        self.backoff.reset()
        self._here()

    def _revoked(self, consumer: Consumer, parts: list[TopicPartition]) -> None:
        self._commit(consumer, False, {(one.topic, one.partition) for one in parts})
        self._lost(consumer, parts)

    def _lost(self, _: Consumer, parts: list[TopicPartition]) -> None:
        gone = {(one.topic, one.partition) for one in parts}
        with self._lock:
            for part in gone:
                self._ours.pop(part, None)
                self._safe.pop(part, None)
        self.queue.drop(lambda message: message.token[0] in gone)

    def _note(self, error: KafkaError) -> None:
        if error.code() == KafkaError._PARTITION_EOF:
            return
        self._away = error.str()
        self.say(False, f"{self.address}: {error.str()}; tries again")

    def _here(self) -> None:
        self._away = ""
        self.say(True, f"connected to {self.address}, {len(self._ours):,} partitions")

    def _ask(self, consumer: Consumer) -> None:
        """Check whether a cluster is back: without messages there is no other sign of it."""
        if time.monotonic() - self._asked > _ASK_EVERY:
            self._asked = time.monotonic()
            try:
                known = consumer.list_topics(timeout=0.5).topics
            except KafkaException:
                return
            plain = [topic for topic in self._topics.filters if not topic.startswith("^")]
            absent = [topic for topic in plain if topic not in known or known[topic].error is not None]
            if absent:
                self.say(False, f"{self.address}: there is no topic {', '.join(absent)}; waits for it")
            elif self._ours:
                self._here()


def _key(key: bytes | str | None) -> str:
    """Return the plant of a key; empty if it is none."""
    try:
        return key.decode() if isinstance(key, bytes) else key or ""
    except UnicodeDecodeError:
        return ""


def _reason_of(error: KafkaException) -> str:
    inner = error.args[0] if error.args else None
    return inner.str() if isinstance(inner, KafkaError) else reason_of(error)


__all__ = ["Kafka", "Settings"]
