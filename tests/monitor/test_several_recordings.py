"""Fitting to several recordings: each from its own start, and nothing across the seams between them."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import residua as rs
from residua.decide.norm_threshold import NormThreshold, fit_norm_test
from residua.decide.peak_threshold import told_sample
from residua.errors import DataError
from residua.monitor import Recording, recording_from_frame

PLANT = (
    rs.Plant([[0.9, 0.05], [0.0, 0.8]], [[0.1], [0.1]], np.eye(2), dt=1.0, inputs=["u"], outputs=["a", "b"])
    .with_sensor_faults()
    .with_noise(process=1e-4, measurement=1e-2)
)


def flight(samples: int, seed: int, level: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """A recording that begins in the steady state that belongs to a level of the input."""
    rng = np.random.default_rng(seed)
    u = level + 0.3 * np.sign(np.sin(0.05 * np.arange(samples)))[:, None]
    u[0] = level
    x = np.linalg.solve(np.eye(2) - PLANT.A, PLANT.B[:, 0] * level)
    y = np.empty((samples, 2))
    for k in range(samples):
        y[k] = x + 0.1 * rng.standard_normal(2)
        x = PLANT.A @ x + PLANT.B @ u[k] + 0.01 * rng.standard_normal(2)
    return u, y


def frame(u: np.ndarray, y: np.ndarray) -> pd.DataFrame:
    return pd.DataFrame({"time": np.arange(len(u), dtype=float), "u": u[:, 0], "a": y[:, 0], "b": y[:, 1]})


def monitor(kind: str = "norm", **settings: int) -> rs.Monitor:
    if kind == "matched":
        return rs.Monitor(rs.design.matched_filters(PLANT, window=20))
    if kind == "bank":
        return rs.Monitor(rs.design.sensor_fault_bank(PLANT, observer="minimal"), test=NormThreshold(**settings))
    if kind == "peak":
        return rs.Monitor(rs.design.kalman_filter(PLANT), test=rs.decide.PeakThreshold(window=20))
    return rs.Monitor(rs.design.kalman_filter(PLANT), test=NormThreshold(**settings))


def numbers(fitted: rs.Monitor) -> np.ndarray:
    test = fitted.norm_test
    levels = np.atleast_1d(getattr(test, "thresholds", test.threshold))
    weights = test.whitening @ test.whitening.T  # whitening itself is known up to a rotation
    return np.concatenate([levels, test.center, weights.ravel()])


@pytest.mark.parametrize("kind", ["norm", "bank", "matched", "peak"])
def test_one_in_a_list_is_the_same_as_one(kind: str) -> None:
    data = flight(1500, 0)
    one = monitor(kind).fit(*data, false_alarm_rate=0.02)
    for given in ([data], (frame(*data),), [recording_from_frame(frame(*data), PLANT)]):
        again = monitor(kind).fit(given, false_alarm_rate=0.02)
        np.testing.assert_array_equal(numbers(again), numbers(one))
        assert again.norm_test.basis == one.norm_test.basis


@pytest.mark.parametrize("kind", ["norm", "bank", "matched", "peak"])
@pytest.mark.parametrize("settings", [{}, {"persistence": 1, "window": 10}])
def test_nothing_goes_across_a_seam(kind: str, settings: dict[str, int]) -> None:
    """As one recording in which a long gap lies between the flights; run through without it, they differ by far."""
    flights = [flight(1500, 0, 20.0), flight(1000, 1, -20.0), flight(1500, 2, 20.0)]
    gap = np.full((100, 1), np.nan), np.full((100, 2), np.nan)
    apart = [np.concatenate([flights[0][i], gap[i], flights[1][i], gap[i], flights[2][i]]) for i in (0, 1)]
    joined = [np.concatenate([f[i] for f in flights]) for i in (0, 1)]
    fitted = monitor(kind, **settings).fit(flights, false_alarm_rate=0.02, held_out=0.0)
    reference = monitor(kind, **settings).fit(*apart, false_alarm_rate=0.02, held_out=0.0)
    # the folds of a fit, and runs of alarms that a gap does not end, may differ by a little
    np.testing.assert_allclose(numbers(fitted), numbers(reference), rtol=0.05, atol=1e-3)
    wrong = monitor(kind, **settings).fit(*joined, false_alarm_rate=0.02, held_out=0.0)
    assert np.abs(numbers(wrong) - numbers(fitted)).max() > 0.2 * np.abs(numbers(fitted)).max()
    assert fitted.norm_test.basis.endswith("; 3 recordings, each from its own start")


def test_the_order_of_recordings_does_not_matter() -> None:
    flights = [flight(1500, k, 10.0 * k) for k in range(3)]
    one, other = (monitor(window=5).fit(order, false_alarm_rate=0.02) for order in (flights, flights[::-1]))
    np.testing.assert_allclose(numbers(one), numbers(other), rtol=0.05, atol=1e-3)


def test_windows_and_runs_end_at_a_seam() -> None:
    """Large twice at the end of each recording and twice at the beginning of the next: no run of three."""
    rng = np.random.default_rng(3)
    rows = rng.uniform(-1, 1, (4000, 1))
    rows[np.arange(4000) % 100 >= 98] = rows[np.arange(4000) % 100 < 2] = 50.0
    options = {"false_alarm_rate": 0.01, "covariance": None, "signal_size": 1.0}
    usable = np.ones(4000, dtype=bool)
    joined, apart = (
        fit_norm_test(NormThreshold(persistence=3, whiten="none"), rows, usable, seams=seams, **options).threshold
        for seams in ((), tuple(range(100, 4000, 100)))
    )
    assert joined > 40
    assert apart < 10


def test_lists_that_cannot_be_fitted() -> None:
    good = flight(500, 0)
    for given, message in (
        ([], "the list of recordings is empty"),
        ([good, good[1]], r"recording 2 of 2 is an array: give pairs, \[\(u, y\)"),
        ([good, (good[0][:3], good[1][:3])], "recording 2 of 2 has no usable sample: 3 samples, settling takes"),
        ([good, (good[0], 0 * good[1])], "no output ever changes in recording 2 of 2"),
        ([frame(*good), frame(*good).drop(columns="b")], "recording 2 of 2: data frame: missing column 'b'"),
        ([good, (np.stack([good[0]] * 2), np.stack([good[1]] * 2))], "recording 2 of 2 has the shape"),
        ([frame(*good), frame(*good).assign(time=2.0 * np.arange(500))], "recording 2 of 2: .* the steps do not agree"),
    ):
        with pytest.raises(DataError, match=message):
            monitor().fit(given)
    with pytest.raises(DataError, match="time is for one recording"):
        monitor().fit([good, good], time=np.arange(500.0))
    with pytest.raises(DataError, match=r"give u and y as arrays"):
        monitor().fit([5, good])


def test_a_certified_threshold_names_the_recording_that_goes_over() -> None:
    flights = [flight(600, 0), flight(600, 1)]
    flights[1][1][400] += 9.0
    watch = rs.Monitor(rs.design.kalman_filter(PLANT), test=rs.decide.PeakThreshold(2.0))
    with pytest.raises(DataError, match="in sample 400 of recording 2"):
        watch.fit(flights)
    assert told_sample(3, ()) == "sample 3"
    assert told_sample(3, (3,)) == "sample 0 of recording 2"


def test_dates_beside_arrays_are_no_notes() -> None:
    u, y = flight(800, 0)
    clock = np.datetime64("2026-11-20T08:00:00") + np.arange(800).astype("timedelta64[s]")
    watch = monitor().fit(*flight(1500, 1))
    dated, plain = watch.run(u, y, time=clock), watch.run(u, y)
    assert isinstance(dated, rs.Diagnosis)
    assert isinstance(plain, rs.Diagnosis)
    assert dated.notes == plain.notes


def test_what_was_done_to_the_rows_is_in_the_diagnosis() -> None:
    table = frame(*flight(800, 0)).drop(index=[100, 101, 300])
    read = recording_from_frame(table, PLANT, fill_gaps=True)
    assert isinstance(read, Recording)
    watch = monitor().fit([flight(1500, 1), read])
    found = watch.run(read)
    assert isinstance(found, rs.Diagnosis)
    assert len(found.time) == 800
    assert found.n_missing == 3
    assert read.notes[0] in found.notes
    assert "3 rows inserted as missing, in 2 gaps" in str(found)
