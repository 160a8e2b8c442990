"""Results in a notebook: short in a list, a headline, a table and a chart of their own, and nothing that runs."""

from __future__ import annotations

import importlib
import inspect
import re
from functools import cache
from html.parser import HTMLParser
from typing import Any

import numpy as np
import pytest

import residua as rs
from residua.decide import detectability
from residua.shown import Bar, Shown, grid, line_chart, table
from residua.validate import Scenario, campaign, step

ROOMS = ("analysis", "analysis.coding", "decide", "design", "identify", "monitor", "plant", "report", "validate")
#: Characters of a whole display, chart included.
LARGEST = 40_000


@cache
def results() -> dict[str, Any]:
    """Return results of every kind, with a name that HTML would take for something else."""
    plant = rs.Plant([[0.9]], [[0.1]], [[1.0], [1.0]], dt=1, inputs=["valve"], outputs=["<i>level</i>", "flow & more"])
    plant = plant.with_sensor_faults().with_faults({"leak": [-1.0]}).with_noise(process=1e-4, measurement=1e-2)
    rng = np.random.default_rng(0)
    quiet = [rng.standard_normal((1500, len(plant.noises))) for _ in range(2)]
    u = np.ones((1500, 1))
    normal, faulty = (plant.system(("control", "noise")).simulate(np.hstack([u, one])) for one in quiet)
    faulty[700:1100, 0] += 2.0
    monitor = rs.Monitor(rs.design.kalman_filter(plant))
    unfitted = rs.Monitor(rs.design.unknown_input_observer(plant).residual_generator())
    monitor.fit(u, normal)
    found = monitor.run(u, faulty)
    assert isinstance(found, rs.Diagnosis)
    fleet = rs.Fleet(monitor, plants=["<b>", "c"])
    fleet.follow(["<b>"], u[None, :900], faulty[None, :900])
    made = campaign(monitor, Scenario("leak", step(at=100), [0.2, 0.4]), runs=5, samples=300)
    return {
        "plant": plant,
        "input-output model": rs.InputOutputModel.from_plant(plant),
        "monitor": monitor,
        "monitor without a threshold": unfitted,
        "diagnosis": found,
        "quiet diagnosis": monitor.run(u, normal),
        "empty diagnosis": monitor.run(u[:0], normal[:0]),
        "alarm": found.alarms[0],
        "diagnosability": rs.diagnosability(plant),
        "suggestion": rs.suggest(plant, seconds=2.0),
        "fit check": monitor.fit_check,
        "campaign": made,
        "table of a campaign": made.table(),
        "detectability": detectability(monitor, runs=50, within=50),
        "residual report": rs.decide.residual_report(monitor, u, normal),
        "fleet": fleet,
        "learnt": rs.learn(normal[:600], outputs=["a", "b"], force=True),
    }


class Tags(HTMLParser):
    """The tags of a page, that each end tag belongs to the last one that was begun."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.seen: set[str] = set()
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.seen.add(tag)
        assert not [name for name, _ in attrs if name.startswith("on") or name in ("href", "src")]
        self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.seen.add(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


NAMES = (
    *("plant", "input-output model", "monitor", "monitor without a threshold", "diagnosis", "quiet diagnosis"),
    *("empty diagnosis", "alarm", "diagnosability", "suggestion", "fit check", "campaign", "table of a campaign"),
    *("detectability", "residual report", "fleet", "learnt"),
)


@pytest.mark.parametrize("name", NAMES)
def test_a_repr_is_a_line(name: str) -> None:
    one = results()[name]
    assert re.fullmatch(rf"{type(one).__name__}\(.{{3,220}}\)", repr(one))


@pytest.mark.parametrize("name", NAMES)
def test_a_display_is_small_escaped_and_runs_nothing(name: str) -> None:
    text = results()[name]._repr_html_()
    tags = Tags(text).seen
    known = {"div", "p", "b", "table", "thead", "tbody", "tr", "th", "td", "ul", "li", "pre", "figure", "figcaption"}
    assert tags <= known | {"svg", "path", "rect", "text"}
    assert "<i>level</i>" not in text
    assert 80 < len(text) < LARGEST


@pytest.mark.parametrize(
    ("name", "wanted"),
    [
        ("plant", ["table", "svg"]),
        ("monitor", ["table"]),
        ("diagnosis", ["table", "svg"]),
        ("alarm", ["table", "svg"]),
        ("suggestion", ["table", "svg"]),
        ("diagnosability", ["table", "svg"]),
        ("campaign", ["table", "svg"]),
        ("detectability", ["table", "svg"]),
        ("fit check", ["table"]),
        ("fleet", ["table"]),
        ("residual report", ["pre"]),
    ],
)
def test_a_display_has_its_table_and_chart(name: str, wanted: list[str]) -> None:
    assert set(wanted) <= Tags(results()[name]._repr_html_()).seen


def test_a_diagnosis_says_what_it_found_first() -> None:
    found = results()["diagnosis"]
    assert "Fault found" in repr(found)
    assert "&lt;i&gt;level&lt;/i&gt; sensor" in found._repr_html_()
    assert "No fault found" in repr(results()["quiet diagnosis"])
    assert "sensor" in repr(found.alarms[0])


def test_a_diagnosis_is_neither_true_nor_false() -> None:
    with pytest.raises(rs.errors.SettingError, match=r"diagnosis\.fault_detected"):
        bool(results()["diagnosis"])


def test_every_public_result_that_prints_as_lines_is_shown() -> None:
    """All but tables that are tuples."""
    missing = []
    for room in ROOMS:
        module = importlib.import_module(f"residua.{room}")
        for name in dir(module):
            cls = getattr(module, name)
            prints = vars(cls).get("__str__") if inspect.isclass(cls) else None
            if prints and 'n".join' in inspect.getsource(prints) and not issubclass(cls, (Shown, tuple)):
                missing.append(f"{room}.{name}")
    assert missing == []


def test_a_line_is_drawn_through_its_extremes() -> None:
    y = np.zeros(100_000)
    y[77_777], y[50_000:60_000] = 9.0, np.nan
    text = line_chart(np.arange(100_000.0), y, label="x", limit=1.0)
    drawn = re.findall(r"[ML]([\d.]+) ([\d.]+)", text.split('stroke="#')[0])
    heights = [float(b) for _, b in drawn]
    assert len(drawn) < 1000
    assert min(heights) == pytest.approx((170 - 18) * 0.06, abs=0.1)
    assert max(heights) == 152.0
    assert text.count("M") >= 2
    assert line_chart([0.0, 1.0], [np.nan, np.nan], label="x") == ""


def test_a_line_far_above_its_threshold_has_a_logarithmic_axis() -> None:
    heights = []
    for top in (5.0, 5e6):
        text = line_chart([0, 1, 2], [0.5, 1.0, top], label="x", limit=1.0)
        heights.append([float(b) for b in re.findall(r"[ML][\d.]+ ([\d.]+)", text.split('stroke="#')[0])])
    assert heights[0][0] - heights[0][1] == pytest.approx(0.5 / 5.0 * 152 * 0.94, abs=0.1)
    assert heights[1][0] - heights[1][1] == pytest.approx(np.log(5) / np.log(5e7) * 152 * 0.94 * 0 + 0.0, abs=20)
    assert heights[1][0] > heights[1][1] > heights[1][2]


def test_tables_and_grids_stay_small() -> None:
    text = table(["a", "b"], [(k, Bar(2.0, "<x>")) for k in range(50)])
    assert text.count("<tr>") == 21
    assert "and 30 more rows" in text
    assert 'width="80.0"' in text
    assert "<x>" not in text
    assert table(["a"], []) == ""
    assert grid(np.eye(100), ["x"] * 100, ["y"] * 100, label="z") == ""
    assert grid(np.eye(3), ["x"] * 3, ["y"] * 3, label="z").count('fill="#') == 3
