"""asyncua's server, in a thread of the test's process."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Coroutine, Mapping
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from typing import Any

from asyncua import Server, ua

#: How threads are called that asyncua's server may begin at any time.
HELPER = "server's helper"
URI = "urn:residua:test"
VARIABLES = {"north.level": 0.0, "north.flow": 0.0, "text": "no", "whole": 1, "flag": False}


class OpcUaServer:
    """A server with variables, which can be stopped and started again on the same port.

    Parameters
    ----------
    port : int
    variables : mapping of str to value
        Their first values, by their names: ``ns=2;s=<name>``.
    prepare : callable, optional
        Called with the server before it starts, and awaited.
    """

    def __init__(self, port: int, variables: Mapping[str, Any] = VARIABLES, prepare: Any = None) -> None:
        self.url = f"opc.tcp://127.0.0.1:{port}/residua"
        self._variables, self._prepare = variables, prepare
        self._nodes: dict[str, Any] = {}
        self._loop = asyncio.new_event_loop()
        self._loop.set_default_executor(ThreadPoolExecutor(thread_name_prefix=HELPER))
        self._thread = threading.Thread(target=self._loop.run_forever)
        self._server: Server | None = None

    def __enter__(self) -> OpcUaServer:
        self._thread.start()
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()
        self._do(self._cancel())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(10)
        self._loop.close()

    def start(self) -> None:
        self._do(self._start())

    async def _start(self) -> None:
        server = Server()
        await server.init()
        server.set_endpoint(self.url)
        if self._prepare:
            await self._prepare(server)
        index = await server.register_namespace(URI)
        assert index == 2
        for name, first in self._variables.items():
            self._nodes[name] = await server.nodes.objects.add_variable(ua.NodeId(name, index), name, first)
        await server.start()
        self._server = server

    def stop(self) -> None:
        if self._server is not None:
            self._do(self._server.stop())
            self._server = None

    async def _cancel(self) -> None:
        """End what the server has left."""
        left = [one for one in asyncio.all_tasks() if one is not asyncio.current_task()]
        for one in left:
            one.cancel()
        await asyncio.gather(*left, return_exceptions=True)

    def set(self, name: str, value: Any, seconds: float | None = None, status: int = ua.StatusCodes.Good) -> None:
        """Set a variable, with its source time in seconds since 1970, and its status."""
        self._do(self._set(name, value, seconds, status))

    def set_all(self, rows: list[tuple[str, float, float]]) -> None:
        """Set variables one after another: name, value, seconds; a missing value has a status that is not good."""

        async def go() -> None:
            for name, value, seconds in rows:
                status = ua.StatusCodes.Good if value == value else ua.StatusCodes.BadSensorFailure
                await self._set(name, value if value == value else 0.0, seconds, status)

        self._do(go())

    async def _set(self, name: str, value: Any, seconds: float | None, status: int) -> None:
        moment = None if seconds is None else datetime.fromtimestamp(seconds, UTC)
        data = ua.DataValue(ua.Variant(value), ua.StatusCode(status), SourceTimestamp=moment)
        assert self._server is not None
        await self._server.write_attribute_value(self._nodes[name].nodeid, data)

    def _do(self, what: Coroutine[Any, Any, Any]) -> Any:
        return asyncio.run_coroutine_threadsafe(what, self._loop).result(30)
