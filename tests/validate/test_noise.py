"""Noise models: unit variance, the correlation and the tails that they say, and blocks of what was recorded."""

from __future__ import annotations

import numpy as np
import pytest

import residua as rs
from residua import validate as v
from residua.errors import DataError, SettingError

SAMPLES = 200_000


@pytest.mark.parametrize("model", [v.white(), v.coloured(0.9), v.coloured(-0.5), v.heavy_tailed(6)], ids=str)
def test_noise_has_mean_zero_and_unit_variance(model: v.NoiseModel) -> None:
    drawn = model.draw(np.random.default_rng(1), SAMPLES, 2)
    assert drawn.shape == (SAMPLES, 2)
    np.testing.assert_allclose(drawn.mean(axis=0), 0, atol=0.05)  # of the slowest, 0.0097 a standard deviation
    np.testing.assert_allclose(drawn.std(axis=0), 1, atol=0.03)


def test_coloured_noise_is_an_autoregression_from_the_first_sample_on() -> None:
    drawn = v.coloured(0.8).draw(np.random.default_rng(2), SAMPLES, 1)[:, 0]
    for lag in (1, 2, 5):
        assert np.mean(drawn[lag:] * drawn[:-lag]) == pytest.approx(0.8**lag, abs=0.03)
    rng = np.random.default_rng(2)
    e, expected = rng.standard_normal((SAMPLES, 1))[:50, 0], []
    for k in range(50):
        expected.append(e[0] if k == 0 else 0.8 * expected[-1] + 0.6 * e[k])
    np.testing.assert_allclose(drawn[:50], expected, rtol=1e-12)


def test_heavy_tails_are_heavy() -> None:
    drawn = v.heavy_tailed(4).draw(np.random.default_rng(3), SAMPLES, 1)
    share = float(np.mean(np.abs(drawn) > 4))
    assert 20 * 6.3e-5 < share < 0.01  # of Gaussian noise 6.3e-5


def test_a_size_scales_a_disturbance() -> None:
    one, two = (v.coloured(0.5, size).draw(np.random.default_rng(4), 100, 1) for size in (1.0, 4.0))
    np.testing.assert_array_equal(two, 4 * one)


def test_resampled_residuals_are_blocks_of_those_recorded() -> None:
    recorded = np.column_stack([np.arange(500.0), -np.arange(500.0)])
    model = v.resampled([recorded[:200], recorded[200:]], block=30)
    drawn = model.draw(np.random.default_rng(5), 95)
    assert drawn.shape == (95, 2)
    for start in range(0, 95, 30):
        steps = np.diff(drawn[start : start + 30, 0])
        assert (steps == 1).all()
        first, last = drawn[start, 0], drawn[min(start + 29, 94), 0]
        assert last < 200 or first >= 200  # no block reaches from one recording into the next


def test_the_length_of_a_block_follows_the_correlation() -> None:
    rng = np.random.default_rng(6)
    short, long = (v.resampled(v.coloured(c).draw(rng, 5000, 1)).block for c in (0.0, 0.95))
    assert 17 <= short <= 30
    assert long > 100


def test_of_a_diagnosis_the_decided_samples_count(monitor: rs.Monitor) -> None:
    y = 0.1 * np.random.default_rng(7).standard_normal((400, 2))
    y[100] = np.nan
    diagnosis = monitor.run(np.zeros((400, 1)), y)
    model = v.resampled(diagnosis, block=20)
    assert len(model.residuals) == diagnosis.decided.sum()
    assert np.isfinite(model.residuals).all()


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (lambda: v.coloured(1.0), SettingError, "over -1 and under 1"),
        (lambda: v.coloured(np.nan), SettingError, "over -1 and under 1"),
        (lambda: v.heavy_tailed(2.0), SettingError, "over 2"),
        (lambda: v.white(0.0), SettingError, "positive, finite"),
        (lambda: v.white(np.inf), SettingError, "positive, finite"),
        (lambda: v.resampled([[1.0, np.nan]]), DataError, "finite"),
        (lambda: v.resampled(np.zeros((0, 2))), DataError, "residuals must be"),
        (lambda: v.resampled("abc"), DataError, "residuals must be numbers"),
        (lambda: v.resampled([np.zeros((9, 2)), np.zeros((9, 3))]), DataError, "as many columns"),
        (lambda: v.resampled(np.zeros((9, 2)), block=10), DataError, "shorter block"),
        (lambda: v.resampled(np.zeros((9, 2)), block=0), SettingError, "whole number of samples"),
    ],
)
def test_what_no_noise_can_be(make, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        make()
