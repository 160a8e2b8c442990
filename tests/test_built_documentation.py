"""The documentation reads without a network. Pages are looked at where ``make docs`` has built them."""

from __future__ import annotations

import importlib.util
import re
import shutil
import subprocess
from pathlib import Path
from types import ModuleType

import pytest

DOCS = Path(__file__).resolve().parent.parent / "docs"
BUILT = DOCS / "_build" / "html"
BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
FORMULA = re.compile(r'class="(?:[^"]* )?math notranslate')
built = pytest.mark.skipif(not (BUILT / "index.html").is_file(), reason="no built pages (make docs)")


@pytest.fixture(scope="module")
def offline() -> ModuleType:
    """The extension of the documentation that looks for other hosts."""
    spec = importlib.util.spec_from_file_location("offline", DOCS / "offline.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    "loading",
    [
        '<script src="https://a.org/x.js"></script>',
        '<link rel="stylesheet" href="//a.org/x.css">',
        '<link rel="preload icon" href="HTTP://a.org/x.png"/>',
        '<img src="https://a.org/x.png">',
        '<img src="x.png" srcset="x.png 1x, https://a.org/x.png 2x">',
        "<style>@import 'https://a.org/x.css';</style>",
        '<p style="background: url( https://a.org/x.png )">',
        '<iframe src="https://a.org/"></iframe>',
    ],
)
def test_what_a_page_loads_from_another_host_is_seen(offline: ModuleType, tmp_path: Path, loading: str) -> None:
    (tmp_path / "page.html").write_text(f"<html><body>{loading}</body></html>", encoding="utf-8")
    ((page, address),) = offline.elsewhere(tmp_path)
    assert page == "page.html"
    assert "a.org" in address


def test_a_style_sheet_is_searched_and_links_for_readers_are_not(offline: ModuleType, tmp_path: Path) -> None:
    page = '<a href="https://a.org">a</a><link rel="canonical" href="https://a.org"/><script src="x.js"></script>'
    (tmp_path / "page.html").write_text(page, encoding="utf-8")
    assert list(offline.elsewhere(tmp_path)) == []
    (tmp_path / "x.css").write_text("p { background: url(x.png) } @import url('//a.org/y.css');", encoding="utf-8")
    assert list(offline.elsewhere(tmp_path)) == [("x.css", "//a.org/y.css")]


@built
def test_no_built_page_loads_from_another_host(offline: ModuleType) -> None:
    pages = list(BUILT.rglob("*.html"))
    assert len(pages) > 50
    assert list(offline.elsewhere(BUILT)) == []


@built
@pytest.mark.skipif(BROWSER is None, reason="no Chromium on this machine")
def test_equations_are_drawn_without_a_network(tmp_path: Path) -> None:
    formulas = {page: len(FORMULA.findall(page.read_text(encoding="utf-8"))) for page in BUILT.rglob("*.html")}
    assert sum(formulas.values()) > 100
    page = max(formulas, key=formulas.__getitem__)
    assert BROWSER is not None
    command = [
        BROWSER,
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--disable-dev-shm-usage",
        "--disable-background-networking",
        "--host-resolver-rules=MAP * ~NOTFOUND",
        f"--user-data-dir={tmp_path / 'browser'}",
        "--virtual-time-budget=20000",
        "--dump-dom",
        page.as_uri(),
    ]
    dom = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True).stdout
    assert len(re.findall(r"<mjx-container[^>]*>\s*<svg", dom)) == formulas[page]
    assert "data-mjx-error" not in dom
    assert "merror" not in re.sub(r"<style.*?</style>", "", dom, flags=re.DOTALL)
