"""What was held out of a fit: its rows, the rate on them, and the interval of that rate."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import binomtest

from residua.decide import NormThreshold
from residua.decide.held_out import LEAST, HeldOut, alarms_held_out, held_out_rows
from residua.decide.norm_fit import fit_norm_test
from residua.decide.test import FaultFreeRun


def run_of(residuals: np.ndarray, seams: tuple[int, ...] = ()) -> FaultFreeRun:
    return FaultFreeRun(residuals, np.ones(len(residuals), dtype=bool), seams, np.ones(residuals.shape[1]))


@pytest.mark.parametrize(("samples", "alarmed"), [(10, 0), (10, 10), (200, 3), (61, 20)])
def test_the_interval_of_independent_samples_is_the_exact_one(samples: int, alarmed: int) -> None:
    exact = binomtest(alarmed, samples).proportion_ci(0.95, method="exact")
    assert HeldOut(samples, alarmed, float(samples), 0.01).interval == pytest.approx((exact.low, exact.high), abs=1e-9)


def test_fewer_independent_samples_say_less() -> None:
    many, few = HeldOut(1000, 50, 1000.0, 0.01), HeldOut(1000, 50, 20.0, 0.01)
    assert many.is_over
    assert not few.is_over
    assert few.interval[0] < many.interval[0] < 0.05 < many.interval[1] < few.interval[1]


def test_the_last_fifth_of_each_recording_is_held_out() -> None:
    run = run_of(np.zeros((1000, 2)), (600,))
    run.usable[:100] = False
    held = held_out_rows(run, 0.2, 1)
    assert held is not None
    assert np.flatnonzero(held).tolist() == [*range(500, 600), *range(920, 1000)]


@pytest.mark.parametrize(("samples", "window"), [(5 * LEAST - 1, 1), (499, 50)])
def test_of_too_few_samples_none_is_held_out(samples: int, window: int) -> None:
    assert held_out_rows(run_of(np.zeros((samples, 1))), 0.2, window) is None
    assert held_out_rows(run_of(np.zeros((samples + 1, 1))), 0.2, window) is not None
    assert held_out_rows(run_of(np.zeros((samples + 1, 1))), 0.0, window) is None


@pytest.mark.parametrize("phi", [0.0, 0.9])
def test_the_interval_holds_the_rate_on_other_data(phi: float) -> None:
    """Of forty fits the intervals of 95 % miss the rate on ten thousand new samples a few times."""
    rng, missed = np.random.default_rng([7, round(10 * phi)]), 0
    for _ in range(40):
        noise = lfilter([1.0], [1, -phi], rng.standard_normal((13_000, 2)), axis=0)[500:]
        run = run_of(noise[:2500])
        held = held_out_rows(run, 0.2, 5)
        assert held is not None
        settings = NormThreshold(window=5, persistence=2)
        test = fit_norm_test(settings, run.residuals, run.usable & ~held, false_alarm_rate=0.1, covariance=None,
                             signal_size=1.0)  # fmt: skip
        low, high = _alarms(test, run, held).interval
        other = run_of(noise[2500:])
        missed += not low <= _alarms(test, other, other.usable).rate <= high
    assert missed <= 6


def _alarms(test: object, run: FaultFreeRun, held: np.ndarray) -> HeldOut:
    out = alarms_held_out(test, run, held, 0.1)  # pyright: ignore
    assert out is not None
    return out


def test_only_whole_windows_of_what_was_held_out_are_judged() -> None:
    rng = np.random.default_rng(3)
    run = run_of(rng.standard_normal((1000, 1)))
    held = held_out_rows(run, 0.2, 20)
    assert held is not None
    settings = NormThreshold(window=20, persistence=1)
    test = fit_norm_test(settings, run.residuals, run.usable & ~held, false_alarm_rate=0.01, covariance=None,
                         signal_size=1.0)  # fmt: skip
    assert _alarms(test, run, held).samples == 200 - 19
