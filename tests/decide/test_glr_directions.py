"""The generalised likelihood ratio in the directions of faults: as designed, and sooner where residuals are many."""

import dataclasses

import numpy as np
import pytest

import residua as rs
from residua.decide.glr import _approximate_along, _compared_along, _Directions, _run_length_along, _worth
from residua.errors import FileFormatError, SettingError
from residua.testing import check_test


def plant(outputs: int = 6) -> rs.Plant:
    """Return a plant whose outputs are the same state, and of whose sensors the first two may fail."""
    made = rs.Plant([[0.9]], [[0.1]], np.ones((outputs, 1)), dt=1, inputs=["valve"])
    return made.with_sensor_faults(made.outputs[:2]).with_noise(process=1e-4, measurement=1e-2)


def directions(kind: str) -> np.ndarray:
    """Return unit vectors in columns: of their own, alike, and more of them than residuals."""
    rng = np.random.default_rng(3)
    made = {
        "one": np.eye(4)[:, :1],
        "orthogonal": np.eye(4)[:, :3],
        "alike": np.array([[1.0, 1.0, 0.0], [0.0, 0.1, 1.0]]),
        "many": rng.standard_normal((3, 12)),
    }[kind]
    return made / np.linalg.norm(made, axis=0)


def simulated(D: np.ndarray, window: int, threshold: float, runs: int) -> np.ndarray:
    """Return the samples of runs up to a threshold, by the definition."""
    rng = np.random.default_rng(5)
    kept = np.zeros((runs, window, len(D)))
    lengths, left, samples = np.zeros(runs), np.arange(runs), 0
    while len(left):
        samples += 1
        kept = np.concatenate([rng.standard_normal((len(left), 1, len(D))), kept[:, :-1]], axis=1)
        sums = np.cumsum(kept, axis=1) / np.sqrt(np.arange(1.0, window + 1))[:, None]
        over = (np.abs(sums @ D) > threshold).any(axis=(1, 2))
        lengths[left[over]] = samples
        left, kept = left[~over], kept[~over]
    return lengths


@pytest.mark.parametrize("kind", ["one", "orthogonal", "alike", "many"])
def test_run_lengths_are_as_designed(kind: str) -> None:
    D = directions(kind)
    along = _Directions(np.ascontiguousarray(D))
    threshold = next(h for h in np.arange(2.5, 6, 0.01) if _run_length_along(h, along, 10) > 500)
    lengths = simulated(D, 10, threshold, 1200)
    assert lengths.mean() == pytest.approx(_run_length_along(threshold, along, 10), rel=0.1)  # 5 % and chance


def test_what_directions_are_worth() -> None:
    assert _worth(4.0, _Directions(np.eye(3))) == pytest.approx(3.0, abs=0.01)
    assert _worth(4.0, _Directions(np.ones((1, 5)))) == pytest.approx(1.0, abs=1e-12)
    assert 1.5 < _worth(4.0, _Directions(directions("alike"))) < 3.0
    made = _compared_along(_Directions(np.eye(2)), 10)
    assert _approximate_along(made.level, _Directions(np.eye(2)), 10) == pytest.approx(300.0, rel=1e-6)
    assert 0.8 < made.ratio < 1.3


def test_a_fault_is_seen_sooner_than_by_the_norm_and_another_change_is_not() -> None:
    flt = rs.design.kalman_filter(plant())
    every, along = (
        rs.Monitor(flt, test=rs.decide.GLR(window=12, mean_time_between_false_alarms=1e4, directions=which))
        for which in (None, "faults")
    )
    assert along.threshold < every.threshold - 0.5
    one, other = (rs.decide.detectability(watch, within=15, runs=200, faults="y1 sensor") for watch in (every, along))
    assert other.smallest[0].size.high < one.smallest[0].size.low
    rng = np.random.default_rng(0)
    u, y = np.zeros((300, 1)), 0.1 * rng.standard_normal((300, 6))
    y[150:, 5] += 0.1  # a sensor that nobody said may fail
    assert every.run(u, y).statistic[-1] > along.run(u, y).statistic[-1]


def test_false_alarms_of_a_fit_come_as_designed() -> None:
    rng = np.random.default_rng(2)
    test = rs.decide.GLR(window=10, mean_time_between_false_alarms=500, directions="faults")
    watch = rs.Monitor(rs.design.kalman_filter(plant()), test=test)
    x = np.zeros(40_000)
    drawn = 0.01 * rng.standard_normal(40_000)
    for k in range(1, len(x)):
        x[k] = 0.9 * x[k - 1] + drawn[k]
    y = x[:, None] + 0.1 * rng.standard_normal((40_000, 6))
    watch.fit(np.zeros((20_000, 1)), y[:20_000])
    alarms = watch.run(np.zeros((20_000, 1)), y[20_000:]).alarms
    assert len(alarms) == pytest.approx(20_000 / 505, abs=4 * 6.3)  # four deviations of their number


def test_the_contract_of_a_test() -> None:
    check_test(rs.decide.GLR(window=6, false_alarm_rate=0.01, directions="faults"))


def test_files(tmp_path: object) -> None:
    test = rs.decide.GLR(window=6, directions="faults")
    watch = rs.Monitor(rs.design.kalman_filter(plant()), test=test)
    path = f"{tmp_path}/watch.json"
    watch.save(path)
    loaded = rs.Monitor.load(path)
    assert loaded.test == test
    y = 0.1 * np.random.default_rng(0).standard_normal((50, 6))
    first, second = watch.run(np.zeros((50, 1)), y), loaded.run(np.zeros((50, 1)), y)
    assert np.array_equal(first.statistic, second.statistic, equal_nan=True)
    wrong = dataclasses.replace(loaded.norm_test, directions=np.ones((6, 2)))
    with pytest.raises(FileFormatError, match="unit vectors"):
        wrong.check(loaded._watched(loaded.generator))


@pytest.mark.parametrize("power", [-20, 20])
def test_units_change_nothing(power: int) -> None:
    scale = np.array([2.0**power, 1, 1, 1, 2.0**-power, 1])
    made = rs.Plant([[0.9]], [[0.1]], scale[:, None], dt=1, inputs=["valve"])
    made = made.with_sensor_faults(made.outputs[:2]).with_noise(process=1e-4, measurement=np.diag(1e-2 * scale**2))
    test = rs.decide.GLR(window=6, directions="faults")
    watch, other = (rs.Monitor(rs.design.kalman_filter(one), test=test) for one in (plant(), made))
    y = 0.1 * np.random.default_rng(0).standard_normal((50, 6))
    first, second = watch.run(np.zeros((50, 1)), y), other.run(np.zeros((50, 1)), y * scale)
    assert first.statistic == pytest.approx(second.statistic, rel=1e-6, nan_ok=True)
    # from simulated runs, along axes that noise alike in some directions leaves open
    assert watch.threshold == pytest.approx(other.threshold, rel=1e-3)


def test_settings_that_cannot_be() -> None:
    with pytest.raises(SettingError, match="directions must be"):
        rs.decide.GLR(directions="all")
    integrator = rs.Plant([[1.0]], [[1.0]], [[1.0]], dt=1).with_sensor_faults().with_noise(process=1.0, measurement=1.0)
    with pytest.raises(SettingError, match="no residual answers to a constant fault"):
        rs.Monitor(rs.design.kalman_filter(integrator), test=rs.decide.GLR(directions="faults"))
