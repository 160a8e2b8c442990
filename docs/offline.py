"""The pages read without a network: equations by a copy of MathJax, and no page loads anything from another host.

MathJax (Apache 2.0) comes with the package sphinx-mathjax-offline. Of it one file is copied into the build: the one
that holds every extension and draws paths, so that it loads nothing further, no fonts either, which browsers refuse to
pages opened from a disk.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from html.parser import HTMLParser
from importlib import import_module
from pathlib import Path

ENGINE = "mathjax/tex-svg-full.js"
REFERENCE = re.compile(r"""(?:@import\s+(?:url\(\s*)?|url\(\s*)["']?([^"')\s;]+)""")
# What a browser loads by itself with a page. Links (<a>) and <link rel=canonical> wait for the reader.
LOADED = {
    ("script", "src"),
    ("link", "href"),
    ("img", "src"),
    ("img", "srcset"),
    ("source", "src"),
    ("source", "srcset"),
    ("iframe", "src"),
    ("video", "src"),
    ("video", "poster"),
    ("audio", "src"),
    ("embed", "src"),
    ("object", "data"),
    ("input", "src"),
    ("image", "href"),
    ("use", "href"),
}
NOT_LOADED = {"canonical", "next", "prev", "search", "index", "author", "help", "license"}


class Loads(HTMLParser):
    """Collects the addresses that a page loads."""

    def __init__(self) -> None:
        super().__init__()
        self.addresses: list[str] = []
        self._style = False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Collect from attributes."""
        self._style = tag == "style"
        values = {name: value or "" for name, value in attrs}
        self.addresses += REFERENCE.findall(values.get("style", ""))
        if tag == "link" and set(values.get("rel", "").lower().split()) <= NOT_LOADED:
            return
        for name, value in values.items():
            if (tag, name) in LOADED:
                parts = value.split(",") if name == "srcset" else [value]
                self.addresses += [part.split()[0] for part in parts if part.strip()]

    handle_startendtag = handle_starttag

    def handle_endtag(self, tag: str) -> None:
        """Leave the style sheet."""
        self._style = False

    def handle_data(self, data: str) -> None:
        """Collect from style sheets inside the page."""
        if self._style:
            self.addresses += REFERENCE.findall(data)


def elsewhere(folder: Path) -> Iterator[tuple[str, str]]:
    """Yield the pages and style sheets under a folder that load something from another host, with its address."""
    for path in sorted(folder.rglob("*")):
        if path.suffix not in (".html", ".css"):
            continue
        text = path.read_text(encoding="utf-8")
        if path.suffix == ".css":
            addresses = REFERENCE.findall(text)
        else:
            reader = Loads()
            reader.feed(text)
            addresses = reader.addresses
        for address in addresses:
            if re.match(r"(?:[a-z][a-z0-9+.-]*:)?//|https?:", address, flags=re.IGNORECASE):
                yield path.relative_to(folder).as_posix(), address


def copy_engine(app) -> None:
    """Put MathJax beside the other static files."""
    source = Path(*import_module("sphinx-mathjax-offline").__path__) / "static" / ENGINE
    target = Path(app.outdir) / "_static" / ENGINE
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(source, target)


def check(app, exception: Exception | None) -> None:
    """Fail the build where a page loads from another host."""
    if exception is None and app.builder.format == "html" and (loads := list(elsewhere(Path(app.outdir)))):
        from sphinx.errors import ExtensionError  # here, so that the tests need no Sphinx

        lines = "\n".join(f"{page} loads {address}" for page, address in loads[:20])
        raise ExtensionError(f"{len(loads)} addresses of other hosts, which nobody without a network reaches:\n{lines}")


def setup(app) -> dict[str, bool]:
    """Register with Sphinx."""
    app.setup_extension("sphinx.ext.mathjax")
    app.config.mathjax_path = ENGINE
    app.connect("builder-inited", copy_engine)
    app.connect("build-finished", check)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
