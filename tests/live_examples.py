"""A fitted monitor of three tanks and recordings of it, and runs without sources, for tests of live monitoring."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import residua as rs
from residua.library import simulate_three_tank
from residua.live.sampling import Rows, SamplingState
from residua.live.sqlite_store import SqliteStore
from residua.live.store import Retry
from residua.live.watch import Watch, Work
from residua.live.watched_model import WatchedModel

A = [[-0.015769, 0, 0.015769], [0, -0.022714, 0.015087], [0.015769, 0.015087, -0.030856]]
B = [[0.0064935, 0], [0, 0.0064935], [0, 0]]


def tank() -> rs.Plant:
    """Return three tanks with all faults, at one second."""
    plant = rs.Plant(A, B, np.eye(3), name="three tanks", inputs=["Q1", "Q2"], outputs=["h1", "h2", "h3"])
    plant = plant.with_operating_point(inputs=[21.4, 53.8], outputs=[41.0, 32.0, 36.6])
    plant = plant.with_actuator_faults().with_sensor_faults()
    plant = plant.with_faults({"leak 1": [-1, 0, 0], "leak 3": [0, 0, -1], "clog 32": [0, -1, 1]})
    return plant.discretize(1.0).with_noise(process=1e-4, measurement=0.02)


@cache
def monitor(kind: str = "direction") -> rs.Monitor:
    """Return a monitor that was fitted to fault-free data, with an isolation of some kind."""
    normal = simulate_three_tank(8_000)
    test: Any = rs.decide.NormThreshold(persistence=5, window=10)
    design, isolate = rs.design.kalman_filter(tank()), "auto"
    if kind == "no names":
        isolate = None
    elif kind == "matched":
        test, isolate = rs.decide.NormThreshold(persistence=5), rs.decide.Matched(window=60)
    elif kind == "likelihood":
        test, isolate = rs.decide.CUSUM(mean_time_between_false_alarms=5000), rs.decide.Likelihood()
    elif kind == "codes":
        design = rs.design.sensor_fault_bank(tank())
    made = rs.Monitor(design, test=test, isolate=isolate)
    return made.fit(normal.u, normal.y) if kind == "likelihood" else made.fit(normal.u, normal.y, false_alarm_rate=0.01)


def recording(samples: int, *, seed: int = 1) -> NDArray[np.float64]:
    """Return rows with a leak that comes and goes, values that are missing, and another leak at the end."""
    k = np.arange(samples)
    hole = 0.05 * ((k >= 600) & (k < 1200) | (k >= samples - 400))
    run = simulate_three_tank(samples, faults={"leak 3": hole}, seed=seed)
    rows = np.hstack([run.u, run.y])
    rows[1500:1550, 3] = np.nan
    rows[1700, 0] = np.nan
    return rows


def opened(path: Path, model: WatchedModel, plants: Sequence[str] = ()) -> Watch:
    """Return a watch on a store, that was or was not there."""
    store = SqliteStore(path)
    store.open()
    try:
        watch = Watch({model.name: model}, store, Retry(threading.Event()), 0.0)
    except Exception:
        store.close()
        raise
    store.commit(watch.add(plants, model.name, 0.0))
    return watch


def fed(watch: Watch, plants: Sequence[str], times: NDArray[np.float64], rows: NDArray[np.float64]) -> None:
    """Go on with the same rows of some plants, and commit."""
    for plant in plants:
        watch.plants[plant].sampling = SamplingState(last=float(times[-1]), grid=float(times[-1]))
    watch.store.commit(watch.take({plant: Work([Rows(times, rows)]) for plant in plants}))


def told(watch: Watch, plant: str) -> list[dict[str, Any]]:
    """Return all events of a plant as plain values, without its name."""
    return [one.to_dict() | {"plant": ""} for one in watch.store.events(0, 10_000, plant)]


def alarms_of(events: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return the alarms that events leave: those that ended, and those that stand."""
    whole = [one for one in events if (one["kind"] == "ended" and "part_of" not in one) or one["kind"] == "standing"]
    beside = ("plant", "number", "kind", "time", "clock", "name", "text", "sure", "plant_name")
    return [{key: value for key, value in one.items() if key not in beside} for one in whole]


def alarms_of_run(made: rs.Monitor, rows: NDArray[np.float64], times: NDArray[np.float64]) -> list[dict[str, Any]]:
    """Return the alarms of a recorded run as plain values."""
    inputs = len(made.generator.plant.inputs)
    diagnosis = made.run(rows[:, :inputs], rows[:, inputs:], time=times)
    assert isinstance(diagnosis, rs.monitor.Diagnosis)
    return [one.to_dict(window=diagnosis.naming.window) for one in diagnosis.alarms]
