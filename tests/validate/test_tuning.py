"""Tuning: the rate that is asked for on other runs, and the window that a closed form would choose."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

import residua as rs
from campaign_examples import white_noise_monitor
from residua import validate as v
from residua.errors import SettingError

STEP = v.Scenario("a sensor", v.step(at=100), size=1.0)
SMALL = {"runs": 100, "samples": 500, "false_alarm_rate": 0.01}


@pytest.fixture(scope="module")
def tuned() -> v.Tuning:
    return v.tune(white_noise_monitor(), STEP, windows=[1, 5, 20], persistences=[1, 3], seed=1, **SMALL | {"runs": 200})


def test_every_candidate_has_the_rate_that_was_asked_for(tuned: v.Tuning) -> None:
    assert len(tuned.candidates) == 6
    for one in tuned.candidates:
        assert one.false_alarm_rate.value == pytest.approx(0.01, rel=0.35)  # alarms come in runs: few independent ones
        assert one.monitor.threshold == one.threshold


def test_the_threshold_of_single_samples_is_the_quantile(tuned: v.Tuning) -> None:
    (single,) = (one for one in tuned.candidates if (one.window, one.persistence) == (1, 1))
    assert single.threshold == pytest.approx(np.sqrt(stats.chi2.ppf(0.99, 2)), rel=0.02)


def test_small_steps_are_seen_soonest_by_a_window(tuned: v.Tuning) -> None:
    """A step of one standard deviation: of single samples one in 25 or so exceeds, and a window adds them up."""
    assert tuned.best.window > 1
    assert tuned.monitor.norm_test.window == tuned.best.window
    delays = [one.delay.value for one in tuned.candidates]
    assert delays == sorted(delays)
    single = max(one.delay.value for one in tuned.candidates if one.window == 1)
    assert single > tuned.best.delay.high
    assert "mean delay" in str(tuned)


def test_large_steps_are_seen_soonest_by_single_samples() -> None:
    large = v.Scenario("a sensor", v.step(at=100), size=30.0)
    tuned = v.tune(white_noise_monitor(), large, windows=[1, 20], persistences=[1, 5], seed=1, **SMALL)
    assert tuned.best.persistence == 1
    assert tuned.best.delay.value == 0


def test_what_cannot_be_tuned(plant: rs.Plant) -> None:
    monitor = white_noise_monitor()
    with pytest.raises(SettingError, match="between 0 and 1"):
        v.tune(monitor, STEP, **SMALL | {"false_alarm_rate": 0.0})
    with pytest.raises(SettingError, match=r"too few for a rate of 1e-05 .* 100,000 runs"):
        v.tune(monitor, STEP, **SMALL | {"false_alarm_rate": 1e-5})
    with pytest.raises(SettingError, match="needs a scenario"):
        v.tune(monitor, (), windows=[1], **SMALL)
    with pytest.raises(SettingError, match="windows must be a list"):
        v.tune(monitor, STEP, windows=[], **SMALL)
    with pytest.raises(SettingError, match="whole number of samples"):
        v.tune(monitor, STEP, persistences=[0], **SMALL)
    for seed in (-1, 1.5):
        with pytest.raises(SettingError, match="seed"):
            v.tune(monitor, STEP, windows=[1], seed=seed, **SMALL)  # pyright: ignore
    with pytest.raises(SettingError, match="on the residual as a whole"):
        v.tune(rs.Monitor(rs.design.matched_filters(plant)), STEP, **SMALL)
    with pytest.raises(SettingError, match="takes a Monitor"):
        v.tune(plant, STEP, **SMALL)  # pyright: ignore
    fitted = white_noise_monitor().fit(np.zeros((2000, 1)), np.random.default_rng(0).standard_normal((2000, 2)))
    with pytest.raises(SettingError, match="was fitted to recordings"):
        v.tune(fitted, STEP, **SMALL)
    with pytest.raises(TypeError, match="nois"):
        v.tune(monitor, STEP, windows=[1], nois=v.white(), **SMALL)


def test_windows_that_hardly_fill_a_run_are_refused() -> None:
    plant = rs.Plant([[0.9]], [[0.1]], [[1.0]], dt=1).with_sensor_faults().with_noise(process=1e-2, measurement=1e-2)
    fault = rs.validate.Scenario("y1 sensor", rs.validate.step(at=100), size=1.0)
    watch = rs.Monitor(rs.design.kalman_filter(plant), test=rs.decide.NormThreshold())
    with pytest.raises(SettingError, match="say too little of sums over 150"):
        rs.validate.tune(watch, fault, false_alarm_rate=0.01, windows=[150], persistences=[1], runs=1000, samples=200)
    with pytest.raises(SettingError, match="windows must be a list"):
        rs.validate.tune(watch, fault, false_alarm_rate=0.01, windows=5)  # pyright: ignore[reportArgumentType]
