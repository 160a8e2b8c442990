"""Server of a run: the page, its events, the metrics and the health, for anyone with the token."""

from __future__ import annotations

import asyncio
import os
import secrets
import socket
import threading
from dataclasses import dataclass
from ipaddress import ip_address
from typing import Any

import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

from residua.errors import SettingError
from residua.live.access import OWN_NAMES, AccessControl
from residua.live.routes import Routes
from residua.live.secrets import check_secret, secret
from residua.live.setting_checks import check_types
from residua.live.view import View

#: Connections at once, at most: beyond, the one that has been idle longest is closed.
MOST_CONNECTIONS = 200
#: Seconds that a connection may stand without a whole request.
IDLE = 15
#: Bytes of the head of a request, at most.
LARGEST_HEAD = 16_384
#: Characters of a token, at least.
SHORTEST_TOKEN = 20


@dataclass(frozen=True)
class Settings:
    """Settings of the server: address and access.

    Attributes
    ----------
    listen : str
        Address and port, ``"127.0.0.1:8000"`` or ``"[::1]:8000"``; port 0 is a free one. Another address than this
        machine's own to itself is reached from elsewhere: put a proxy with HTTPS before it.
    token_file, token_env : str
        The token; without them each run makes a new one.
    hosts : tuple of str
        Further names that the server is reached by, such as that of a proxy, with or without a port.
    https : bool
        Whether browsers reach it by HTTPS, through a proxy.
    per_plant : bool
        Whether the metrics have a series for each plant.

    Raises
    ------
    SettingError
    """

    listen: str = "127.0.0.1:0"
    token_file: str = ""
    token_env: str = ""
    hosts: tuple[str, ...] = ()
    https: bool = False
    per_plant: bool = False

    def __post_init__(self) -> None:
        check_types(self)
        address_of(self.listen)
        check_secret(self, "token")
        if not all(host and "/" not in host for host in self.hosts):
            raise SettingError("hosts: names such as 'alarms.example.org' are expected, without https://")


def address_of(listen: str) -> tuple[str, int]:
    """Return the host and port of an address to listen on.

    Raises
    ------
    SettingError

    Examples
    --------
    >>> address_of("127.0.0.1:8000"), address_of("[::1]:0")
    (('127.0.0.1', 8000), ('::1', 0))
    """
    host, _, port = listen.rpartition(":")
    try:
        number = ip_address(host.removeprefix("[").removesuffix("]") if host != "localhost" else "127.0.0.1")
        if not (port.isascii() and port.isdigit() and int(port) < 65536):
            raise ValueError(port)
    except ValueError:
        raise SettingError(f"listen: an address and a port, such as '127.0.0.1:8000', not {listen!r}") from None
    return str(number), int(port)


class Server:
    """Server in its own thread, from :meth:`start` to :meth:`stop`.

    Parameters
    ----------
    view : View
        View to show.
    settings : Settings

    Attributes
    ----------
    address : str
        Of the page, with the token in it: for whoever started the run, and for no log.
    place : str
        The same without the token: for logs.
    port : int

    Raises
    ------
    SettingError
        If it cannot listen there, or the token cannot be read or is short enough to be guessed.
    """

    def __init__(self, view: View, settings: Settings | None = None) -> None:
        settings = settings or Settings()
        self._token = secret(settings, "token") or secrets.token_urlsafe(32)
        if len(self._token) < SHORTEST_TOKEN or not self._token.isascii():
            raise SettingError(f"token: at least {SHORTEST_TOKEN} ASCII characters, so that nobody guesses it")
        self._socket = _listening(settings.listen)
        host, self.port = self._socket.getsockname()[:2]
        shown = f"[{host}]" if ":" in host else host
        self.place = f"http://{shown}:{self.port}"
        names = [f"{name}:{self.port}" for name in (*OWN_NAMES, shown)]
        self._routes = Routes(view, per_plant=settings.per_plant)
        self._uvicorn = uvicorn.Server(
            uvicorn.Config(
                AccessControl(self._routes.app, self._token, [*names, *settings.hosts], https=settings.https),
                loop="asyncio",
                http=_Connection,
                ws="none",
                lifespan="off",
                log_config=None,
                log_level="warning",
                access_log=False,  # it would hold the token
                proxy_headers=False,
                server_header=False,
                backlog=128,
                timeout_keep_alive=IDLE,
                timeout_graceful_shutdown=2,
                h11_max_incomplete_event_size=LARGEST_HEAD,
            )
        )
        self._thread = threading.Thread(target=self._run, name="residua-server", daemon=True)
        self._failed: BaseException | None = None

    @property
    def address(self) -> str:
        """The address of the page, with the token."""
        return f"{self.place}/?token={self._token}"

    def start(self) -> None:
        """Start answering.

        Raises
        ------
        RuntimeError
            If the server ended while it started.
        """
        self._thread.start()
        while not self._uvicorn.started:
            self._thread.join(0.01)
            if not self._thread.is_alive():
                raise RuntimeError(f"the server ended while it started: {self._failed}")

    def stop(self) -> None:
        """Close all connections and end the thread, within a few seconds."""
        self._routes.stop()
        self._uvicorn.should_exit = True
        if self._thread.is_alive():
            self._thread.join(10)
        self._socket.close()

    def __enter__(self) -> Server:
        self.start()
        return self

    def __exit__(self, *_: Any) -> None:
        self.stop()

    def _run(self) -> None:
        try:
            asyncio.run(self._serve())
        except BaseException as error:
            self._failed = error
            raise

    async def _serve(self) -> None:
        with self._routes.running():
            await self._uvicorn.serve(sockets=[self._socket])


def _listening(listen: str) -> socket.socket:
    host, port = address_of(listen)
    listener = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET, socket.SOCK_STREAM)
    try:
        if socket.has_ipv6 and ":" in host:
            listener.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
        if os.name == "posix":  # elsewhere it would let others listen at the same port
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((host, port))
    except OSError as error:
        listener.close()
        raise SettingError(f"listen: {listen} cannot be opened for connections: {error.strerror or error}") from error
    return listener


class _Connection(H11Protocol):
    """A connection that is closed when idle for long, the oldest first if there are too many.

    A process has a thousand open files or so, and the sources and the store need theirs.
    """

    def connection_made(self, transport: asyncio.Transport) -> None:  # pyright: ignore[reportIncompatibleMethodOverride]
        super().connection_made(transport)
        self._begun = self.loop.time()
        self._head = self.loop.call_later(IDLE, self._end_if_idle)
        if len(self.connections) > MOST_CONNECTIONS:
            idle = [c for c in self.connections if isinstance(c, _Connection) and c._idle and c is not self]
            min(idle, key=lambda c: c._begun, default=self)._end()

    def data_received(self, data: bytes) -> None:
        self._begun = self.loop.time()
        super().data_received(data)

    def connection_lost(self, exc: Exception | None) -> None:
        self._head.cancel()
        super().connection_lost(exc)

    @property
    def _idle(self) -> bool:
        """True if no request is in progress."""
        return self.cycle is None or self.cycle.response_complete

    def _end_if_idle(self) -> None:
        if self.cycle is None:
            self._end()

    def _end(self) -> None:
        self.connections.discard(self)
        self.transport.abort()
