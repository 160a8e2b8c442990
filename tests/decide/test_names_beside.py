"""Names by responses beside any test: the same bits however time is cut, and the right fault."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import residua as rs
from residua.decide import CUSUM, EWMA, GLR, Matched, MultiscaleEWMA
from residua.errors import SettingError
from residua.library import simulate_three_tank


def tank() -> rs.Plant:
    A = [[-0.015769, 0, 0.015769], [0, -0.022714, 0.015087], [0.015769, 0.015087, -0.030856]]
    plant = rs.Plant(A, [[0.0064935, 0], [0, 0.0064935], [0, 0]], np.eye(3), inputs=["Q1", "Q2"])
    plant = plant.with_operating_point(inputs=[21.4, 53.8], outputs=[41.0, 32.0, 36.6]).with_sensor_faults()
    plant = plant.with_faults({"leak 1": [-1, 0, 0], "leak 3": [0, 0, -1], "clog 32": [0, -1, 1]})
    return plant.discretize(1.0).with_noise(process=1e-4, measurement=0.02)


def monitor(test: rs.decide.TestSettings) -> rs.Monitor:
    normal = simulate_three_tank(4000, seed=5)
    watch = rs.Monitor(rs.design.kalman_filter(tank()), test=test, isolate=Matched(window=40))
    return watch.fit(normal.u, normal.y, false_alarm_rate=1e-3)


def faulty(name: str) -> tuple[np.ndarray, np.ndarray]:
    start = np.arange(700) >= 300
    if name.endswith("sensor"):
        found = simulate_three_tank(700, seed=1)
        y = found.y.copy()
        y[:, int(name[1]) - 1] += 1.0 * start
        return found.u, y
    found = simulate_three_tank(700, faults={name: 0.1 * start}, seed=1)
    return found.u, found.y


@pytest.mark.parametrize("test", [CUSUM(), EWMA(), GLR(), MultiscaleEWMA()], ids=lambda one: type(one).__name__)
@pytest.mark.parametrize("name", ["leak 3", "y2 sensor", "y3 sensor"])
def test_any_test_has_names_by_responses(test: rs.decide.TestSettings, name: str) -> None:
    found = monitor(test).run(*faulty(name))
    assert found.main_alarm is not None
    assert name in found.main_alarm.candidates[0].faults
    assert found.main_alarm.candidates[0].score > 0.7


def test_the_same_bits_however_time_is_cut_and_after_a_file(tmp_path: Path) -> None:
    watch = monitor(MultiscaleEWMA())
    u, y = faulty("leak 3")
    y[350:353, 1] = np.nan
    whole = watch.run(u, y)
    watch.reset()
    parts = [watch.update(u[a : a + 97], y[a : a + 97]) for a in range(0, 400, 97)]
    watch.save(tmp_path / "m.json")
    again = rs.Monitor.load(tmp_path / "m.json")
    parts.append(again.update(u[485:], y[485:]))
    assert np.array_equal(np.concatenate([one.scores for one in parts], axis=1)[0], whole.scores, equal_nan=True)
    again.reset()
    steps = [again.step(a, b) for a, b in zip(u, y, strict=True)]
    named = [one.candidates[0].faults for one in steps if one.alarm and one.candidates]
    assert named[-1] == whole.main_alarm.candidates[0].faults  # type: ignore[union-attr]
    fleet = rs.Fleet(again, plants=[1, 2])
    rows = np.array([u, u]), np.array([y, y])
    assert np.array_equal(fleet.run(*rows).scores[0], whole.scores, equal_nan=True)


def test_residuals_that_are_not_white_are_refused() -> None:
    design = rs.design.luenberger_observer(tank()).residual_generator()
    with pytest.raises(SettingError, match="white"):
        rs.Monitor(design, test=CUSUM(), isolate=Matched())
