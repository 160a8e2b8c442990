from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from residua.arrays import runs
from residua.report.charts import time_axis
from residua.report.decimate import choose_bins, spans
from residua.report.text import rounded


@settings(max_examples=60, deadline=None)
@given(st.integers(1, 500), st.integers(2, 120), st.integers(0, 2**31), st.floats(0, 1))
def test_bins_keep_extremes_and_size(n, limit, seed, share_missing):
    rng = np.random.default_rng(seed)
    values = rng.standard_normal(n)
    values[rng.random(n) < share_missing] = np.nan
    bins = choose_bins(n, limit)
    points = bins.extremes(values)
    times = bins.times(np.arange(n) * 0.5)
    assert len(points) == len(times) == bins.n_points <= max(limit, 2)
    assert (np.diff(times) > 0).all()
    if np.isfinite(values).any():
        assert np.nanmin(points) == np.nanmin(values)
        assert np.nanmax(points) == np.nanmax(values)
    else:
        assert np.isnan(points).all()
    if bins.width > 1:
        for k in range(bins.n_points // 2):
            block = values[k * bins.width : (k + 1) * bins.width]
            if np.isfinite(block).any():
                assert set(points[2 * k : 2 * k + 2]) == {np.nanmin(block), np.nanmax(block)}
            else:
                assert np.isnan(points[2 * k : 2 * k + 2]).all()


def test_a_single_spike_in_a_million_samples_stays():
    values = np.zeros(1_000_000)
    values[765_432] = 7.0
    bins = choose_bins(len(values), 20_000)
    points = bins.extremes(values)
    at = bins.times(np.arange(1_000_000.0))[int(points.argmax())]
    assert points.max() == 7.0
    assert abs(at - 765_432) < bins.width


def test_infinite_values_are_gaps():
    assert np.isnan(choose_bins(3, 10).extremes(np.array([np.inf, -np.inf, np.nan]))).all()
    assert choose_bins(4, 2).extremes(np.array([np.inf, 1.0, 2.0, -np.inf])).tolist() == [1.0, 2.0]


@settings(max_examples=60, deadline=None)
@given(st.lists(st.booleans(), max_size=40))
def test_runs_are_the_true_samples(flags):
    array = np.array(flags, dtype=bool)
    back = np.zeros(len(array), dtype=bool)
    for start, stop in runs(array):
        assert stop > start
        back[start:stop] = True
    assert (back == array).all()


def test_too_many_spans_are_joined():
    time = np.arange(100_000.0)
    flags = np.zeros(100_000, dtype=bool)
    flags[::2] = True
    flags[50_000:60_000] = False
    found = spans(time, runs(flags))
    assert found == [[0.0, 49_999.0], [60_000.0, 99_999.0]]


@pytest.mark.parametrize(("offset", "ripple"), [(0.0, 1.0), (1e6, 1e-3), (-273.15, 0.01), (0.0, 1e-12)])
def test_rounding_keeps_what_a_chart_shows(offset, ripple):
    values = offset + ripple * np.sin(np.arange(200))
    back = np.array(rounded(values), dtype=float)
    assert np.abs(back - values).max() <= 1e-4 * ripple * 2


def test_even_times_are_sent_as_three_numbers():
    assert time_axis(0.1 * np.arange(5000)) == {"start": 0.0, "step": pytest.approx(0.1), "n": 5000}
    uneven = time_axis(np.array([0.0, 1.0, 3.0]))
    assert uneven == {"list": [0.0, 1.0, 3.0]}
