"""Thresholds fitted to residuals that come in steps, as those of a coarse sensor: equal readings stay on one side."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

import residua as rs
from residua.decide.exceedance_tail import quantile, without_steps
from residua.decide.normal_scores import knots_of, normal_scores
from residua.decide.whitened_norm import NormTest

FITS = 20


def given(columns: int = 1) -> rs.design.ResidualGenerator:
    return rs.identify.given_residuals([f"r{i}" for i in range(columns)], dt=1.0)


def rounded(step: float, rows: int, columns: int, seed: int) -> np.ndarray:
    return np.round(np.random.default_rng(seed).standard_normal((rows, columns)) / step) * step


def fitted(residuals: np.ndarray, rate: float, source: str = "auto", persistence: int = 1) -> rs.Monitor:
    test = rs.decide.NormThreshold(persistence=persistence, source=source)
    monitor = rs.Monitor(given(residuals.shape[1]), test=test, isolate=None)
    return monitor.fit(None, residuals, false_alarm_rate=rate, held_out=0)


def ran(monitor: rs.Monitor, residuals: np.ndarray) -> rs.Diagnosis:
    diagnosis = monitor.run(None, residuals)
    assert isinstance(diagnosis, rs.Diagnosis)
    return diagnosis


def share_over(test: NormTest, step: float) -> float:
    """The fraction of one rounded Gaussian residual over a threshold: exactly."""
    readings = step * np.arange(-40, 41)
    share = stats.norm.cdf(readings + step / 2) - stats.norm.cdf(readings - step / 2)
    return float(share[np.abs((readings - test.center[0]) * test.whitening[0, 0]) > test.threshold].sum())


@pytest.mark.parametrize("source", ["quantile", "auto"])
def test_a_reading_at_the_threshold_is_not_over_it(source: str) -> None:
    """The sum of the fit and that of the run are rounded differently, and one reading in ten lies at the threshold."""
    for seed in range(12):
        residuals = rounded(2.5, 5000, 1, seed)
        monitor = fitted(residuals, 1e-4, source)
        assert ran(monitor, residuals).alarm[2500:].mean() < 0.01


@pytest.mark.parametrize("source", ["auto", "quantile"])
@pytest.mark.parametrize(
    ("step", "rows", "rate"), [(1.5, 1000, 0.01), (2.0, 1000, 0.001), (2.0, 5000, 0.0001), (2.5, 5000, 0.0001)]
)
def test_a_promise_from_few_readings_is_kept(source: str, step: float, rows: int, rate: float) -> None:
    """A tail between two steps promised a rate that the readings of the fit themselves exceeded up to 27 times."""
    tests = [fitted(rounded(step, rows, 1, seed), rate, source).norm_test for seed in range(FITS)]
    kept = sum(share_over(test, step) <= test.promised for test in tests)
    assert kept >= stats.binom.ppf(0.01, FITS, 0.95)


@pytest.mark.parametrize("persistence", [1, 3])
def test_a_promise_for_two_coarse_residuals_is_kept(persistence: int) -> None:
    kept, new = 0, rounded(4.0, 60_000, 2, 99)
    for seed in range(FITS):
        monitor = fitted(rounded(4.0, 3000, 2, seed), 0.001, persistence=persistence)
        kept += ran(monitor, new).alarm.mean() <= monitor.norm_test.promised
    assert kept >= stats.binom.ppf(0.01, FITS, 0.95)


def test_a_quantile_of_equal_values_is_beyond_all_of_them() -> None:
    values = np.array([0.0] * 80 + [1.0] * 15 + [1.0 + 1e-15] * 3 + [2.0] * 2)
    assert quantile(values, 0.1) == pytest.approx(1.5)
    assert quantile(values, 0.0) == pytest.approx(2.0, rel=1e-8)
    assert quantile(values, 0.0) > 2.0
    assert quantile(values, 0.3) == pytest.approx(0.5)


def test_values_without_steps_stay_as_they_are() -> None:
    values = np.abs(np.random.default_rng(0).standard_normal(1000))
    same, half = without_steps(values)
    assert same is values
    assert half == 0.0


@pytest.mark.parametrize("scale", [2.0**-20, 1.0, 2.0**20])
def test_values_in_steps_are_spread_over_them(scale: float) -> None:
    values = scale * np.abs(rounded(0.5, 2000, 1, 3)[:, 0])
    spread, half = without_steps(values)
    assert half == scale * 0.25
    assert np.abs(spread - values).max() <= half
    assert len(np.unique(spread)) > 1000
    runs = np.flatnonzero(np.diff(values) == 0)
    np.testing.assert_array_equal(spread[runs], spread[runs + 1])


def spikes(rng: np.random.Generator, rows: int) -> np.ndarray:
    """Noise with a value far above it in some samples, so that the mean lies above all the rest."""
    return rng.standard_normal((rows, 1)) + 500.0 * (rng.random((rows, 1)) < 0.015)


@pytest.mark.parametrize("step", [3.0, 5.0, None])
@pytest.mark.parametrize("test", [rs.decide.CUSUM, rs.decide.EWMA])
def test_equal_values_and_spikes_have_scores(step: float | None, test: type[rs.decide.CUSUM | rs.decide.EWMA]) -> None:
    """Of which most had the lowest score there is: 99 % of new samples were in alarm, or the fit failed."""
    rng = np.random.default_rng(2)
    fit, new = (spikes(rng, n) if step is None else rounded(step, n, 1, n) for n in (5000, 100_000))
    settings = test(mean_time_between_false_alarms=2000.0)
    monitor = rs.Monitor(given(), test=settings, isolate=None).fit(None, fit)
    diagnosis = ran(monitor, new)
    assert diagnosis.alarm.mean() < 0.02
    assert len(diagnosis.alarms) <= 100_000 / 1000


def test_the_score_of_equal_values_is_in_the_middle_of_theirs() -> None:
    e = np.concatenate([np.zeros(800), np.full(100, 2.0), np.full(100, -2.0)])[:, None]
    knots, scores = knots_of(e)
    found = normal_scores(np.array([[-2.0], [0.0], [2.0]]), knots, scores)[:, 0]
    np.testing.assert_allclose(found, stats.norm.ppf([0.05, 0.5, 0.95]), atol=0.02)
    assert (np.diff(knots) > 0).all()


def test_outliers_do_not_alarm_more_often_than_was_asked_for() -> None:
    """Twelve outliers say nothing of lower thresholds."""
    rng = np.random.default_rng(1)

    def outliers(rows: int) -> np.ndarray:
        return rng.standard_normal((rows, 1)) * np.where(rng.random((rows, 1)) < 0.003, 20.0, 1.0)

    settings = rs.decide.GLR(window=20, mean_time_between_false_alarms=2000.0)
    monitor = rs.Monitor(given(), test=settings, isolate=None).fit(None, outliers(5000))
    assert len(ran(monitor, outliers(100_000)).alarms) <= 100


@pytest.mark.parametrize("test", [rs.decide.EWMA, rs.decide.PageHinkley])
def test_a_valve_that_is_open_or_shut_for_a_while_keeps_the_promise(test: type[rs.decide.EWMA]) -> None:
    """Few alarms, and most of the samples in them."""
    rng = np.random.default_rng(0)

    def valve(rows: int) -> np.ndarray:
        position = np.repeat((rng.random(rows // 40 + 1) < 0.5).astype(float), 40)[:rows]
        return np.column_stack([position, rng.standard_normal(rows)])

    monitor = rs.Monitor(given(2), test=test(), isolate=None).fit(None, valve(1500), false_alarm_rate=0.05)
    assert ran(monitor, valve(20_000)).alarm.mean() <= monitor.norm_test.promised
