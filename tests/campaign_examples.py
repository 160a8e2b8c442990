"""Plants and monitors that campaigns are run for."""

from __future__ import annotations

import residua as rs


def two_tanks() -> rs.Plant:
    """A sampled plant with two states, faults of every kind, a disturbance and noise."""
    plant = rs.Plant(
        [[0.9, 0.1], [0.0, 0.8]], [[0.0], [0.5]], [[1.0, 0.0], [0.0, 1.0]], dt=0.5, inputs=["valve"], outputs=["a", "b"]
    )
    plant = plant.with_sensor_faults().with_actuator_faults().with_faults({"leak": [-1.0, 0.5]})
    return plant.with_disturbances({"gust": [0.3, 0.1]}).with_noise(process=1e-4, measurement=1e-2)


def white_noise_monitor(**settings) -> rs.Monitor:
    """Two residuals that are independent from sample to sample, one for each sensor, alarms in one of a hundred."""
    plant = rs.Plant([[0.0]], [[1.0]], [[1.0], [0.0]], dt=1, outputs=["a", "b"])
    plant = plant.with_sensor_faults().with_noise(process=0.5, measurement=1.0)
    test = rs.decide.NormThreshold(**{"persistence": 1, "false_alarm_rate": 0.01, **settings})
    return rs.Monitor(rs.design.kalman_filter(plant), test=test)
