"""When a change began: what is stated of the interval, by simulation, and what it says where it cannot tell."""

from __future__ import annotations

import numpy as np
import pytest

from change_examples import CASES, ONSET, coverage, noise, noisy
from residua.decide.change_time import JUMP_QUANTILE, LEAST_BEFORE, MOST_TOGETHER, change_time

#: Least fraction of intervals that hold the true onset; 0.95 is stated.
LEAST_COVERAGE = 0.90


def test_the_quantile_is_that_of_a_jumps_time() -> None:
    assert (1 - np.exp(-JUMP_QUANTILE / 2)) ** 2 == pytest.approx(0.95, abs=1e-12)


@pytest.mark.parametrize("kind", ["step", "ramp"])
@pytest.mark.parametrize("slow", [0.0, 0.5, 0.9])
def test_intervals_hold_the_true_onset(kind: str, slow: float) -> None:
    """Over all sizes together, 25 recordings of each: at least 0.90, by a margin of what so few can show."""
    counts = [coverage(kind, size, slow, 25, seed=7) for size in CASES[kind]]
    dated, held = (sum(c[k] for c in counts) for k in (0, 1))
    assert dated >= 60
    assert held / dated >= LEAST_COVERAGE


@pytest.mark.parametrize(("kind", "size"), [("step", 8.0), ("step", 40.0), ("ramp", 10.0), ("ramp", 50.0)])
def test_intervals_are_short_where_the_change_is_clear(kind: str, size: float) -> None:
    _, _, width = coverage(kind, size, 0.0, 20, seed=1)
    assert width <= {"step": 1, "ramp": 60}[kind]


def test_the_response_of_a_filter_does_not_matter() -> None:
    """A step through a lag of 20 samples, of which the shapes know nothing."""
    for size in (8.0, 15.0, 40.0):
        dated, held, _ = coverage("step", size, 0.0, 30, seed=3, lag=0.95)
        assert dated >= 25
        assert held / dated >= LEAST_COVERAGE


def test_a_slow_drift_beyond_what_is_looked_at_together() -> None:
    """The interval goes on in bins until it ends, or the recording does."""
    n, begin = 6 * MOST_TOGETHER, MOST_TOGETHER
    signal = noise(np.random.default_rng(2), n, 0.0) + 4.5 * np.maximum(np.arange(n) - begin, 0) / (3.5 * MOST_TOGETHER)
    over = np.convolve(signal > 4, np.ones(3), "valid") == 3
    first = int(np.argmax(over))
    assert first - begin > MOST_TOGETHER
    found = change_time(signal, first, first + 2)
    assert found.earliest is not None
    assert found.earliest <= begin <= found.latest < first


def test_what_began_before_the_data_is_said_to_be_before() -> None:
    """A ramp that began before the recording: no earliest time is made up."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        signal = noise(rng, 400, 0.0) + 0.01 * np.arange(400)
        over = np.convolve(signal > 3.5, np.ones(3), "valid") == 3
        first = int(np.argmax(over)) if over.any() else 300
        found = change_time(signal, first, first + 2)
        assert found is None or found.earliest is None or found.earliest - LEAST_BEFORE < 100


def test_too_little_is_not_dated() -> None:
    signal = noisy("step", 8.0, 0.0, np.random.default_rng(1))
    assert change_time(signal[ONSET - LEAST_BEFORE + 2 :], LEAST_BEFORE - 1, LEAST_BEFORE + 1) is None, "too short"
    assert change_time(noise(np.random.default_rng(1), 300, 0.0), 200, 202) is None, "no change"


def test_without_noise_the_first_sample_that_differs() -> None:
    signal = np.r_[np.full(100, 3.0), 3.0 + np.arange(50) * 1e-3]
    found = change_time(signal, 120, 122)
    assert (found.earliest, found.estimate, found.latest) == (101, 101, 101)


@pytest.mark.parametrize("power", [-20, 20])
def test_units_do_not_matter(power: int) -> None:
    signal = noisy("ramp", 3.0, 0.5, np.random.default_rng(4))
    first = int(np.argmax(np.convolve(np.abs(signal) > 4, np.ones(3), "valid") == 3))
    assert change_time(signal * 2.0**power, first, first + 2) == change_time(signal, first, first + 2)
