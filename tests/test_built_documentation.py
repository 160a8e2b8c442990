"""The documentation reads without a network. Pages are looked at where ``make docs`` has built them."""

from __future__ import annotations

import importlib.util
import json
import re
import shutil
import subprocess
from pathlib import Path
from types import ModuleType
from urllib.parse import quote

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


browser = pytest.mark.skipif(BROWSER is None, reason="no Chromium on this machine")


def drawn(address: str, profile: Path) -> str:
    """Return the elements of a page after its scripts have run, without a network."""
    assert BROWSER is not None
    command = [
        BROWSER,
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--disable-dev-shm-usage",
        "--disable-background-networking",
        "--host-resolver-rules=MAP * ~NOTFOUND",
        f"--user-data-dir={profile}",
        "--virtual-time-budget=20000",
        "--dump-dom",
        address,
    ]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=True).stdout


@built
@browser
def test_equations_are_drawn_without_a_network(tmp_path: Path) -> None:
    formulas = {page: len(FORMULA.findall(page.read_text(encoding="utf-8"))) for page in BUILT.rglob("*.html")}
    assert sum(formulas.values()) > 100
    page = max(formulas, key=formulas.__getitem__)
    dom = drawn(page.as_uri(), tmp_path)
    assert len(re.findall(r"<mjx-container[^>]*>\s*<svg", dom)) == formulas[page]
    assert "data-mjx-error" not in dom
    assert "merror" not in re.sub(r"<style.*?</style>", "", dom, flags=re.DOTALL)


#: What newcomers search for, and the page that answers.
QUESTIONS = {
    "plant without a model": "i-have-a-log",
    "too many alarms": "how-to/too-many-alarms",
    "missing rows": "how-to/missing-rows",
    "decimal comma": "how-to/missing-rows",
    "UIO": "i-have-a-paper",
    "choose Q and R": "how-to/choose-q-and-r",
    "Chow-Willsky": "i-have-a-paper",
    "PLC": "export",
    "e-mail": "how-to/e-mail",
    "which sensor": "how-to/which-sensor",
    "stuck sensor": "how-to/stuck-sensor",
    "EKF": "how-to/nonlinear",
    "Simulink": "how-to/simulink",
    "python-control": "how-to/simulink",
    "Jupyter": "how-to/notebooks",
    "Windows": "how-to/windows",
    "cite": "how-to/cite",
    "score": "glossary",
    "CSV out": "how-to/results",
    "fault from the first sample": "how-to/first-sample",
}
#: The same in other words.
REWORDED = {
    "no model": "i-have-a-log",
    "false alarms": "how-to/too-many-alarms",
    "gaps in the data": "how-to/missing-rows",
    "comma instead of point": "how-to/missing-rows",
    "unknown input observer": "i-have-a-paper",
    "tune the Kalman filter": "how-to/choose-q-and-r",
    "parity space": "i-have-a-paper",
    "Structured Text": "export",
    "send mail": "how-to/e-mail",
    "add a sensor": "how-to/which-sensor",
    "frozen sensor": "how-to/stuck-sensor",
    "nonlinear plant": "how-to/nonlinear",
    "MATLAB": "how-to/simulink",
    "transfer function": "how-to/simulink",
    "notebook": "how-to/notebooks",
    "install on Windows": "how-to/windows",
    "bibtex": "how-to/cite",
    "how sure": "how-sure",
    "export residuals to pandas": "how-to/results",
    "fault at start": "how-to/first-sample",
    "Excel": "how-to/historians",
    "No Data": "how-to/historians",
    "anomaly detection": "learnt-monitors",
    "getting started": "getting-started",
}
ASK = """
const found = {};
for (const question of QUESTIONS)
  found[question] = Search._performSearch(...Search._parseQuery(question)).reverse().map((result) => result[0]);
document.body.textContent = JSON.stringify(found);
"""


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[str]]:
    """Return the pages that the search of the built documentation lists for each question, best first."""
    folder = tmp_path_factory.mktemp("search")
    page = (BUILT / "search.html").read_text(encoding="utf-8")
    own = re.findall(r'<script src="((?:_static/|searchindex)[^?"]*)', page)
    scripts = [f'<script src="{(BUILT / script).as_uri()}"></script>' for script in own]
    ask = f"<script>{ASK.replace('QUESTIONS', json.dumps([*QUESTIONS, *REWORDED]))}</script>"
    page = f'<html data-content_root="./"><head></head><body>{"".join(scripts)}{ask}</body></html>'
    (folder / "page.html").write_text(page, encoding="utf-8")
    dom = drawn((folder / "page.html").as_uri(), folder / "browser")
    body = re.findall(r"<body>(.*?)</body>", dom, flags=re.DOTALL)
    answers: dict[str, list[str]] = json.loads(body[0])
    return {question: list(dict.fromkeys(pages)) for question, pages in answers.items()}


@built
@browser
def test_the_search_answers_newcomers(found: dict[str, list[str]]) -> None:
    missed = {
        question: found[question][:10] for question, page in QUESTIONS.items() if page not in found[question][:10]
    }
    assert not missed
    later = [question for question, page in QUESTIONS.items() if found[question][0] != page]
    assert len(later) <= 2, later


@built
@browser
def test_the_search_answers_other_words(found: dict[str, list[str]]) -> None:
    assert not [question for question, page in REWORDED.items() if page not in found[question][:10]]


@built
@browser
def test_the_page_of_the_search_shows_the_same(found: dict[str, list[str]], tmp_path: Path) -> None:
    dom = drawn(f"{(BUILT / 'search.html').as_uri()}?q={quote('stuck sensor')}", tmp_path)
    (results,) = re.findall(r'<ul[^>]*class="search".*?</ul>', dom, flags=re.DOTALL)
    addresses = re.findall(r'<a href="([^"#?]*)\.html', results)
    assert list(dict.fromkeys(addresses))[:5] == found["stuck sensor"][:5]
