"""Monitors that campaigns are run for."""

from __future__ import annotations

import pytest

import residua as rs
from campaign_examples import two_tanks, white_noise_monitor


@pytest.fixture(scope="session")
def plant() -> rs.Plant:
    return two_tanks()


@pytest.fixture(scope="session")
def monitor() -> rs.Monitor:
    return rs.Monitor(
        rs.design.kalman_filter(two_tanks()), test=rs.decide.NormThreshold(persistence=2, false_alarm_rate=0.01)
    )


@pytest.fixture(scope="session")
def white_monitor() -> rs.Monitor:
    return white_noise_monitor()
