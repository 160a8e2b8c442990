"""The page in a real browser: charts drawn, no error, no access to the network."""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import residua as rs
from bank_examples import hand_made_bank, recording, sampled_plant, static_estimator
from dedicated_examples import dedicated_bank, three_drifts
from report_examples import diagnosis, generator
from residua.report.page import Section, write_demo_page, write_page

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
pytestmark = pytest.mark.skipif(BROWSER is None, reason="no Chromium on this machine")
NASTY = '</script><img src=x onerror="document.title=1">'


def browse(page: Path, folder: Path, *options: str) -> str:
    assert BROWSER is not None
    command = [
        BROWSER,
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--disable-dev-shm-usage",
        f"--user-data-dir={folder / 'browser'}",
        "--window-size=1280,1600",
        "--virtual-time-budget=5000",
        *options,
        page.as_uri(),
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    return done.stdout


def facts(dom: str) -> dict[str, str]:
    root = re.search(r"<html[^>]*>", dom)
    assert root is not None
    return dict(re.findall(r'data-([a-z-]+)="([^"]*)"', root[0]))


def test_charts_are_drawn_without_error(tmp_path):
    d = diagnosis(20_000)
    dom = browse(write_page(d, tmp_path / "page.html"), tmp_path, "--dump-dom")
    seen = facts(dom)
    assert seen["error"] == ""
    assert seen["charts"] == seen["drawn-charts"] == "5"
    assert int(seen["drawn-points"]) == 20_000 * (3 + 1 + len(d.groups))
    canvases = re.findall(r'<canvas[^>]*width="(\d+)"[^>]*height="(\d+)"', dom)
    assert len(canvases) == 5
    assert all(int(w) > 500 and int(h) > 100 for w, h in canvases)
    assert float(seen["draw-ms"]) < 5000


def test_a_hard_page_draws_too(tmp_path):
    missing = np.zeros(600, dtype=bool)
    missing[100:110] = True
    nan = np.where(missing, np.nan, 1.0)
    gappy = diagnosis(gen=generator(2, names=[NASTY, "b"]), missing=missing, source=NASTY)
    gappy = replace(gappy, residuals=gappy.residuals * nan[:, None], statistic=gappy.statistic * nan * 1e4)
    nothing = diagnosis(100, fault=False)
    nothing = replace(nothing, residuals=nothing.residuals * np.nan, statistic=nothing.statistic * np.nan)
    sections = [
        Section(NASTY, gappy, NASTY),
        Section("nothing to draw", nothing),
        Section("many residuals", diagnosis(gen=generator(8))),
        Section("one residual", diagnosis(1, gen=generator(1), fault=False)),
    ]
    dom = browse(write_demo_page(sections, tmp_path / "page.html", NASTY), tmp_path, "--dump-dom")
    seen = facts(dom)
    assert seen["error"] == ""
    assert int(seen["charts"]) == 4 + 5 + 10 + 3
    assert int(seen["drawn-charts"]) == 4 + 5 + 8 + 3  # two residuals wait behind a click
    assert not re.search(r"<img", dom)


def test_a_bank_with_an_estimator_is_drawn(tmp_path):
    plant = sampled_plant(5, outputs=5)
    watch = rs.Monitor(hand_made_bank(plant), estimator=static_estimator(plant, "y2 sensor"))
    found = watch.run(*recording(plant, faults={"y2 sensor": 4.0}))
    assert isinstance(found, rs.Diagnosis)
    seen = facts(browse(found.to_html(tmp_path / "page.html"), tmp_path, "--dump-dom"))
    assert seen["error"] == ""
    assert int(seen["charts"]) == len(found.generator.residuals) + 1 + 5 + 1 + 5 + 2
    # The bank's own residuals, the fifth output and the inputs wait behind a click.
    assert int(seen["drawn-charts"]) == 1 + 1 + 5 + 1 + 4


def test_three_drifting_sensors_are_drawn(tmp_path):
    """Charts with axes, alarms and onsets of their own, and residuals behind a click."""
    found = rs.Monitor(dedicated_bank()).run(None, three_drifts())
    assert isinstance(found, rs.Diagnosis)
    dom = browse(found.to_html(tmp_path / "page.html"), tmp_path, "--dump-dom")
    seen = facts(dom)
    assert seen["error"] == ""
    assert int(seen["charts"]) == 3 + 1 + 3 + 3
    assert int(seen["drawn-charts"]) == 1 + 3 + 3


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_screenshot_is_not_blank(tmp_path, scheme):
    pytest.importorskip("matplotlib")
    from matplotlib.image import imread

    page = write_page(diagnosis(), tmp_path / "page.html")
    picture = tmp_path / "page.png"
    theme = f"--blink-settings=preferredColorScheme={0 if scheme == 'dark' else 1}"
    browse(page, tmp_path, "--hide-scrollbars", theme, f"--screenshot={picture}")
    pixels = imread(picture)[..., :3]
    assert pixels.shape[:2] == (1600, 1280)
    corner = pixels[5, 5].mean()
    assert corner < 0.2 if scheme == "dark" else corner > 0.95
    charts = pixels[600:1500, 150:1200].reshape(-1, 3)
    blue = (charts[:, 2] > charts[:, 0] + 0.25).mean()
    assert blue > 0.005  # the residuals' line


def test_paper_is_light_whatever_the_screen(tmp_path):
    page = write_page(diagnosis(gen=generator(8)), tmp_path / "page.html")
    sheet = tmp_path / "page.pdf"
    browse(page, tmp_path, "--blink-settings=preferredColorScheme=0", f"--print-to-pdf={sheet}")
    assert sheet.read_bytes().startswith(b"%PDF")
    assert sheet.stat().st_size > 20_000
