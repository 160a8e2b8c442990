"""Steps and drifts in what was taken for fault-free."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from residua.decide.stationarity import changes, likeliest_change, transient_samples
from residua.decide.test import FaultFreeRun


def noise(seed: int, time: int, k: int, phi: float = 0.0) -> np.ndarray:
    rng = np.random.default_rng([seed, k, round(100 * phi)])
    return lfilter([np.sqrt(1 - phi**2)], [1, -phi], rng.standard_normal((time + 300, k)), axis=0)[300:]


def run_of(residuals: np.ndarray, seams: tuple[int, ...] = (), sizes: float = 1.0) -> FaultFreeRun:
    return FaultFreeRun(residuals, np.ones(len(residuals), dtype=bool), seams, np.full(residuals.shape[1], sizes))


def names(k: int) -> list[str]:
    return [f"r{i + 1}" for i in range(k)]


@pytest.mark.parametrize("time", [100, 300, 1000, 5000])
@pytest.mark.parametrize("phi", [0.0, 0.5, 0.9, 0.95])
def test_noise_that_stays_as_it_is_is_rarely_a_change(time: int, phi: float) -> None:
    """At 1 % asked for at most 2 % of 400; where under fifty correlation times fit into the data, 5 %."""
    columns = noise(1, time, 400, phi)
    few = time * (1 - phi) / (1 + phi) < 50
    assert sum(likeliest_change(columns[:, j], 0.01) is not None for j in range(400)) <= (20 if few else 8)


@pytest.mark.parametrize("k", [1, 5, 40])
@pytest.mark.parametrize("phi", [0.0, 0.8])
def test_no_change_is_reported_of_stationary_residuals(k: int, phi: float) -> None:
    rng = np.random.default_rng(k)
    reported = [
        changes(run_of(noise(seed, 400, k, phi) @ rng.standard_normal((k, k)) + 5), names(k)) for seed in range(12)
    ]
    assert sum(map(bool, reported)) <= 1


@pytest.mark.parametrize("exponent", [-20, 0, 20])
def test_a_step_is_found_by_name_and_place(exponent: int) -> None:
    residuals = noise(2, 1000, 4)
    residuals[600:, 2] += 2.0
    units = 2.0 ** (exponent * np.linspace(-1, 1, 4)).round()
    found = changes(run_of(residuals * units, sizes=float(units.max())), names(4))
    means = [one for one in found if one.residuals]
    assert [one.residuals for one in means] == [("r3",)]
    assert means[0].sample == pytest.approx(600, abs=20)
    assert means[0].size == pytest.approx(2.0, rel=0.2)
    assert "r3 changes its mean by up to" in means[0].sentence(False)


def test_a_drift_is_found() -> None:
    residuals = noise(3, 2000, 3, 0.5)
    residuals[:, 0] += np.linspace(0, 3, 2000)
    assert ("r1",) in [one.residuals for one in changes(run_of(residuals), names(3))]


def test_a_transient_at_the_start_is_found_and_counted() -> None:
    """Of ten residuals each moves by half a deviation or so; all together they are far from the rest."""
    residuals = noise(4, 600, 10, 0.3) @ np.random.default_rng(4).standard_normal((10, 10))
    residuals[:80] += 8 * np.random.default_rng(5).standard_normal(10)
    found = changes(run_of(residuals), names(10))
    assert transient_samples(found, 1) == pytest.approx(80, abs=15)
    assert "transient='auto'" in next(one for one in found if one.is_transient).sentence(False)


def test_recordings_are_looked_at_one_by_one() -> None:
    """Two flights of another mean each are no change; a step within the second is one, there."""
    residuals = noise(6, 1600, 2)
    residuals[800:] += 5
    assert changes(run_of(residuals, (800,)), names(2)) == ()
    residuals[1200:] += 3
    found = changes(run_of(residuals, (800,)), names(2))
    assert {one.recording for one in found} == {2}
    assert next(one for one in found if one.residuals).sample == pytest.approx(400, abs=20)


@pytest.mark.parametrize("residuals", [np.zeros((500, 2)), 1e-15 * noise(7, 500, 2), noise(8, 50, 2)])
def test_where_there_is_no_noise_or_too_little_of_it_nothing_is_said(residuals: np.ndarray) -> None:
    assert changes(run_of(residuals), names(2)) == ()
