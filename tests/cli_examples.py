"""A small plant with recordings, and what every failing command has in common."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

Residua = Callable[..., tuple[int, str, str]]

PLANT = """
format = "residua-plant/1"
name = "two tanks"
dt = 1.0

[matrices]
A = [[0.9, 0.05], [0.05, 0.8]]
B = [[0.1], [0.0]]
C = [[1.0, 0.0], [0.0, 1.0]]

[inputs]
names = ["pump"]
operating_point = [2.0]

[outputs]
names = ["level 1", "level 2"]
operating_point = [10.0, 5.0]

[noise]
process = 1e-4
measurement = 1e-3

[[faults]]
kind = "sensor"
output = "level 1"

[[faults]]
kind = "actuator"
input = "pump"

[[faults]]
name = "leak"
component = "tank 1"
state = [-0.3, 0.0]
"""
DISTURBED = """
[[disturbances]]
name = "inflow"
state = [0.0, 1.0]
"""


def simulate(steps: int, seed: int, *, sensor: float = 0.0, from_: int = 0) -> np.ndarray:
    """Columns time, pump, level 1, level 2 of the plant above, with an offset of the first sensor."""
    A, B = np.array([[0.9, 0.05], [0.05, 0.8]]), np.array([0.1, 0.0])
    rng = np.random.default_rng(seed)
    u = 0.5 * np.sign(np.sin(0.05 * np.arange(steps)))
    x, rows = np.zeros(2), []
    for k in range(steps):
        y = x + np.sqrt(1e-3) * rng.standard_normal(2)
        y[0] += sensor * (k >= from_)
        rows.append([k, u[k] + 2.0, y[0] + 10.0, y[1] + 5.0])
        x = A @ x + B * u[k] + np.sqrt(1e-4) * rng.standard_normal(2)
    return np.array(rows)


def write_csv(path: Path, rows: np.ndarray, header: str = "time,pump,level 1,level 2") -> Path:
    np.savetxt(path, rows, delimiter=",", header=header, comments="")
    return path


def assert_error(outcome: tuple[int, str, str], *parts: str) -> None:
    """One line on stderr, nothing on stdout, status 2."""
    status, out, err = outcome
    assert (status, out) == (2, "")
    assert err.startswith("error: ")
    assert err.count("\n") == 1
    for part in parts:
        assert part in err
