"""Messages from an MQTT broker, each acknowledged once its results are saved."""

from __future__ import annotations

import selectors
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from residua.errors import SettingError, missing_extra
from residua.live.secrets import check_secret, check_tls, secret, tls_context
from residua.live.setting_checks import check_types, choice, needed, texts, whole
from residua.live.source import LARGEST, Message
from residua.live.sources.adapter import BrokerSource
from residua.live.sources.topics import Topics

try:
    from paho.mqtt import client as paho
    from paho.mqtt.enums import CallbackAPIVersion, MQTTErrorCode
    from paho.mqtt.packettypes import PacketTypes
    from paho.mqtt.properties import Properties
    from paho.mqtt.subscribeoptions import SubscribeOptions
except ImportError as error:
    raise missing_extra("paho-mqtt", "mqtt") from error

#: Packets that are read before acknowledgements are sent and others get their turn.
_BURST = 500
#: Bytes of messages of which the same is true.
_BURST_BYTES = 4_000_000
#: Bytes that are read from the system at once.
_PIECE = 1 << 16
#: Bytes of messages that may wait for the run.
_MOST_BYTES = 64_000_000
#: Limit on packets given to the broker: messages over the usual limit are counted, up to this size.
_LARGEST_PACKET = 8 * LARGEST
#: Seconds that connecting may take, and that the last acknowledgements may take.
_CONNECTING, _LEAVING = 5.0, 2.0
#: How a packet that acknowledges begins.
_PUBACK = 4
_VERSIONS = {"5": paho.MQTTv5, "3.1.1": paho.MQTTv311}


@dataclass(frozen=True)
class Settings:
    """Settings of the broker, and of its topics.

    Attributes
    ----------
    client_id : str
        Name by which the broker recognises this run, and keeps messages while it is away: the same from run to run,
        and unique.
    topics : list of str
        Such as ``"plants/{plant}/data"`` for whole messages (with or without ``{plant}``), and
        ``"plants/{plant}/{channel}"`` for one channel a topic; ``+`` and ``#`` as in MQTT.
    plant : str
        The plant of topics without ``{plant}``, if messages do not name it.
    host : str
    port : int
        0: 1883, with TLS 8883.
    version : {"5", "3.1.1"}
        Of the protocol.
    qos : {1, 0}
        1: a message is repeated until it is acknowledged, once saved. 0: nothing is acknowledged, and messages that
        arrive while this run is away or has no room are lost. (2 would be acknowledged before it is saved, by the
        protocol; and the run drops repeats. Messages published with 2 arrive with 1.)
    username : str
    password_file, password_env : str
    tls : bool
        Whether to connect by TLS; certificates of the broker and its name are checked.
    ca_file : str
        Certificates of a certification authority of your own; empty: the system's.
    cert_file, key_file : str
        A certificate that this client shows, and its key.
    keepalive : int
        Seconds of silence after which either side asks whether the other is there.
    session_expiry : int
        Seconds for which the broker keeps messages while this run is away (version 5).
    receive_maximum : int
        Messages that may be on their way without being acknowledged (version 5; before it the broker's settings say).
    retained : bool
        Whether messages that the broker has kept from earlier are taken, when the connection is made.
    name : str
        Of the source; empty: ``"mqtt "``, host and port.

    Raises
    ------
    SettingError
    """

    client_id: str
    topics: tuple[str, ...]
    plant: str = ""
    host: str = "localhost"
    port: int = 0
    version: str = "5"
    qos: int = 1
    username: str = ""
    password_file: str = ""
    password_env: str = ""
    tls: bool = False
    ca_file: str = ""
    cert_file: str = ""
    key_file: str = ""
    keepalive: int = 30
    session_expiry: int = 7 * 86_400
    receive_maximum: int = 2000
    retained: bool = False
    name: str = ""

    def __post_init__(self) -> None:
        needed(self, "client_id", "a name for this run, under which the broker keeps messages while it is away")
        needed(self, "host", "the broker's host name or address")
        texts(self, "topics", needed="name at least one topic, such as 'plants/{plant}/data'")
        Topics(self.topics, self.plant)
        whole(self, "port", 0, 65_535)
        choice(self, "version", tuple(_VERSIONS))
        if self.qos == 2:
            raise SettingError(
                "qos: 2 takes a message over before it is saved, so that a kill loses it; 1 loses none, and the run "
                "drops what comes twice. What is published with 2 arrives with 1"
            )
        choice(self, "qos", (1, 0))
        check_tls(self)
        whole(self, "keepalive", 5, 65_535)
        whole(self, "session_expiry", 0, 2**32 - 1)
        whole(self, "receive_maximum", 1, 65_535)
        check_secret(self, "password")
        check_types(self)


class Mqtt(BrokerSource):
    """Source that subscribes to topics of a broker.

    One thread reads, acknowledges and keeps the connection alive, whatever the run is doing; another puts. With QoS 1
    the queue is bounded by ``receive_maximum``: the broker sends no more until some are acknowledged. With QoS 0 the
    socket is not read while there is no room, and when the connection would end, messages are dropped, which is
    reported. Of messages so large that 64 MB of them wait no more are read; if the connection ends of it, they come
    again.

    Parameters
    ----------
    settings : Settings

    Raises
    ------
    SettingError
        If the password cannot be read, or a certificate.

    Notes
    -----
    A message is acknowledged once: not on a connection that was made after it came, for there its number may be
    another's. It then comes again, and the run drops the repeat.
    """

    kind: ClassVar[str] = "mqtt"

    def __init__(self, settings: Settings) -> None:
        self._port = settings.port or (8883 if settings.tls else 1883)
        address = f"{settings.host}:{self._port}"
        super().__init__(
            settings.name or f"mqtt {address}", address, max(settings.receive_maximum, 2 * _BURST), _MOST_BYTES
        )
        self._settings = settings
        self._topics = Topics(settings.topics, settings.plant)
        self._password = secret(settings, "password")
        self._tls = tls_context(settings) if settings.tls else None
        self._safe: deque[Sequence[Message]] = deque()
        self._connections = 0
        self._dropping = False
        self._dropped = 0

    def acknowledge(self, messages: Sequence[Message]) -> None:
        """Acknowledge messages, in the thread of the connection."""
        if self._settings.qos:
            self._safe.append(messages)
            self.wake()

    def comes_again(self, message: Message) -> bool:
        """Tell whether the broker repeats a message: all but those of QoS 0."""
        return message.token is not None

    def serve(self) -> None:
        """Connect, read, acknowledge and answer until the connection is lost, or the run ends."""
        self._connections += 1
        connection = _Connection(self)
        try:
            connection.open()
            connection.serve()
        except Exception:
            connection.abandon()
            raise

    def connected(self, resumed: bool, granted: str) -> None:
        """Report the subscriptions."""
        self.backoff.reset()
        first = self._connections == 1
        kept = "" if resumed or first else "; the broker has not kept the session, messages may be lost"
        lost = f"; {self._dropped:,} messages of QoS 0 dropped: the queue was full" if self._dropped else ""
        self.say(True, f"connected to {self.address}{granted}{kept}{lost}")

    def drop(self, dropping: bool) -> None:
        """Begin or end to drop messages of QoS 0, and report how many were."""
        if dropping != self._dropping:
            self._dropping = dropping
            if not dropping:
                self.connected(True, "")


class _Client(paho.Client):
    """Client of paho that reads and acknowledges many messages by one system call.

    By itself it makes three calls to read a message, and one to acknowledge it; at each of them another thread that
    computes may keep it waiting for five milliseconds.

    Attributes
    ----------
    dry : bool
        Whether the last attempt to read has found nothing.
    """

    def __init__(self, *arguments: Any, **named: Any) -> None:
        self.dry = True
        self._held, self._used = b"", 0
        self._acknowledgements = bytearray()
        super().__init__(*arguments, **named)

    def _sock_recv(self, bufsize: int) -> bytes:
        used = self._used
        if used >= len(self._held):
            try:
                self._held = super()._sock_recv(_PIECE)
            except BlockingIOError:
                self.dry = True
                raise
            self.dry, used = False, 0
        self._used = used + bufsize
        return self._held[used : used + bufsize]

    def _sock_send(self, buf: bytes | bytearray) -> int:
        if buf[0] >> 4 == _PUBACK:
            self._acknowledgements += buf
            return len(buf)
        if not self.flush():  # a packet in progress must be finished first
            raise BlockingIOError
        return super()._sock_send(buf)

    def want_write(self) -> bool:
        """True if there is something to send."""
        return bool(self._acknowledgements) or super().want_write()

    def flush(self) -> bool:
        """Send acknowledgements; return whether all are sent.

        Raises
        ------
        OSError
            If the connection is lost.
        """
        if self._acknowledgements:
            try:
                del self._acknowledgements[: super()._sock_send(self._acknowledgements)]
            except BlockingIOError:
                return False
        return not self._acknowledgements


class _Connection:
    """One connection: from CONNECT until it is lost, or the run ends."""

    def __init__(self, source: Mqtt) -> None:
        self._source, self._settings = source, source._settings
        self._client = self._new_client()
        self._refusal = ""
        self._resumed = False
        self._ready = False
        self._events = 0
        self._burst: list[Message] = []
        self._burst_bytes = 0
        self._burst_time = time.time()

    def _new_client(self) -> _Client:
        settings = self._settings
        more = {} if settings.version == "5" else {"clean_session": False}
        client = _Client(
            CallbackAPIVersion.VERSION2,
            client_id=settings.client_id,
            protocol=_VERSIONS[settings.version],
            reconnect_on_failure=False,
            manual_ack=True,
            **more,
        )
        client.connect_timeout = _CONNECTING
        if settings.username or self._source._password is not None:
            client.username_pw_set(settings.username, self._source._password)
        if self._source._tls is not None:
            client.tls_set_context(self._source._tls)
        client.on_connect, client.on_subscribe = self._on_connect, self._on_subscribe
        client.on_disconnect = self._on_disconnect
        client.on_message = lambda _, __, message: self._take(message)
        client.on_socket_register_write = lambda *_: None  # else acknowledging writes at once, one by one
        return client

    def open(self) -> None:
        """Connect; the answer arrives in :meth:`serve`."""
        settings, more = self._settings, {}
        if settings.version == "5":
            properties = Properties(PacketTypes.CONNECT)
            properties.SessionExpiryInterval = settings.session_expiry
            properties.ReceiveMaximum = settings.receive_maximum
            properties.MaximumPacketSize = _LARGEST_PACKET
            more = {"clean_start": False, "properties": properties}
        self._client.connect(settings.host, self._source._port, settings.keepalive, **more)

    def serve(self) -> None:
        """Read, acknowledge and answer until the connection is lost, or the run ends."""
        longest, full_since = self._settings.keepalive / 3, 0.0
        opened, client, source = time.monotonic(), self._client, self._source
        with selectors.DefaultSelector() as selector:
            selector.register(source.waker, selectors.EVENT_READ)
            while not source.leaving:
                full, now = source.queue.full, time.monotonic()
                full_since = (full_since or now) if full else 0.0
                late = full and now - full_since > longest
                source.drop(late)
                reads = not full or (late and not (self._settings.qos and source.queue.heavy))
                self._wait(selector, reads)
                source.waker.clear()
                self._acknowledge()
                if reads:
                    self._read()
                if client.want_write():
                    self._check(client.loop_write())
                    client.flush()
                self._check(client.loop_misc())
                if not self._ready and time.monotonic() - opened > 2 * _CONNECTING:
                    raise ConnectionError("no answer")
        self._leave()

    def _wait(self, selector: selectors.BaseSelector, reads: bool) -> None:
        """Wait until there is something to read, to write or to acknowledge."""
        client = self._client
        socket = client.socket()
        if socket is None:
            raise ConnectionError(self._refusal or "the connection was lost")
        events = selectors.EVENT_READ * reads | selectors.EVENT_WRITE * client.want_write()
        if events != self._events:
            if self._events:
                selector.unregister(socket)
            if events:
                selector.register(socket, events)
            self._events = events
        selector.select(0 if reads and not client.dry else min(1.0, self._settings.keepalive / 5))

    def _read(self) -> None:
        """Read a burst of packets."""
        self._burst_time = time.time()
        try:
            for _ in range(_BURST):
                self._check(self._client.loop_read())
                if self._client.dry or self._burst_bytes > _BURST_BYTES:
                    break
        finally:
            if self._burst:
                self._source.queue.give(self._burst)
            self._burst, self._burst_bytes = [], 0

    def _take(self, message: paho.MQTTMessage) -> None:
        """Add a message to the burst in progress."""
        source = self._source
        token = (self, message.mid) if message.qos else None
        if source._dropping and token is None:
            source._dropped += 1
            return
        try:
            place = source._topics.place(message.topic)
        except UnicodeDecodeError:
            place = None
        payload, refused = bytes(message.payload), ""
        if place is None:
            refused, place = "topic", ("", "")
        elif message.retain and not self._settings.retained:
            refused = "retained"
        elif len(payload) > LARGEST:
            refused = "size"
        payload = b"" if refused else payload
        self._burst.append(Message(source, payload, self._burst_time, *place, None, token, refused))
        self._burst_bytes += len(payload)

    def _acknowledge(self) -> None:
        """Acknowledge the safe messages of this connection, in order."""
        safe = self._source._safe
        while safe:
            for message in safe.popleft():
                if message.token is not None and message.token[0] is self:
                    self._client.ack(message.token[1], 1)

    def _check(self, result: MQTTErrorCode) -> None:
        if result != paho.MQTT_ERR_SUCCESS or self._refusal:
            raise ConnectionError(self._refusal or paho.error_string(result).rstrip("."))

    def _leave(self) -> None:
        """Send the acknowledgements, and disconnect."""
        client, until = self._client, time.monotonic() + _LEAVING
        self._acknowledge()
        client.disconnect()
        while client.socket() is not None and time.monotonic() < until:
            if client.loop_write() != paho.MQTT_ERR_SUCCESS:
                break
            if client.socket() is not None:
                client.flush()
            time.sleep(0.005 if client.want_write() else 0)
        self.abandon()

    def abandon(self) -> None:
        """Close the socket without a message."""
        socket = self._client.socket()
        if socket is not None:
            socket.close()

    # Callbacks of paho.

    def _on_connect(self, client: paho.Client, _: Any, flags: Any, reason: Any, __: Any) -> None:
        if reason.is_failure:
            self._refusal = f"the broker refuses the connection: {reason}"
            return
        self._resumed = flags.session_present
        settings, source = self._settings, self._source
        if settings.version == "5":
            handling = (
                SubscribeOptions.RETAIN_SEND_ON_SUBSCRIBE if settings.retained else SubscribeOptions.RETAIN_DO_NOT_SEND
            )
            options = SubscribeOptions(qos=settings.qos, retainHandling=handling)
            client.subscribe([(one, options) for one in source._topics.filters])
        else:
            client.subscribe([(one, settings.qos) for one in source._topics.filters])

    def _on_subscribe(self, _: paho.Client, __: Any, ___: int, reasons: Any, ____: Any) -> None:
        refused = [topic for topic, one in zip(self._source._topics.filters, reasons, strict=False) if one.is_failure]
        if refused:
            self._refusal = f"the broker refuses the topics {', '.join(refused)}"
            return
        self._ready = True
        less = any(one.value < self._settings.qos for one in reasons)
        self._source.connected(self._resumed, "; it grants QoS 0 only, messages may be lost" if less else "")

    def _on_disconnect(self, _: paho.Client, __: Any, flags: Any, reason: Any, ___: Any) -> None:
        if flags.is_disconnect_packet_from_server:
            self._refusal = f"the broker has ended the connection: {reason}"


__all__ = ["Mqtt", "Settings"]
