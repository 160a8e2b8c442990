"""Settings that no machine can serve are refused at once, with the largest that it can; long ones are cheap."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest

import residua as rs
from residua.decide import Directional, Matched, NormThreshold, PeakThreshold, Structured
from residua.design.core.internal_form import covariance_of_sums, state_covariance
from residua.errors import SettingError
from residua.linear import StateSpace
from running_examples import plant, recording


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"test": NormThreshold(window=10_000_000)}, r"NormThreshold\(window=10000000\) keeps 20,000,000 numbers"),
        (
            {"isolate": Directional(window=10**9)},
            r"Directional\(window=1000000000\) .* 5,000,000 samples at most",
        ),
        ({"isolate": Matched(window=10**9)}, r"Matched\(window=1000000000\)"),
        ({"isolate": Matched(window=10**9, steady=True)}, r"Matched\(window=1000000000\)"),
    ],
)
def test_windows_that_no_machine_can_hold_are_refused(settings: dict, words: str) -> None:
    start = time.perf_counter()
    with pytest.raises(SettingError, match=words):
        rs.Monitor(rs.design.kalman_filter(plant()), **settings)
    assert time.perf_counter() - start < 2, "at once"


def test_windows_of_banks_too() -> None:
    with pytest.raises(SettingError, match=r"Structured\(window=1000000000\)"):
        rs.Monitor(rs.design.sensor_fault_bank(plant()), isolate=Structured(window=10**9))


def test_counters_may_be_as_long_as_one_likes() -> None:
    test = NormThreshold(persistence=10**9, release=10**9)
    found = rs.Monitor(rs.design.kalman_filter(plant()), test=test, max_hold=10**12).run(*recording(fault="p1"))
    assert isinstance(found, rs.Diagnosis)
    assert not found.alarm.any()
    peak = rs.Monitor(rs.design.sensor_fault_bank(plant()), test=PeakThreshold(3.0, window=10**9))
    assert not peak.run(*recording()).alarm.any()  # type: ignore[union-attr]


def test_the_covariance_of_sums_over_a_long_window_is_exact_and_cheap() -> None:
    """Once nothing is left of the autocovariance, further terms are zeros: the same bits."""
    generator = rs.design.detection_filter(plant())
    assert np.isfinite(np.asarray(generator.covariance_of_sums(10**6))).all()
    short, long = generator.covariance_of_sums(20_000), generator.covariance_of_sums(2_000_000)
    np.testing.assert_allclose(np.asarray(short), np.asarray(long), rtol=1e-2)


def test_a_long_window_of_a_slow_filter_is_summed_as_a_short_one_is() -> None:
    """By doubling: the same sum as term by term, in time that grows with the logarithm of the window."""
    slow = StateSpace(np.diag([1 - 1e-7, -0.5]), np.eye(2), np.array([[1.0, 2.0]]), np.array([[0.1, 0.0]]), dt=1.0)
    X, window = state_covariance(slow.A, slow.B @ slow.B.T), 5000
    step = slow.A @ X @ slow.C.T + slow.B @ slow.D.T
    terms = [(1 - k / window) * slow.C @ np.linalg.matrix_power(slow.A, k - 1) @ step for k in range(1, window)]
    direct = slow.C @ X @ slow.C.T + slow.D @ slow.D.T + 2 * sum(terms)
    np.testing.assert_allclose(covariance_of_sums(slow, window), direct, rtol=1e-12)
    began = time.process_time()
    assert np.isfinite(covariance_of_sums(slow, 10**9)).all()
    assert time.process_time() - began < 1


@pytest.mark.parametrize(
    "make",
    [
        lambda g, long: rs.Monitor(g, start=long),
        lambda g, long: rs.Monitor(g, test=long),
        lambda g, long: rs.Monitor(g, isolate=long),
        lambda g, long: rs.Monitor(g, plausible=long),
        lambda g, long: rs.decide.NormThreshold(whiten=long),
        lambda g, long: rs.decide.NormThreshold(threshold=long),
        lambda g, long: rs.decide.NormThreshold(window=long),
        lambda g, long: rs.decide.NormThreshold(false_alarm_rate=long),
    ],
)
def test_a_long_setting_is_not_repeated_whole(make: Any) -> None:
    """Settings come from files too, and an error message is no place for a megabyte."""
    generator = rs.design.decoupled_residual(rs.library.gertler(), insensitive_to="p1")
    with pytest.raises(SettingError) as error:
        make(generator, "Z" * 100_000)
    assert "Z" * 20 in str(error.value)
    assert len(str(error.value)) < 600
