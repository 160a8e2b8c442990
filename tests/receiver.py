"""A receiver of webhooks on this machine, and events to send to it."""

from __future__ import annotations

import ssl
import threading
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from residua.live.events import Event


def events(count: int = 3, plant: str = "north") -> list[Event]:
    """Return events of one plant, one after another."""
    content = {"name": "leak 3", "text": ["Fault found: leak 3."], "sure": "good match"}
    return [Event(k, plant, k, "raised", 40.0 + k, "2026-11-24T06:00:00+00:00", content) for k in range(1, count + 1)]


class Receiver:
    """Keeps what is posted to it; ``answer`` says with which status, and what happens before; with a certificate and
    its key, it speaks HTTPS.

    Attributes
    ----------
    received : list of (path, headers, body)
        Whatever was answered.
    """

    def __init__(
        self,
        answer: Callable[[int], int] = lambda number: 204,
        port: int = 0,
        certificate: tuple[Path, Path] | None = None,
    ) -> None:
        self.received: list[tuple[str, dict[str, str], bytes]] = []
        self.answer = answer
        receiver = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def do_POST(self) -> None:
                body = self.rfile.read(int(self.headers["Content-Length"]))
                receiver.received.append((self.path, dict(self.headers.items()), body))
                status = receiver.answer(len(receiver.received))
                self.send_response(status)
                if 300 <= status < 400:
                    self.send_header("Location", "/elsewhere")
                self.send_header("Content-Length", "0")
                self.end_headers()

            def log_message(self, *_: Any) -> None:
                pass

        self._server = ThreadingHTTPServer(("127.0.0.1", port), Handler)
        self.port = self._server.server_address[1]
        if certificate is not None:
            context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
            context.load_cert_chain(*certificate)
            # The handshake is made by the thread of the connection: whoever does not make one holds up nobody.
            self._server.socket = context.wrap_socket(
                self._server.socket, server_side=True, do_handshake_on_connect=False
            )
        self.url = f"{'http' if certificate is None else 'https'}://127.0.0.1:{self.port}/hook"
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.02,))
        self._thread.start()

    def close(self) -> None:
        """Go away."""
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()

    def __enter__(self) -> Receiver:
        return self

    def __exit__(self, *_: Any) -> None:
        self.close()
