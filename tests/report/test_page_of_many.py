"""What a page shows: measured signals, what carries an alarm, what to look at, clock times, and ten of many faults."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest

import residua as rs
from page_reader import read, words
from report_examples import changed, diagnosis, generator
from residua.decide.alarm import Beginning, Size
from residua.design.core.generator import Member
from residua.report.charts import chart_data
from residua.report.choosing import SHOWN_FAULTS, look_alikes, shown_groups, signal_order
from residua.report.contributions import averaged_residuals, inside_band, shares_of_statistic
from residua.report.page import Section, render
from residua.report.tables import structure_table
from residua.report.text import escape, visible
from residua.words import some

N = 26


def column() -> rs.Plant:
    """A column of 26 trays with 52 faults; tray 7 is noted."""
    A = 0.9 * np.eye(N) + 0.03 * np.eye(N, k=1) + 0.02 * np.eye(N, k=-1)
    outputs = [f"T{101 + i}" for i in range(N)]
    plant = rs.Plant(A, np.ones((N, 1)), np.eye(N), dt=60.0, inputs=["steam"], outputs=outputs, name="column")
    plant = plant.with_sensor_faults().with_faults({f"fouling {i + 1}": row for i, row in enumerate(np.eye(N))})
    notes = {"fouling 7": {"check": "tray 7: pressure drop", "description": "A tray is fouled.", "unit": "K/min"}}
    return plant.with_fault_notes(notes).with_noise(process=1e-3, measurement=1e-2)


def recorded(plant: rs.Plant, fault: str, size: float, *, seed: int, n: int = 1200, begin: int = 600):
    rng = np.random.default_rng(seed)
    f = np.zeros((n, len(plant.faults)))
    if fault:
        f[begin:, plant.faults.index(fault)] = size
    u = np.sin(np.arange(n) / 150)[:, None]
    w = rng.standard_normal((n, len(plant.noises)))
    return u, plant.system(("control", "fault", "noise")).simulate(np.hstack([u, f, w]))


@pytest.fixture(scope="module")
def monitor() -> rs.Monitor:
    plant = column()
    design = rs.design.kalman_filter(plant)
    return rs.Monitor(design, isolate=rs.decide.Directional()).fit(*recorded(plant, "", 0.0, seed=0, n=4000))


@pytest.fixture(scope="module")
def many(monitor: rs.Monitor) -> rs.Diagnosis:
    u, y = recorded(monitor.generator.plant, "fouling 7", 0.5, seed=1)
    time = np.datetime64("2026-03-02T22:10:00") + np.arange(len(u)) * np.timedelta64(60, "s")
    found = monitor.run(u, y, time=time, source="column.csv")
    assert isinstance(found, rs.Diagnosis)
    return found


def test_ten_of_many_faults_are_shown_and_the_rest_counted(many: rs.Diagnosis) -> None:
    assert len(many.groups) > 40
    page = render([Section("", many)], "t")
    data = json.loads(read(page).data)["diagnoses"][0]
    (scores,) = [c for c in data["charts"] if c["kind"] == "scores"]
    assert len(scores["names"]) == len(scores["y"]) == SHOWN_FAULTS
    assert scores["hidden"] == len(many.groups) - SHOWN_FAULTS
    assert scores["names"][0] == many.candidates[0].name
    text = words(page)
    assert f"{len(many.groups) - SHOWN_FAULTS} more candidates, with lower scores" in text
    assert f"The 10 of {len(many.groups)} groups with the best scores in the main alarm." in text
    heat = re.findall(r'<td style="--v:', page)
    assert len(heat) == SHOWN_FAULTS * (SHOWN_FAULTS + 1)
    assert "have signatures that look alike (cosine 0.98 or more, one to the next)" in text
    assert re.search(r"52 faults in \d+ patterns|All 52 faults move the same residuals", text)
    assert page.count("●") == 0, "no matrix of ones"


def test_many_faults_are_told_by_pattern() -> None:
    """A bank of 12 sensors: a fault fires all members but its own."""
    gen = generator(11)
    assert len(gen.faults) == 12
    codes = ~np.eye(6, 12, dtype=bool)
    members = tuple(Member(f"without {k}", (k,), ()) for k in range(6))
    text = words(structure_table(replace(gen, codes=codes, members=members)))
    assert "Which members respond to which fault: 12 faults in 7 patterns" in text
    assert f"{gen.faults[0]} all members but without 0" in text
    assert "all 6 members" in text


def test_without_an_alarm_no_matrix_is_shown(monitor: rs.Monitor) -> None:
    found = monitor.run(*recorded(monitor.generator.plant, "", 0.0, seed=2))
    assert isinstance(found, rs.Diagnosis)
    assert not found.alarms
    page = render([Section("", found)], "t")
    assert not re.findall(r'<td style="--v:', page)
    assert len(shown_groups(found)) == SHOWN_FAULTS


def test_what_to_look_at(many: rs.Diagnosis) -> None:
    assert many.named[0][0] in ("fouling 7", "T107 sensor")
    text = words(render([Section("", many)], "t"))
    assert "What to look at Fault Component Kind" in text
    assert "fouling 7 fouling 7 component A tray is fouled. tray 7: pressure drop" in text
    assert "Estimated size" not in text, "nothing estimates it"
    main = many.main_alarm
    assert main is not None
    sized = replace(main, sizes=(Size("fouling 7", 0.52, 0.5, "K/min"),))
    assert "0.52 K/min (last 0.5 K/min)" in words(render([Section("", replace(many, alarms=(sized,)))], "t"))
    assert "What to look at" not in words(render([Section("", diagnosis(fault=False))], "t"))


def test_signals_and_model(many: rs.Diagnosis) -> None:
    data = chart_data(many)
    signals = [c for c in data["charts"] if c["kind"] == "signal"]
    assert [c["role"] for c in signals] == ["output"] * N + ["input"]
    assert signals[0]["label"] == "T107", "the one that moved the most is first"
    assert signal_order(many)[0] == 6
    for chart in signals[:N]:
        j = many.generator.plant.outputs.index(chart["label"])
        assert chart["names"] == ["measured", "model"]
        np.testing.assert_allclose(chart["y"][0], many.signals[:, 1 + j], rtol=1e-4, atol=1e-4)
        np.testing.assert_allclose(chart["y"][1], many.predictions[chart["label"]], rtol=1e-4, atol=1e-4)
    text = words(render([Section("", many)], "t"))
    assert "Measured and predicted" in text
    assert "Drawn first: T107," in text
    assert "22 more outputs" in text


def test_clock_times_on_axes_and_in_sentences(many: rs.Diagnosis) -> None:
    clock = chart_data(many)["clock"]
    assert clock["base"] == np.datetime64("2026-03-02T22:10:00").astype("M8[s]").astype(int)
    text = words(render([Section("", many)], "t"))
    assert "1,200 samples from 2026-03-02 22:10:00 to 2026-03-03 18:09:00 (clock of the recording)" in text
    assert "step 60 s, 19 h 59 min in all" in text
    assert "alarm raised at 2026-03-03 08:" in text
    plain = changed(many, origin="")
    assert chart_data(plain)["clock"] == {"base": None, "unit": "h", "factor": 3600.0}
    assert chart_data(replace(plain, time=many.time / 60))["clock"]["unit"] == "s"
    zoned = words(render([Section("", changed(many, origin="2026-03-02T22:10:00+01:00"))], "t"))
    assert "(local times of the recording, UTC+01:00)" in zoned


def test_shares_add_to_one_and_a_culprit_inside_its_band_is_explained() -> None:
    """Two correlated residuals: what moves one against the other is seen although both stay small."""
    d = diagnosis(gen=generator(3))
    rng = np.random.default_rng(0)
    common = rng.standard_normal(600)
    rows = np.column_stack([common, common, rng.standard_normal(600)]) + 0.05 * rng.standard_normal((600, 3))
    rows[300:, 0] += 0.8
    before = rows[:300]
    covariance = np.cov(before.T)
    whitening = np.linalg.inv(np.linalg.cholesky(covariance)).T
    statistic = np.linalg.norm((rows - before.mean(0)) @ whitening, axis=1)
    d = changed(
        d,
        residuals=rows,
        center=before.mean(axis=0),
        whitening=whitening,
        statistic=statistic,
        band=3.29 * before.std(axis=0),
        band_share=0.999,
    )
    shares = shares_of_statistic(d)
    assert shares is not None
    assert shares.sum() == pytest.approx(1.0)
    assert shares[:2].min() > 0.3
    assert d.main_alarm is not None
    inside = inside_band(d, d.main_alarm.start, d.main_alarm.stop)
    assert inside[0] > 0.9
    text = words(render([Section("", d)], "t"))
    assert "of the statistic although it stayed inside its normal range for" in text
    assert "1 in 1,000 fault-free samples is outside" in text
    assert shares_of_statistic(diagnosis(fault=False)) is None


def test_averages_are_those_of_the_test() -> None:
    d = changed(diagnosis(100), averaged=5)
    means = averaged_residuals(d)
    k = 60
    np.testing.assert_allclose(means[k], d.residuals[k - 4 : k + 1].mean(axis=0), rtol=1e-9, atol=1e-12)
    assert np.isnan(means[:10]).all(), "where nothing is judged"


def test_the_interval_is_drawn_and_told() -> None:
    d = diagnosis()
    d = replace(d, alarms=(replace(d.alarms[0], began=Beginning(28.0, 29.5, 30.0)),))
    assert chart_data(d)["spans"]["began"] == [[28.0, 30.0]]
    text = words(render([Section("", d)], "t"))
    assert (
        "Began between 28 s and 30 s (95 % confidence if the residual began to move by a step or a ramp), most" in text
    )
    assert "when it began (95 % confidence)" in text
    assert "starts to move as a step, a ramp or the square of time" in text
    assert "28 s to 30 s" in text


@pytest.mark.parametrize("name", ["\x1b[31mred\x1b[0m", "a\x07b", "\x9b31m", "left\u202eright", "nul\x00"])
def test_control_characters_in_names_are_shown_not_sent(name: str) -> None:
    gen = generator(2, names=[name, "b"])
    page = render([Section(name, diagnosis(gen=gen, source=name, notes=(name,)), [name])], name)
    for character in name:
        if not character.isprintable():
            assert character not in page
            assert visible(character).startswith("\\")
    assert escape(visible(name)) in page


def test_lists_are_cut_and_counted() -> None:
    assert some([f"f{i}" for i in range(12)], 10) == ", ".join(f"f{i}" for i in range(10)) + " and 2 more"
    assert some(["a", "b"]) == "a and b"
    assert some([f"f{i}" for i in range(11)], 10).endswith("f9 and f10"), "one more is named, not counted"


def test_look_alikes_are_clusters() -> None:
    similarity = np.array([[1, 0.99, 0, np.nan], [0.99, 1, 0.985, 0], [0, 0.985, 1, 0], [np.nan, 0, 0, 1]])
    assert look_alikes(["a", "b", "c", "d"], similarity, 0.98) == [["a", "b", "c"]]
    assert look_alikes(["a", "b"], np.eye(2), 0.98) == []
