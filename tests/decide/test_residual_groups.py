"""Groups of residuals tested one by one: a channel that one norm hides, the share of the rate, running, saving."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import residua as rs
from residua.decide import NormThreshold
from residua.decide.member_thresholds import GroupTest, rows_of_groups
from residua.decide.whitened_norm import NormTest
from residua.errors import FileFormatError, SettingError
from residua.monitor import Alarm

K = 52


def many_sensors(k: int = K) -> rs.Plant:
    """One state and many sensors of it, each of which may fail."""
    plant = rs.Plant([[0.9]], [[0.1]], np.linspace(0.5, 1.5, k)[:, None], dt=1.0)
    return plant.with_sensor_faults().with_noise(process=1e-4, measurement=1e-2)


def recording(plant: rs.Plant, samples: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    u = rng.standard_normal((samples, 1))
    x, y = np.zeros(1), np.empty((samples, plant.n_outputs))
    for t in range(samples):
        y[t] = plant.C @ x + 0.1 * rng.standard_normal(plant.n_outputs)
        x = plant.A @ x + plant.B @ u[t] + 0.01 * rng.standard_normal(1)
    return u, y


def monitor_of(groups: object, k: int = K, **options: object) -> rs.Monitor:
    plant = many_sensors(k)
    test = NormThreshold(persistence=1, false_alarm_rate=1e-3, groups=groups, **options)  # pyright: ignore
    return rs.Monitor(rs.design.kalman_filter(plant), test=test)


@pytest.fixture(scope="module")
def fitted() -> rs.Monitor:
    monitor = monitor_of("each")
    return monitor.fit(*recording(many_sensors(), 4000, seed=1))


def test_one_channel_is_not_hidden_by_the_others(fitted: rs.Monitor) -> None:
    """A jump of 7 standard deviations in one of 52: the norm of all lies at 9.7, sqrt(52 + 49) = 10.05 on average."""
    u, y = recording(many_sensors(), 400, seed=2)
    y[200:, 17] += 0.7
    together = monitor_of(None).fit(*recording(many_sensors(), 4000, seed=1))
    found, hidden = fitted.run(u, y), together.run(u, y)
    assert found.alarm[205:].mean() > 0.95
    assert hidden.alarm[205:].mean() < 0.8 * found.alarm[205:].mean()
    alarm = found.main_alarm
    assert isinstance(alarm, Alarm)
    name = fitted.generator.residuals[17]
    assert alarm.fired[0] == name
    assert alarm.candidates[0].faults == (many_sensors().faults[17],)
    assert name in str(found)
    assert alarm.to_dict()["fired"][0] == name
    assert found.members == fitted.generator.residuals
    assert f"statistic {name}" in found.columns()


def test_all_together_keep_the_rate(fitted: rs.Monitor) -> None:
    found = fitted.run(*recording(many_sensors(), 20_000, seed=3))
    test = fitted.norm_test
    assert isinstance(test, GroupTest)
    assert test.promised is not None
    assert 0.2e-3 <= found.false_alarm_fraction <= max(1.5e-3, test.promised)
    assert "52 groups" in test.basis


def test_the_noise_model_gives_each_its_share() -> None:
    monitor = monitor_of("each")
    test = monitor.norm_test
    assert isinstance(test, GroupTest)
    np.testing.assert_allclose(test.thresholds, np.sqrt(rs_chi2(1e-3 / K)), rtol=1e-6)
    found = monitor.run(*recording(many_sensors(), 20_000, seed=4))
    assert 0.2e-3 <= found.false_alarm_fraction <= 1.5e-3


def rs_chi2(rate: float) -> float:
    from scipy.stats import chi2

    return float(chi2.isf(rate, 1))


def test_one_group_of_all_is_the_norm_of_all() -> None:
    data = recording(many_sensors(4), 3000, seed=5)
    names = monitor_of(None, 4).generator.residuals
    one = monitor_of({"all": names}, 4, window=5).fit(*data)
    whole = monitor_of(None, 4, window=5).fit(*data)
    fresh = recording(many_sensors(4), 3000, seed=6)
    a, b = one.run(*fresh), whole.run(*fresh)
    np.testing.assert_allclose(a.parts.statistics[:, 0], b.statistic, rtol=1e-9)
    np.testing.assert_array_equal(a.alarm, b.alarm)
    np.testing.assert_allclose(a.scores, b.scores, rtol=1e-9)
    assert isinstance(whole.norm_test, NormTest)
    assert one.norm_test.thresholds[0] == whole.threshold  # pyright: ignore


@pytest.mark.parametrize("window", [1, 7])
def test_step_equals_run_and_a_saved_monitor_goes_on(window: int, tmp_path: Path) -> None:
    generator = monitor_of(None, 6).generator
    groups = [generator.residuals[:2], generator.residuals[2:5], generator.residuals[5:]]
    monitor = monitor_of(groups, 6, window=window).fit(*recording(many_sensors(6), 2000, seed=7))
    u, y = recording(many_sensors(6), 300, seed=8)
    y[100:180, 3] += 0.5
    y[50, 1] = np.nan
    whole = monitor.run(u, y)
    monitor.reset()
    first = monitor.update(u[:120], y[:120])
    monitor.save(tmp_path / "m.json")
    again = rs.Monitor.load(tmp_path / "m.json")
    assert again.test == monitor.test
    rest = [again.step(u[t], y[t]) for t in range(120, 300)]
    assert np.array_equal(first.statistic[0], whole.statistic[:120], equal_nan=True)
    assert np.array_equal([d.statistic for d in rest], whole.statistic[120:], equal_nan=True)
    assert [d.alarm for d in rest] == whole.alarm[120:].tolist()
    names = tuple(again.norm_test.names)  # pyright: ignore
    assert [d.fired for d in rest] == [tuple(np.array(names)[row]) for row in whole.parts.fired[120:]]
    assert names[1] == ", ".join(groups[1])


def test_it_is_drawn_and_told(fitted: rs.Monitor, tmp_path: Path) -> None:
    u, y = recording(many_sensors(), 400, seed=2)
    y[200:, 17] += 0.7
    found = fitted.run(u, y)
    page = found.to_html(tmp_path / "page.html").read_text(encoding="utf-8")
    assert "Over their thresholds" in page
    assert fitted.generator.residuals[17] in page
    assert "group of residuals" in found.settings["test"]


@pytest.mark.parametrize(
    ("groups", "match"),
    [
        ("all", "groups must be"),
        ({}, "got none"),
        ({"a": "r1"}, "for one group"),
        ([["a"], ["a"]], "two groups are called"),
        (3, "groups must be"),
    ],
)
def test_what_are_no_groups_is_refused(groups: object, match: str) -> None:
    with pytest.raises(SettingError, match=match):
        NormThreshold(groups=groups)  # pyright: ignore


def test_every_residual_is_in_one_group() -> None:
    assert rows_of_groups("each", ["a", "b"]) == {"a": (0,), "b": (1,)}
    wrong = NormThreshold(groups={"x": ["a", "c"], "y": ["a"]}).groups
    with pytest.raises(SettingError, match=r"unknown: 'c'; in two groups: 'a'; in none: 'b'"):
        rows_of_groups(wrong, ["a", "b"])
    with pytest.raises(SettingError, match="unknown: 'nobody'"):
        monitor_of([["nobody"]], 3)


def test_a_bank_has_its_members() -> None:
    plant = many_sensors(3)
    with pytest.raises(SettingError, match="members are tested one by one"):
        rs.Monitor(rs.design.sensor_fault_bank(plant), test=NormThreshold(groups="each"))
    with pytest.raises(SettingError, match="matched"):
        rs.Monitor(rs.design.matched_filters(plant), test=NormThreshold(groups="each"))


def test_a_file_with_other_groups_is_refused(tmp_path: Path) -> None:
    monitor = monitor_of("each", 3)
    monitor.save(tmp_path / "m.json")
    content = json.loads((tmp_path / "m.json").read_text(encoding="utf-8"))
    content["fitted"]["names"][0] = "nobody"
    (tmp_path / "m.json").write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(FileFormatError, match="names must be those of the groups"):
        rs.Monitor.load(tmp_path / "m.json")
