"""Fitted thresholds on data that they were not fitted to: the rate asked for, or what the fit promises."""

from __future__ import annotations

import importlib
import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from residua.decide.calibrate import persistent_levels
from residua.decide.dependence import correlation_times, effective_exceedances
from residua.decide.exceedance_tail import Scale
from residua.decide.fault_free import FaultFree, oracle_approximating_intensity, shrunk
from residua.decide.member_thresholds import fit_bank_test, member_alarms
from residua.decide.norm_threshold import NormTest, NormThreshold, fit_norm_test
from residua.decide.persistence import alarm_logic
from residua.decide.test import FaultFreeRun
from residua.errors import DataError

REPOSITORY = Path(__file__).resolve().parent.parent.parent


@pytest.fixture
def benchmark_module(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(REPOSITORY / "benchmarks"))
    module = importlib.import_module("false_alarm_rates")
    monkeypatch.setattr(module, "NEW", 100_000)
    return module


# ------------------------------------------------------------- the rate on new data

#: Residuals, samples, window, persistence, noise. The first four alarmed on .029, .065, .455 and .966 of new samples,
#: the last on .117, when threshold and covariance were of the same samples.
CELLS = [
    (52, 1000, 1, 1, 0.0),
    (52, 1000, 1, 3, 0.0),
    (52, 1000, 1, 6, 0.0),
    (52, 1000, 20, 1, 0.0),
    (11, 5000, 100, 1, 0.0),
    (1, 300, 1, 1, 0.9),
    (60, 300, 1, 1, 0.0),
    (5, 5000, 20, 3, 0.5),
]


@pytest.mark.parametrize("cell", CELLS)
def test_the_rate_on_new_data_is_that_asked_for_or_promised(benchmark_module: ModuleType, cell: tuple) -> None:
    """Of four fits three at least keep it: each does with 95 % confidence; and none is far off."""
    k, n, window, persistence, phi = cell
    sums = benchmark_module.new_sums(np.random.default_rng(0), k, phi, window)
    found = list(benchmark_module.outcomes(sums, n, window, persistence, phi, 4))
    assert sum(one.kept for one in found) >= 3
    assert np.median([one.rate for one in found]) < 2 * benchmark_module.ASKED


@pytest.mark.campaign
def test_the_whole_grid(benchmark_module: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(benchmark_module, "NEW", 500_000)
    grid = (getattr(benchmark_module, name) for name in ("RESIDUALS", "SAMPLES", "WINDOWS", "PERSISTENCES", "NOISES"))
    rows = list(benchmark_module.rows(*grid))
    column = benchmark_module.HEADER.index
    assert sum(row[column("kept")] for row in rows) >= 0.95 * sum(row[column("fits")] for row in rows)


def test_the_tables_of_the_page_are_current() -> None:
    spec = importlib.util.spec_from_file_location("make_tables", REPOSITORY / "docs" / "make_tables.py")
    assert spec is not None
    assert spec.loader is not None
    made = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    assert made.RATES_BY_PERSISTENCE.read_text(encoding="utf-8") == made.false_alarm_rates()
    assert made.RATES_BY_SAMPLES.read_text(encoding="utf-8") == made.false_alarm_rates_by_samples()


def test_the_table_keeps_what_the_page_says() -> None:
    import csv

    with (REPOSITORY / "docs" / "data" / "false_alarm_rates_all.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    fits, kept = (sum(int(row[name]) for row in rows) for name in ("fits", "kept"))
    assert kept >= 0.95 * fits
    large = [row for row in rows if row["samples"] == "50000"]
    assert sum(int(row["said"]) for row in large) < 0.2 * sum(int(row["fits"]) for row in large)


def fitted(residuals: np.ndarray, rate: float = 0.01, seams: tuple[int, ...] = (), **options: object) -> NormTest:
    return fit_norm_test(
        NormThreshold(**options),  # pyright: ignore
        residuals,
        np.ones(len(residuals), dtype=bool),
        false_alarm_rate=rate,
        covariance=None,
        signal_size=1.0,
        seams=seams,
    )


@pytest.mark.parametrize("exponent", [-20, 20])
@pytest.mark.parametrize("options", [{}, {"window": 10}, {"persistence": 1}])
def test_units_do_not_change_the_threshold(exponent: int, options: dict) -> None:
    rng = np.random.default_rng(1)
    residuals = rng.standard_normal((400, 60)) @ rng.standard_normal((60, 60)) + 3
    units = 2.0 ** (exponent * np.linspace(-1, 1, 60)).round()
    one, other = fitted(residuals, **options), fitted(residuals * units, **options)
    assert other.threshold == pytest.approx(one.threshold, rel=1e-9)
    assert other.promised == pytest.approx(one.promised, rel=1e-6)
    assert one.shrinkage == pytest.approx(other.shrinkage, rel=1e-6)
    assert one.shrinkage is not None
    assert one.shrinkage > 0.05
    assert "covariance of too few samples" in one.basis


def test_nothing_reaches_across_a_seam() -> None:
    """Two flights with a jump between them: as one recording the jump is noise, as two each keeps its windows."""
    rng = np.random.default_rng(2)
    residuals = rng.standard_normal((4000, 2))
    data = FaultFree(residuals, np.ones(4000, dtype=bool), 50, (2500,))
    alone = FaultFree(residuals[2500:], np.ones(1500, dtype=bool), 50)
    np.testing.assert_allclose(
        data.sums[2500:], (alone.sums + alone.weights * (alone.middle - data.middle)), atol=1e-12
    )
    assert not data.full[2500:2549].any()
    assert data.full[2549]
    for _, kept, summed in data.held_out():
        assert not (summed & ~data.full).any()
        assert kept.any()
    assert [part.start for part in data.parts] == [0, 2500]
    stops = [stop for held, _, _ in data.held_out() for stop in [int(np.flatnonzero(held)[-1]) + 1]]
    assert 2500 in stops, "a stretch that is held out ends at a seam nearby"


def test_what_is_held_out_shares_no_sample_with_what_is_kept() -> None:
    rng = np.random.default_rng(3)
    data = FaultFree(np.cumsum(rng.standard_normal((600, 1)), axis=0) * 0.1, np.ones(600, dtype=bool), 20)
    for held, kept, summed in data.held_out():
        a, b = np.flatnonzero(held)[[0, -1]]
        windows = np.arange(max(0, a - 19), b + 1)
        assert not kept[windows].any()
        for t in np.flatnonzero(summed):
            assert not set(range(t - 19, t + 1)) & set(windows.tolist())


def test_heavy_tails_are_seen() -> None:
    """The tail is that of the data: for 1e-4 of Student's t with 4 degrees far over that of a Gaussian."""
    rng = np.random.default_rng(4)
    heavy, light = rng.standard_t(4, (20_000, 1)), rng.standard_normal((20_000, 1))
    options = {"persistence": 1, "rate": 1e-4, "whiten": "none"}
    assert fitted(light, **options).threshold == pytest.approx(3.9, rel=0.1)
    assert fitted(heavy, **options).threshold > 8


def test_too_few_for_any_promise_is_said() -> None:
    rng = np.random.default_rng(5)
    test = fitted(rng.standard_normal((300, 3)), window=100)
    assert test.promised == 1
    assert "too short to confirm a rate" in test.basis
    with pytest.raises(DataError, match="at least 200"):
        fitted(rng.standard_normal((150, 3)), window=100)


def test_more_data_promise_more() -> None:
    rng = np.random.default_rng(6)
    residuals = rng.standard_normal((40_000, 2))
    promised = [fitted(residuals[:n], persistence=3).promised or 0 for n in (300, 3000, 40_000)]
    assert promised[0] > promised[2]
    assert promised[2] <= 0.015


# --------------------------------------------------------------------------- banks


def test_members_that_alarm_together_share_the_rate() -> None:
    """Twelve members that are nearly one: a twelfth of the rate each would be a twelfth of what was asked for."""
    rng = np.random.default_rng(7)
    common = rng.standard_normal((60_000, 1))
    residuals = common + 0.05 * rng.standard_normal((60_000, 12))
    usable = np.ones(20_000, dtype=bool)
    settings_ = NormThreshold(persistence=1)
    run = FaultFreeRun(residuals[:20_000], usable, (), np.ones(12))
    test = fit_bank_test(settings_, run, [(i,) for i in range(12)], 0.01, None)
    q = np.abs((residuals[20_000:] - test.center) @ test.whitening)
    none, off = np.zeros((1, 12), dtype=np.int64), np.zeros((1, 12), dtype=bool)
    fired, _, _ = member_alarms(test, (q > test.thresholds)[None], np.ones((1, 40_000), dtype=bool), none, none, off)
    assert 0.002 < fired.any(axis=2).mean() < 0.015
    assert test.promised is not None


def test_members_that_are_independent_add_up() -> None:
    rng = np.random.default_rng(8)
    run = FaultFreeRun(rng.standard_normal((20_000, 4)), np.ones(20_000, dtype=bool), (), np.ones(4))
    test = fit_bank_test(NormThreshold(persistence=1), run, [(i,) for i in range(4)], 0.01, None)
    q = np.abs((rng.standard_normal((40_000, 4)) - test.center) @ test.whitening)
    shares = (q > test.thresholds).mean(axis=0)
    assert shares == pytest.approx(np.full(4, 0.0025), rel=0.4)


# ---------------------------------------------------------------------------- parts


@settings(max_examples=200, deadline=None)
@given(st.lists(st.integers(0, 6), min_size=1, max_size=50), st.integers(1, 7), st.integers(1, 7), st.integers(0, 6))
def test_a_level_is_over_the_threshold_where_the_alarm_is_on(
    values: list[int], persistence: int, release: int, threshold: int
) -> None:
    statistic = np.array(values, dtype=float)
    none, off = np.zeros(1, dtype=np.int64), np.zeros(1, dtype=bool)
    usable = np.ones((1, len(values)), dtype=bool)
    alarm, _, _ = alarm_logic((statistic > threshold)[None], usable, none, none, off, persistence, release)
    assert np.array_equal(alarm[0], persistent_levels(statistic, persistence, release) > threshold)


@pytest.mark.parametrize("phi", [0.0, 0.5, 0.9])
def test_correlation_times_are_those_of_the_process(benchmark_module: ModuleType, phi: float) -> None:
    x = benchmark_module.channels(np.random.default_rng(9), 200_000, 2, phi)
    whole = (slice(0, 200_000),)
    np.testing.assert_allclose(correlation_times(x, whole), (1 + phi) / (1 - phi), rtol=0.1)
    np.testing.assert_allclose(correlation_times(x, whole, 2), (1 + phi**2) / (1 - phi**2), rtol=0.1)


def test_exceedances_in_one_block_are_one() -> None:
    assert effective_exceedances(np.array([0.0, 7.0, 0.0])) == 1
    assert effective_exceedances(np.array([2.0, 2.0, 2.0, 0.0])) == pytest.approx(3)
    assert effective_exceedances(np.zeros(3)) == 0


def test_shrinkage_is_for_covariances_that_are_poorly_known() -> None:
    rng = np.random.default_rng(10)
    x = rng.standard_normal((40, 20))
    covariance = x.T @ x / 40
    drawn, intensity = shrunk(covariance, 40)
    np.testing.assert_array_equal(np.diag(drawn), np.diag(covariance))
    assert 0.5 < intensity <= 1, "the true one is the identity"
    assert np.linalg.cond(drawn) < np.linalg.cond(covariance)
    same, none = shrunk(covariance, 200)
    assert none == 0
    np.testing.assert_array_equal(same, covariance)
    strong = np.full((5, 5), 0.9) + 0.1 * np.eye(5)
    assert oracle_approximating_intensity(strong, 1000) < 0.01


def test_a_scale_has_the_depths_of_chi_squared() -> None:
    from scipy.stats import chi2

    scale = Scale(2.0, 7.0)
    levels = np.array([0.5, 3.0, 6.0, 12.0])
    np.testing.assert_allclose(scale.depth(levels), -chi2.logsf(levels**2 / 2, 7), rtol=1e-9)
    far = np.array([40.0, 60.0, 100.0])  # of eight degrees the distribution is a sum, of which no term underflows here
    x = far**2 / 4
    exact = x - np.log(1 + x + x**2 / 2 + x**3 / 6)
    np.testing.assert_allclose(Scale(2.0, 8.0).depth(far), exact, rtol=1e-4)
    assert float(scale.depth(scale.level(20.0))) == pytest.approx(20.0)
