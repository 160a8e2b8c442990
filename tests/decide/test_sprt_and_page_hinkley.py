"""Wald's test and that of Page and Hinkley: published figures, and designs against simulation."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy import stats
from scipy.signal import lfilter

import residua as rs
from residua.decide.stream_test import plain
from residua.decide.test import Block, Watched
from residua.errors import DataError, FileFormatError, SettingError

#: METHODS V12: six digits after the point are printed.
PRINTED = 1e-6
#: Runs are compared with the design in deviations of their mean: one in 100 of right ones is beyond.
SURE = stats.norm.isf(0.005)


def times_to_alarm(
    settings: rs.decide.SPRT | rs.decide.PageHinkley, h: float, dimension: int, runs: int, longest: int, *,
    shift: float = 0.0, offset: float = 0.0, seed: int = 1,
) -> np.ndarray:  # fmt: skip
    """Samples from a start to the first over the threshold, of runs that all come to it; the shift is of one part."""
    test = settings.test(**plain(np.zeros(dimension), np.eye(dimension)), threshold=h, release=h / 2, basis="")
    rng, times, first = np.random.default_rng(seed), np.zeros(runs), 0
    state = test.start(runs)
    while not times.all():
        assert first < longest
        e = rng.standard_normal((runs, 100, dimension)) + offset
        e[..., 0] += shift
        state, out = test.run(state, Block(e, np.ones((runs, 100), bool)))
        here = (times == 0) & out.exceeded.any(axis=1)
        times[here] = first + 1 + out.exceeded[here].argmax(axis=1)
        first += 100
    return times


def assert_mean(values: np.ndarray, wanted: float) -> None:
    """Inside the 99 % interval."""
    assert abs(values.mean() - wanted) < SURE * values.std() / np.sqrt(len(values))


def test_walds_bounds_and_sample_numbers_as_published() -> None:
    test = rs.decide.SPRT(false_alarm_rate=0.01, miss_rate=0.05, shift=1.0)
    assert test.upper == pytest.approx(4.553877, abs=PRINTED)
    assert test.lower == pytest.approx(-2.985682, abs=PRINTED)
    assert test.designed(1) == test.upper
    assert test.wald_sample_numbers == pytest.approx((5.820573, 8.353798), abs=PRINTED)


@pytest.mark.parametrize("shift", [0.5, 1.0, 2.0])
def test_single_decisions_are_as_their_integral_equations_say(shift: float) -> None:
    """By plain sums of logarithms of ratios, without the code of the package."""
    test = rs.decide.SPRT(false_alarm_rate=0.05, miss_rate=0.1, shift=shift)
    exact = test.decisions(test.upper)
    assert exact.false_alarm_rate < 0.05 / 0.9
    assert exact.miss_rate < 0.1 / 0.95
    assert exact.samples > test.wald_sample_numbers[0]
    rng, runs = np.random.default_rng(2), 20_000
    for mean, wrong, samples in (
        (0.0, exact.false_alarm_rate, exact.samples),
        (shift, exact.miss_rate, exact.samples_with_fault),
    ):
        ratio, count = np.zeros(runs), np.zeros(runs)
        while (left := (ratio <= test.upper) & (ratio >= test.lower)).any():
            ratio[left] += shift * (rng.standard_normal(left.sum()) + mean) - shift**2 / 2
            count += left
        over = ratio > test.upper
        assert_mean((over if mean == 0 else ~over).astype(float), wrong)
        assert_mean(count, samples)


def test_a_ratio_below_its_lower_bound_starts_again_and_an_alarm_ends_at_half_the_threshold() -> None:
    settings = rs.decide.SPRT(shift=1.0, false_alarm_rate=0.01)
    test = settings.test(
        **plain(np.zeros(1), np.eye(1)), threshold=settings.upper, release=settings.upper / 2, basis=""
    )
    e = np.array([1.5, 1.5, -9.0, 0.5, 3.5, 3.0, -5.0, 2.0])[None, :, None]
    state, out = test.run(test.start(1), Block(e, np.ones((1, 8), bool)))
    # the lower side starts again at the second sample, the upper one at the third, and both at the last
    np.testing.assert_allclose(out.statistic[0], [1.0, 2.0, 8.5, 7.5, 3.5, 5.5, 4.5, 2.0], atol=1e-12)
    assert out.alarm[0].tolist() == [False, False, True, True, True, True, True, False]
    assert not state.sums.any()


@pytest.mark.parametrize(("dimension", "rate"), [(1, 0.02), (3, 0.01)])
def test_the_times_of_walds_test_are_the_designed_ones(dimension: int, rate: float) -> None:
    """Both sides of all residuals are counted as independent: exact of one side, within a few per cent of several."""
    test = rs.decide.SPRT(false_alarm_rate=rate, miss_rate=0.1, shift=1.0)
    h = test.designed(dimension)
    known = test.run_length(h, dimension)
    found = times_to_alarm(test, h, dimension, 1500, 40 * int(known))
    assert abs(found.mean() - known) < SURE * found.std() / np.sqrt(len(found)) + 0.05 * known
    late = times_to_alarm(test, h, dimension, 1500, 4000, shift=1.5, seed=2)
    wanted = test.delay(h, dimension, shift=1.5)
    assert abs(late.mean() - wanted) < SURE * late.std() / np.sqrt(len(late)) + 0.03 * wanted


def test_one_side_of_walds_test_takes_as_long_as_its_decisions_do() -> None:
    """A false alarm each N / alpha samples: two integral equations, one answer."""
    test = rs.decide.SPRT(false_alarm_rate=0.003, miss_rate=0.05, shift=0.8)
    exact = test.decisions(test.upper)
    assert 2 * test.run_length(test.upper, 1) == pytest.approx(exact.samples / exact.false_alarm_rate, rel=1e-5)


def test_a_wanted_time_sets_the_upper_bound_of_walds_test() -> None:
    test = rs.decide.SPRT(mean_time_between_false_alarms=5000, miss_rate=0.05)
    for dimension in (1, 4):
        assert test.run_length(test.designed(dimension), dimension) == pytest.approx(5000, rel=1e-4)


@pytest.mark.parametrize(("dimension", "offset"), [(1, 7.0), (3, 0.0)])
def test_the_times_of_page_and_hinkley_are_the_designed_ones_whatever_the_mean(dimension: int, offset: float) -> None:
    test = rs.decide.PageHinkley(drift=0.5, mean_time_between_false_alarms=200)
    h = test.designed(dimension)
    found = times_to_alarm(test, h, dimension, 2000, 10_000, offset=offset)
    assert abs(found.mean() - 200) < SURE * found.std() / np.sqrt(len(found)) + 0.02 * 200


def test_page_and_hinkley_without_an_allowance_for_the_mean_is_the_sum_that_its_equation_says() -> None:
    """By the equation of the docstring, with cumulative sums and their minimum, before any alarm."""
    e = np.random.default_rng(4).standard_normal(300) + 3.0
    settings = rs.decide.PageHinkley(drift=0.2)
    test = settings.test(**plain(np.zeros(1), np.eye(1)), threshold=1e6, release=5e5, basis="")
    values = test.statistic(test.first_sums(1), e[None, :, None], np.ones((1, 300), bool))[0][0]
    off = e - np.cumsum(e) / np.arange(1, 301)
    wanted = []
    for sign in (1, -1):
        sums = np.concatenate([[0.0], np.cumsum(sign * off - 0.2)])
        wanted.append((sums - np.minimum.accumulate(sums))[1:])
    np.testing.assert_allclose(values, np.max(wanted, axis=0), atol=1e-10)


def test_the_delay_of_page_and_hinkley_is_that_with_a_mean_known_well() -> None:
    settings = rs.decide.PageHinkley(drift=0.5)
    h = 12.0
    test = settings.test(**plain(np.zeros(1), np.eye(1)), threshold=h, release=h / 2, basis="")
    e = np.random.default_rng(5).standard_normal((1000, 2100, 1))
    e[:, 2000:] += 1.5
    state, _ = test.run(test.start(1000), Block(e[:, :2000], np.ones((1000, 2000), bool)))
    out = test.run(state, Block(e[:, 2000:], np.ones((1000, 100), bool)))[1]
    late = 1.0 + out.exceeded.argmax(axis=1)
    wanted = settings.delay(h, 1, shift=1.5)
    # the sum of the quiet time is a little over zero, and the mean takes up a little of the step
    assert late.mean() == pytest.approx(wanted, rel=0.05)


@pytest.mark.parametrize(
    ("settings", "kind"),
    [
        (rs.decide.SPRT(mean_time_between_false_alarms=200), "coloured"),
        (rs.decide.PageHinkley(mean_time_between_false_alarms=200), "heavy-tailed"),
    ],
)
def test_a_fit_keeps_the_designed_time_on_memory_and_heavy_tails(settings: rs.decide.SPRT, kind: str) -> None:
    """About 190 false alarms; every kind of noise is in ``test_streams.py``."""
    rng = np.random.default_rng(3)
    if kind == "coloured":
        residuals = lfilter([1.0], [1.0, -0.9], rng.standard_normal((60_000, 2)), axis=0)
    else:
        residuals = rng.standard_t(4, (60_000, 2))
    monitor = rs.Monitor(rs.identify.given_residuals(["a", "b"], dt=1.0), test=settings, isolate=None)
    alarm = monitor.fit(None, residuals[:20_000], held_out=0).run(None, residuals[20_000:]).alarm
    raised = int((alarm[1:] & ~alarm[:-1]).sum())
    assert (~alarm).sum() / raised == pytest.approx(200, rel=0.30)


def test_an_offset_that_no_fit_has_seen_alarms_a_cusum_and_not_page_and_hinkley() -> None:
    rng = np.random.default_rng(6)
    fault_free, later = rng.standard_normal((5000, 1)), rng.standard_normal((3000, 1)) + 2.0
    later[2000:] += 2.0
    alarms = []
    for test in (rs.decide.CUSUM, rs.decide.PageHinkley):
        generator = rs.identify.given_residuals(["r"], dt=1.0)
        monitor = rs.Monitor(generator, test=test(mean_time_between_false_alarms=1e5), isolate=None)
        alarms.append(monitor.fit(None, fault_free).run(None, later).alarm)
    assert alarms[0][:2000].mean() > 0.9
    assert not alarms[1][:2000].any()
    assert 2000 < np.flatnonzero(alarms[1])[0] < 2030


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: rs.decide.SPRT(false_alarm_rate=0), "false_alarm_rate must lie between 0 and 1"),
        (lambda: rs.decide.SPRT(false_alarm_rate=1.5), "false_alarm_rate must lie between 0 and 1"),
        (lambda: rs.decide.SPRT(miss_rate=0), "miss_rate must lie between 0 and 1"),
        (lambda: rs.decide.SPRT(miss_rate=np.nan), "miss_rate must lie between 0 and 1"),
        (lambda: rs.decide.SPRT(miss_rate="few"), "miss_rate must lie between 0 and 1"),  # pyright: ignore[reportArgumentType]
        (lambda: rs.decide.SPRT(false_alarm_rate=0.5, miss_rate=0.5), "below 1 together, got 0.5 and 0.5"),
        (lambda: rs.decide.SPRT(shift=0), "shift must be a positive number"),
        (lambda: rs.decide.SPRT(shift=np.inf), "shift must be a positive number"),
        (lambda: rs.decide.PageHinkley(drift=0), "drift must be a positive number"),
        (lambda: rs.decide.PageHinkley(drift=-0.5), "half of the change to be seen"),
        (lambda: rs.decide.PageHinkley(source="guess"), "source must be one of auto"),
    ],
)
def test_settings_that_cannot_be_are_refused(make: object, message: str) -> None:
    with pytest.raises(SettingError, match=message):
        make()  # pyright: ignore[reportCallIssue]


def test_few_samples_are_refused_by_walds_test() -> None:
    monitor = rs.Monitor(rs.identify.given_residuals(["r"], dt=1.0), test=rs.decide.SPRT(), isolate=None)
    with pytest.raises(DataError, match=r"give at least 100 samples, or use NormThreshold"):
        monitor.fit(None, np.random.default_rng(0).standard_normal((60, 1)), held_out=0)


def test_files_that_fit_nothing_are_refused() -> None:
    watched = Watched(rs.identify.given_residuals(["r"], dt=1.0))
    fine = rs.decide.SPRT().test(**plain(np.zeros(1), np.eye(1)), threshold=4.0, release=2.0, basis="")
    fine.check(watched)
    with pytest.raises(FileFormatError, match="where a test starts again, negative"):
        dataclasses.replace(fine, lower=0.5).check(watched)
