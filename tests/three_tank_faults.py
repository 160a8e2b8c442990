"""The faults of the three-tank benchmark's recordings, and a monitor run over one of them."""

from __future__ import annotations

import numpy as np

import residua as rs

FAILED = {
    2: "Q1 actuator",
    3: "Q2 actuator",
    4: "h1 sensor",
    5: "h2 sensor",
    6: "h3 sensor",
    7: "leak 1",
    8: "leak 2",
    9: "leak 3",
    10: "clog 13",
    11: "clog 20",
    12: "clog 32",
}
START = 200  # sample at which every fault begins


def diagnosis(monitor: rs.Monitor, data: np.ndarray) -> rs.Diagnosis:
    found = monitor.run(data[:, :2], data[:, 2:])
    assert isinstance(found, rs.Diagnosis)
    return found
