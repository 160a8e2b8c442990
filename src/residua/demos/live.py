"""Three plants running live: one is well, one has a leak, one has a silent sensor and one that is off."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from residua.design import kalman_filter
from residua.errors import DataError
from residua.library import simulate_three_tank, three_tank, three_tank_fault
from residua.monitor import Monitor
from residua.recording.table_writer import write_table

#: Samples of a second each; when the hole begins, values of one sensor are gone, and another is off.
STEPS, LEAK_AT, GONE, SENSOR_AT = 1800, 300.0, slice(500, 620), 900
#: Times as fast as it was recorded: the first fault is named within half a minute.
SPEED = 30
#: Centimetres that the sensor is off.
OFF = 2.0
_NORMAL = 40_000
INTRODUCTION = (
    "three tanks three times, thirty times as fast as they were: north is well, south has a leak in tank 3 that grows",
    "from 300 s on (10 s from now), in east the values of h2 are missing for two minutes, and h1 is off by 2 cm later",
)
_CONFIGURATION = f"""\
[[monitors]]
file = "tank.json"
name = "tanks"
plants = ["north", "south", "east"]

[[sources]]
kind = "replay"
files = {{ north = "north.csv", south = "south.csv", east = "east.csv" }}
speed = {SPEED}

[store]
kind = "sqlite"
file = "live.db"

[[sinks]]
kind = "jsonl"
path = "events.jsonl"

[server]
listen = "127.0.0.1:0"
"""


def write(folder: Path) -> Path:
    """Write monitor, recordings and configuration, and return the path of the configuration.

    Parameters
    ----------
    folder : Path
        Exists. What an earlier demo stored there is removed, so that it begins at the beginning.

    Raises
    ------
    DataError
        If the folder has anything else in it.
    """
    path = folder / "live.toml"
    mine = path.exists() and path.read_text(encoding="utf-8") == _CONFIGURATION
    if not mine and any(folder.iterdir()):
        raise DataError(f"{folder} has files in it that the demo might replace: name a new folder")
    plant = three_tank()
    monitor = Monitor(kalman_filter(plant))
    normal = simulate_three_tank(_NORMAL, seed=1)
    monitor.fit(normal.u, normal.y, time=normal.time)
    monitor.save(folder / "tank.json")
    names = [*plant.inputs, *plant.outputs]
    leak = three_tank_fault(9, STEPS, onset=LEAK_AT)
    for k, (name, faults) in enumerate({"north": {}, "south": leak, "east": {}}.items()):
        run = simulate_three_tank(STEPS, faults=faults, seed=10 + k)
        rows = np.hstack([run.u, run.y])
        if name == "east":
            _spoil(rows)
        write_table(folder / f"{name}.csv", {"time": run.time} | {n: rows[:, c] for c, n in enumerate(names)})
    for old in ("live.db", "live.db-wal", "live.db-shm", "live.db.lock", "events.jsonl"):
        (folder / old).unlink(missing_ok=True)
    path.write_text(_CONFIGURATION, encoding="utf-8")
    return path


def _spoil(rows: NDArray[np.float64]) -> None:
    """Remove the values of the second sensor for a while, and offset the first one from then on."""
    rows[GONE, -2] = np.nan
    rows[SENSOR_AT:, -3] += OFF
