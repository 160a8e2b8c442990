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
from urllib.parse import unquote_to_bytes

import orjson
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import HTMLResponse, PlainTextResponse, Response, StreamingResponse
from starlette.routing import Route
from starlette.types import Message, Receive, Scope, Send

from residua.live.events import Event
from residua.live.view import CONTENT_TYPE, View, metrics_text
from residua.report.live_page import live_page, live_policy

#: Plants on one page of the overview, at most, and where nothing is said.
MOST_ROWS, ROWS = 500, 100
#: Events that are sent at once.
PIECE = 500
#: Those that follow the events at once, at most.
MOST_FOLLOWERS = 32
#: Seconds between two signs of life, and those after which a follower that takes nothing is left.
HEARTBEAT, SEND_TIMEOUT = 5.0, 30.0
#: Seconds in which the run must answer.
ANSWER_TIMEOUT = 5.0
#: Seconds that the thread that waits for events waits at once: the end of a run waits for it.
NEWS_TIMEOUT = 0.5
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
        self.followers = 0
        self._loop: asyncio.AbstractEventLoop | None = None
        self._news: asyncio.Event | None = None
        self.app = Starlette(
            routes=[
                Route("/", self._page),
                Route("/overview.json", self._overview),
                Route("/plant/{rest:path}", self._plant),
                Route("/metrics", self._metrics),
                Route("/health", self._health),
                Route("/events", self._events),
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
            thread.join(2 * NEWS_TIMEOUT)
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
                if self._view.wait_for_event(place, NEWS_TIMEOUT):
                    events = self._view.events_after(place, PIECE)
                    place = events[-1].place if events else place
                    self._tell()
            except Exception:
                _LOG.exception("The page does not see events at once.")
                self._stopping.wait(HEARTBEAT)

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
            now = await asyncio.wait_for(self.ask(self._view.overview, 0, 0), ANSWER_TIMEOUT)
        except TimeoutError:
            return _json({"good": False, "reasons": [f"the run did not answer within {ANSWER_TIMEOUT:g} s"]}, 503)
        reasons = [*now["problems"]]
        reasons += [f"{one['name']}: {one['text']}" for one in (*now["sources"], *now["sinks"]) if not one["good"]]
        return _json({"good": not reasons, "reasons": reasons}, 503 if reasons else 200)

    # ------------------------------------------------------------ events

    async def _events(self, request: Request) -> Response:
        """Answer with an endless stream of events, if there is room for one more follower."""
        # A browser that reconnects sends the place in a header.
        after = request.headers.get("last-event-id") or request.query_params.get("after")
        try:
            place = _whole(after, _LAST) if after else None
        except ValueError:
            return PlainTextResponse("after, or Last-Event-ID, is a whole number", 400)
        if self.followers >= MOST_FOLLOWERS:
            return PlainTextResponse("Too many follow the events.", 503, {"Retry-After": "10"})
        if request.method == "HEAD":
            return Response(headers={"Content-Type": "text/event-stream"})
        self.followers += 1
        return _EventStream(self, place)

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
                await asyncio.wait_for(news.wait(), HEARTBEAT)
            except TimeoutError:
                yield beat(after)


class _EventStream(StreamingResponse):
    """The events after a place, until the reader leaves or takes nothing any more."""

    def __init__(self, routes: Routes, after: int | None) -> None:
        super().__init__(routes.pieces(after), headers={"Content-Type": "text/event-stream", "X-Accel-Buffering": "no"})
        self._routes = routes

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        try:
            await super().__call__(scope, receive, send)
        finally:
            self._routes.followers -= 1

    async def stream_response(self, send: Send) -> None:
        async def limited(message: Message) -> None:
            await asyncio.wait_for(send(message), SEND_TIMEOUT)

        with suppress(TimeoutError):
            await super().stream_response(limited)


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
