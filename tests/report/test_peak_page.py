"""Pages and plots of a finite-horizon test, and of several faults in a dedicated bank."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest

import residua as rs
from bank_examples import recording as noisy, sampled_plant
from dedicated_examples import FAULTS, MEMBERS, THREE, dedicated_bank, recording, three_drifts
from page_reader import read, words
from report_examples import changed
from residua.decide import NormThreshold, PeakThreshold
from residua.report.charts import PEAK_FLOOR, chart_data, onsets, own_alarms, shows_scores
from residua.report.codes import code_table, present_table
from residua.report.page import Section, render
from residua.report.plots import plot_diagnosis
from residua.report.verdict import CERTAIN, verdict

BANK = dedicated_bank()


def run(y: np.ndarray, watch: rs.Monitor | None = None, u: np.ndarray | None = None) -> rs.Diagnosis:
    found = (watch or rs.Monitor(BANK)).run(u, y)
    assert isinstance(found, rs.Diagnosis)
    return found


@pytest.fixture(scope="module")
def three() -> rs.Diagnosis:
    return run(three_drifts())


def test_the_verdict_names_all_with_their_times(three: rs.Diagnosis) -> None:
    found = verdict(three)
    times = [f"{p.since:g}" for p in three.present]
    assert found.headline == (
        f"Fault found: either 3 at once, XNH sensor (fired from {times[0]} s), TMPC sensor (fired from {times[1]} s) "
        f"and XNL sensor (fired from {times[2]} s), or one that is not listed."
    )
    assert (found.confidence, found.margin) == ("either", None)
    assert CERTAIN in found.sentences
    assert CERTAIN not in verdict(changed(three, certified=False)).sentences
    gone = run(recording(60.0, drifts={FAULTS[0]: (20.0, 0.5), FAULTS[2]: (30.0, 0.5, 40.0)}))
    assert any(s.startswith("TMPC sensor: its member fell silent at 4") for s in verdict(gone).sentences)


def test_a_short_alarm_of_several_is_told_with_caution() -> None:
    """Not by a peak test, of which one sample over a threshold is enough."""
    normal, y = recording(30.0), recording(30.0)
    y[-12:] += 3.0
    assert verdict(run(y)).headline.startswith("Fault found: either 3 at once, XNH sensor (fired from 29.88 s), XNL")
    found = verdict(run(y, rs.Monitor(BANK, test=NormThreshold()).fit(None, normal)))
    assert found.confidence == "too early"
    assert re.search(
        r"too early to be sure of the names, .*; so far \w+ sensor \(fired from 29.9 s\), ", found.headline
    )


def test_the_page_says_how_it_was_tested(three: rs.Diagnosis) -> None:
    text = words(render([Section("", three)], "t"))
    assert "finite-horizon peak test, window 60 samples (0.6 s), thresholds certified by the design" in text
    assert (
        "only XNH 0.126, only XNL 0.1335, only TMPC 0.0608 (certified by the design over its uncertainty set)" in text
    )
    assert "raised by one sample over its threshold, ended by 60 below it" in text
    assert "Member only XNL: norm of its residual and its threshold" in text
    assert "Largest ratio of a member's norm to its threshold" in text
    assert "The test over time" in text
    assert "Every fault fires a member of its own." in text
    for absent in ("whitened", "Fault-free mean", "fault-free mean", "The score is", "Candidate scores"):
        assert absent not in text
    one = words(render([Section("", run(recording(40.0, drifts={FAULTS[1]: (25.0, 0.5)})))], "t"))
    assert "Fault found: XNL sensor" in one
    assert "The score is the fraction of the members that agree with a code." in one
    assert "Candidate scores" in one


def test_the_summary_knows_when_all_were_named(three: rs.Diagnosis) -> None:
    sections = [
        Section("a", three, actual=FAULTS),
        Section("b", three, actual=FAULTS[:2]),
        Section("c", three, actual=()),
    ]
    text = words(render(sections, "t"))
    named = "XNH sensor, XNL sensor and TMPC sensor"
    assert f"{named} ✓ right" in text
    assert f"{named} ✗ wrong" in text
    assert f"{named} ✗ false alarm" in text


def test_tables_show_each_fault_with_its_member(three: rs.Diagnosis) -> None:
    rows = re.findall(r"<tr>(.*?)</tr>", present_table(three), flags=re.DOTALL)[1:]
    cells = [re.findall(r">([^<]+)</td>", row) for row in rows]
    assert [(fault, member) for fault, member, *_ in cells] == [(f, MEMBERS[FAULTS.index(f)]) for f in THREE]
    assert [since for *_, since, _ in cells] == [f"{p.since:g} s" for p in three.present]
    table = code_table(three)
    assert table.count('<span class="tag">read</span>') == 3
    assert "differs" not in table
    assert "Agree" not in table
    alone = run(recording(40.0, drifts={FAULTS[1]: (25.0, 0.5)}))
    assert present_table(alone) == ""
    assert "Agree" in code_table(alone)


def test_the_chart_of_a_member_shows_its_own_alarms(three: rs.Diagnosis) -> None:
    data = chart_data(three)
    assert data["onsets"] == onsets(three) == sorted(p.since for p in three.present)
    members = {c["label"]: c for c in data["charts"] if c["kind"] == "member"}
    for p in three.present:
        chart = members[p.member]
        assert chart["onsets"] == [p.since]
        assert chart["alarms"][-1] == [p.since, pytest.approx(69.99)]
        assert chart["log"], "all members on one kind of axis"
        assert chart["floor"] == pytest.approx(PEAK_FLOOR * BANK.thresholds[p.member])
        assert chart["threshold"] == BANK.thresholds[p.member]
    (ratio,) = (c for c in data["charts"] if c["kind"] == "statistic")
    assert (ratio["axis"], ratio["threshold"]) == ("ratio [–]", 1.0)
    assert not any(c["kind"] == "scores" for c in data["charts"])
    assert not shows_scores(three)


def test_a_residual_keeps_its_unit_as_it_is_not_whitened() -> None:
    plant = sampled_plant(3)
    watch = rs.Monitor(rs.design.kalman_filter(plant), test=PeakThreshold(2.0))
    u, y = noisy(plant, faults={"y2 sensor": 4.0})
    found = run(y, watch, u)
    assert own_alarms(changed(found, codes=None), 0) is None
    charts = {c["kind"]: c for c in chart_data(found)["charts"]}
    assert (charts["statistic"]["unit"], charts["statistic"]["axis"]) == ("m", "norm [m]")
    page = render([Section("", found)], "t")
    assert "Norm and its threshold [m]" in words(page)
    assert json.loads(read(page).data)["diagnoses"][0]["charts"]


def test_plots_shade_the_alarms_of_each_member(three: rs.Diagnosis) -> None:
    matplotlib = pytest.importorskip("matplotlib")
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = plot_diagnosis(three, figure=Figure(figsize=(8, 8)))
    FigureCanvasAgg(figure).draw()
    assert len(figure.axes) == 3 + 1, "no scores: they say nothing of several faults"
    for panel, member, fault in zip(figure.axes, MEMBERS, FAULTS, strict=False):
        since = next(p.since for p in three.present if p.faults == (fault,))
        begun = [line.get_xdata()[0] for line in panel.lines if line.get_linestyle() == ":"]
        assert begun == [since]
        assert panel.get_yscale() == "log"
        assert panel.get_ylim()[0] == pytest.approx(PEAK_FLOOR * BANK.thresholds[member])
    text = " | ".join(t.get_text() for t in figure.findobj(matplotlib.text.Text))
    assert "norm" in text
    quiet = plot_diagnosis(run(recording(20.0)), figure=Figure(figsize=(8, 8)))
    assert {panel.get_yscale() for panel in quiet.axes} == {"linear"}


def test_an_unknown_time_leaves_the_name(three: rs.Diagnosis) -> None:
    (alarm,) = three.alarms
    less = replace(three, alarms=(replace(alarm, present=alarm.present[:2]),))
    assert verdict(less).headline.endswith(
        "TMPC sensor (fired from 40.18 s) and XNL sensor, or one that is not listed."
    )


def test_a_dedicated_bank_of_the_package_names_three_drifting_sensors() -> None:
    """With thresholds given by hand; each drift is some steps that add up."""
    plant = sampled_plant(1)
    bank = rs.design.sensor_fault_bank(plant, scheme="dedicated")
    quiet = noisy(plant, 2000, seed=4)
    limits = 1.4 * np.nanmax(run(quiet[1], rs.Monitor(bank), quiet[0]).residuals[100:] ** 2, axis=0) ** 0.5
    watch = rs.Monitor(bank, test=PeakThreshold([float(x) for x in limits], window=60))
    u, y = noisy(plant, 2000, seed=5)
    starts = {"y3 sensor": 400, "y1 sensor": 1000, "y4 sensor": 1400}
    for name, start in starts.items():
        y[start:, plant.faults.index(name)] += 0.02 * np.arange(2000 - start)
    found = run(y, watch, u)
    assert verdict(found).present == (("y1 sensor",), ("y3 sensor",), ("y4 sensor",))
    assert [p.faults[0] for p in found.present] == list(starts)
    for p in found.present:
        assert 0 < p.since / plant.dt - starts[p.faults[0]] < 450  # what a member sees of a constant fault is small
