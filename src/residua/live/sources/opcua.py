"""Values from the nodes of an OPC UA server, by subscription; a status that is not good is a missing value."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any, ClassVar
from urllib.parse import urlsplit

from residua.errors import SettingError, missing_extra
from residua.live.secrets import check_secret, secret
from residua.live.setting_checks import check_types, choice, file, number, table_of_texts, texts, whole
from residua.live.source import Message
from residua.live.sources.adapter import BrokerSource, reason_of
from residua.visible import echo

try:
    from asyncua import ua
    from asyncua.client.client import Client
    from asyncua.common.subscription import DataChangeEvent, StatusChangeEvent, Subscription
    from asyncua.crypto import security_policies
    from asyncua.ua.attribute_ids import AttributeIds
    from asyncua.ua.status_codes import StatusCodes
except ImportError as error:
    raise missing_extra("asyncua", "opcua") from error

#: Values that may wait for the run, beside those of one message of the server, and bytes of them.
_MOST, _MOST_BYTES = 20_000, 64_000_000
#: Nodes that are subscribed to in one request.
_AT_ONCE = 1000
#: Seconds that a request may take, and that leaving may take.
_TIMEOUT, _LEAVING = 10.0, 3.0
_POLICIES = ("", "Basic256Sha256", "Aes128Sha256RsaOaep", "Aes256Sha256RsaPss")


@dataclass(frozen=True)
class Settings:
    """Settings of the server, and of the node of each channel of each plant.

    Attributes
    ----------
    url : str
        ``opc.tcp://host:port/...``, without user and password.
    nodes : table
        For each plant a table from channel to node, such as ``{"north": {"level": "ns=2;s=north.level"}}``. Nodes are
        written ``ns=2;s=name``, ``ns=2;i=number``, or with the namespace by its address, ``nsu=http://...;s=name``.
    plants : list of str
        Plants whose nodes are called alike.
    channels : table
        Of these, from channel to node, with ``{plant}`` in it: ``{"level": "ns=2;s={plant}.level"}``.
    interval : float
        Seconds between notifications of the server.
    sampling : float
        Seconds between the server's looks at a node; 0: as fast as it can.
    queue : int
        Values of one node that the server keeps until it sends them: at least those of an interval.
    username : str
    password_file, password_env : str
    policy : {"", "Basic256Sha256", "Aes128Sha256RsaOaep", "Aes256Sha256RsaPss"}
        Protection of messages; empty: none, not even for a password.
    mode : {"SignAndEncrypt", "Sign"}
    cert_file, key_file : str
        The certificate of this client, and its key; with a policy.
    server_cert_file : str
        The certificate of the server: no other one is talked to; with a policy.
    application_uri : str
        As it stands in the certificate of this client.
    name : str
        Of the source; empty: ``"opcua "``, host and port.

    Raises
    ------
    SettingError
    """

    url: str
    nodes: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    plants: tuple[str, ...] = ()
    channels: Mapping[str, str] = field(default_factory=dict)
    interval: float = 0.2
    sampling: float = 0.0
    queue: int = 1000
    username: str = ""
    password_file: str = ""
    password_env: str = ""
    policy: str = ""
    mode: str = "SignAndEncrypt"
    cert_file: str = ""
    key_file: str = ""
    server_cert_file: str = ""
    application_uri: str = "urn:residua:live"
    name: str = ""

    def __post_init__(self) -> None:
        check_types(self)
        try:
            address = urlsplit(self.url)
            fits = address.scheme == "opc.tcp" and bool(address.hostname) and address.port is not None
        except ValueError:
            fits = False
        if not fits or "@" in self.url:
            raise SettingError("url: opc.tcp://host:port is expected, without user and password")
        texts(self, "plants")
        object.__setattr__(self, "channels", table_of_texts(self.channels, "channels"))
        if not isinstance(self.nodes, Mapping):
            raise SettingError("nodes: a table with a table for each plant is expected")
        tables = {str(plant): table_of_texts(one, f"nodes: {echo(plant)}") for plant, one in self.nodes.items()}
        object.__setattr__(self, "nodes", tables)
        if bool(self.plants) != bool(self.channels):
            raise SettingError("channels: plants whose nodes are called alike need both, plants and channels")
        if not self.table():
            raise SettingError("nodes: name at least one node")
        number(self, "interval", 0.01, 3600.0)
        number(self, "sampling", 0.0, 3600.0)
        whole(self, "queue", 1, 1_000_000)
        check_secret(self, "password")
        choice(self, "policy", _POLICIES)
        choice(self, "mode", ("SignAndEncrypt", "Sign"))
        for key in ("cert_file", "key_file", "server_cert_file"):
            file(self, key)
            if bool(getattr(self, key)) != bool(self.policy):
                raise SettingError(f"{key}: a policy needs cert_file, key_file and server_cert_file, and they a policy")

    def table(self) -> dict[str, list[tuple[str, str]]]:
        """Return the plants and channels of every node.

        Raises
        ------
        SettingError
            If a channel has two nodes, or a node is written as none.
        """
        out: dict[str, list[tuple[str, str]]] = {}
        alike = {plant: {c: one.replace("{plant}", plant) for c, one in self.channels.items()} for plant in self.plants}
        for plant in dict.fromkeys((*self.nodes, *alike)):
            for channel, node in (*self.nodes.get(plant, {}).items(), *alike.get(plant, {}).items()):
                _parsed(node)
                places = out.setdefault(node, [])
                if any((plant, channel) in one for one in out.values()):
                    raise SettingError(f"nodes: {channel} of {plant} has two nodes")
                places.append((plant, channel))
        return out


class OpcUa(BrokerSource):
    """Source that subscribes to nodes of a server, and to every change of value, status or source time of them.

    The time of a value is its source time, or else the server's; values without both have that of their arrival.
    While the run has no room the server is told not to send; it keeps ``queue`` values of each node.

    Parameters
    ----------
    settings : Settings

    Raises
    ------
    SettingError
        If the password cannot be read.

    Notes
    -----
    OPC UA has no acknowledgement: values sent while the connection is away, or a run is killed, are lost.
    """

    kind: ClassVar[str] = "opcua"

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings.name or f"opcua {urlsplit(settings.url).netloc}", settings.url, _MOST, _MOST_BYTES)
        self._settings = settings
        self._password = secret(settings, "password")
        self._places = settings.table()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._awake: asyncio.Event | None = None
        self._lost = ""

    def wake(self) -> None:
        """Wake the event loop, to check for changes."""
        loop, awake = self._loop, self._awake
        if loop is not None and awake is not None:
            with contextlib.suppress(RuntimeError):  # it has just ended
                loop.call_soon_threadsafe(awake.set)

    def serve(self) -> None:
        """Connect, and listen until the connection is lost."""
        asyncio.run(self._serve())

    async def _serve(self) -> None:
        self._loop, self._awake, self._lost = asyncio.get_running_loop(), asyncio.Event(), ""
        client = await self._connected()
        try:
            subscription, places, remark = await self._subscribed(client)
            self.backoff.reset()
            self.say(True, f"connected to {self.address}, {len(places):,} nodes{remark}")
            reader = asyncio.create_task(self._read(subscription, places))
            sends = True
            try:
                while not (self.leaving or self._lost):
                    if self.queue.full == sends:
                        sends = not sends
                        await subscription.set_publishing_mode(sends)
                    with contextlib.suppress(TimeoutError):
                        await asyncio.wait_for(self._awake.wait(), 0.5)
                        self._awake.clear()
                    if reader.done():
                        self._lost = reason_of(reader.exception() or ConnectionError("the subscription has ended"))
            finally:
                reader.cancel()
            if self._lost:
                raise ConnectionError(self._lost)
        finally:
            try:
                await asyncio.wait_for(client.disconnect(), _LEAVING)
            except Exception as error:  # the connection is given up in any case
                logging.getLogger(__name__).debug("leaving: %s", error)

    async def _connected(self) -> Client:
        settings = self._settings
        client = Client(settings.url, timeout=_TIMEOUT, watchdog_intervall=2.0)
        client.name = client.description = "residua live"
        client.application_uri = settings.application_uri
        if settings.policy:
            await client.set_security(
                getattr(security_policies, f"SecurityPolicy{settings.policy}"),
                settings.cert_file,
                settings.key_file,
                server_certificate=settings.server_cert_file,
                mode=getattr(ua.MessageSecurityMode, settings.mode),
            )
        if settings.username:
            client.set_user(settings.username)
        if self._password is not None:
            client.set_password(self._password)

        async def note(error: Exception) -> None:
            self._lost = reason_of(error)
            self.wake()

        client.connection_lost_callback = note
        await asyncio.wait_for(client.connect(), 2 * _TIMEOUT)
        return client

    async def _subscribed(self, client: Client) -> tuple[Subscription, dict[int, list[tuple[str, str]]], str]:
        """Subscribe to all nodes; return the channels of each handle, and the requests that the server refused."""
        subscription = await client.create_subscription(
            1000.0 * self._settings.interval,
            queue_maxsize=0,  # it is emptied after every message of the server
        )
        namespaces = await client.get_namespace_array()
        nodes = dict(enumerate(self._places, 1))
        ids = {handle: _resolved(node, namespaces) for handle, node in nodes.items()}
        refused = [f"{nodes[handle]}: its namespace does not exist" for handle, one in ids.items() if one is None]
        ids = {handle: one for handle, one in ids.items() if one is not None}
        answers = await self._monitored(subscription, ids, by_time=True)
        plain = {handle: ids[handle] for handle, answer in answers.items() if _is_about_filters(answer)}
        answers |= await self._monitored(subscription, plain, by_time=False)
        failed = {handle for handle, answer in answers.items() if isinstance(answer, ua.StatusCode)}
        refused += [f"{nodes[handle]}: {answers[handle].name}" for handle in sorted(failed)]
        places = {handle: self._places[nodes[handle]] for handle in answers.keys() - failed}
        if not places:
            raise ConnectionError(f"the server has none of the nodes: {'; '.join(refused[:3])}")
        remark = f"; {len(refused):,} are not there: {'; '.join(refused[:3])}" if refused else ""
        return subscription, places, remark + ("; values that do not change are not sent" if plain else "")

    async def _monitored(self, subscription: Subscription, ids: dict[int, Any], *, by_time: bool) -> dict[int, Any]:
        """Request values of nodes, many at once, and return the answers by handle."""
        answers: dict[int, Any] = {}
        handles = list(ids)
        for first in range(0, len(handles), _AT_ONCE):
            part = handles[first : first + _AT_ONCE]
            requests = [self._request(handle, ids[handle], by_time) for handle in part]
            answers |= zip(part, await subscription.create_monitored_items(requests), strict=True)
        return answers

    def _request(self, handle: int, node: Any, by_time: bool) -> ua.MonitoredItemCreateRequest:
        """Return the request for a node; ``by_time``: report equal values at later times too."""
        parameters = ua.MonitoringParameters()
        parameters.ClientHandle = ua.UInt32(handle)
        parameters.SamplingInterval = 1000.0 * self._settings.sampling
        parameters.QueueSize = ua.UInt32(self._settings.queue)
        parameters.DiscardOldest = True
        if by_time:
            parameters.Filter = ua.DataChangeFilter(Trigger=ua.DataChangeTrigger.StatusValueTimestamp)
        request = ua.MonitoredItemCreateRequest()
        request.ItemToMonitor = ua.ReadValueId(NodeId=node, AttributeId=AttributeIds.Value)
        request.MonitoringMode = ua.MonitoringMode.Reporting
        request.RequestedParameters = parameters
        return request

    async def _read(self, subscription: Subscription, places: Mapping[int, list[tuple[str, str]]]) -> None:
        """Read values; those that arrive together are given to the run together, in order of time."""
        burst: list[Message] = []

        def flush() -> None:
            burst.sort(key=lambda one: one.arrived if one.time is None else one.time)
            self.queue.give(burst)
            burst.clear()

        async for event in subscription:
            if isinstance(event, StatusChangeEvent):
                self._lost = f"the server has ended the subscription: {event.notification.Status}"
                self.wake()
            elif isinstance(event, DataChangeEvent):
                if not burst:
                    asyncio.get_running_loop().call_soon(flush)
                item = event.data.monitored_item
                content, refused = _number_of(item.Value)
                moment, arrived = _time_of(item.Value), time.time()
                for plant, channel in places.get(item.ClientHandle, ()):
                    burst.append(Message(self, content, arrived, plant, channel, moment, None, refused))


# ------------------------------------------------------------------ values


def _number_of(value: ua.DataValue) -> tuple[float, str]:
    """Return the number of a value, NaN if its status is not good, and the reason for a refusal."""
    if value.StatusCode is not None and not value.StatusCode.is_good():
        return math.nan, ""
    content = None if value.Value is None else value.Value.Value
    if content is None:
        return math.nan, ""
    if isinstance(content, bool | int | float):
        try:
            return float(content), ""
        except OverflowError:
            pass
    return math.nan, "number"


def _time_of(value: ua.DataValue) -> float | None:
    moment: datetime | None = value.SourceTimestamp or value.ServerTimestamp
    if moment is None:
        return None
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()


# ------------------------------------------------------------------ nodes


def _parsed(node: str) -> tuple[str, ua.NodeId]:
    """Return the address of the namespace of a node, if it is written with one, and its id."""
    address, rest = "", node
    if node.startswith("nsu="):
        address, _, rest = node.removeprefix("nsu=").rpartition(";")
    try:
        node_id = ua.NodeId.from_string(rest)
    except Exception as error:  # asyncua raises several kinds
        raise SettingError(f"nodes: {echo(node)} is not a node; 'ns=2;s=name' and 'ns=2;i=number' are") from error
    return address, node_id


def _resolved(node: str, namespaces: list[str]) -> ua.NodeId | None:
    address, node_id = _parsed(node)
    if not address:
        return node_id
    if address not in namespaces:
        return None
    return ua.NodeId(node_id.Identifier, ua.Int16(namespaces.index(address)), node_id.NodeIdType)


def _is_about_filters(answer: Any) -> bool:
    return isinstance(answer, ua.StatusCode) and answer.value in (
        StatusCodes.BadFilterNotAllowed,
        StatusCodes.BadMonitoredItemFilterUnsupported,
        StatusCodes.BadMonitoredItemFilterInvalid,
    )


__all__ = ["OpcUa", "Settings"]
