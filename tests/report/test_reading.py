"""Pages as they are read: on a phone, by keyboard, at first sight."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from bank_examples import hand_made_bank, recording, sampled_plant
from chromium import BROWSER, Chromium
from page_reader import read, words
from report_examples import diagnosis, generator
from residua.monitor import Monitor
from residua.report.page import Section, Table, render, write_demo_page, write_page

in_browser = pytest.mark.skipif(BROWSER is None, reason="no Chromium on this machine")
LONG = "a very long name of a residual, without an end, of the third exchanger"
COMMAND = "residua run tank.json leak.csv --report leak.html"


@pytest.fixture
def show(browser, tmp_path):
    """Open a page; at the end nothing went wrong in it."""

    def opened(path, *, phone: bool = False) -> Chromium:
        browser.size(390 if phone else 1280, 844 if phone else 1600, phone=phone)
        browser.open("about:blank")
        browser.open(path.as_uri())
        browser.wait("document.documentElement.dataset.charts")
        return browser

    yield opened
    assert browser.ask("document.documentElement.dataset.error") == ""


def press(page: Chromium, key: str) -> None:
    for kind in ("keyDown", "keyUp"):
        page.call("Input.dispatchKeyEvent", type=kind, key=key)


def several(**options) -> list[Section]:
    shared = generator(3, names=["a", "b", LONG])
    return [
        Section("In short", paragraphs="Threshold 3.2.", commands=[COMMAND], table=Table(["n"] * 12, [[1.2345] * 12])),
        Section("quiet", diagnosis(gen=shared, fault=False), actual=(), folded=True),
        Section("failed", diagnosis(gen=shared), actual="b", **options),
    ]


def test_the_verdict_comes_first():
    text = words(render(several(), "Which failed?", "Two recordings of three tanks."))
    assert text.startswith(
        "Which failed? Which failed? ⚠ Fault found: either b sensor or something not listed, alarm raised at 30.2 s. "
        "Case: failed Two recordings"
    )
    one = words(render([Section("", diagnosis())], "tanks"))
    assert one.startswith("tanks tanks ⚠ Fault found: either level 2 sensor or something not listed")


def test_a_folded_section_shows_its_heading_and_verdict_alone():
    reader = read(render(several(), "t"))
    cases = [attributes for tag, attributes in reader.tags if tag == "details" and attributes.get("class") == "case"]
    assert cases == [{"class": "case"}]
    assert "quiet No fault found." in words(render(several(), "t"))


def test_a_command_is_one_whole_line():
    page = render(several(), "t")
    assert f'<pre class="command"><code>{COMMAND}</code></pre>' in page


@in_browser
@pytest.mark.parametrize("kind", ["several", "bank", "many"])
def test_a_page_fits_a_phone(show, tmp_path, kind):
    path = tmp_path / "page.html"
    if kind == "several":
        write_demo_page(several(), path, "Which of the three tanks has failed?")
    elif kind == "bank":
        plant = sampled_plant(5, outputs=5)
        write_page(Monitor(hand_made_bank(plant)).run(*recording(plant, faults={"y2 sensor": 4.0})), path)
    else:
        write_page(diagnosis(gen=generator(12), source="x" * 200), path)
    page = show(path, phone=True)
    assert page.ask("document.documentElement.scrollWidth") == 390
    page.ask("document.querySelectorAll('details').forEach((one) => { one.open = true; })")
    page.wait("[...document.querySelectorAll('.plot')].every((one) => one.querySelector('canvas'))")
    assert page.ask("document.documentElement.scrollWidth") == 390
    sizes = "[...document.querySelectorAll('button, summary, figcaption label')].map((one) => one.offsetHeight)"
    assert min(json.loads(page.ask(f"JSON.stringify({sizes})"))) >= 44
    widths = "[...document.querySelectorAll('.plot canvas')].map((one) => one.getBoundingClientRect().right)"
    assert max(json.loads(page.ask(f"JSON.stringify({widths})"))) <= 390


@in_browser
def test_values_are_there_before_any_hover(show, tmp_path):
    found = diagnosis()
    statistic = found.statistic.copy()
    statistic[-3:] = np.nan  # the last one with a value is shown
    page = show(write_page(replace(found, statistic=statistic), tmp_path / "page.html"))
    legend = page.ask("document.querySelector('.chart.scores .u-legend').textContent")
    assert legend.startswith("Att = 59.9 s")
    for name, score in zip(found.group_names, found.scores[-1], strict=True):
        shown = float(legend.split(name)[1][:6].rstrip("abcdefghijklmnopqrstuvwxyz"))
        assert shown == pytest.approx(score, abs=1e-4)
    readout = page.ask("document.querySelector('.chart.statistic .readout').textContent")
    assert readout == f"t = 59.6 s: {float(f'{statistic[-4]:.4g}'):.5g}"


@in_browser
def test_a_chart_is_read_by_keyboard(show, tmp_path):
    found = diagnosis()
    page = show(write_page(found, tmp_path / "page.html"))
    page.ask("document.querySelector('.log').focus()")
    press(page, "Tab")
    assert page.ask("document.activeElement.getAttribute('aria-label')") == (
        f"Statistic and its threshold over time, threshold {found.threshold:.4g}"
    )

    def heard() -> str:
        return page.ask("document.activeElement.getAttribute('aria-valuetext')")

    def spoken(k: int) -> str:
        return f"t = {k / 10:.8g} s: {float(f'{found.statistic[k]:.4g}'):.5g}"

    assert heard() == spoken(599)
    for key, k in [("ArrowLeft", 598), ("ArrowLeft", 597), ("ArrowRight", 598), ("Home", 0), ("ArrowRight", 1)]:
        press(page, key)
        assert heard() == spoken(k), key
    readout = page.ask("document.querySelector('.chart.residual .readout').textContent")
    assert readout.startswith("t = 0.1 s: ")  # the cursors of all charts move together
    press(page, "PageDown")
    assert heard() == spoken(31)
    press(page, "End")
    press(page, "+")
    press(page, "Home")
    assert heard() == spoken(450)  # the last quarter is left
    press(page, "Escape")
    press(page, "Home")
    assert heard() == spoken(0)


@in_browser
def test_each_chart_has_a_table(show, tmp_path):
    found = diagnosis()
    page = show(write_page(found, tmp_path / "page.html"))
    assert page.ask("document.querySelectorAll('.plot + details.values').length") == 5
    table = "document.querySelector('.chart.statistic details.values')"
    assert page.ask(f"{table}.querySelector('table')") is None
    page.ask(f"{table}.querySelector('summary').click()")
    page.wait(f"{table}.querySelector('table')")
    cells = "[...row.cells].map((cell) => cell.textContent)"
    head, *rows = json.loads(page.ask(f"JSON.stringify([...{table}.querySelectorAll('tr')].map((row) => {cells}))"))
    assert head == ["From", "statistic", "State"]
    assert len(rows) == 24
    assert [rows[0][0], rows[0][2], rows[-1][0], rows[-1][2]] == ["t = 0 s", "not judged", "t = 57.5 s", "alarm"]
    low, high = (float(text) for text in rows[-1][1].split(" to "))
    assert [low, high] == pytest.approx([found.statistic[575:].min(), found.statistic[575:].max()], rel=1e-3)


@in_browser
def test_a_folded_section_is_drawn_when_its_link_opens_it(show, tmp_path):
    page = show(write_demo_page(several(), tmp_path / "page.html", "t"))
    drawn = "Number(document.documentElement.dataset.drawnCharts)"
    page.wait(f"{drawn} === 5")
    page.ask("document.querySelector('.summary a[href=\"#s2\"]').click()")
    page.wait(f"{drawn} === 10")
    assert page.ask("document.querySelector('#s2 details').open") is True


@in_browser
def test_the_button_copies_the_command(show, tmp_path):
    page = show(write_demo_page(several(), tmp_path / "page.html", "t"))
    page.ask("document.querySelector('pre.command button').click()")
    assert page.ask("String(getSelection())") == COMMAND
