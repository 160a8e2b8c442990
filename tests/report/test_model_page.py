"""The page of an identified model: its parts, its numbers against the report, and odd recordings."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

import residua as rs
from page_reader import words
from residua.report import write_model_page
from residua.report.drawings import stems
from residua.report.model_page import LAGS, autocorrelation

ROWS = 3000


def log(rows: int = ROWS, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Inputs and outputs of two tanks in a row."""
    rng = np.random.default_rng(seed)
    plant = rs.Plant([[0.9, 0.0], [0.1, 0.8]], [[0.5], [0.0]], np.eye(2), dt=2.0)
    u = rng.standard_normal((rows, 1))
    return u + 3.0, plant.system("control").simulate(u) + [40.0, 30.0] + 0.1 * rng.standard_normal((rows, 2))


@pytest.fixture(scope="module")
def model() -> rs.identify.IdentifiedModel:
    units = {"valve": "%", "upper": "cm"}
    return rs.identify.subspace(*log(), inputs=["valve"], outputs=["upper", "lower <b>"], dt=2.0, units=units)


def data_of(page: str) -> dict:
    found = re.search(r'id="residua-data">(.*?)</script>', page, flags=re.DOTALL)
    assert found is not None
    return json.loads(found[1])["diagnoses"][0]


def test_the_page_says_what_the_report_says(model: rs.identify.IdentifiedModel, tmp_path: Path) -> None:
    u, y = log(800, seed=1)
    page = write_model_page(model, u, tmp_path / "fit.html", y=y).read_text(encoding="utf-8")
    text = words(page)
    assert f"order {model.report.order}" in text
    for line in model.report.remarks:
        assert line in text
    assert "http://" not in re.sub(r"<svg.*?</svg>|<!--.*?-->|<script>.*?</script>", "", page, flags=re.DOTALL)
    assert "lower &lt;b&gt;" in page
    assert "per valve [%]" in text
    assert page.count('class="chart"') == 2
    data = data_of(page)
    assert [c["label"] for c in data["charts"]] == ["upper", "lower <b>"]
    assert data["charts"][0]["unit"] == "cm"
    measured, predicted = (np.array(series, dtype=float) for series in data["charts"][0]["y"])
    [seen] = model.predict(u, y)
    assert np.allclose(measured, y[:, 0], rtol=1e-3)  # as many digits as a chart shows
    assert np.allclose(predicted, seen.predicted[:, 0], rtol=1e-3, equal_nan=True)
    past = model.report.past
    assert data["spans"]["undecided"] == [[0.0, 2.0 * past]]


def test_long_recordings_keep_their_extremes(model: rs.identify.IdentifiedModel, tmp_path: Path) -> None:
    u, y = log(50_000, seed=2)
    y[31_234, 0] = 60.0
    page = write_model_page(model, u, tmp_path / "fit.html", y=y).read_text(encoding="utf-8")
    data = data_of(page)
    assert max(v for v in data["charts"][0]["y"][0] if v is not None) == 60.0
    assert len(data["charts"][0]["y"][0]) <= 20_000
    assert "Drawn as the smallest and the largest value of every" in words(page)


def test_gaps_are_shown_as_gaps(model: rs.identify.IdentifiedModel, tmp_path: Path) -> None:
    u, y = log(500, seed=3)
    y[200:210, 1] = np.nan
    data = data_of(write_model_page(model, u, tmp_path / "fit.html", y=y).read_text(encoding="utf-8"))
    assert data["spans"]["missing"] == [[400.0, 420.0]]
    assert len(data["spans"]["undecided"]) == 2


def test_a_recording_too_short_to_predict_has_a_page(model: rs.identify.IdentifiedModel, tmp_path: Path) -> None:
    u, y = log(2, seed=3)
    page = write_model_page(model, u, tmp_path / "fit.html", y=y).read_text(encoding="utf-8")
    assert "Prediction errors in time" not in words(page)


def test_autocorrelation_against_its_definition() -> None:
    e = np.random.default_rng(4).standard_normal((400, 2)) + 1.0
    e[1:] += 0.6 * e[:-1]
    own, pairs = autocorrelation([e], LAGS)
    centred = e - e.mean(axis=0)
    for lag in (1, 7, LAGS):
        expected = (centred[lag:] * centred[:-lag]).mean(axis=0) / (centred**2).mean(axis=0)
        assert np.allclose(own[lag - 1], expected)
        assert pairs[lag - 1] == 400 - lag
    apart, counted = autocorrelation([e[:200], e[200:]], 3)
    assert counted.tolist() == [398, 396, 394]
    assert np.abs(apart - own[:3]).max() < 0.05  # two pairs fewer to a lag


def test_stems_lie_inside_their_picture() -> None:
    values = [3.2e3, 41.0, 0.2, 1e-30, np.nan, 0.0]
    for log_axis in (False, True):
        picture = stems(range(1, 7), values, title="a <b>", x_label="order", y_label="size", mark=2, log=log_axis)
        assert "a &lt;b&gt;" in picture
        at = np.array([[float(x), float(y)] for x, y in re.findall(r'circle cx="([\d.-]+)" cy="([\d.-]+)"', picture)])
        assert len(at) == (4 if log_axis else 5)  # a logarithm leaves out zero, and both what is no number
        assert (at >= 0).all()
        assert (at <= [340, 210]).all()
        assert (np.diff(at[:, 1]) >= 0).all()  # smaller values lie lower
    assert stems([1, 2], [np.nan, np.nan], title="", x_label="", y_label="") == ""
    assert "class" not in stems([0], [0.0], title="t", x_label="x", y_label="y")
