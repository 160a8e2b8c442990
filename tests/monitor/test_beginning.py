"""When what an alarm is about began, and how times are told."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from datetime import datetime

import numpy as np
import pytest

import residua as rs
from residua.decide import NormThreshold
from residua.decide.alarm import Alarm, Beginning
from residua.decide.statement import SHOWN_ALARMS, began_text
from residua.decide.whitened_norm import BAND_DEVIATIONS
from residua.library import simulate_three_tank, three_tank, three_tank_fault
from residua.linear import StateSpace
from residua.monitor.alarms import with_beginnings
from residua.monitor.outcome import compared_outputs
from residua.recording.clock import Clock, length
from residua.report.signals import signal_text
from residua.report.verdict import verdict

BEGIN = 400


def rows_with(change: np.ndarray, k: int, seed: int) -> np.ndarray:
    rows = np.random.default_rng(seed).standard_normal((len(change), k))
    rows[:, 0] += change
    return rows


def dated(rows: np.ndarray, *alarms: Alarm) -> tuple[Alarm, ...]:
    return with_beginnings(alarms, rows, np.ones(len(rows), dtype=bool), 10.0 * np.arange(len(rows)))


def alarm(first: int, stop: int) -> Alarm:
    return Alarm(10.0 * first, 10.0 * (first + 2), None, (), first + 2, stop)


@pytest.mark.parametrize("k", [1, 3, 20])
def test_a_step_is_dated_to_the_sample(k: int) -> None:
    (one,) = dated(rows_with(8.0 * (np.arange(1000) >= BEGIN), k, k), alarm(BEGIN, 1000))
    assert one.began is not None
    assert one.began.earliest is not None
    assert 10.0 * (BEGIN - 6) < one.began.earliest < 10.0 * BEGIN == one.began.estimate == one.began.latest
    assert one.began.confidence == 0.95
    assert one.onset == 10.0 * BEGIN


@pytest.mark.parametrize("size", [4.0, -4.0])
def test_a_short_pulse_between_readings_of_a_coarse_sensor(size: float) -> None:
    """The second half of the alarm is as before it, to the last bit, and has no sign; all of it has."""
    rows = np.zeros((BEGIN + 10, 1))
    rows[:BEGIN, 0] = np.random.default_rng(0).permutation(np.resize([0.0, 4.0, 0.0, -4.0], BEGIN))
    rows[BEGIN : BEGIN + 4] = 4 * size
    (one,) = dated(rows, alarm(BEGIN, BEGIN + 7))
    assert one.began is not None
    assert one.began.earliest is not None
    assert one.began.earliest < 10.0 * BEGIN <= one.began.latest + 10.0
    assert one.began.latest - one.began.earliest < 100.0


def test_a_residual_that_does_not_move_is_not_dated() -> None:
    (one,) = dated(np.zeros((BEGIN + 10, 1)), alarm(BEGIN, BEGIN + 5))
    assert one.began is None


def test_a_drift_is_dated_before_its_first_crossing() -> None:
    drift = 0.02 * np.maximum(np.arange(1200) - BEGIN, 0)
    (one,) = dated(rows_with(drift, 3, 1), alarm(BEGIN + 220, 1200))
    assert one.began is not None
    assert one.began.earliest is not None
    assert one.began.earliest < 10.0 * BEGIN <= one.began.latest < one.onset


def test_small_alarms_just_before_are_part_of_it() -> None:
    """A drift that crosses the threshold and back is dated by what came before the first crossing."""
    drift = 0.02 * np.maximum(np.arange(1200) - BEGIN, 0)
    *_, last = dated(rows_with(drift, 3, 1), alarm(BEGIN + 170, BEGIN + 175), alarm(BEGIN + 220, 1200))
    assert last.began is not None
    assert (last.began.earliest or 0.0) < 10.0 * BEGIN <= last.began.latest


def test_where_it_cannot_be_told() -> None:
    change = 8.0 * (np.arange(1000) >= BEGIN)
    rows = rows_with(change, 3, 2)
    (one,) = dated(rows[BEGIN - 20 :], alarm(20, 600))
    assert one.began is None, "too little before it"
    many = [alarm(50 + 300 * j, 55 + 300 * j) for j in range(SHOWN_ALARMS + 5)]
    rows = np.random.default_rng(0).standard_normal((300 * len(many) + 100, 20))
    assert all(a.began is None for a in dated(rows, *many)), "noise has no direction and no change"
    clock = Clock("", 1.0)
    assert began_text(many[0], clock) == "began at an unknown time, at or before 520 s"
    edge = replace(many[0], began=Beginning(None, 400.0, 450.0))
    assert began_text(edge, clock).startswith("began at or before 450 s; the earlier data")


def test_missing_samples_do_not_move_it() -> None:
    rows = rows_with(8.0 * (np.arange(1000) >= BEGIN), 3, 5)
    usable = np.ones(1000, dtype=bool)
    usable[350:370] = False
    rows[350:370] = np.nan
    (one,) = with_beginnings([alarm(BEGIN, 1000)], rows, usable, 10.0 * np.arange(1000))
    assert one.began == Beginning(10.0 * (BEGIN - 1), 10.0 * BEGIN, 10.0 * BEGIN)


@pytest.fixture(scope="module")
def leak() -> rs.Diagnosis:
    normal = simulate_three_tank(12_000, seed=1)
    monitor = rs.Monitor(rs.design.kalman_filter(three_tank()), test=NormThreshold(persistence=10))
    monitor.fit(normal.u, normal.y)
    faulty = simulate_three_tank(2001, faults=three_tank_fault(9), seed=3)
    found = monitor.run(faulty.u, faulty.y, time=np.datetime64("2026-03-29T00:30:00") + faulty.time.astype("m8[s]"))
    assert isinstance(found, rs.Diagnosis)
    return found


def test_no_text_states_the_first_crossing_as_the_beginning(leak: rs.Diagnosis) -> None:
    """The leak began at 200 s; the statistic first stayed over its threshold some 240 s later."""
    assert leak.onset is not None
    assert leak.onset > 400
    began = leak.began
    assert began is not None
    assert (began.earliest or 0.0) <= 200.0 <= began.latest < leak.onset
    for text in (str(leak), " ".join(verdict(leak).sentences), verdict(leak).headline):
        assert "since" not in text
        assert "onset" not in text.lower()
    record = leak.main_alarm.to_dict() if leak.main_alarm else {}
    assert set(record["began"]) == {"earliest", "estimate", "latest", "confidence"}
    json.dumps(record, allow_nan=False)


def test_times_are_told_by_the_clock_of_the_recording(leak: rs.Diagnosis) -> None:
    assert leak.recording.origin.startswith("2026-03-29T00:30")
    assert leak.main_alarm is not None
    raised = datetime(2026, 3, 29, 0, 30).timestamp() + leak.main_alarm.raised
    told = f"{datetime.fromtimestamp(raised):%Y-%m-%d %H:%M:%S}"
    assert f"raised {told}" in str(leak)
    assert told in verdict(leak).headline


def test_predictions_are_measured_less_residual(leak: rs.Diagnosis) -> None:
    plant = leak.generator.plant
    assert list(leak.predictions) == list(plant.outputs)
    assert leak.signals.shape == (2001, 5)
    system = leak.generator.observer
    assert system is not None, "a Kalman filter"
    seen = leak.decided
    for j, name in enumerate(plant.outputs):
        gap = leak.signals[seen, 2 + j] - leak.predictions[name][seen]
        np.testing.assert_allclose(gap, leak.residuals[seen, j], rtol=0, atol=1e-12)
        assert np.std(leak.predictions[name][100:200]) < np.std(leak.signals[100:200, 2 + j]), "it is filtered"


def test_filters_that_predict_no_output_say_so() -> None:
    filter_ = rs.design.kalman_filter(three_tank())
    mixed = StateSpace(np.zeros((0, 0)), np.zeros((0, 5)), np.zeros((2, 0)), [[0, 0, 2, 0, 0], [0, 0, 1, 1, 0]], dt=1.0)
    assert compared_outputs(filter_) == ((0, 0), (1, 1), (2, 2))
    assert compared_outputs(replace(filter_, system=mixed)) == ()
    run = simulate_three_tank(300, seed=1)
    found = rs.Monitor(filter_).run(run.u, run.y)
    assert isinstance(found, rs.Diagnosis)
    found = replace(found, recording=replace(found.recording, compared=()))
    assert found.predictions == {}
    assert "predicts no output" in signal_text(found)


def test_a_band_holds_the_share_that_is_said(leak: rs.Diagnosis) -> None:
    """Of each residual on its own, on data that were not used to fit it: 1 in 1,000 outside, within 0.5 and 2."""
    normal, other = simulate_three_tank(12_000, seed=1), simulate_three_tank(40_000, seed=9)
    for test in (NormThreshold(), NormThreshold(window=20)):
        monitor = rs.Monitor(rs.design.kalman_filter(three_tank()), test=test).fit(normal.u, normal.y)
        found = monitor.run(other.u, other.y)
        assert isinstance(found, rs.Diagnosis)
        assert (found.test.band_share, found.test.averaged) == (0.999, test.window)
        rows = np.where(found.decided[:, None], found.residuals, np.nan)[100:] - found.test.center
        sums = np.cumsum(rows, axis=0)
        means = rows if test.window == 1 else (sums[test.window :] - sums[: -test.window]) / test.window
        outside = np.mean(np.abs(means) > found.test.band, axis=0)
        assert np.all(outside < 2e-3 * (1 if test.window == 1 else 2)), outside
        assert np.all(outside > 0.2e-3), outside


def test_the_band_of_an_unknown_covariance_is_the_threshold() -> None:
    monitor = rs.Monitor(rs.design.kalman_filter(three_tank()), test=NormThreshold(threshold=2.5, whiten="none"))
    band, share = monitor.norm_test.bands()
    assert share == 0.0
    np.testing.assert_array_equal(band, 2.5)
    whitened = rs.Monitor(rs.design.kalman_filter(three_tank())).norm_test
    band, share = whitened.bands()
    covariance = np.linalg.inv(whitened.whitening @ whitened.whitening.T)
    np.testing.assert_allclose(band, BAND_DEVIATIONS * np.sqrt(np.diag(covariance)), rtol=1e-9)
    assert share == pytest.approx(1 - math.erfc(BAND_DEVIATIONS / math.sqrt(2)), abs=1e-12)


@pytest.mark.parametrize(
    ("origin", "step", "seconds", "told"),
    [
        ("", 1.0, 439.0, "439 s"),
        ("", 1.0, 7500.0, "2 h 5 min (7500 s)"),
        ("", 1.0, 200_000.0, "2 d 8 h (200000 s)"),
        ("", 0.1, -3.5, "−3.5 s"),
        ("2026-03-02T22:10:00", 60.0, 7200.0, "2026-03-03 00:10:00"),
        ("2026-03-02T22:10:00+01:00", 60.0, 0.0, "2026-03-02 22:10:00"),
        ("2026-03-02T22:10:00.25", 0.01, 0.5, "2026-03-02 22:10:00.75"),
        ("2026-03-02T22:10:00", 0.5, 0.999, "2026-03-02 22:10:01.0"),
        ("no date", 1.0, 12.0, "12 s"),
        ("2026-03-02", 1.0, 1e300, "1e300 s"),
        ("", 1.0, math.nan, "–"),
    ],
)
def test_clock(origin: str, step: float, seconds: float, told: str) -> None:
    assert Clock(origin, step).at(seconds).startswith(told)


def test_lengths_are_told_in_units_that_fit() -> None:
    told = {
        45.0: "45 s",
        1500.0: "25 min",
        3600.0: "1 h",
        18_720.0: "5 h 12 min",
        273_600.0: "3 d 4 h",
        0.005: "0.005 s",
    }
    assert {seconds: length(seconds) for seconds in told} == told
    assert Clock("2026-03-02T22:10:00+05:30").zone == "+05:30"
    assert Clock("2026-03-02T22:10:00").zone == ""
