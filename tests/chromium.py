"""Chromium without a window, driven by its own protocol through a pipe: what a page does as time goes on."""

from __future__ import annotations

import base64
import fcntl
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
_START = (
    "import os, sys; os.dup2(int(sys.argv[1]), 3); os.dup2(int(sys.argv[2]), 4); os.execv(sys.argv[3], sys.argv[3:])"
)


class Chromium:
    """One browser with one page; ``messages`` are what it has told of the page, such as each request."""

    def __init__(self, folder: Path, width: int = 1280, height: int = 1600) -> None:
        assert BROWSER is not None
        (told, self._write), (self._read, tell) = os.pipe(), os.pipe()
        command = [BROWSER, "--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"]
        command += [f"--user-data-dir={folder / 'browser'}", f"--window-size={width},{height}", "--hide-scrollbars"]
        command += ["--disable-background-networking", "--remote-debugging-pipe", "about:blank"]
        # The protocol's descriptors are 3 and 4, whatever they are here.
        low, high = (fcntl.fcntl(one, fcntl.F_DUPFD, 10) for one in (told, tell))
        start = [sys.executable, "-c", _START, str(low), str(high), *command]
        self._process = subprocess.Popen(
            start, pass_fds=(low, high), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        for one in (told, tell, low, high):
            os.close(one)
        self._number, self._buffer = 0, b""
        self._session: str | None = None
        self.messages: list[dict[str, Any]] = []
        targets = self.call("Target.getTargets")["targetInfos"]
        page = next(one for one in targets if one["type"] == "page")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=page, flatten=True)["sessionId"]
        for domain in ("Page", "Network", "Runtime", "Log"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Return the answer to one command."""
        self._number += 1
        message: dict[str, Any] = {"id": self._number, "method": method, "params": parameters}
        if self._session is not None:
            message["sessionId"] = self._session
        os.write(self._write, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._next()
            if answer.get("id") == self._number:
                assert "error" not in answer, answer
                return answer["result"]
            self.messages.append(answer)

    def _next(self) -> dict[str, Any]:
        while b"\0" not in self._buffer:
            piece = os.read(self._read, 1 << 20)
            assert piece, "the browser has ended"
            self._buffer += piece
        message, _, self._buffer = self._buffer.partition(b"\0")
        return json.loads(message)

    def open(self, address: str) -> None:
        """Go to a page."""
        self.call("Page.navigate", url=address)

    def ask(self, expression: str) -> Any:
        """Return the value of an expression in the page."""
        answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def wait(self, expression: str, seconds: float = 20.0) -> float:
        """Wait until an expression is true in the page; return the seconds that it took."""
        begun = time.monotonic()
        while not self.ask(f"Boolean(document.body && ({expression}))"):
            assert time.monotonic() - begun < seconds, f"{expression}: {self.ask('document.body.outerHTML')[:3000]}"
            time.sleep(0.02)
        return time.monotonic() - begun

    def size(self, width: int, height: int, *, phone: bool = False) -> None:
        """Make the page so large."""
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=2 if phone else 1,
            mobile=phone,
        )

    def dark(self, dark: bool = True) -> None:
        """Choose dark or light colours."""
        features = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
        self.call("Emulation.setEmulatedMedia", features=features)

    def picture(self, path: Path, *, whole: bool = False) -> Path:
        """Write what is seen as a PNG file; ``whole``: the page to its end."""
        data = self.call("Page.captureScreenshot", captureBeyondViewport=whole)["data"]
        path.write_bytes(base64.b64decode(data))
        return path

    def requests(self, wanted: Callable[[str], bool] = lambda url: True) -> list[str]:
        """Return the addresses that the page has asked for, those that were blocked included."""
        self.ask("1")
        sent = [m["params"]["request"]["url"] for m in self.messages if m["method"] == "Network.requestWillBeSent"]
        return [url for url in sent if wanted(url)]

    def close(self) -> None:
        """End the browser."""
        os.close(self._write)  # it ends when nobody can tell it anything any more
        try:
            self._process.wait(10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        os.close(self._read)

    def __enter__(self) -> Chromium:
        return self

    def __exit__(self, *_: Any) -> None:
        self.close()
