"""The finite-horizon test: its settings, the moving maximum, and why the alarm logic that is there runs it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import residua as rs
from residua.decide import PeakThreshold, peak_over_window
from residua.decide.member_thresholds import BankTest
from residua.decide.peak_threshold import CERTIFIED, GIVEN, checked_peak_test, fit_peak_test, peak_test
from residua.decide.persistence import alarm_logic
from residua.decide.whitened_norm import NormTest
from residua.errors import DataError, SettingError
from robust_loops import random_loop

MEMBERS = ("a", "b", "c")
ROWS = ((0,), (1, 2), (3,))


@st.composite
def recordings(draw: st.DrawFn) -> tuple[np.ndarray, int, int]:
    """Residuals with missing samples, a window, and where to cut."""
    time, k = draw(st.integers(0, 40)), draw(st.integers(1, 3))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    rows = rng.integers(-4, 5, (time, k)).astype(float) * (rng.random((time, 1)) < 0.3)
    rows[rng.random(time) < draw(st.sampled_from([0.0, 0.2, 0.7]))] = np.nan
    return rows, draw(st.integers(1, 50)), draw(st.integers(0, time))


def by_definition(rows: np.ndarray, window: int) -> np.ndarray:
    """The largest norm of the last ``window`` usable samples, one sample after the other."""
    out, seen = np.full(len(rows), np.nan), []
    for k, row in enumerate(rows):
        if not np.isnan(row).any():
            seen.append(float(np.sqrt(np.sum(row**2))))
        if seen:
            out[k] = max(seen[-window:])
    return out


# --------------------------------------------------------------------- the maximum


@settings(max_examples=300, deadline=None)
@given(recordings())
def test_the_moving_maximum_is_that_of_the_last_usable_samples(case: tuple[np.ndarray, int, int]) -> None:
    rows, window, _ = case
    found = peak_over_window(rows, window)
    np.testing.assert_allclose(found, by_definition(rows, window), rtol=1e-15)
    if rows.shape[1] == 1:
        assert np.array_equal(found, peak_over_window(rows[:, 0], window), equal_nan=True)


@settings(max_examples=300, deadline=None)
@given(recordings(), st.floats(0.5, 6.0))
def test_the_alarm_logic_is_the_test_of_the_maximum(case: tuple[np.ndarray, int, int], threshold: float) -> None:
    """Persistence 1 and release = window, in one piece and in two."""
    rows, window, at = case
    usable = ~np.isnan(rows).any(axis=1)
    over = np.where(usable, np.sqrt(np.sum(np.where(usable[:, None], rows, 0.0) ** 2, axis=1)), 0.0) > threshold
    up, down, on = np.zeros(1, dtype=np.int64), np.zeros(1, dtype=np.int64), np.zeros(1, dtype=bool)
    alarms = []
    for piece in (slice(None, at), slice(at, None)):
        alarm, ups, downs = alarm_logic(over[piece][None], usable[piece][None], up, down, on, 1, window)
        alarms.append(alarm[0])
        if alarm.shape[1]:
            up, down, on = ups[:, -1], downs[:, -1], alarm[:, -1]
    wanted = by_definition(rows, window) > threshold
    assert np.array_equal(np.concatenate(alarms), wanted)
    assert np.array_equal(peak_over_window(rows, window) > threshold, wanted)


def test_an_alarm_lasts_a_window_of_usable_samples_however_long_that_takes() -> None:
    rows = np.zeros(20)
    rows[3] = 5.0
    assert np.flatnonzero(peak_over_window(rows, 4) > 1).tolist() == [3, 4, 5, 6]
    rows[[4, 6]] = np.nan
    assert np.flatnonzero(peak_over_window(rows, 4) > 1).tolist() == [3, 4, 5, 6, 7, 8]


def test_what_is_no_time_course_or_no_window_is_refused() -> None:
    with pytest.raises(DataError, match=r"\(time, residuals\)"):
        peak_over_window(np.zeros((2, 3, 4)))
    with pytest.raises(SettingError, match="window"):
        peak_over_window(np.zeros(3), 0)


# ------------------------------------------------------------------------ settings


@pytest.mark.parametrize(
    "wrong", [0, -1.0, np.inf, np.nan, "0.3", True, [], {}, [1, -1], {"a": 0.0}, [[1.0]], object()]
)
def test_thresholds_are_positive_numbers(wrong: object) -> None:
    with pytest.raises(SettingError):
        PeakThreshold(wrong)  # pyright: ignore[reportArgumentType]


class Certified:
    """A value that is a number, and much besides."""

    def __init__(self, value: float) -> None:
        self.value = value

    def __float__(self) -> float:
        return self.value

    def __repr__(self) -> str:
        return "line\n" * 1200


def test_thresholds_may_be_what_a_design_has_certified() -> None:
    assert PeakThreshold({"a": Certified(0.3)}).thresholds == {"a": 0.3}
    assert PeakThreshold([Certified(0.3), 1]).thresholds == (0.3, 1.0)
    assert PeakThreshold(Certified(0.3)).thresholds == 0.3  # pyright: ignore[reportArgumentType]
    loop = random_loop(3)
    observer = rs.design.luenberger_observer(loop.nominal, margin=1.0).residual_generator()
    found = rs.design.certified_thresholds(observer, loop, method="centred")
    assert PeakThreshold(found).thresholds == {name: float(one) for name, one in found.items()}


@pytest.mark.parametrize("wrong", [Certified(-1.0), {"a": Certified(np.nan)}, ["x" * 5000], np.ones((200, 200))])
def test_what_is_wrong_is_repeated_in_short(wrong: object) -> None:
    with pytest.raises(SettingError) as error:
        PeakThreshold(wrong)  # pyright: ignore[reportArgumentType]
    assert len(str(error.value)) < 300
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("wrong", [{"window": 0}, {"window": 1.5}, {"false_alarm_rate": 0.0}])
def test_window_and_rate_are_checked(wrong: dict) -> None:
    with pytest.raises(SettingError):
        PeakThreshold(1.0, **wrong)


def test_thresholds_go_to_their_members() -> None:
    assert PeakThreshold().for_members(MEMBERS) is None
    assert PeakThreshold(2).for_members(MEMBERS) == (2.0, 2.0, 2.0)
    assert PeakThreshold({"c": 3, "a": 1, "b": 2}).for_members(MEMBERS) == (1.0, 2.0, 3.0)
    assert PeakThreshold(np.array([1.0, 2.0, 3.0])).for_members(MEMBERS) == (1.0, 2.0, 3.0)
    assert PeakThreshold(np.float64(2)).for_members(()) == PeakThreshold([2.0]).for_members(()) == (2.0,)
    given = {"a": 1.0}
    made = PeakThreshold(given)
    given["a"] = 7.0
    assert made == PeakThreshold({"a": 1.0}), "what is handed over later changes nothing"


@pytest.mark.parametrize(
    ("thresholds", "members", "words"),
    [
        ({"a": 1, "b": 1}, MEMBERS, "missing 'c'"),
        ({"a": 1, "b": 1, "c": 1, "d": 1}, MEMBERS, "unknown 'd'"),
        ([1, 2], MEMBERS, "expected 3 thresholds"),
        ([1, 2], (), "tested as a whole"),
        ({"a": 1}, (), "tested as a whole"),
    ],
)
def test_thresholds_that_do_not_fit_are_refused(thresholds: object, members: tuple, words: str) -> None:
    with pytest.raises(SettingError, match=words):
        PeakThreshold(thresholds).for_members(members)  # pyright: ignore[reportArgumentType]


# -------------------------------------------------------------------- what runs


def test_nothing_is_centred_or_whitened() -> None:
    whole = peak_test(PeakThreshold(2.0, window=7), (2.0,), GIVEN, 3)
    assert isinstance(whole, NormTest)
    assert (whole.persistence, whole.release, whole.window, whole.kind) == (1, 7, 1, "peak")
    assert np.array_equal(whole.whitening, np.eye(3))
    assert not whole.center.any()
    np.testing.assert_array_equal(whole.band, [2.0, 2.0, 2.0])
    bank = peak_test(PeakThreshold(window=7), (1.0, 2.0, 3.0), CERTIFIED, 4, ROWS)
    assert isinstance(bank, BankTest)
    assert np.array_equal(bank.whitening, np.eye(4))
    assert (bank.persistence, bank.release, bank.window, bank.kind, bank.basis) == (1, 7, 1, "peak", CERTIFIED)
    np.testing.assert_array_equal(bank.band, [1.0, 2.0, 2.0, 3.0])


def test_known_thresholds_are_held_against_a_recording() -> None:
    bank = peak_test(PeakThreshold(), (1.0, 5.0, 4.0), CERTIFIED, 4, ROWS)
    rows = np.array([[0.5, 3.0, 0.0, 1.0], [-0.25, 0.0, -2.0, 2.0], [9.0, 9.0, 9.0, 9.0]])
    usable = np.array([True, True, False])
    found = checked_peak_test(bank, rows, usable, MEMBERS)
    assert (
        found.basis
        == f"{CERTIFIED}; 2 fault-free samples reached 50 % of that of a, 60 % of that of b, 50 % of that of c"
    )
    assert isinstance(found, BankTest)
    assert np.array_equal(found.thresholds, [1.0, 5.0, 4.0])
    again = checked_peak_test(found, rows / 2, usable, MEMBERS)
    assert again.basis.endswith("reached 25 % of that of a, 30 % of that of b, 25 % of that of c")
    with pytest.raises(
        DataError, match=r"'b': \|r\| = 12\.73 in sample 2, 2\.55 times the threshold of 5, .* 1 of 3 .*cert"
    ):
        checked_peak_test(peak_test(PeakThreshold(), (9.0, 5.0, 9.0), CERTIFIED, 4, ROWS), rows, usable | True, MEMBERS)
    whole = peak_test(PeakThreshold(), (4.0,), GIVEN, 4)
    assert checked_peak_test(whole, rows, usable).basis == f"{GIVEN}; 2 fault-free samples reached 80 % of it"
    with pytest.raises(DataError, match="or higher thresholds"):
        checked_peak_test(whole, rows, usable | True)
    with pytest.raises(DataError, match="no sample"):
        checked_peak_test(whole, rows, usable & False)
    many = peak_test(PeakThreshold(), range(1, 11), GIVEN, 10, [(k,) for k in range(10)])
    told = checked_peak_test(many, np.full((2, 10), 0.5), np.ones(2, dtype=bool), [f"m{k}" for k in range(10)])
    assert told.basis.endswith("reached at most 50 % of one, that of m0")


def test_a_threshold_that_is_just_reached_is_not_gone_over() -> None:
    whole = peak_test(PeakThreshold(), (5.0,), CERTIFIED, 2)
    assert "100 %" in checked_peak_test(whole, np.array([[3.0, 4.0]]), np.ones(1, dtype=bool)).basis


@pytest.mark.parametrize("window", [1, 20, 60])
def test_fitted_thresholds_keep_their_rate_on_other_data(window: int) -> None:
    """Of a bank whose residuals have a mean: it is not taken out, and each member gets its share."""
    rng = np.random.default_rng(3)
    mean, usable = np.array([2.0, 0.0, 0.0, -1.0]), np.ones(400_000, dtype=bool)
    rate = 0.02
    test = fit_peak_test(
        PeakThreshold(window=window),
        mean + rng.standard_normal((40_000, 4)),
        usable[:40_000],
        false_alarm_rate=rate,
        signal_sizes=[1.0] * 3,
        members=ROWS,
    )
    assert isinstance(test, BankTest)
    assert "1/3 of the rate of the whole bank" in test.basis
    assert not test.center.any()
    fresh = mean + rng.standard_normal((400_000, 4))
    for rows, threshold in zip(ROWS, test.thresholds, strict=True):
        alarm = peak_over_window(fresh[:, list(rows)], window) > threshold
        assert 0.2 * rate / 3 <= alarm.mean() <= 1.5 * rate / 3


def test_few_data_are_extended_by_their_tail() -> None:
    """4,000 samples cannot show an alarm of 60 samples in 600,000; the tail of the norm goes on."""
    found, usable = [], np.ones(4000, dtype=bool)
    for seed in range(12):
        normal = np.random.default_rng(seed).standard_normal((4000, 2))
        options = {"false_alarm_rate": 1e-4, "signal_sizes": [1.0]}
        test = fit_peak_test(PeakThreshold(window=60), normal, usable, **options)
        assert "extended" in test.basis
        found.append(test.threshold)
    # of the norm of two: P(|r| > J) = exp(-J**2 / 2), and 60 samples for each; so few data aim at 0.6 of the rate
    exact = np.sqrt(2 * np.log(60 / 0.6e-4))
    assert np.mean(found) == pytest.approx(exact, rel=0.02)
    assert found == pytest.approx([exact] * 12, rel=0.08)


def test_data_without_noise_give_a_threshold_above_rounding() -> None:
    zero, usable = np.zeros((700, 1)), np.ones(700, dtype=bool)
    test = fit_peak_test(PeakThreshold(), zero, usable, false_alarm_rate=1e-3, signal_sizes=[5.0])
    assert test.threshold >= 5e-12
    assert "rounding" in test.basis
    with pytest.raises(DataError, match="at least 600"):
        fit_peak_test(PeakThreshold(), zero[:500], usable[:500], false_alarm_rate=1e-3, signal_sizes=[5.0])
