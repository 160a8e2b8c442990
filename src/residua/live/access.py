"""Access control: the token, the host name, and the origin of a request."""

from __future__ import annotations

import hashlib
import hmac
from collections.abc import Iterable
from ipaddress import ip_address
from urllib.parse import urlsplit

from starlette.datastructures import MutableHeaders
from starlette.requests import Request
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

#: Names of this machine to itself.
OWN_NAMES = ("localhost", "127.0.0.1", "[::1]")
#: With every answer: nothing is kept, guessed at, framed, or handed to other pages.
HEADERS = {
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Permissions-Policy": "camera=(), geolocation=(), microphone=()",
}
#: Origins of requests whose answers pages elsewhere may not read; they may only send their user here.
_FOREIGN = ("cross-site", "same-site")


class AccessControl:
    """Middleware that passes allowed requests on only; it stands in front of everything, unknown paths included.

    In this order: 405 for other methods than GET and HEAD; 421 where ``Host`` is not a name of this server (a name of
    another's that leads here is how pages elsewhere would read what is here); 403 for requests that pages of other
    origins make; 401 without the token. The token is taken from the header ``Authorization: Bearer``, from the address
    of the page (``/?token=``), which is answered with a cookie, or from that cookie. Its value is not the token itself,
    scripts cannot read it, and other sites cannot have it sent. Comparisons take the same time whatever is compared.

    Parameters
    ----------
    app : ASGI application
    token : str
    hosts : iterable of str
        Values of ``Host``, with the port; a name without a port stands for any port.
    https : bool
        Whether browsers come by HTTPS, through a proxy.
    """

    def __init__(self, app: ASGIApp, token: str, hosts: Iterable[str], *, https: bool = False) -> None:
        self._app, self._token, self._https = app, token, https
        self._hosts = frozenset(host.lower() for host in hosts)
        self._cookie = f"residua-{_derived(token, 'name')[:12]}"  # ports share their cookies, so each run has its own
        self._value = _derived(token, "cookie")

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, or pass it on; every answer has :data:`HEADERS`."""
        if scope["type"] != "http":
            return
        request = Request(scope)
        tokens = [one for one in request.query_params.getlist("token") if one] if scope["path"] == "/" else []
        refused = self._refused(request, tokens)
        fresh = bool(tokens) and not refused
        if scope["path"] == "/":
            scope = {**scope, "query_string": b""}  # nothing behind it sees the token

        async def sent(message: Message) -> None:
            if message["type"] == "http.response.start":
                added = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    added.setdefault(name, value)
                if fresh:
                    added.append("Set-Cookie", self._set_cookie())
            await send(message)

        await (PlainTextResponse(refused[1], refused[0], refused[2]) if refused else self._app)(scope, receive, sent)

    def _refused(self, request: Request, tokens: list[str]) -> tuple[int, str, dict[str, str]] | None:
        """Return the answer to a request that is not allowed; ``tokens`` are those of its address."""
        headers = request.headers
        if request.method not in ("GET", "HEAD"):
            return 405, "Only GET and HEAD.", {"Allow": "GET, HEAD"}
        hosts = headers.getlist("host")
        if len(hosts) != 1 or not self._own(hosts[0].lower(), request.scope.get("server")):
            return (
                421,
                "This server has another name: open the address that it printed, or name this one in 'hosts'.",
                {},
            )
        origin = headers.get("origin")
        if origin is not None and origin.lower() != f"{'https' if self._https else 'http'}://{hosts[0].lower()}":
            return 403, "Pages of other origins may not read this.", {}
        visit = headers.get("sec-fetch-mode") == "navigate" and headers.get("sec-fetch-dest") == "document"
        if headers.get("sec-fetch-site") in _FOREIGN and not visit:
            return 403, "Pages of other origins may not read this.", {}
        if not self._known(request, tokens):
            text = "The token is missing or wrong: open the address that residua live printed when it started."
            return 401, text, {"WWW-Authenticate": 'Bearer realm="residua"'}
        return None

    def _own(self, host: str, server: tuple[str, int | None] | None) -> bool:
        """Tell whether a host belongs to this server; the address of the interface of the request always does."""
        if host in self._hosts:
            return True
        try:
            parts = urlsplit(f"//{host}")
            name, port = parts.hostname, parts.port
        except ValueError:
            return False
        if name is None or host != parts.netloc or "@" in host:
            return False
        if (f"[{name}]" if ":" in name else name) in self._hosts:
            return True
        try:
            return server is not None and ip_address(name) == ip_address(server[0]) and (port or 80) == server[1]
        except ValueError:
            return False

    def _known(self, request: Request, tokens: list[str]) -> bool:
        """Tell whether a request has the token in its address, or else in a header, or else the cookie."""
        if tokens:
            return len(tokens) == 1 and _equal(tokens[0], self._token)
        scheme, _, given = request.headers.get("authorization", "").partition(" ")
        if scheme.lower() == "bearer":
            return _equal(given.strip(), self._token)
        return _equal(request.cookies.get(self._cookie, ""), self._value)

    def _set_cookie(self) -> str:
        secure = "; Secure" if self._https else ""
        return f"{self._cookie}={self._value}; Path=/; HttpOnly; SameSite=Strict{secure}"


def _equal(given: str, right: str) -> bool:
    return hmac.compare_digest(given.encode("utf-8", "surrogatepass"), right.encode())


def _derived(token: str, purpose: str) -> str:
    return hmac.new(token.encode(), f"residua {purpose}".encode(), hashlib.sha256).hexdigest()
