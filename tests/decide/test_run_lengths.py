"""Run lengths against published ones, to their printed digits, and against simulation."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

import residua as rs
from guards import trips
from residua.decide.cusum import PageChain
from residua.decide.gaussian_norm import norm_above, norm_density
from residua.decide.run_lengths import Chain, alarm_cycle, mean_run_length, settled, threshold_of
from residua.decide.stream_test import plain
from residua.decide.test import Block
from residua.decide.vector_run_lengths import LengthChain, shifted_run_length
from residua.errors import AccuracyError, SettingError

#: A published figure with so many digits, METHODS V11.
PRINTED = 1e-3
#: Runs are compared with the design in deviations of their mean: one in 100 of right ones is beyond.
SURE = stats.norm.isf(0.005)


def ewma(dimension: int, weight: float) -> LengthChain:
    return LengthChain(dimension, kept=(1 - weight) / weight, gain=weight)


@pytest.mark.parametrize(
    ("h", "mean", "length"), [(4, 0, 335.3676), (4, 1, 8.38320), (5, 0, 930.887), (5, 1, 10.37598)]
)
def test_one_sided_sums_as_published(h: float, mean: float, length: float) -> None:
    assert mean_run_length(PageChain(0.5, mean), h) == pytest.approx(length, rel=1e-6)


def test_two_sided_sums_and_their_design_as_published() -> None:
    test = rs.decide.CUSUM(shift=1.0)
    assert test.run_length(5.0, 1) == pytest.approx(465.4435, rel=1e-6)
    h = threshold_of(lambda level: mean_run_length(PageChain(0.5), level), 1000, 4.0)
    assert h == pytest.approx(5.07070, rel=1e-5)
    assert mean_run_length(PageChain(0.5, 1.0), h) == pytest.approx(10.5171, rel=1e-5)


def test_the_path_of_a_sum_as_published() -> None:
    test = rs.decide.CUSUM(form="page").test(**plain(np.zeros(1), np.eye(1)), threshold=9.0, release=1.0, basis="")
    e = np.array([0.2, -0.3, 0.8, 1.5, 1.1, 2.0])[None, :, None]
    np.testing.assert_allclose(
        test.statistic(test.first_sums(1), e, np.ones((1, 6), bool))[0][0], [0, 0, 0.3, 1.3, 1.9, 3.4], atol=1e-12
    )


def test_moving_averages_as_published() -> None:
    """Lucas and Saccucci (1990): 500 in control, 10.3 after a step of one deviation."""
    test = rs.decide.EWMA(weight=0.1)
    assert round(test.run_length(2.814, 1)) == 500
    assert round(test.delay(2.814, 1, shift=1.0), 1) == 10.3
    plain_of_one = rs.decide.EWMA(weight=1.0)
    assert plain_of_one.run_length(3.0, 1) == pytest.approx(1 / (2 * stats.norm.sf(3.0)), rel=1e-6)


@pytest.mark.parametrize(
    ("dimension", "level", "lengths"),
    [(4, 12.73, (199.78, 35.05, 12.17, 7.22, 5.19, 3.42)), (20, 37.01, (199.09, 61.62, 20.17, 11.40, 8.03, 5.18))],
)
def test_vector_moving_averages_as_published(dimension: int, level: float, lengths: tuple[float, ...]) -> None:
    """Molnau and others (2001), by a Markov chain of 25 states: itself within a per cent or so."""
    weight, shifts = 0.1, (0.0, 0.5, 1.0, 1.5, 2.0, 3.0)
    h = float(np.sqrt(level * weight / (2 - weight)))
    wanted = list(zip(shifts, lengths, strict=True))
    for shift, length in wanted if dimension < 10 else wanted[:1]:
        assert shifted_run_length(ewma(dimension, weight), h, shift) == pytest.approx(length, rel=0.02)


@pytest.mark.parametrize("dimension", [1, 2, 5, 30])
def test_the_length_of_a_gaussian_vector(dimension: int) -> None:
    length = np.linspace(0.2, 12.0, 25)
    for mean in (0.0, 1e-9, 0.4, 3.0, 8.0):
        exact = stats.ncx2(dimension, max(mean, 1e-9) ** 2)
        np.testing.assert_allclose(
            norm_density(length, np.full(25, mean), dimension), 2 * length * exact.pdf(length**2), rtol=1e-6, atol=1e-12
        )
        assert norm_above(4.0, np.array([mean]), dimension)[0] == pytest.approx(exact.sf(16.0), abs=1e-12)


TESTS = [
    rs.decide.CUSUM(shift=1.0, form="page"),
    rs.decide.CUSUM(shift=2.0, form="crosier"),
    rs.decide.CUSUM(shift=1.0, form="crosier"),
    rs.decide.CUSUM(shift=2.0, form="pignatiello-runger"),
    rs.decide.EWMA(weight=0.1),
    rs.decide.EWMA(weight=0.5),
]


@pytest.mark.parametrize("dimension", [1, 3])
@pytest.mark.parametrize("settings", TESTS, ids=lambda one: f"{one.kind} {getattr(one, 'form', '')}")
def test_simulated_times_are_the_designed_ones(settings: rs.decide.CUSUM, dimension: int) -> None:
    """Times from a start to the first alarm, and after a step, within what chance allows for the number of runs."""
    h, runs = threshold_of(lambda level: settings.run_length(level, dimension), 200.0, 4.0), 600
    rng = np.random.default_rng(7)
    made = settings.test(**plain(np.zeros(dimension), np.eye(dimension)), threshold=h, release=h / 2, basis="")
    for shift, length in ((0.0, 200.0), (1.0, settings.delay(h, dimension, shift=1.0))):
        time = int(10 * length) + 50
        e = rng.standard_normal((runs, time, dimension))
        e[:, :, 0] += shift
        alarm = made.run(made.start(runs), Block(e, np.ones((runs, time), bool)))[1].alarm
        first = np.where(alarm.any(axis=1), alarm.argmax(axis=1) + 1, time)
        # the page form counts the sums of several residuals as independent ones: 2 %
        assert abs(first.mean() - length) < SURE * first.std() / np.sqrt(runs) + 0.02 * length * (
            settings.kind == "cusum"
        )


def test_the_time_of_an_alarm_is_the_simulated_one() -> None:
    chain = PageChain(0.5)
    cycle = alarm_cycle(chain, 4.0, 2.0)
    rng, total, count = np.random.default_rng(0), 0, 0
    s, over = np.zeros(2000), np.zeros(2000, bool)
    for _ in range(3000):
        s = np.maximum(s + rng.standard_normal(2000) - 0.5, 0)
        count += int((~over & (s > 4.0)).sum())
        over = (over | (s > 4.0)) & (s > 2.0)
        total += int(over.sum())
        s = np.where(~over & (s <= 2.0) & False, 0.0, s)
    assert total / count == pytest.approx(cycle.lasting, rel=0.03)
    assert 0 < cycle.fraction < cycle.lasting / cycle.quiet


def test_delays_near_the_asymptote_of_lordens_bound() -> None:
    """``2 log(T) / shift^2`` is the first term alone: within 10 % for large changes, too much for small ones."""
    ratios = []
    for shift in (1.0, 1.5, 2.0):
        h = threshold_of(lambda level, k=shift / 2: mean_run_length(PageChain(k), level), 1e5, 5.0)
        ratios.append(mean_run_length(PageChain(shift / 2, shift), h) * shift**2 / 2 / np.log(1e5))
    assert ratios[-1] == pytest.approx(1.0, abs=0.1)
    assert ratios == sorted(ratios)
    assert ratios[0] == pytest.approx(0.855, abs=0.01)


def test_what_cannot_be_designed_is_refused() -> None:
    with pytest.raises(SettingError, match=r"1e\+12 samples cannot be designed"):
        threshold_of(lambda h: mean_run_length(PageChain(0.5), h), 1e12, 4.0)
    with pytest.raises(SettingError, match=r"reached once in more than 1e\+10 samples"):
        mean_run_length(PageChain(0.5), 30.0)
    with pytest.raises(SettingError, match="every threshold has a longer time"):
        threshold_of(lambda h: 5.0 + h, 2.0, 4.0)


@trips("decide.run_lengths:settled")
def test_a_quadrature_that_does_not_settle_is_refused() -> None:
    class Jump(Chain):
        width = 5.0

        def density(self, now: np.ndarray, then: np.ndarray) -> np.ndarray:
            return np.where(
                np.broadcast_to((then > 1.2) & (then < 1.3), np.broadcast_shapes(now.shape, then.shape)), 5.0, 0
            )

        def above(self, now: np.ndarray, level: float) -> np.ndarray:
            return np.full(now.shape, 0.1)

    with pytest.raises(AccuracyError, match="by two quadratures"):
        mean_run_length(Jump(), 4.0)
    assert settled(lambda factor: 3.0, "anything") == 3.0


def test_the_fraction_in_alarm_is_that_of_a_whole_cycle() -> None:
    """Of single samples: over with probability p, and at or below the release with q."""
    from scipy.special import chdtrc

    settings = rs.decide.EWMA(weight=1.0, false_alarm_rate=0.2)
    h = settings.designed(2)
    p, q = chdtrc(2, h**2), 1 - chdtrc(2, (h / 2) ** 2)
    assert (1 / q) / (1 / p + 1 / q) == pytest.approx(0.2, rel=1e-4)
    single = rs.decide.ChiSquared()
    assert single.cycle(single.designed(3, 0.1), 3).fraction == pytest.approx(0.1, rel=1e-9)
