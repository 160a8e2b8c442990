"""The bank of means: what it guarantees of false alarms, of faults, of bits, and of what it takes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter

import residua as rs
from residua.decide import Block, FaultFreeRun, MultiscaleEWMA, Watched
from residua.errors import FileFormatError, SettingError


def generator(k: int) -> rs.ResidualGenerator:
    return rs.identify.given_residuals([f"r{j}" for j in range(k)])


def fitted(r: NDArray, rate: float = 1e-3, seams: tuple[int, ...] = (), **settings: object) -> object:
    run = FaultFreeRun(r, ~np.isnan(r).any(axis=1), seams, np.ones(r.shape[1]))
    return MultiscaleEWMA(**settings).fitted(Watched(generator(r.shape[1])), run, rate)  # pyright: ignore


def alarms(test: object, r: NDArray) -> NDArray[np.bool_]:
    block = Block(r[None], ~np.isnan(r).any(axis=1)[None])
    return test.run(test.start(1), block)[1].alarm[0]  # pyright: ignore


def coloured(rng: np.random.Generator, rows: int, pole: float, k: int = 2) -> NDArray:
    e = rng.standard_normal((rows + 1000, k))
    return lfilter([np.sqrt(1 - pole**2)], [1, -pole], e, axis=0)[1000:]


def test_the_statistic_is_that_of_its_formula() -> None:
    """Written out again, sample by sample, with SciPy's quantiles in place of Wilson and Hilferty's scores."""
    rng = np.random.default_rng(0)
    r = rng.standard_normal((3000, 2)) @ rng.standard_normal((2, 2)) + 3.0
    test = fitted(r[:2000])
    r[2500:2520] += 30.0
    found = test.run(test.start(1), Block(r[None], np.ones((1, len(r)), bool)))[1]  # pyright: ignore
    means, standing = np.zeros((2, 2)), False
    for t, one in enumerate(r):
        e = (one - test.center) @ test.whitening  # pyright: ignore
        lengths = [np.linalg.norm(e @ test.scaling[0])]  # pyright: ignore
        clipped = e * min(1.0, test.clips[0] / np.linalg.norm(e))  # pyright: ignore
        for j, weight in enumerate((1 / 8, 1 / 64)):
            means[j] = (1 - weight) * means[j] + weight * clipped
            length = np.linalg.norm(means[j] @ test.scaling[j + 1])  # pyright: ignore
            means[j] *= min(1.0, test.fulls[0] / length)  # pyright: ignore
            lengths.append(min(length, test.fulls[0]))  # pyright: ignore
        assert found.statistic[0, t] == pytest.approx(max(lengths), rel=1e-12)
        standing = max(lengths) > test.threshold or (standing and max(lengths) > test.release)  # pyright: ignore
        assert found.alarm[0, t] == standing
    assert found.alarm[0, 2500:2520].all()
    assert not found.alarm[0, 2520 + 250 :].any()  # the alarm ends, however large the fault was


@pytest.mark.parametrize(("pole", "rows"), [(0.0, 1000), (0.0, 5000), (0.5, 5000), (0.9, 5000)])
def test_false_alarms_are_as_rare_as_asked(pole: float, rows: int) -> None:
    """The mean over fits on 20,000 new rows each; the whole table is that of ``benchmarks/default_test_rates.py``."""
    rates = []
    for seed in range(6):
        rng = np.random.default_rng([seed, rows])
        r = coloured(rng, rows + 20_000, pole)
        rates.append(alarms(fitted(r[:rows], 5e-3), r[rows:]).mean())
    assert 0.1 * 5e-3 < np.mean(rates) < 2 * 5e-3


def test_heavy_tails_of_mixed_residuals_keep_the_rate() -> None:
    rng = np.random.default_rng(3)
    r = rng.standard_t(4, (45_000, 3)) @ rng.standard_normal((3, 3))
    assert alarms(fitted(r[:5000]), r[5000:]).mean() < 2.5e-3


def test_noise_that_grows_and_shrinks_raises_the_threshold() -> None:
    rng = np.random.default_rng(2)
    size = np.exp(0.5 * coloured(rng, 60_000, 0.99, 1))
    r = rng.standard_normal((60_000, 2)) * size
    test = fitted(r[:20_000])
    assert "that the noise model" in test.basis  # pyright: ignore
    assert alarms(test, r[20_000:]).mean() < 4e-3
    assert "beyond" not in fitted(rng.standard_normal((20_000, 2))).basis  # pyright: ignore


@pytest.mark.parametrize("size", [0.5, 1.0, 5.0, 10.0])
def test_lasting_faults_are_seen_and_spikes_too(size: float) -> None:
    rng = np.random.default_rng(1)
    r = rng.standard_normal((24_000, 2))
    test = fitted(r[:20_000])
    r[21_000:22_500, 0] += size
    alarm = alarms(test, r[20_000:])
    assert alarm[1000:2500].mean() > {0.5: 0.7, 1.0: 0.95}.get(size, 0.99)
    assert not alarm[2500 + 400 :].any()
    spiked = rng.standard_normal((300, 2))
    spiked[200] += 8.0
    assert alarms(test, spiked)[200]


def test_few_rows_are_fitted_and_missing_ones_left_out() -> None:
    rng = np.random.default_rng(4)
    r = rng.standard_normal((60, 3))
    assert not alarms(fitted(r), rng.standard_normal((200, 3))).mean() > 0.05
    r = rng.standard_normal((4000, 2))
    r[rng.random(4000) < 0.3] = np.nan
    r[1000:1300] = np.nan
    test = fitted(r, seams=(2000,))
    assert alarms(test, rng.standard_normal((50_000, 2))).mean() < 3e-3


def test_units_do_not_matter() -> None:
    rng = np.random.default_rng(5)
    r = rng.standard_normal((2000, 3)) @ rng.standard_normal((3, 3))
    one, other = fitted(r), fitted(r * np.array([1e-6, 7.0, 1e8]))
    assert other.threshold == pytest.approx(one.threshold, rel=1e-6)  # pyright: ignore
    new = rng.standard_normal((500, 3))
    run = [t.run(t.start(1), Block(x[None], np.ones((1, 500), bool)))[1].statistic for t, x in  # pyright: ignore
           ((one, new), (other, new * np.array([1e-6, 7.0, 1e8])))]  # fmt: skip
    assert np.allclose(*run, rtol=1e-6)


def test_residuals_without_noise_have_a_threshold_at_rounding() -> None:
    test = fitted(np.zeros((500, 2)))
    assert "rounding" in test.basis  # pyright: ignore
    new = np.zeros((100, 2))
    new[50:] += 1e-9
    alarm = alarms(test, new)
    assert alarm[50:].all()
    assert not alarm[:50].any()


def test_members_of_a_bank_are_tested_by_themselves_under_one_threshold() -> None:
    """Two members that share a residual: the rate is that of both together, and a fault fires its own."""
    rng = np.random.default_rng(6)
    r = rng.standard_normal((45_000, 3)) @ rng.standard_normal((3, 3))
    watched = Watched(generator(3), {"a": (0, 1), "b": (1, 2)})
    run = FaultFreeRun(r[:5000], np.ones(5000, bool), (), np.ones(3))
    test = MultiscaleEWMA().fitted(watched, run, 2e-3)
    assert alarms(test, r[5000:]).mean() < 4e-3
    new = r[5000:6000].copy()
    new[500:, 0] += 5 * r[:, 0].std()
    found = test.run(test.start(1), Block(new[None], np.ones((1, 1000), bool)))[1]
    assert found.fired[0, 600:, 0].all()
    assert not found.fired[0, 600:, 1].any()


def test_the_noise_model_alone_gives_a_test() -> None:
    plant = rs.Plant([[0.9, 0.1], [0, 0.7]], [[0.0], [1.0]], np.eye(2), dt=1).with_sensor_faults()
    plant = plant.with_noise(process=1e-2, measurement=1e-1)
    test = rs.Monitor(rs.design.kalman_filter(plant), test=MultiscaleEWMA(false_alarm_rate=0.01)).norm_test
    rng = np.random.default_rng(0)
    covariance = rs.design.kalman_filter(plant).covariance
    r = rng.multivariate_normal(np.zeros(2), covariance, 300_000)  # pyright: ignore
    assert alarms(test, r).mean() == pytest.approx(0.01, rel=0.2)


@pytest.mark.parametrize("weights", [(), (0.5,), (1, 1), (1, 0.1, 0.2), (1, 0), "no", (1, float("nan"))])
def test_weights_fall_from_one(weights: object) -> None:
    with pytest.raises(SettingError, match="weights"):
        MultiscaleEWMA(weights=weights)  # pyright: ignore


def test_other_settings_are_checked() -> None:
    with pytest.raises(SettingError, match="treatment"):
        MultiscaleEWMA(treatment="some")
    with pytest.raises(SettingError, match="false_alarm_rate"):
        MultiscaleEWMA(false_alarm_rate=2.0)


@pytest.mark.parametrize(
    "wrong",
    [
        {"sizes": np.array([1])},
        {"weights": np.array([1.0, 0.5, 0.7])},
        {"clips": np.ones(2)},
        {"releases": np.array([99.0])},
        {"scaling": np.zeros((2, 2, 2))},
    ],
)
def test_a_file_that_does_not_fit_is_refused(wrong: dict) -> None:
    rng = np.random.default_rng(0)
    test = fitted(rng.standard_normal((500, 2)))
    with pytest.raises(FileFormatError, match="fitted"):
        replace(test, **wrong).check(Watched(generator(2)))  # pyright: ignore


def test_it_is_what_a_monitor_takes_without_an_option(tmp_path: object) -> None:
    plant = rs.Plant([[0.9]], [[0.1]], [[1.0]], dt=1).with_sensor_faults().with_noise(process=1e-4, measurement=1e-2)
    monitor = rs.Monitor(rs.design.kalman_filter(plant))
    assert monitor.test == MultiscaleEWMA()
    rng = np.random.default_rng(0)
    u, y = np.zeros((3000, 1)), 0.1 * rng.standard_normal((3000, 1))
    monitor.fit(u, y)
    path = tmp_path / "m.json"  # pyright: ignore
    monitor.save(path)
    again = rs.Monitor.load(path)
    y[1000:1400] += 0.2
    assert np.array_equal(again.run(u, y).statistic, monitor.run(u, y).statistic, equal_nan=True)
    assert monitor.run(u, y).alarms


def test_a_recording_of_which_nothing_can_be_judged_is_passed_over() -> None:
    rng = np.random.default_rng(7)
    r = coloured(rng, 1200, 0.8)
    r[600:] = np.nan
    assert fitted(r, seams=(600, 900)).threshold > 3  # pyright: ignore


def test_a_wander_slower_than_the_fit_is_noticed() -> None:
    """Half a deviation over 2,000 samples, after a fit to 1,000: at the fit, or at the first run."""
    noticed = []
    for seed in range(6):
        rng = np.random.default_rng([seed, 1000])
        wander = coloured(rng, 29_000, 0.9995)[8000:]
        r = rng.standard_normal((21_000, 2)) + 0.5 * wander
        monitor = rs.Monitor(generator(2), isolate=None, dt=1.0).fit(None, r[:1000], false_alarm_rate=1e-3, force=True)
        assert monitor.fit_check is not None
        found = monitor.run(None, r[1000:])
        noticed.append(
            bool(monitor.fit_check.notes) or any("slower than the recordings" in note for note in found.notes)
        )
    assert sum(noticed) >= 5
