"""Residuals that do not move in fault-free data: they are no direction of noise, whatever their mean is rounded to."""

from __future__ import annotations

import numpy as np
import pytest

import residua as rs
from residua.decide.fault_free import FaultFree


def beside(level: float, rows: int, seed: int) -> np.ndarray:
    """A residual with heavy tails beside one that stands still."""
    return np.column_stack([np.random.default_rng(seed).standard_t(3, rows), np.full(rows, level)])


@pytest.mark.parametrize("level", [0.0, 0.1, 1 / 3, -3.7e6])
@pytest.mark.parametrize("seams", [(), (400, 7000)])
def test_one_that_stands_still_is_no_direction(level: float, seams: tuple[int, ...]) -> None:
    rows = beside(level, 20_001, 0)
    data = FaultFree(rows, np.ones(len(rows), dtype=bool), 1, seams)
    assert data.moving == 1
    assert not data.deviations[:, 1].any()
    assert max(data.worth) < 2


@pytest.mark.parametrize("level", [0.1, 3.7])
def test_a_test_that_remembers_is_fitted_beside_one(level: float) -> None:
    """The scores of nothing were not numbers, and the fit failed."""
    generator = rs.identify.given_residuals(["a", "b"], dt=1.0)
    monitor = rs.Monitor(generator, test=rs.decide.CUSUM(mean_time_between_false_alarms=1000.0), isolate=None)
    monitor.fit(None, beside(level, 1500, 1))
    assert "1 of the 2 residuals are independent" in monitor.norm_test.basis
    quiet, faulty = beside(level, 300, 2), beside(level, 300, 3) + [2.0, 0.0]
    alarms = []
    for rows in (quiet, faulty):
        diagnosis = monitor.run(None, rows)
        assert isinstance(diagnosis, rs.Diagnosis)
        alarms.append(np.mean(diagnosis.alarm))
    assert alarms[0] < 0.1 < 0.9 < alarms[1]
