"""The live page in a real browser: faults at once, after a lost connection too, and nobody else is asked."""

from __future__ import annotations

import contextlib
import json
import re
import socket
import time
from urllib.parse import urlsplit

import pytest

from chromium import BROWSER, Chromium
from fake_view import FakeView, Played, diagnoses
from page_reader import NASTY, read, words

pytest.importorskip("uvicorn", reason="the extra 'live' is not installed")


from residua.live.server import Server, Settings
from residua.report.live_page import live_page, live_policy

in_browser = pytest.mark.skipif(BROWSER is None, reason="no Chromium on this machine")
LIVE = "document.body.dataset.state === 'live'"
DRAWN = "document.body.dataset.drawnCharts > 0"


def test_the_page_is_whole_without_a_server():
    page = live_page(NASTY)
    reader = read(page)
    assert [tag for tag, _ in reader.tags].count("script") == 7
    assert not any("src" in dict(attributes) for tag, attributes in reader.tags if tag in ("script", "img", "iframe"))
    assert "three tanks" not in words(page)
    assert words(live_page("three <tanks>")).startswith("three <tanks>")
    assert "uPlot" in page
    assert "Leon Sorokin" in page
    policy = re.search(r'http-equiv="Content-Security-Policy" content="([^"]*)"', page)
    assert policy is not None
    assert live_policy() == policy[1] + "; frame-ancestors 'none'"


def test_no_data_is_ever_taken_as_html():
    """The scripts of the page put text, and nothing else, into it."""
    from importlib import resources

    for name in ("live.js", "live_charts.js", "axes.js", "reading.js"):
        text = resources.files("residua.report").joinpath("static", name).read_text()
        for word in ("innerHTML", "outerHTML", "insertAdjacentHTML", "document.write", "eval(", "new Function"):
            assert word not in text, name


@pytest.fixture
def page(browser):
    """The browser, for one page; afterwards nothing went wrong in it, and it asked nobody but its server."""
    browser.messages.clear()
    browser.size(1280, 1600)
    yield browser
    assert browser.ask("document.documentElement.dataset.error || ''") == ""
    asked = {urlsplit(url).hostname for url in browser.requests() if not url.startswith(("data:", "about:"))}
    assert asked <= {"127.0.0.1"}
    browser.open("about:blank")


@pytest.fixture
def view():
    made = FakeView.of({"north": "leak", "south": "healthy"})
    made.sources.append({"name": "mqtt b:1883", "kind": "mqtt", "good": True, "text": "connected"})
    made.sinks.append({"name": "jsonl x", "kind": "jsonl", "good": False, "text": "the disk is full", "behind": 3})
    return made


@contextlib.contextmanager
def shown(page: Chromium, view: FakeView, path: str = "", until: str = LIVE, settings: Settings | None = None):
    """A server whose page is open, once something is so of it."""
    with Server(view, settings) as running:
        page.open(running.address + path)
        page.wait(until)
        yield running


def numbers(page: Chromium) -> list[int]:
    """Return the places of the events that the page lists, oldest first."""
    places = "[...document.querySelectorAll('ol.events li')].map((li) => Number(li.dataset.place))"
    return json.loads(page.ask(f"JSON.stringify({places}.reverse())"))


def test_the_first_fault_is_there_within_two_seconds(page, view):
    view.play(150)
    with shown(page, view) as running:
        assert page.ask("document.body.dataset.faults") == "0"
        assert "No fault in 2 plants" in page.ask("document.querySelector('#summary').textContent")
        raised = view.plants["north"].diagnosis.alarms[0].start
        view.play(raised - 150, "north")
        assert not view.overview()["plants"]["fault"]
        begun = time.monotonic()
        view.play(1, "north")
        page.wait("document.querySelector('tr[data-plant=north][data-fault=\"leak 3\"]')", 2.0)
        page.wait("document.querySelector('ol.events li[data-plant=north][data-kind=raised]')", 2.0)
        assert time.monotonic() - begun < 2.0
        assert page.ask("document.title").startswith("⚠ 1")
        assert "A fault in 1 of 2 plants" in page.ask("document.querySelector('#summary').textContent")
        assert running.address.partition("token=")[2] not in page.ask("location.href")


def test_after_a_lost_connection_it_goes_on_without_a_hole(page, view, tmp_path):
    secret = tmp_path / "token"
    secret.write_text("the token of both servers\n")
    secret.chmod(0o600)
    view.play(150)
    with socket.create_server(("127.0.0.1", 0)) as free:
        settings = Settings(listen=f"127.0.0.1:{free.getsockname()[1]}", token_file=str(secret))
    with shown(page, view, settings=settings):
        page.wait(f"document.body.dataset.lastEvent == {len(view.events)}")
    page.wait("document.body.dataset.state === 'lost'")
    assert "Connection lost" in page.ask("document.querySelector('#status').textContent")
    for k in range(20):
        view.tell("south", "missing", k)  # meanwhile
    with Server(view, settings):
        page.wait(LIVE)
        page.wait(f"document.body.dataset.lastEvent == {len(view.events)}", 5.0)
        assert numbers(page) == list(range(1, len(view.events) + 1))
        view.play(view.plants["north"].diagnosis.alarms[0].start - 150, "north")
        begun = time.monotonic()
        view.play(1, "north")
        page.wait("document.querySelector('tr[data-plant=north][data-state=fault]')", 2.0)
        assert time.monotonic() - begun < 2.0
        assert numbers(page) == list(range(1, len(view.events) + 1))


def test_a_network_that_goes_and_comes(page, view):
    view.play(150)
    with shown(page, view):
        page.call("Network.emulateNetworkConditions", offline=True, latency=0, downloadThroughput=0, uploadThroughput=0)
        page.wait("document.body.dataset.state === 'lost'")
        view.tell("south", "missing", 1.0)
        page.call(
            "Network.emulateNetworkConditions", offline=False, latency=0, downloadThroughput=-1, uploadThroughput=-1
        )
        page.wait(LIVE)
        page.wait(f"document.body.dataset.lastEvent == {len(view.events)}")
        assert numbers(page) == list(range(1, len(view.events) + 1))


def test_another_token_is_said(page, view):
    with shown(page, view) as running:
        port = running.port
    with Server(view, Settings(listen=f"127.0.0.1:{port}")):
        page.wait("document.body.dataset.state === 'refused'")
        assert "open the address" in page.ask("document.querySelector('#status').textContent")


def test_one_plant_is_drawn_and_goes_on(page, view):
    view.play(400)
    with shown(page, view, "#/north", DRAWN):
        d = view.plants["north"].diagnosis
        assert page.ask("document.body.dataset.plant") == "north"
        assert page.ask("document.body.dataset.fault") == "leak 3"
        assert page.ask("document.querySelector('#verdict').className") == "verdict fault"
        assert "leak 3" in page.ask("document.querySelector('#verdict').textContent")
        assert page.ask("document.querySelectorAll('#alarms .told.lasts').length") == 1
        series = 1 + len(d.generator.residuals) + len(d.signals[0])
        assert int(page.ask("document.body.dataset.drawnCharts")) == series
        points = int(page.ask("document.body.dataset.drawnPoints"))
        assert points > 300 * series
        assert page.ask(
            "[...document.querySelectorAll('figure.chart')].map((f) => f.dataset.series).join()"
        ) == ",".join(["statistic", *d.generator.residuals, *d.generator.plant.inputs, *d.generator.plant.outputs])
        view.play(50, "north")
        page.wait(f"document.body.dataset.drawnPoints > {points}", 5.0)
        # Zoomed by a mouse, the charts stand still until all is shown again.
        box = "document.querySelector('#statistic .u-over').getBoundingClientRect()"
        left, top = page.ask(f"{box}.left"), page.ask(f"{box}.top + 50")
        for kind, x in (("mousePressed", 100), ("mouseMoved", 200), ("mouseMoved", 300), ("mouseReleased", 300)):
            page.call("Input.dispatchMouseEvent", type=kind, x=left + x, y=top, button="left", clickCount=1)
        page.wait("!document.querySelector('#held').hidden")
        page.ask("document.querySelector('#whole').click()")
        assert page.ask("document.querySelector('#held').hidden") is True
        page.ask("location.hash = ''")
        page.wait("document.body.dataset.view === 'overview'")
        page.ask("location.hash = '#/nowhere'")
        page.wait("document.querySelector('#verdict').textContent.includes('no such plant')")


def test_a_run_of_one_plant_shows_it_at_once(page):
    view = FakeView.of({"the only one": "leak"})
    view.play(300)
    with shown(page, view, until=f"document.body.dataset.view === 'plant' && {DRAWN}"):
        assert page.ask("document.body.dataset.plant") == "the only one"
        assert page.ask("document.querySelector('#all').hidden") is True


def test_whatever_is_said_is_shown_as_text(page):
    view = FakeView.of({NASTY: "leak", "<b>bold</b>": "healthy"}, title=NASTY)
    view.problems.append(NASTY)
    view.sources.append({"name": NASTY, "kind": "mqtt", "good": False, "text": NASTY})
    view.play(400)
    view.tell(NASTY, "missing", 1.0, channels=[NASTY])
    with shown(page, view):
        page.wait("document.querySelectorAll('ol.events li').length > 2")
        page.ask(f"location.hash = '#/' + encodeURIComponent({json.dumps(NASTY)})")
        page.wait(DRAWN)
        assert page.ask("document.body.dataset.plant") == NASTY
        assert page.ask("window.bad === undefined") is True
        assert page.ask("document.images.length") == 0
        assert page.ask("document.querySelectorAll('section b').length") == 0


def test_what_is_away_is_marked(page, view):
    view.play(100, "north")  # within the gap
    with shown(page, view):
        assert page.ask("document.querySelector('tr[data-plant=north]').dataset.state") == "missing"
        assert page.ask("document.querySelector('tr[data-plant=south]').dataset.state") == "waiting"
        assert "ago" not in page.ask("document.querySelector('table.plants tbody').textContent")
        ends = page.ask("[...document.querySelectorAll('table.ends tr')].map((tr) => tr.dataset.good).join()")
        assert ends == "true,false"
        assert "the disk is full; 3 events wait" in page.ask("document.querySelector('table.ends').textContent")
        away = "document.querySelector('#away').textContent"
        assert page.ask(away) == "⚠ to jsonl x: the disk is full; 3 events wait"
        view.sinks[0]["good"] = True
        page.wait("document.querySelector('#away').hidden", 5.0)
        view.problems.append("the store is away")
        view.age = 600.0
        page.wait("document.querySelector('tr[data-plant=north] td.old')?.textContent.endsWith(', 10 min ago')", 5.0)
        page.wait("!document.querySelector('#problems').hidden", 5.0)
        assert "the store is away" in page.ask("document.querySelector('#problems').textContent")


@pytest.fixture(scope="module")
def many():
    """Ten thousand plants, of which one has a fault."""
    healthy = diagnoses()["healthy"]
    view = FakeView({f"pump {k:05d}": Played(healthy, 300) for k in range(9_999)})
    view.plants["zz last"] = Played(diagnoses()["leak"])
    view.play(400, "zz last")
    return view


def test_ten_thousand_plants_go_by_pages(page, many):
    with shown(page, many):
        page.wait("document.querySelectorAll('table.plants tbody tr').length === 100")
        assert page.ask("document.querySelector('table.plants tbody tr').dataset.plant") == "zz last"
        assert page.ask("document.querySelector('#range').textContent") == "1 to 100 of 10,000"
        page.ask("document.querySelector('#on').click()")
        page.wait("document.querySelector('#range').textContent === '101 to 200 of 10,000'")
        page.ask("const f = document.querySelector('#find'); f.value = '04711'; f.dispatchEvent(new Event('input'))")
        page.wait("document.querySelectorAll('table.plants tbody tr').length === 1")
        assert page.ask("document.querySelector('table.plants tbody tr').dataset.plant") == "pump 04711"


@pytest.mark.parametrize("width", [390, 1280])
@pytest.mark.parametrize("hash", ["", "#/north"])
def test_it_fits_its_window(page, view, width, hash):
    view.play(400)
    page.size(width, 844, phone=width < 600)
    with shown(page, view, hash):
        page.wait(DRAWN if hash else "document.querySelector('tr[data-plant=north]')")
        assert page.ask("document.documentElement.scrollWidth") <= width


def test_the_ratio_reads_as_such_on_a_phone(page, view):
    view.play(900)
    page.size(390, 844, phone=True)
    with shown(page, view, until="document.querySelector('tr[data-plant=north]')"):
        cell = "document.querySelector('tr[data-plant=north] td.num')"
        assert float(page.ask(f"{cell}.textContent")) > 1
        assert page.ask(f"getComputedStyle({cell}, '::after').content") == '" × the threshold"'


def test_a_live_chart_is_read_by_keyboard_and_as_a_table(page, view):
    view.play(400)
    with shown(page, view, "#/north", DRAWN):
        page.ask("document.querySelector('#statistic .plot').focus()")
        heard = "document.activeElement.getAttribute('aria-valuetext')"
        last = view.plants["north"].diagnosis.statistic[399]
        assert float(page.ask(heard).split(": ")[1]) == pytest.approx(last, rel=1e-3)
        page.call("Input.dispatchKeyEvent", type="keyDown", key="ArrowLeft")
        before = view.plants["north"].diagnosis.statistic[398]
        assert float(page.ask(heard).split(": ")[1]) == pytest.approx(before, rel=1e-3)
        page.ask("document.querySelector('#statistic summary').click()")
        page.wait("document.querySelectorAll('#statistic tbody tr').length === 24")
        assert "alarm" in page.ask("document.querySelector('#statistic tbody').lastChild.textContent")


@pytest.mark.parametrize("dark", [False, True])
def test_charts_are_drawn_in_light_and_dark(page, view, tmp_path, dark):
    pytest.importorskip("matplotlib")
    from matplotlib.image import imread

    view.play(400)
    page.dark(dark)
    with shown(page, view, "#/north", DRAWN):
        pixels = imread(page.picture(tmp_path / "page.png"))[..., :3]
    page.dark(False)
    corner = pixels[5, 5].mean()
    assert corner < 0.2 if dark else corner > 0.95
    charts = pixels[450:1500, 150:1200].reshape(-1, 3)
    assert (charts[:, 2] > charts[:, 0] + 0.25).mean() > 0.005  # the lines
