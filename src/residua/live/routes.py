"""Routes of the server: the page, its data, its events, the metrics, the health."""

from __future__ import annotations

import asyncio
import logging
import threading
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any, TypeVar
from urllib.parse import parse_qs, unquote_to_bytes

import orjson
from starlette.applications import Starlette
from starlette.datastructures import Headers
from starlette.requests import Request
from starlette.responses import HTMLResponse, PlainTextResponse, Response
from starlette.routing import Route
from starlette.types import Receive, Scope, Send

from residua.live.events import Event
from residua.live.metrics import CONTENT_TYPE, metrics_text
from residua.live.view import View
from residua.report.live_page import live_page, live_policy

#: Plants on one page of the overview, at most, and where nothing is said.
MOST_ROWS, ROWS = 500, 100
#: Events that are sent at once.
PIECE = 500
#: Those that follow the events at once, at most.
MOST_FOLLOWERS = 32
#: Seconds between two signs of life, and those after which a follower that takes nothing is left.
BEAT, STUCK = 5.0, 30.0
#: Seconds in which the run must answer.
PATIENCE = 5.0
#: Seconds that the thread that waits for events waits at once: the end of a run waits for it.
WATCHED = 0.5
#: The largest place of an event that anybody asks for.
_LAST = 1 << 62

T = TypeVar("T")
_LOG = logging.getLogger("residua.live")


class Routes:
    """The application behind the access control.

    Parameters
    ----------
    view : View
    per_plant : bool
        Whether the metrics have a series for each plant.
    """

    def __init__(self, view: View, *, per_plant: bool = False) -> None:
        self._view, self._per_plant = view, per_plant
        self._threads = ThreadPoolExecutor(4, thread_name_prefix="residua-page")
        self._stopping = threading.Event()
        self._followers = 0
        self._loop: asyncio.AbstractEventLoop | None = None
        self._news: asyncio.Event | None = None
        self.app = Starlette(
            routes=[
                Route("/", self._page),
                Route("/overview.json", self._overview),
                Route("/plant/{rest:path}", self._plant),
                Route("/metrics", self._metrics),
                Route("/health", self._health),
                Route("/events", _Follow(self)),
            ]
        )
        self.app.router.redirect_slashes = False

    # ----------------------------------------------------------- running

    @contextmanager
    def running(self) -> Iterator[None]:
        """Watch for events while the event loop of this thread runs."""
        self._loop, self._news = asyncio.get_running_loop(), asyncio.Event()
        thread = threading.Thread(target=self._watch, name="residua-news", daemon=True)
        thread.start()
        try:
            yield
        finally:
            self.stop()
            self._loop = None
            thread.join(2 * WATCHED)
            self._threads.shutdown(wait=False, cancel_futures=True)

    def stop(self) -> None:
        """Stop, and let the followers of events go."""
        self._stopping.set()
        self._tell()

    def _tell(self) -> None:
        """Wake the followers of events, from any thread."""
        loop = self._loop
        if loop is not None:
            with suppress(RuntimeError):  # it has just ended
                loop.call_soon_threadsafe(self._wake)

    def _watch(self) -> None:
        """Wake the followers when there is an event; if that fails, they check by themselves at every heartbeat."""
        place = -1
        while not self._stopping.is_set():
            try:
                place = self._last_place() if place < 0 else place
                if self._view.wait_for_event(place, WATCHED):
                    events = self._view.events_after(place, PIECE)
                    place = events[-1].place if events else place
                    self._tell()
            except Exception:
                _LOG.exception("The page does not see events at once.")
                self._stopping.wait(BEAT)

    def _last_place(self) -> int:
        return int(self._view.overview(0, 0)["last_event"])

    def _wake(self) -> None:
        news, self._news = self._news, asyncio.Event()
        if news is not None:
            news.set()

    async def ask(self, question: Callable[..., T], *arguments: Any) -> T:
        """Return an answer of the view, computed in another thread."""
        return await asyncio.get_running_loop().run_in_executor(self._threads, partial(question, *arguments))

    # ----------------------------------------------------------- answers

    async def _page(self, request: Request) -> Response:
        return HTMLResponse(live_page(self._view.title), headers={"Content-Security-Policy": live_policy()})

    async def _overview(self, request: Request) -> Response:
        try:
            first = _whole(request.query_params.get("first", "0"), _LAST)
            count = min(_whole(request.query_params.get("count", str(ROWS)), _LAST), MOST_ROWS)
        except ValueError:
            return PlainTextResponse("first and count are whole numbers", 400)
        return _json(await self.ask(self._view.overview, first, count, request.query_params.get("find", "")[:200]))

    async def _plant(self, request: Request) -> Response:
        plant = plant_of(request.scope["raw_path"])
        found = None if plant is None else await self.ask(self._view.plant, plant)
        return PlainTextResponse("There is no such plant.", 404) if found is None else _json(found)

    async def _metrics(self, request: Request) -> Response:
        text = await self.ask(partial(metrics_text, self._view, per_plant=self._per_plant))
        return Response(text, media_type=None, headers={"Content-Type": CONTENT_TYPE})

    async def _health(self, request: Request) -> Response:
        try:
            now = await asyncio.wait_for(self.ask(self._view.overview, 0, 0), PATIENCE)
        except TimeoutError:
            return _json({"good": False, "reasons": [f"the run did not answer within {PATIENCE:g} s"]}, 503)
        reasons = [*now["problems"]]
        reasons += [f"{one['name']}: {one['text']}" for one in (*now["sources"], *now["sinks"]) if not one["good"]]
        return _json({"good": not reasons, "reasons": reasons}, 503 if reasons else 200)

    # ------------------------------------------------------------ events

    @contextmanager
    def follower(self) -> Iterator[bool]:
        """Count one more follower of events; yield whether there is room."""
        self._followers += 1
        try:
            yield self._followers <= MOST_FOLLOWERS
        finally:
            self._followers -= 1

    async def pieces(self, after: int | None) -> AsyncIterator[bytes]:
        """Yield the stream of events after a place (``None``: from now on), for as long as the server runs."""
        last = await self.ask(self._last_place)
        yield b"retry: 2000\n\n"
        if after is None or after > last:
            # Another store than that of the place: events seen from it do not count.
            yield b"event: anew\nid: %d\ndata: {}\n\n" % last if after is not None else beat(last)
            after = last
        while not self._stopping.is_set():
            news = self._news
            events: Sequence[Event] = await self.ask(self._view.events_after, after, PIECE)
            if events:
                after = events[-1].place
                yield b"".join(map(sent, events))
                continue
            try:
                assert news is not None
                await asyncio.wait_for(news.wait(), BEAT)
            except TimeoutError:
                yield beat(after)


class _Follow:
    """The route of the events: an endless stream of text."""

    def __init__(self, routes: Routes) -> None:
        self._routes = routes

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        try:
            after = _asked_place(scope)
        except ValueError:
            await PlainTextResponse("after, or Last-Event-ID, is a whole number", 400)(scope, receive, send)
            return
        with self._routes.follower() as room:
            if not room:
                full = PlainTextResponse("Too many follow the events.", 503, {"Retry-After": "10"})
                await full(scope, receive, send)
                return
            leaving = asyncio.ensure_future(_gone(receive))
            following = asyncio.ensure_future(self._follow(scope, send, after))
            _, pending = await asyncio.wait({leaving, following}, return_when=asyncio.FIRST_COMPLETED)
            for one in pending:
                one.cancel()
            await asyncio.gather(*pending, return_exceptions=True)
            if following.done() and not following.cancelled() and (error := following.exception()) is not None:
                raise error

    async def _follow(self, scope: Scope, send: Send, after: int | None) -> None:
        headers = [(b"content-type", b"text/event-stream"), (b"x-accel-buffering", b"no")]
        await send({"type": "http.response.start", "status": 200, "headers": headers})
        if scope["method"] == "GET":
            async for piece in self._routes.pieces(after):
                try:
                    await asyncio.wait_for(
                        send({"type": "http.response.body", "body": piece, "more_body": True}), STUCK
                    )
                except TimeoutError:
                    return
        await send({"type": "http.response.body", "body": b"", "more_body": False})


async def _gone(receive: Receive) -> None:
    while (await receive())["type"] != "http.disconnect":
        pass


def _asked_place(scope: Scope) -> int | None:
    """Return the place after which events are requested: a browser that reconnects sends it in a header."""
    asked = (
        Headers(scope=scope).get("last-event-id")
        or parse_qs(scope["query_string"].decode("latin-1")).get("after", [""])[-1]
    )
    return _whole(asked, _LAST) if asked else None


def _whole(text: str, most: int) -> int:
    """Return a whole number from 0 to ``most``; anything else raises ``ValueError``."""
    if not (text.isascii() and text.isdigit() and len(text) < 20 and int(text) <= most):
        raise ValueError(text)
    return int(text)


def sent(event: Event) -> bytes:
    r"""Return an event for the stream: its place in the order of all as id, and its JSON.

    Examples
    --------
    >>> sent(Event(7, "north", 2, "ended", 40.0))
    b'id: 7\ndata: {"plant": "north", "number": 2, "kind": "ended", "time": 40.0}\n\n'
    """
    return f"id: {event.place}\ndata: {event.to_json()}\n\n".encode()


def beat(place: int) -> bytes:
    """Return a heartbeat with the place up to which everything was sent."""
    return b'event: beat\ndata: {"last": %d}\n\n' % place


def plant_of(raw_path: bytes) -> str | None:
    """Return the plant requested by a path as it was sent; ``None`` without one.

    Examples
    --------
    >>> plant_of(b"/plant/hall%203%2Fpump.json")
    'hall 3/pump'
    >>> plant_of(b"/plant/../metrics.json") is None
    True
    """
    _, _, rest = raw_path.partition(b"/plant/")
    if b"/" in rest or not rest.endswith(b".json"):
        return None
    try:
        return unquote_to_bytes(rest.removesuffix(b".json")).decode("utf-8") or None
    except UnicodeDecodeError:
        return None


def _json(value: Any, status: int = 200) -> Response:
    text = orjson.dumps(value, option=orjson.OPT_SERIALIZE_NUMPY | orjson.OPT_NON_STR_KEYS)
    return Response(text, status, media_type="application/json")
