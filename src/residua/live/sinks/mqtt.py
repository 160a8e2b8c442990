"""Events to an MQTT broker, each acknowledged by it."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar
from urllib.parse import quote

import paho.mqtt.client as mqtt
from paho.mqtt.enums import CallbackAPIVersion
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode

from residua.errors import SettingError
from residua.live.delivery import LONGEST_CALL, DeliveryError, Sink
from residua.live.events import Event
from residua.live.secrets import check_secret, check_tls, secret, tls_context
from residua.live.setting_checks import check_types, choice, needed, seconds, whole

#: Events that are on their way at once.
WINDOW = 100
_VERSIONS = {"3.1.1": mqtt.MQTTv311, "5": mqtt.MQTTv5}
#: Characters of a plant's id that mean something in a topic, and the percent sign that they are written with.
_SPECIAL = "%/+#"
#: Bytes of a topic, at most (a length of two bytes).
_LONGEST_TOPIC = 65_535


@dataclass(frozen=True)
class Settings:
    """Settings of the broker, and of the topic of events.

    Attributes
    ----------
    host : str
    port : int
        0: 8883 with TLS, else 1883.
    topic : str
        ``{plant}`` in it is replaced by the id of the plant, with ``/``, ``+``, ``#``, ``%`` and control characters
        percent-encoded: an id is one level.
    tls : bool
        Whether the connection is encrypted and the broker proves who it is.
    ca_file : str
        Certificates of a certification authority of your own; empty: those of the system.
    username, password_file, password_env : str
    version : str
        ``"5"`` or ``"3.1.1"``. Before 5 a broker that does not allow a topic says nothing of it.
    timeout : float
        Seconds until the broker must have answered.
    name : str
        Of the sink; empty: ``"mqtt "``, host and port.

    Raises
    ------
    SettingError
    """

    host: str
    port: int = 0
    topic: str = "residua/{plant}/events"
    tls: bool = False
    ca_file: str = ""
    username: str = ""
    password_file: str = ""
    password_env: str = ""
    version: str = "5"
    timeout: float = 10.0
    name: str = ""

    def __post_init__(self) -> None:
        check_types(self)
        seconds(self, "timeout")
        needed(self, "host", "the broker must be named")
        whole(self, "port", 0, 65_535)
        if not self.topic or any(c in self.topic for c in "+#\0"):
            raise SettingError(f"topic: not empty, and without +, # and NUL, not {self.topic!r}")
        check_tls(self)
        choice(self, "version", tuple(_VERSIONS))
        check_secret(self, "password")
        if (self.password_file or self.password_env) and not self.username:
            raise SettingError("username: a password is sent with the name of a user")


def topic_of(pattern: str, plant: str) -> str:
    """Return the topic of a plant's events.

    Examples
    --------
    >>> topic_of("residua/{plant}/events", "hall 3/pump")
    'residua/hall 3%2Fpump/events'
    """
    level = "".join(
        c if c.isprintable() and c not in _SPECIAL else quote(c, safe="", errors="surrogatepass") for c in plant
    )
    return pattern.replace("{plant}", level)


@dataclass(eq=False)
class _Connection:
    """One connection to the broker; after any failure it is abandoned, with all messages in flight."""

    client: mqtt.Client
    acknowledged: set[int] = field(default_factory=set)
    trouble: str = ""
    open: bool = False
    changed: threading.Condition = field(default_factory=threading.Condition)

    def on_connect(self, client: Any, data: Any, flags: Any, reason: ReasonCode, more: Properties | None) -> None:
        with self.changed:
            self.open = not reason.is_failure
            self.trouble = f"does not let this sink in ({reason})" if reason.is_failure else ""
            self.changed.notify_all()

    def on_disconnect(self, client: Any, data: Any, flags: Any, reason: ReasonCode, more: Properties | None) -> None:
        with self.changed:
            self.open = False
            self.trouble = self.trouble or f"has ended the connection ({reason})"
            self.changed.notify_all()

    def on_publish(self, client: Any, data: Any, number: int, reason: ReasonCode, more: Properties | None) -> None:
        with self.changed:
            if reason.is_failure:
                self.trouble = f"refuses the event ({reason})"
            else:
                self.acknowledged.add(number)
            self.changed.notify_all()

    def wait(self, done: Any, seconds: float) -> bool:
        """Wait for a condition, trouble, or the end of the time; return the condition."""
        with self.changed:
            self.changed.wait_for(lambda: done() or bool(self.trouble), seconds)
            return bool(done())


class Mqtt(Sink):
    """Sink that publishes events with quality of service 1; acknowledged by the broker means delivered.

    The connection is made with the first event and kept; after any failure a new one is made, and what was not
    acknowledged is published again. Messages are not retained: whoever subscribes later does not get old alarms for new
    ones.

    Parameters
    ----------
    settings : Settings

    Raises
    ------
    SettingError
        If the password or the certificates cannot be read.
    """

    kind: ClassVar[str] = "mqtt"

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._port = settings.port or (8883 if settings.tls else 1883)
        self._where = f"the broker at {settings.host}:{self._port}"
        self.name = settings.name or f"mqtt {settings.host}:{self._port}"
        self._password = secret(settings, "password")
        self._context = tls_context(settings) if settings.tls else None
        self._connection: _Connection | None = None

    def deliver(self, events: Sequence[Event]) -> int:
        """Publish events, and return how many from the first on the broker acknowledged.

        Raises
        ------
        DeliveryError
            If not even the first one: no connection, no answer in time, or not allowed.
        """
        over = time.monotonic() + min(2 * self._settings.timeout, LONGEST_CALL)
        try:
            connection = self._connected()
            client, numbers = connection.client, list[int]()
            for event in events[:WINDOW]:
                topic = topic_of(self._settings.topic, event.plant)
                if len(topic.encode()) > _LONGEST_TOPIC:
                    raise DeliveryError(f"{self._where} cannot take an id of {len(event.plant)} characters in a topic")
                numbers.append(client.publish(topic, event.to_json().encode(), qos=1).mid)
            connection.wait(lambda: connection.acknowledged.issuperset(numbers), over - time.monotonic())
            done = next((k for k, n in enumerate(numbers) if n not in connection.acknowledged), len(numbers))
            connection.acknowledged.difference_update(numbers)
            if done < len(numbers):
                trouble = connection.trouble
                self.close()
                if not done:
                    raise DeliveryError(f"{self._where} {trouble or 'did not acknowledge in time'}")
            return done
        except (OSError, ValueError) as error:
            self.close()
            raise DeliveryError(f"{self._where} cannot be reached: {error}") from error

    def _connected(self) -> _Connection:
        if self._connection is not None and self._connection.open:
            return self._connection
        self.close()
        settings = self._settings
        client = mqtt.Client(
            CallbackAPIVersion.VERSION2, protocol=_VERSIONS[settings.version], reconnect_on_failure=False
        )
        client.connect_timeout = settings.timeout
        if settings.username:
            client.username_pw_set(settings.username, self._password)
        if self._context is not None:
            client.tls_set_context(self._context)
        connection = self._connection = _Connection(client)
        client.on_connect, client.on_disconnect = connection.on_connect, connection.on_disconnect
        client.on_publish = connection.on_publish
        client.connect(settings.host, self._port, keepalive=30)
        client.loop_start()
        if not connection.wait(lambda: connection.open, settings.timeout):
            trouble = connection.trouble
            self.close()
            raise DeliveryError(f"{self._where} {trouble or 'did not answer in time'}")
        return connection

    def close(self) -> None:
        """Disconnect from the broker."""
        if self._connection is not None:
            client, self._connection = self._connection.client, None
            client.disconnect()
            client.loop_stop()
