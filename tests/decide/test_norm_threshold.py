"""Thresholds: the rate asked for, the tail when data are few, no alarms from rounding."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.stats

import residua as rs
from residua.decide.norm_threshold import NormThreshold, fit_norm_test, norm_test_from_model
from residua.decide.persistence import alarm_logic
from residua.decide.whitened_norm import check_invertible
from residua.errors import DataError


def fraction_in_alarm(test: object, residuals: np.ndarray) -> float:
    q = (residuals - test.center) @ test.whitening  # pyright: ignore[reportAttributeAccessIssue]
    over = np.linalg.norm(q, axis=1) > test.threshold  # pyright: ignore[reportAttributeAccessIssue]
    zero, off = np.zeros(1, dtype=np.int64), np.zeros(1, dtype=bool)
    usable = np.ones((1, len(over)), dtype=bool)
    on, _, _ = alarm_logic(over[None], usable, zero, zero, off, test.persistence, test.release)  # pyright: ignore
    return float(on.mean())


@pytest.mark.parametrize("rate", [0.05, 0.01])
@pytest.mark.parametrize("persistence", [1, 3])
def test_the_rate_holds_on_new_data(rate: float, persistence: int) -> None:
    rng = np.random.default_rng(0)
    mixing = rng.standard_normal((3, 3))
    on_new_data = []
    for _ in range(6):
        data = rng.standard_normal((40_000, 3)) @ mixing + [5, 0, -2]
        test = fit_norm_test(
            NormThreshold(persistence=persistence),
            data[:20_000],
            np.ones(20_000, bool),
            false_alarm_rate=rate,
            covariance=None,
            signal_size=1,
        )
        on_new_data.append(fraction_in_alarm(test, data[20_000:]))
    assert np.mean(on_new_data) == pytest.approx(rate, rel=0.25)


def test_whitening_makes_the_statistic_chi_distributed() -> None:
    rng = np.random.default_rng(1)
    data = rng.standard_normal((50_000, 2)) @ np.array([[3.0, 1], [0, 0.01]])
    test = fit_norm_test(
        NormThreshold(persistence=1),
        data,
        np.ones(len(data), bool),
        false_alarm_rate=0.01,
        covariance=None,
        signal_size=1,
    )
    assert test.threshold == pytest.approx(np.sqrt(scipy.stats.chi2.ppf(0.99, 2)), rel=0.02)


def test_few_data_use_the_tail() -> None:
    rng = np.random.default_rng(2)
    data = rng.standard_normal((200, 2))
    test = fit_norm_test(
        NormThreshold(persistence=1),
        data,
        np.ones(200, bool),
        false_alarm_rate=1e-5,
        covariance=None,
        signal_size=1,
    )
    assert test.promised is not None
    assert test.promised > 1.5e-5
    assert test.threshold == pytest.approx(np.sqrt(scipy.stats.chi2.ppf(1 - 1e-5, 2)), rel=0.2)


@pytest.mark.parametrize("persistence", [1, 3])
def test_the_extended_tail_holds_on_many_new_data(persistence: int) -> None:
    rng = np.random.default_rng(4)
    rate, found = 1e-3, []
    for _ in range(12):
        data = rng.standard_normal((2000, 2))
        test = fit_norm_test(
            NormThreshold(persistence=persistence),
            data,
            np.ones(2000, bool),
            false_alarm_rate=rate,
            covariance=None,
            signal_size=1,
        )
        found.append(fraction_in_alarm(test, rng.standard_normal((100_000, 2))))
    assert rate / 3 < np.mean(found) < 3 * rate


def test_too_few_data_are_refused() -> None:
    with pytest.raises(DataError, match="too few"):
        fit_norm_test(
            NormThreshold(),
            np.zeros((20, 2)),
            np.ones(20, bool),
            false_alarm_rate=0.01,
            covariance=None,
            signal_size=1,
        )


def test_noise_free_data_do_not_turn_rounding_into_alarms() -> None:
    rng = np.random.default_rng(3)
    data = 1e-16 * rng.standard_normal((500, 2))
    test = fit_norm_test(
        NormThreshold(),
        data,
        np.ones(500, bool),
        false_alarm_rate=0.01,
        covariance=None,
        signal_size=10.0,
    )
    assert test.threshold >= 1e-11
    assert "rounding" in test.basis


@pytest.mark.parametrize("window", [1, 5, 40])
def test_a_combination_that_never_moved_stays_at_the_floor(window: int) -> None:
    """Of three residuals the third is the sum of the others: what is left of it is rounding, windows or not."""
    rng = np.random.default_rng(4)
    two = rng.standard_normal((2000, 2))
    data = np.column_stack([two, two @ [1.0, 1.0]]) * [1.0, 2.0**20, 2.0**-20]
    rounding = 1e-15 * rng.standard_normal(data.shape) * np.abs(data)
    test = fit_norm_test(
        NormThreshold(window=window),
        data + rounding,
        np.ones(2000, bool),
        false_alarm_rate=0.01,
        covariance=None,
        signal_size=10.0,
    )
    check_invertible(test.whitening)
    in_own_units = test.whitening * data.std(axis=0)[:, None]
    assert np.linalg.norm(in_own_units, 2) < 3e4  # the root of the floor, 1e-8 of the variance of the largest


def test_the_model_gives_a_threshold_without_data() -> None:
    test = norm_test_from_model(NormThreshold(false_alarm_rate=0.001), np.diag([4.0, 1, 9]), 3)
    assert test is not None
    assert test.threshold == pytest.approx(np.sqrt(16.266236), rel=1e-6)
    np.testing.assert_allclose(test.band, test.threshold * np.array([2, 1, 3]))
    assert norm_test_from_model(NormThreshold(), None, 3) is None


@pytest.mark.parametrize(
    "wrong",
    [{"threshold": -1.0}, {"persistence": 0}, {"release": 0}, {"whiten": "yes"}, {"false_alarm_rate": 1.5}],
)
def test_wrong_settings_are_refused(wrong: dict) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        NormThreshold(**wrong)


def test_a_window_longer_than_any_recording_is_refused() -> None:
    made = rs.identify.given_residuals(["a"], dt=1.0)
    rng = np.random.default_rng(0)
    monitor = rs.Monitor(made, test=NormThreshold(window=20), isolate=None)
    with pytest.raises(DataError, match="window of 20: the longest has"):
        monitor.fit([(None, rng.standard_normal((15, 1))) for _ in range(20)], held_out=0, transient=0)
