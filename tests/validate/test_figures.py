"""Figures against closed forms and examples from the literature."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from residua.errors import SettingError
from residua.validate.campaign_result import mcnemar
from residua.validate.delays import delays_of
from residua.validate.figure_table import FigureTable
from residua.validate.intervals import Estimate, bootstrap, clustered_share, events_apart, wilson
from residua.validate.separation import roc_of
from residua.validate.size_fit import detection_probability


@pytest.mark.parametrize("confidence", [0.9, 0.95, 0.99])
def test_wilson_and_poisson_intervals_are_those_of_scipy(confidence: float) -> None:
    for count, of in [(0, 20), (3, 20), (20, 20), (81, 263)]:
        expected = stats.binomtest(count, of).proportion_ci(confidence, method="wilson")
        seen = wilson(count, of, confidence)
        np.testing.assert_allclose([seen.low, seen.high], [expected.low, expected.high], atol=1e-12)
    side = (1 - confidence) / 2
    seen = events_apart(7, 1000.0, confidence)
    rates = stats.chi2.ppf([side, 1 - side], [14, 16]) / 2 / 1000
    np.testing.assert_allclose([seen.low, seen.high], 1 / rates[::-1], rtol=1e-10)
    none = events_apart(0, 1000.0, confidence)
    assert (none.value, none.high) == (np.inf, np.inf)
    assert none.low == pytest.approx(1000 / -np.log(side))


def test_a_share_is_one_only_where_it_is() -> None:
    assert str(Estimate(1.0, 0.99962, 1.0)) == "1 (0.9996 to 1)"
    assert str(Estimate(0.99999, 0.9, 1.0)) == "0.99999 (0.9 to 1)"


def test_no_data_give_no_figure() -> None:
    assert np.isnan(wilson(0, 0).value)
    assert str(events_apart(0, 0.0)) == "–"
    assert str(bootstrap(np.zeros(0), lambda drawn: drawn.mean(axis=1), 0)) == "–"


@pytest.mark.parametrize("confidence", [0.0, 1.0, np.nan, "high"])
def test_a_confidence_lies_between_zero_and_one(confidence) -> None:
    with pytest.raises(SettingError, match="between 0 and 1"):
        wilson(1, 2, confidence)


def test_correlated_samples_widen_the_interval_of_a_rate() -> None:
    """Alarms that last ten samples each: the interval holds the true rate as often as it says."""
    rng, held, plain = np.random.default_rng(0), 0, 0
    for _ in range(300):
        alarmed = 10 * rng.binomial(100, 0.02, size=40)
        of = np.full(40, 1000)
        held += 0.02 in clustered_share(alarmed, of, 1)
        plain += 0.02 in wilson(int(alarmed.sum()), int(of.sum()))
    assert held > 0.9 * 300
    assert plain < 0.7 * 300
    assert clustered_share(np.zeros(5, int), np.full(5, 100), 25).high == pytest.approx(wilson(0, 20).high)


def test_delays_of_the_leukaemia_trial() -> None:
    """Freireich et al. (1963), 6-mercaptopurine: weeks of remission, as every textbook has them."""
    weeks = [6, 6, 6, 6, 7, 9, 10, 10, 11, 13, 16, 17, 19, 20, 22, 23, 25, 32, 32, 34, 35]
    ended = [1, 1, 1, 0, 1, 0, 1, 0, 0, 1, 1, 0, 0, 0, 1, 1, 0, 0, 0, 0, 0]
    delay = delays_of(np.array(weeks, dtype=float), np.array(ended, dtype=bool))
    np.testing.assert_array_equal(delay.time, [6, 7, 10, 13, 16, 22, 23])
    expected = [0.8571, 0.8067, 0.7529, 0.6902, 0.6275, 0.5378, 0.4482]
    np.testing.assert_allclose(delay.undetected, expected, atol=5e-5)
    assert delay.quantile(0.5).value == 23
    assert delay.quantile(0.9).value == np.inf
    assert delay.censored == 12


def test_delays_are_those_of_scipy() -> None:
    rng = np.random.default_rng(5)
    delay, end = rng.exponential(5, 40), rng.uniform(1, 12, 40)
    seen, time = delay <= end, np.minimum(delay, end)
    ours = delays_of(time, seen)
    theirs = stats.ecdf(stats.CensoredData.right_censored(time, ~seen)).sf
    where = np.isin(theirs.quantiles, ours.time)
    with pytest.warns(RuntimeWarning, match="undefined at some"):  # where nobody is left
        interval = theirs.confidence_interval(method="log-log")
    np.testing.assert_allclose(ours.undetected, theirs.probabilities[where], atol=1e-12)
    inside = ours.undetected > 0
    np.testing.assert_allclose(ours.low[inside], interval.low.probabilities[where][inside], atol=1e-12)
    np.testing.assert_allclose(ours.high[inside], interval.high.probabilities[where][inside], atol=1e-12)


def test_the_interval_of_a_median_delay_holds_it_as_often_as_it_says() -> None:
    rng, held = np.random.default_rng(1), 0
    for _ in range(300):
        delay = rng.exponential(10.0, 60)
        held += 10 * np.log(2) in delays_of(np.minimum(delay, 15.0), delay < 15.0).quantile(0.5)
    assert 0.9 * 300 < held <= 300


def test_all_at_once_and_none_at_all() -> None:
    at_once = delays_of(np.full(50, 3.0), np.ones(50, bool))
    assert at_once.quantile(0.9) == Estimate(3.0, 3.0, 3.0)
    assert at_once.quantile(0.99) == Estimate(3.0, 3.0, np.inf)  # fifty runs do not show one in a hundred
    none = delays_of(np.full(50, 9.0), np.zeros(50, bool))
    assert none.quantile(0.5).value == np.inf
    assert none.censored == 50


def test_the_area_under_the_curve_of_two_normal_distributions() -> None:
    rng, true = np.random.default_rng(2), float(stats.norm.cdf(1 / np.sqrt(2)))
    held = sum(true in roc_of(rng.normal(1.0, 1.0, 300), rng.normal(0.0, 1.0, 300), 0.5).area for _ in range(200))
    assert held > 0.9 * 200
    roc = roc_of(rng.normal(1.0, 1.0, 4000), rng.normal(0.0, 1.0, 4000), 0.5)
    assert roc.area.value == pytest.approx(true, abs=0.02)
    assert np.trapezoid(roc.detections, roc.false_alarms) == pytest.approx(roc.area.value, abs=0.01)
    level = int(np.argmin(np.abs(roc.threshold - 0.5)))
    assert roc.false_alarms[level] == pytest.approx(stats.norm.sf(0.5), abs=0.02)
    assert roc.detections[level] == pytest.approx(stats.norm.sf(-0.5), abs=0.02)


def test_statistics_that_are_alike_have_half_the_area() -> None:
    same = roc_of(np.ones(100), np.ones(100), 0.5)
    assert same.area.value == 0.5
    apart = roc_of(np.full(100, 9.0), np.full(100, 1.0), 0.5)
    assert apart.area.value == apart.area.high == 1
    assert 0.95 < apart.area.low < 0.97  # a hundred runs do not show more


def test_a90_of_a_logistic_curve() -> None:
    rng, sizes, n = np.random.default_rng(3), np.geomspace(0.05, 0.5, 8), 400
    p = 1 / (1 + np.exp(-(8 + 4 * np.log(sizes))))
    true = np.exp((np.log(9) - 8) / 4)
    values, bounded = [], 0
    for _ in range(100):
        fit = detection_probability("leak", "step", sizes, np.full(8, n), rng.binomial(n, p))
        values.append(fit.a90)
        bounded += fit.a90_95 > true
        assert fit.a90_95 > fit.a90
    assert np.mean(values) == pytest.approx(true, rel=0.01)
    assert 90 <= bounded <= 100  # 95 in a hundred
    middle, low = fit.probability(np.array([fit.a90, fit.a90_95]))
    assert middle[0] == pytest.approx(0.9)
    assert low[1] == pytest.approx(0.9)


def test_a90_does_not_depend_on_the_unit_nor_on_the_sign() -> None:
    sizes, runs, seen = np.array([0.1, 0.2, 0.3, 0.4]), np.full(4, 50), np.array([3, 20, 39, 48])
    plain = detection_probability("leak", "step", sizes, runs, seen)
    for factor in (2.0**-20, 2.0**20, -1.0):
        other = detection_probability("leak", "step", factor * sizes, runs, seen)
        assert other.a90 == pytest.approx(abs(factor) * plain.a90, rel=1e-9)
        assert other.a90_95 == pytest.approx(abs(factor) * plain.a90_95, rel=1e-9)


def test_the_fit_is_the_most_likely_one() -> None:
    from scipy.optimize import minimize

    sizes, runs, seen = np.array([0.1, 0.2, 0.3, 0.4]), np.full(4, 50), np.array([3, 20, 39, 48])
    fit = detection_probability("leak", "step", sizes, runs, seen)

    def unlikely(beta: np.ndarray) -> float:
        eta = beta[0] + beta[1] * np.log(sizes)
        return float(runs @ np.logaddexp(0, eta) - seen @ eta)

    best = minimize(unlikely, [5.0, 3.0], method="BFGS", options={"gtol": 1e-6})
    np.testing.assert_allclose(fit.beta, best.x, rtol=1e-4)
    np.testing.assert_allclose(fit.covariance, best.hess_inv, rtol=0.05)  # that of BFGS is approximate


@pytest.mark.parametrize(
    ("sizes", "seen", "message"),
    [
        ([0.1], [20], "two sizes or more"),
        ([0.1, 0.2], [50, 50], "add smaller ones"),
        ([0.1, 0.2], [0, 0], "add larger ones"),
        ([0.1, 0.2], [0, 50], "all runs were missed up to size 0.1 and all detected from 0.2 on"),
        ([0.1, 0.2, 0.3], [0, 20, 50], "only size 0.2"),
        ([0.1, 0.2, 0.3], [40, 30, 20], "larger faults are not detected more often"),
    ],
)
def test_what_cannot_be_fitted_is_said(sizes: list[float], seen: list[int], message: str) -> None:
    fit = detection_probability("leak", "step", np.array(sizes), np.full(len(sizes), 50), np.array(seen))
    assert np.isnan(fit.a90)
    assert message in str(fit)


def test_a90_beyond_the_sizes_is_said() -> None:
    fit = detection_probability("leak", "step", np.array([0.1, 0.2]), np.full(2, 50), np.array([5, 15]))
    assert fit.a90 > 0.2
    assert "outside of the sizes" in str(fit)


def test_mcnemar_is_the_exact_binomial_test() -> None:
    for first, second in [(0, 0), (0, 6), (3, 9), (20, 21)]:
        expected = stats.binomtest(first, first + second).pvalue if first + second else 1.0
        assert mcnemar(first, second) == pytest.approx(expected)


def test_a_table_prints_in_line_and_has_columns() -> None:
    table = FigureTable(
        ("fault", "share"), (("leak", Estimate(0.5, 0.25, 0.75)), ("a longer name", Estimate(1, 0.9, 1)))
    )
    lines = str(table).splitlines()
    assert len({line.index(text) for line, text in zip(lines, ("share", "0.5", "1 ("), strict=True)}) == 1
    assert table.columns()["share low"] == [0.25, 0.9]
    assert list(table.to_frame().columns) == ["fault", "share", "share low", "share high"]
    assert table.to_frame("polars").shape == (2, 4)
    with pytest.raises(SettingError, match="'pandas' or 'polars'"):
        table.to_frame("excel")
