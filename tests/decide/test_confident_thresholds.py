"""Order statistics with a statement of confidence: promises hold as often as they say, and say what it takes."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from scipy import stats
from scipy.signal import lfilter

import residua as rs
from effort import cases
from residua.decide.confident_thresholds import StatedPromise, least_rate, promise_by, samples_for
from residua.decide.false_alarms import Observed, observed
from residua.decide.test import Watched
from residua.errors import NotFittedError, SettingError

#: Promises of 95 % that are kept: in one of 100 series of 500 right ones fewer are.
REPEATS = 500
KEPT = stats.binom.ppf(0.01, REPEATS, 0.95)


def given(columns: int = 1) -> rs.ResidualGenerator:
    return rs.identify.given_residuals([f"r{i}" for i in range(columns)], dt=1.0)


def noise(kind: str, rng: np.random.Generator, rows: int) -> np.ndarray:
    """White, of an autoregression with 0.5, heavy-tailed, or quantised: of unit variance, but for rounding."""
    if kind == "t4":
        return rng.standard_t(4, rows) / np.sqrt(2)
    e = rng.standard_normal(rows)
    if kind == "coloured":
        e[0] /= np.sqrt(0.75)
        return lfilter([1.0], [1.0, -0.5], e) * np.sqrt(0.75)
    return np.round(2 * e) / 2 if kind == "quantised" else e


def share_outside(kind: str, low: float, high: float) -> float:
    """The fraction of such samples below ``low`` or above ``high``: exactly."""
    if kind == "t4":
        return float(stats.t.cdf(low * np.sqrt(2), 4) + stats.t.sf(high * np.sqrt(2), 4))
    if kind == "quantised":
        low, high = np.ceil(2 * low - 1e-9) / 2 - 0.25, np.floor(2 * high + 1e-9) / 2 + 0.25
    return float(stats.norm.cdf(low) + stats.norm.sf(high))


def seen_of(x: np.ndarray) -> Observed:
    every, parts = np.ones(len(x), bool), [slice(0, len(x))]
    return observed(np.abs(x), every, every, parts, 1.0, persistence=1, release=1, window=1)


def test_the_statement_of_the_issue() -> None:
    assert least_rate(8000) == pytest.approx(3.744e-4, abs=1e-7)
    assert least_rate(samples_for(1e-4)) <= 1e-4 < least_rate(samples_for(1e-4) - 1)
    test = rs.decide.NormThreshold(persistence=1, source="quantile", false_alarm_rate=1e-4)
    residuals = np.random.default_rng(1).standard_normal((8000, 1))
    monitor = rs.Monitor(given(), test=test, isolate=None).fit(None, residuals, held_out=0)
    assert "with 8000 samples no fewer than 1 in 2,700 can be promised at 95 %; 1 in 10,000 takes 29956 samples" in str(
        monitor.norm_test.basis
    )
    assert monitor.norm_test.promised == pytest.approx(least_rate(8000), rel=0.02)


@pytest.mark.parametrize("rate", [0.002, 0.01, 0.1])
def test_an_order_statistic_is_that_of_the_binomial_distribution(rate: float) -> None:
    """With independent samples: the most over the threshold with P(no more than those | rate) of 5 % or less."""
    n = 3000
    x = np.random.default_rng(1).standard_normal(n)
    seen = seen_of(x)
    seen = dataclasses.replace(seen, blocks=np.arange(n))
    promise = promise_by("quantile", seen, rate)
    most = int(np.flatnonzero(stats.binom.cdf(np.arange(n), n, rate) <= 0.05)[-1])
    assert abs(int((np.abs(x) > promise.threshold).sum()) - most) <= 1  # samples are worth nearly as many
    assert promise.promised <= rate
    assert promise.holds


def promises_kept(source: str, kind: str, rate: float, rows: int, fit: bool) -> int:
    """How many of the promises from so few samples are kept."""
    rng, kept = np.random.default_rng(1), 0
    settings = rs.decide.NormThreshold(persistence=1, source=source)
    for _ in range(REPEATS):
        x = noise(kind, rng, rows)
        if fit:
            run = rs.decide.FaultFreeRun(x[:, None], np.ones(rows, bool), (), np.ones(1))
            test = settings.fitted(Watched(given()), run, rate)
            half = test.threshold / test.whitening[0, 0]
            outside = share_outside(kind, test.center[0] - half, test.center[0] + half)
            kept += outside <= test.promised * (1 + 1e-9)
        else:
            promise = promise_by(source, seen_of(x), rate)
            kept += share_outside(kind, -promise.threshold, promise.threshold) <= promise.promised * (1 + 1e-9)
    return kept


@pytest.mark.parametrize(
    "case",
    cases(
        [
            ("quantile", "coloured", 0.02),
            ("quantile", "quantised", 0.02),
            ("quantile", "t4", 0.002),
            ("quantile", "white", 0.002),
            *[("quantile", k, 0.02) for k in ("white", "t4")],
            *[("quantile", k, 0.002) for k in ("coloured", "quantised")],
        ],
        4,
    ),
)
def test_a_promise_is_kept_in_95_of_100_cases(case: tuple[str, str, float]) -> None:
    source, kind, rate = case
    assert promises_kept(source, kind, rate, 200, fit=False) >= KEPT


@pytest.mark.parametrize(
    "case",
    cases(
        [("quantile", k) for k in ("coloured", "white", "t4", "quantised")],
        1,
    ),
)
def test_a_promise_is_kept_with_mean_and_covariance_from_the_same_data(case: tuple[str, str]) -> None:
    source, kind = case
    assert promises_kept(source, kind, 0.03, 200, fit=True) >= KEPT


def test_correlated_samples_count_for_fewer() -> None:
    rng = np.random.default_rng(5)
    slow = lfilter([1.0], [1.0, -0.95], rng.standard_normal(5000))
    white, coloured = promise_by("quantile", seen_of(rng.standard_normal(5000)), 1e-4), promise_by(
        "quantile", seen_of(slow), 1e-4
    )  # fmt: skip
    assert isinstance(white, StatedPromise)
    assert isinstance(coloured, StatedPromise)
    assert white.worth > 0.9 * 5000
    assert coloured.worth < 0.4 * 5000
    assert coloured.promised > 2 * white.promised
    assert "independent ones) no fewer than" in str(coloured)
    assert "takes about" in str(coloured)


@pytest.mark.parametrize("source", ["auto", "quantile"])
def test_a_threshold_counts_samples_in_alarm_with_persistence(source: str) -> None:
    rng = np.random.default_rng(6)
    test = rs.decide.NormThreshold(persistence=3, source=source, false_alarm_rate=0.005)
    monitor = rs.Monitor(given(2), test=test, isolate=None)
    monitor.fit(None, rng.standard_normal((6000, 2)), held_out=0)
    rate = monitor.run(None, rng.standard_normal((60_000, 2))).alarm.mean()
    assert 0.0005 < rate <= monitor.norm_test.promised


@pytest.mark.parametrize(
    "case",
    cases(
        [
            *[("quantile", make) for make in (rs.decide.CUSUM, rs.decide.ChiSquared, rs.decide.EWMA, rs.decide.SPRT)],
            *[("auto", make) for make in (rs.decide.CUSUM, rs.decide.ChiSquared, rs.decide.EWMA, rs.decide.SPRT)],
        ],
        3,
    ),
)
def test_streams_keep_the_promise_of_their_data(case: tuple[str, type[rs.decide.CUSUM]]) -> None:
    source, make = case
    rng = np.random.default_rng(7)
    test = make(source=source, false_alarm_rate=0.02)
    monitor = rs.Monitor(given(), test=test, isolate=None).fit(None, noise("coloured", rng, 6000)[:, None], held_out=0)
    alarm = monitor.run(None, noise("coloured", rng, 60_000)[:, None]).alarm
    assert 0.003 < alarm.mean() <= monitor.norm_test.promised
    assert monitor.norm_test.promised < 0.06


@pytest.mark.parametrize("source", ["auto", "quantile"])
def test_units_change_nothing(source: str) -> None:
    rng = np.random.default_rng(8)
    residuals = rng.standard_normal((600, 3))
    test = rs.decide.NormThreshold(source=source, false_alarm_rate=0.01)
    thresholds = [
        rs.Monitor(given(3), test=test, isolate=None).fit(None, residuals * by, held_out=0).threshold
        for by in (np.ones(3), 2.0 ** np.array([-20, 3, 20]))
    ]
    assert thresholds[1] == pytest.approx(thresholds[0], rel=1e-6)


def test_a_noise_model_is_not_taken_where_the_data_are_asked_for() -> None:
    plant = rs.Plant([[0.9]], [[0.1]], [[1.0]], dt=1).with_sensor_faults().with_noise(process=1e-4, measurement=1e-2)
    flt = rs.design.kalman_filter(plant)
    for test in (rs.decide.NormThreshold, rs.decide.CUSUM):
        assert np.isfinite(rs.Monitor(flt, test=test()).threshold)
        with pytest.raises(NotFittedError, match=r"no threshold: fit.* it to fault-free data$"):
            rs.Monitor(flt, test=test(source="quantile")).run(np.zeros((50, 1)), np.zeros((50, 1)))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: rs.decide.NormThreshold(source="guess"), "source must be one of auto, quantile"),
        (lambda: rs.decide.NormThreshold(source="quantile", threshold=3.0), "cannot be combined: leave one out"),
        (lambda: rs.decide.CUSUM(source="quantile", threshold=3.0), "cannot be combined: leave one out"),
        (
            lambda: rs.Monitor(given(2), test=rs.decide.NormThreshold(source="quantile", groups="each")),
            "for one threshold",
        ),
    ],
)
def test_settings_that_cannot_be_are_refused(make: object, message: str) -> None:
    with pytest.raises(SettingError, match=message):
        make()  # pyright: ignore[reportCallIssue]


def test_settings_and_thresholds_come_back_from_files(tmp_path: Path) -> None:
    rng = np.random.default_rng(10)
    for source in ("auto", "quantile"):
        test = rs.decide.NormThreshold(source=source)
        monitor = rs.Monitor(given(), test=test, isolate=None).fit(None, rng.standard_normal((500, 1)))
        monitor.save(tmp_path / "monitor.json")
        again = rs.Monitor.load(tmp_path / "monitor.json")
        assert again.test == test
        assert again.threshold == monitor.threshold
        assert ('"source"' in (tmp_path / "monitor.json").read_text()) == (source != "auto")
