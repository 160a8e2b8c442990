"""The three-tank benchmark's recordings: no false alarms, every fault detected, the right component named."""

from __future__ import annotations

import numpy as np
import pytest

import residua as rs
from three_tank_faults import FAILED, START, diagnosis


@pytest.fixture(scope="module")
def monitor(recordings: dict[str, np.ndarray]) -> rs.Monitor:
    normal = recordings["normal"]
    made = rs.Monitor(rs.design.kalman_filter(rs.library.three_tank()), isolate=rs.decide.Directional(window=300))
    return made.fit(normal[:8004, :2], normal[:8004, 2:], false_alarm_rate=0.005)


def test_at_most_one_percent_false_alarms(monitor: rs.Monitor, recordings: dict[str, np.ndarray]) -> None:
    assert diagnosis(monitor, recordings["normal"][8004:]).false_alarm_fraction <= 0.01


@pytest.mark.parametrize("number", FAILED)
def test_every_fault_is_detected(monitor: rs.Monitor, recordings: dict[str, np.ndarray], number: int) -> None:
    found = diagnosis(monitor, recordings[f"fault{number:02d}"])
    assert found.alarm[-300:].all()
    assert found.main_alarm is not None
    assert START <= found.main_alarm.onset < 1200


def test_the_failed_component_is_named_in_ten_of_eleven(monitor: rs.Monitor, recordings: dict[str, np.ndarray]) -> None:
    named = []
    for number, fault in FAILED.items():
        found = diagnosis(monitor, recordings[f"fault{number:02d}"])
        best = found.groups[int(np.argmax(found.scores[-1]))]
        if fault in best:
            named.append(number)
    assert len(named) >= 10
    assert set(FAILED) - set(named) <= {12}, "fault 12 is the close call: a clogged pipe against the level sensor"


@pytest.fixture(scope="module")
def sensor_bank(recordings: dict[str, np.ndarray]) -> rs.Monitor:
    bank = rs.design.sensor_fault_bank(rs.library.three_tank(), observer="minimal")
    made = rs.Monitor(bank, test=rs.decide.NormThreshold(window=30, persistence=10))
    normal = recordings["normal"]
    return made.fit(normal[:8004, :2], normal[:8004, 2:], false_alarm_rate=0.005)


def test_the_sensor_bank_alarms_as_often_as_asked(sensor_bank: rs.Monitor, recordings: dict[str, np.ndarray]) -> None:
    assert diagnosis(sensor_bank, recordings["normal"][8004:]).false_alarm_fraction <= 0.01


@pytest.mark.parametrize("number", FAILED)
def test_the_sensor_bank_knows_sensors_from_the_rest(
    sensor_bank: rs.Monitor, recordings: dict[str, np.ndarray], number: int
) -> None:
    """Every sensor alone; everything else as none of them; h1 and the clog that looks like it when constant as both."""
    alarm = diagnosis(sensor_bank, recordings[f"fault{number:02d}"]).main_alarm
    assert alarm is not None
    assert START <= alarm.onset < 450
    named = alarm.candidates[0].faults
    name = FAILED[number]
    if name in ("h1 sensor", "clog 13"):
        assert named == ("h1 sensor", "clog 13")
    elif name.endswith("sensor"):
        assert named == (name,)
    else:
        assert name in named
        assert not any(other.endswith("sensor") for other in named)
