from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from page_reader import NASTY, read, words
from report_examples import changed, diagnosis, generator
from residua.errors import FileFormatError
from residua.monitor.diagnosis import Candidate
from residua.report.charts import chart_data
from residua.report.page import Section, Table, render, write_demo_page, write_page
from residua.report.text import safe_json


def test_page_states_verdict_score_and_provenance(tmp_path):
    path = write_page(diagnosis(), tmp_path / "page.html")
    text = words(path.read_text(encoding="utf-8"))
    assert "tanks: fault diagnosis" in text
    assert "Fault found: either level 2 sensor or something not listed, alarm raised at 30.2 s." in text
    assert "Score 0.991, 7.7° off its signature; next is level 1 sensor with 0.780" in text
    assert "Recording tank08.csv : 600 samples from 0 s to 59.9 s, step 0.1 s" in text
    assert "No sample has missing values." in text
    assert re.search(r"Made by residua \d+\.\d+", text)
    leak = diagnosis().generator.evidence.decoupling["control"]
    assert leak < 1e-12
    assert f"{leak:.2g}".replace("-", "−") in text
    assert "Chen, Patton and Zhang (1996), eqs. (2) to (8)" in text


def test_pages_need_a_folder_that_exists(tmp_path):
    path = tmp_path / "new folder" / "page.html"
    for write in (lambda: write_page(diagnosis(50), path), lambda: write_demo_page([], path, "t")):
        with pytest.raises(FileFormatError, match="does not exist"):
            write()
    assert not path.parent.exists()
    with pytest.raises(FileFormatError, match="is a folder"):
        write_page(diagnosis(50), tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_directions_of_a_monitor_that_does_not_isolate():
    page = words(render([Section("", EDGES["no isolation"][0]())], "t"))
    assert "This monitor does not isolate; these are the signatures it would judge by." in page


def test_the_band_is_said_to_be_of_averaged_residuals():
    d = changed(diagnosis(), averaged=20, band_share=0.999)
    text = words(render([Section("", d)], "t"))
    assert "with Gaussian noise, 1 in 1,000 fault-free averages over 20 samples is outside" in text
    assert "its average over 20 samples; the test and the normal range refer to this average" in text
    charts = [c for c in chart_data(d)["charts"] if c["kind"] == "residual"]
    assert all(c["names"][1:] == ["average of 20"] and len(c["y"]) == 2 for c in charts)


def test_page_loads_nothing_and_allows_only_its_own_scripts():
    page = render([Section("", diagnosis())], "t")
    reader = read(page)
    assert not [a for _, attrs in reader.tags for a in attrs if a in ("src", "srcset") or a.startswith("on")]
    assert all(attrs.get("href", "#").startswith("#") for _, attrs in reader.tags)
    assert not re.search(r"url\(|@import", page)
    policy = next(a["content"] for t, a in reader.tags if a.get("http-equiv") == "Content-Security-Policy")
    assert policy is not None
    assert policy.startswith("default-src 'none'; script-src 'sha256-")
    script_rule = policy.split(";")[1]
    assert "unsafe" not in script_rule
    assert "Permission is hereby granted" in page  # uPlot's licence goes with it


def test_page_is_the_same_every_time():
    d = diagnosis()
    assert render([Section("", d)], "t") == render([Section("", d)], "t")


def test_every_text_is_escaped():
    names = [f"{NASTY} {k}" for k in range(3)]
    gen = generator(3, names=names)
    gen = replace(
        gen, evidence=replace(gen.evidence, notes=(NASTY,), references=(NASTY,), conditions={NASTY: 1.0}), method=NASTY
    )
    d = diagnosis(gen=gen, source=NASTY, notes=(NASTY,), unjudged=(NASTY,))
    sections = [
        Section(NASTY, d, [NASTY], Table([NASTY], [[NASTY]], NASTY), NASTY),
        Section(NASTY, diagnosis(gen=generator(2, names=[NASTY, "b"]))),
    ]
    page = render(sections, NASTY, NASTY)
    reader = read(page)
    assert [t for t, _ in reader.tags].count("script") == 6
    assert "img" not in [t for t, _ in reader.tags]
    assert not any(a.startswith("on") for _, attrs in reader.tags for a in attrs)
    labels = [c["label"] for c in json.loads(reader.data)["diagnoses"][0]["charts"] if c["kind"] == "residual"]
    assert labels == [f"r {name}".replace("\u2028", "\\u2028") for name in names]


@settings(max_examples=40, deadline=None)
@given(st.text(max_size=60))
def test_any_name_survives_the_embedded_data(text):
    embedded = safe_json({"name": text})
    assert not set("<>&\u2028\u2029") & set(embedded)
    assert json.loads(embedded) == {"name": text}


@settings(max_examples=15, deadline=None)
@given(st.text(st.characters(codec="utf-8", exclude_categories=["Cc", "Cs"]), min_size=1, max_size=20))
def test_any_heading_shows_as_written(text):
    page = render([Section(text)], "t")
    assert " ".join(text.split()) in words(page)


def test_nan_and_infinity_become_gaps():
    d = diagnosis(50)
    residuals = d.residuals.copy()
    residuals[3, 0], residuals[4, 0], residuals[5, 0] = np.nan, np.inf, -np.inf
    d = changed(d, residuals=residuals, threshold=np.nan, center=np.full(3, np.nan))
    charts = json.loads(read(render([Section("", d)], "t")).data)["diagnoses"][0]["charts"]
    assert charts[0]["y"][0][3:6] == [None, None, None]
    assert None not in charts[1]["y"][0]
    assert charts[0]["band"] is None
    assert next(c for c in charts if c["kind"] == "statistic")["threshold"] is None


def test_missing_values_are_counted():
    missing = np.zeros(600, dtype=bool)
    missing[100:112] = True
    d = diagnosis(missing=missing, resets=1)
    page = render([Section("", d)], "t")
    assert "12 samples (2 %) have missing values:" in words(page)
    assert "The filter was restarted once after longer gaps." in words(page)
    assert json.loads(read(page).data)["diagnoses"][0]["spans"]["missing"] == [[10.0, 11.2]]


def _empty(d):
    nothing = np.zeros(0, dtype=bool)
    return replace(
        d,
        time=np.zeros(0),
        residuals=np.zeros((0, 3)),
        statistic=np.zeros(0),
        alarm=nothing,
        decided=nothing,
        missing=nothing,
        scores=np.zeros((0, len(d.groups))),
        alarms=(),
    )


def _all_nan(d):
    n = len(d.time)
    return replace(
        d,
        residuals=np.full_like(d.residuals, np.nan),
        statistic=np.full(n, np.nan),
        scores=np.full_like(d.scores, np.nan),
        decided=np.zeros(n, dtype=bool),
        missing=np.ones(n, dtype=bool),
        alarms=(),
    )


EDGES = {
    "no alarm": (lambda: diagnosis(fault=False), "No fault found."),
    "no isolation": (
        lambda: changed(
            (d := diagnosis()),
            groups=(),
            signatures=(),
            scores=np.zeros((600, 0)),
            alarms=(replace(d.alarms[0], candidates=()),),
        ),
        "it was not isolated",
    ),
    "one residual": (lambda: diagnosis(gen=generator(1)), "One residual has no direction"),
    "two residuals": (lambda: diagnosis(gen=generator(2)), "Fault found"),
    "many residuals": (lambda: diagnosis(gen=generator(12)), "6 more residuals"),
    "noise": (lambda: diagnosis(gen=generator(3, noise=True)), "after whitening"),
    "all missing": (lambda: _all_nan(diagnosis()), "No decision."),
    "empty": (lambda: _empty(diagnosis()), "The recording is empty."),
    "one sample": (lambda: diagnosis(1, fault=False, decided=np.zeros(1, dtype=bool)), "No decision."),
    "no faults": (
        lambda: diagnosis(
            gen=(g := generator(2)) and replace(g, plant=g.plant),
            groups=(),
            signatures=(),
            scores=np.zeros((600, 0)),
            unjudged=generator(2).faults,
        ),
        "Never named, because this monitor has no signature for it",
    ),
    "scores not judged": (
        lambda: replace(
            (d := diagnosis()), alarms=(replace(d.alarms[0], candidates=(Candidate(("a",), np.nan, np.nan),)),)
        ),
        "it was not isolated",
    ),
    "one candidate": (
        lambda: replace((d := diagnosis()), alarms=(replace(d.alarms[0], candidates=d.candidates[:1]),)),
        "there is no other candidate",
    ),
    "poor match": (
        lambda: replace((d := diagnosis()), alarms=(replace(d.alarms[0], candidates=(Candidate(("a",), 0.5, 0.87),)),)),
        "a poor match: the best score is 0.500, below 0.90; nearest is a.",
    ),
    "close call": (
        lambda: replace(
            (d := diagnosis()),
            alarms=(replace(d.alarms[0], candidates=(Candidate(("a", "b"), 0.95, 0.3), Candidate(("c",), 0.94, 0.3))),),
        ),
        "This monitor does not distinguish a and b.",
    ),
}


@pytest.mark.parametrize("case", EDGES)
def test_unusual_diagnoses_render(case):
    make, expected = EDGES[case]
    page = render([Section("", make())], "t")
    assert expected in words(page)
    json.loads(read(page).data, parse_constant=lambda c: pytest.fail(f"{c} in the data"))


def test_close_calls_are_called_so():
    page = words(render([Section("", EDGES["close call"][0]())], "t"))
    assert "Fault found: either a, b, c or something not listed, alarm raised at 30.2 s." in page


def test_the_longest_of_many_alarms_are_listed_and_the_others_counted():
    d = diagnosis()
    many = tuple(replace(d.alarms[0], start=5 * k, stop=5 * k + 1 + k // 400, onset=float(k)) for k in range(450))
    page = words(render([Section("", replace(d, alarms=many))], "t"))
    assert "… and 250 more alarms, none longer than 1 sample." in page
    assert "401 main" in page


def test_several_diagnoses_share_a_summary_and_their_filters(tmp_path):
    beard, robust = generator(3), generator(2)
    sections = [
        Section("Beard, sensor 2", diagnosis(gen=beard), "text", actual="level 2 sensor"),
        Section("Beard, sensor 1", diagnosis(gen=beard, seed=1), actual=["level 1 sensor"]),
        Section("Beard, healthy", diagnosis(gen=beard, seed=2), actual=()),
        Section("Quiet", diagnosis(gen=beard, fault=False), actual=()),
        Section("Robust", diagnosis(gen=robust), table=Table(["Fault", "NPD"], [["level 1", 0.00213], ["two", 3]])),
    ]
    page = write_demo_page(
        sections, tmp_path / "demo.html", "Two filters", introduction="Which one is right?"
    ).read_text(encoding="utf-8")
    text = words(page)
    assert "level 2 sensor ✓ right" in text
    assert "level 2 sensor ✗ wrong" in text
    assert text.count("Evidence: checks of the design") == 2
    assert "level 2 sensor ✗ false alarm" in text
    assert "No fault found ✓ right" in text
    assert "Used in: Beard, sensor 2, Beard, sensor 1, Beard, healthy and Quiet." in text
    assert "0.00213" in text
    assert len(json.loads(read(page).data)["diagnoses"]) == 5
    ids = [a["id"] for _, a in read(page).tags if "id" in a]
    assert len(ids) == len(set(ids))


def test_a_long_recording_is_drawn_from_bins():
    page = render([Section("", diagnosis(100_000))], "t")
    data = json.loads(read(page).data)["diagnoses"][0]
    assert data["binned"] == 10
    assert all(len(series) == 20_000 for chart in data["charts"] for series in chart["y"])
    assert data["x"]["n"] == 20_000
    assert "Drawn from bins of 10 samples: the smallest and the largest value" in words(page)
    assert len(page) < 2_500_000


def test_a_settling_transient_does_not_set_the_axis():
    d = diagnosis(600, fault=False)
    residuals = d.residuals.copy()
    residuals[:10] += 100.0
    page = render([Section("", replace(d, residuals=residuals))], "t")
    chart = json.loads(read(page).data)["diagnoses"][0]["charts"][0]
    assert chart["limits"] == [residuals[10:, 0].min(), residuals[10:, 0].max()]
    assert max(chart["y"][0]) > 99
    assert "a settling filter may run off them" in words(page)


def test_a_fault_that_was_not_found_is_missed_not_wrong():
    sections = [Section("a", diagnosis(fault=False), actual="x"), Section("b", diagnosis())]
    assert "No fault found ✗ missed" in words(render(sections, "t"))


def test_a_short_alarm_is_not_sure_of_its_name():
    d = diagnosis()
    brief = changed(d, window=d.alarms[0].stop - d.alarms[0].start + 1)
    assert "too early to be sure of the name" in words(render([Section("", brief)], "t"))
    assert "too early to be sure of the name" not in words(render([Section("", d)], "t"))
