"""How fast monitors and fleets run, in units of copying the signals: the table of the page on speed.

Every figure is the median of interleaved rounds in this one run. A plant with 4 states, 5 inputs and 3 outputs has 64
bytes a sample; "copies" are times the cost of copying them. CPU time of the thread is taken, and wall time where
several threads run.

    python benchmarks/fused_speed.py [--rounds 7] [--out docs/data/speed.csv]
"""

from __future__ import annotations

import argparse
import csv
import os
import platform
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

import numpy as np

import residua as rs
from residua.linear.systems import recursion
from residua.monitor import fused
from residua.monitor.fused import OUTPUTS, FusedRun, plan_of
from residua.monitor.plant_records import bytes_of_record, copied
from residua.monitor.running import State, initial_state

SAMPLES, PLANTS = 1_000_000, 1_000_000


def plant() -> rs.Plant:
    rng = np.random.default_rng(0)
    A = np.diag([0.9, 0.8, 0.7, 0.6])
    A[0, 1] = 0.1
    made = rs.Plant(A, 0.1 * rng.standard_normal((4, 5)), rng.standard_normal((3, 4)), dt=1)
    made = made.with_sensor_faults().with_actuator_faults(["u1", "u2"])
    return made.with_noise(process=1e-2, measurement=1e-1)


def recorded(made: rs.Plant, samples: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    u, noise = rng.standard_normal((samples, 5)), rng.standard_normal((samples, len(made.noises)))
    return u, made.system(("control", "noise")).simulate(np.hstack([u, noise]))


def cost(call: Callable[[], object], clock: Callable[[], float]) -> float:
    start = clock()
    call()
    return clock() - start


class Rounds:
    """Calls that take turns, so that whatever else the machine does hits all alike."""

    def __init__(self, rounds: int) -> None:
        self.rounds = rounds

    def medians(self, calls: dict[str, Callable[[], object]], *, wall: bool = False) -> dict[str, float]:
        """Return the median cost of each call, in seconds of this thread or by the wall clock."""
        clock = time.perf_counter if wall else time.thread_time
        for call in calls.values():
            call()
        costs: dict[str, list[float]] = {name: [] for name in calls}
        for _ in range(self.rounds):
            for name, call in calls.items():
                costs[name].append(cost(call, clock))
        return {name: median(values) for name, values in costs.items()}


def one_series(rounds: Rounds) -> list[tuple[str, str, float, str]]:
    made = plant()
    generator = rs.design.kalman_filter(made)
    u, y = recorded(made, SAMPLES)
    source = np.hstack([u, y])
    target, data = np.empty_like(source), np.hstack([u, y])[None]
    system, out = generator.system, np.empty((1, SAMPLES, 3))
    path, kernel = recursion.best_path(), recursion._kernel
    assert kernel is not None
    matrices = (system.A, system.B, system.C, system.D, np.zeros((1, 4)), data, np.empty((1, 4)), out, path)
    calls: dict[str, Callable[[], object]] = {
        "copy": lambda: np.copyto(target, source),
        "kernel": lambda: kernel.run(*matrices),
        "generator.run": lambda: generator.run(u, y),
    }
    kinds = {
        "norm": ({"isolate": None}, ("residuals", "alarm")),
        "CUSUM": ({"isolate": None, "test": rs.decide.CUSUM()}, ("residuals", "alarm")),
        "chi-squared": ({"isolate": None, "test": rs.decide.ChiSquared()}, ("residuals", "alarm")),
        "directions": ({"isolate": rs.decide.Directional(window=50)}, tuple(n for n in OUTPUTS if n != "ready")),
    }
    for name, (settings, keep) in kinds.items():
        spec = rs.Monitor(generator, **settings)._specification()
        plan = plan_of(spec)
        assert plan is not None
        run = FusedRun(spec, plan, copied(initial_state(spec, 1)), 5)
        outputs = run.outputs(1, SAMPLES, keep)
        calls[name] = lambda run=run, outputs=outputs: run.run(u[None], y[None], outputs)
    for name, isolate in (("Monitor.run", None), ("Monitor.run, default", "auto")):
        monitor = rs.Monitor(generator, test=rs.decide.NormThreshold(false_alarm_rate=1e-9), isolate=isolate)
        calls[name] = lambda monitor=monitor: monitor.run(u, y)
    taken = rounds.medians(calls)
    copy, alone = taken["copy"], taken["kernel"]
    rows = [("the filter alone, in copies", "", alone / copy, "")]
    for name, label, most in (
        ("norm", "fused norm and persistence, against the filter alone", "1.25"),
        ("CUSUM", "fused CUSUM, against the filter alone", "1.25"),
        ("chi-squared", "fused chi-squared, against the filter alone", "1.25"),
        ("directions", "window 50 and five directions, all outputs, against the filter alone", "2.5"),
    ):
        rows.append((label, most, taken[name] / alone, ""))
    rows.append(("generator.run, in copies", "3", taken["generator.run"] / copy, ""))
    rows.append(("Monitor.run without isolation, with its diagnosis, in copies", "6", taken["Monitor.run"] / copy, ""))
    rows.append(("Monitor.run, default, in copies", "10", taken["Monitor.run, default"] / copy, ""))
    return rows


def one_sample(rounds: Rounds) -> list[tuple[str, str, float, str]]:
    made = plant()
    generator = rs.design.kalman_filter(made)
    u, y = recorded(made, 3000)
    monitor = rs.Monitor(generator)
    system, path, kernel = generator.system, recursion.best_path(), recursion._kernel
    assert kernel is not None
    x, v, out = np.zeros((1, 4)), np.zeros((1, 1, 8)), np.empty((1, 1, 3))

    def bare() -> None:
        for _ in range(2000):
            kernel.run(system.A, system.B, system.C, system.D, x, v, np.empty((1, 4)), out, path)

    def steps() -> None:
        for k in range(2000):
            monitor.step(u[k], y[k])

    taken = rounds.medians({"bare": bare, "steps": steps})
    latency = []
    for k in range(3000):
        start = time.perf_counter()
        monitor.step(u[k], y[k])
        latency.append(1e6 * (time.perf_counter() - start))
    tail = f"p99 {np.quantile(latency, 0.99):.1f}, p99.9 {np.quantile(latency, 0.999):.1f} µs"
    return [
        ("Monitor.step, default, against bare calls of the filter", "2.5", taken["steps"] / taken["bare"], ""),
        ("Monitor.step, default, in µs", "5", 1e6 * taken["steps"] / 2000, tail),
    ]


def fleets(rounds: Rounds, plants: int) -> list[tuple[str, str, float, str]]:
    made = plant()
    u, y = recorded(made, plants)
    source = np.hstack([u, y])
    target = np.empty_like(source)
    rows: list[tuple[str, str, float, str]] = []
    monitor = rs.Monitor(rs.design.kalman_filter(made), isolate=None)
    fleet = rs.Fleet(monitor, plants=range(plants))
    first = cost(lambda: fleet.tick(None, u, y), time.thread_time)
    for _ in range(40):
        fleet.tick(None, u, y)
    shuffled = tuple(np.random.default_rng(2).permutation(plants).tolist())
    calls: dict[str, Callable[[], object]] = {
        "copy": lambda: np.copyto(target, source),
        "tick": lambda: fleet.tick(None, u, y),
        "shuffled": lambda: fleet.tick(shuffled, u, y),
    }
    taken = rounds.medians(calls)
    rows.append((f"tick of {plants:,} plants, in copies", "5", taken["tick"] / taken["copy"], ""))
    rows.append(("the same, ids shuffled, in copies", "15", taken["shuffled"] / taken["copy"], "ids looked up before"))
    rows.append(("first tick, against a later one", "1.5", first / taken["tick"], "with the estimate of the start"))
    fleet.threads = 2
    both = rounds.medians({"two": lambda: fleet.tick(None, u, y)}, wall=True)["two"]
    fleet.threads = 1
    alone = rounds.medians({"one": lambda: fleet.tick(None, u, y)}, wall=True)["one"]
    rows.append(("two threads, times as fast as one", "1.7", alone / both, ""))
    content = fleet.snapshot()
    own = rounds.medians({"copy": lambda: bytearray(content)})["copy"]
    one = cost(fleet.snapshot, time.thread_time) / own
    rows.append(("snapshot, in copies of itself", "15", one, f"{len(content) / plants:.0f} bytes a plant"))
    back = cost(lambda: rs.Fleet.restore(content, monitor), time.thread_time) / own
    rows.append(("restore, likewise", "15", back, ""))
    state = bytes_of_record([fleet._blocks[""].state])
    rows.append(("state of a plant, norm and persistence, in bytes", "128", state, ""))
    state = bytes_of_record([settled(monitor.design, isolate=None, test=rs.decide.CUSUM())])
    rows.append(("state of a plant, CUSUM, in bytes", "128", state, ""))
    state = bytes_of_record([settled(monitor.design, isolate=rs.decide.Directional(window=50))])
    rows.append(("state of a plant, window 50 and five directions, in bytes", "1400", state, ""))
    return rows + missing(rounds, plants // 10)


def settled(generator: rs.design.ResidualGenerator, **settings: object) -> State:
    """Return the state of some plants whose starts are over."""
    made = rs.Fleet(rs.Monitor(generator, **settings), plants=range(100))  # pyright: ignore[reportArgumentType]
    u, y = recorded(plant(), 100)
    for _ in range(60):
        made.tick(None, u, y)
    return made._blocks[""].state


def missing(rounds: Rounds, plants: int) -> list[tuple[str, str, float, str]]:
    made = plant()
    bare = rs.Plant(made.A, made.B, made.C, dt=1).with_sensor_faults()
    observer = rs.design.unknown_input_observer(bare).residual_generator()
    u, y = recorded(made, plants)
    holes = y.copy()
    holes[::100, 0] = np.nan
    rows = []
    for name, generator in (("an observer", observer), ("a Kalman filter", rs.design.kalman_filter(made))):
        monitor = rs.Monitor(generator, test=rs.decide.NormThreshold(threshold=10.0), isolate=None)
        whole, holed = (rs.Fleet(monitor, plants=range(plants)) for _ in range(2))
        for _ in range(40):
            whole.tick(None, u, y)
            holed.tick(None, u, y)
        taken = rounds.medians(
            {
                "whole": lambda fleet=whole: fleet.tick(None, u, y),
                "holes": lambda fleet=holed: fleet.tick(None, u, holes),
            }
        )
        label = f"tick with 1 % of plants missing a value, {name}, against a complete one"
        rows.append((label, "1.3", taken["holes"] / taken["whole"], ""))
    return rows


def eight_sensors() -> rs.Plant:
    rng = np.random.default_rng(4)
    made = plant()
    return rs.Plant(made.A, made.B, rng.standard_normal((8, 4)), dt=1).with_sensor_faults()


def in_numpy(call: Callable[[], object]) -> Callable[[], None]:
    """Return a call without the fused loop: the filter in C, all else in NumPy, as before there was one for it."""

    def called() -> None:
        kernel = fused._kernel
        fused._kernel = None
        try:
            call()
        finally:
            fused._kernel = kernel

    return called


def banks(rounds: Rounds, samples: int, plants: int) -> list[tuple[str, str, float, str]]:
    made, path, kernel = eight_sensors(), recursion.best_path(), recursion._kernel
    assert kernel is not None
    bank = rs.design.sensor_fault_bank(made)
    generator, rng = bank.residual_generator(), np.random.default_rng(5)
    whole = generator.system
    u = rng.standard_normal((samples, 5))
    y = made.system(("control",)).simulate(u) + 0.1 * rng.standard_normal((samples, 8))
    source = np.hstack([u, y])
    data, target = source[None], np.empty_like(source)
    rows = [list(member.residuals) for member in generator.members]
    states = [np.flatnonzero(whole.C[own].any(axis=0)) for own in rows]
    outs = [np.empty((1, samples, len(own))) for own in rows]
    alone = []
    for own, at, one in zip(rows, states, outs, strict=True):
        parts = (whole.A[np.ix_(at, at)], whole.B[at], whole.C[np.ix_(own, at)], whole.D[own])
        x, after = np.zeros((1, len(at))), np.empty((1, len(at)))
        alone.append((*(np.ascontiguousarray(M) for M in parts), x, data, after, one, path))
    n, out = len(whole.A), np.empty((1, samples, len(whole.C)))
    together = (whole.A, whole.B, whole.C, whole.D, np.zeros((1, n)), data, np.empty((1, n)), out, path)
    test = rs.decide.NormThreshold(threshold=20.0)
    monitor, other = rs.Monitor(bank, test=test), rs.Monitor(bank, test=test)
    spec = monitor._specification()
    plan = plan_of(spec)
    assert plan is not None
    run = FusedRun(spec, plan, copied(initial_state(spec, 1)), 5)
    outputs = run.outputs(1, samples, ("residuals", "alarm"))
    taken = rounds.medians(
        {
            "copy": lambda: np.copyto(target, source),
            "together": lambda: kernel.run(*together),
            "alone": lambda: [kernel.run(*one) for one in alone],
            "fused": lambda: run.run(u[None], y[None], outputs),
            "run": lambda: monitor.run(u, y),
            "run in NumPy": in_numpy(lambda: other.run(u, y)),
        }
    )
    assert all(np.array_equal(out[..., own], one) for own, one in zip(rows, outs, strict=True))
    rows_out = [
        ("bank of 8 filters, against 8 runs of one", "1.1", taken["together"] / taken["alone"], ""),
        ("fused bank of 8 with its code, against its filters alone", "", taken["fused"] / taken["together"], ""),
        ("Monitor.run of a bank of 8, in copies", "", taken["run"] / taken["copy"], "104 bytes a sample"),
        ("Monitor.run of a bank of 8 in NumPy, times as long", "", taken["run in NumPy"] / taken["run"], ""),
    ]
    return rows_out + single_samples_of_banks(rounds, bank, u[:plants], y[:plants])


def single_samples_of_banks(
    rounds: Rounds, bank: rs.design.Bank, u: np.ndarray, y: np.ndarray
) -> list[tuple[str, str, float, str]]:
    test, plants = rs.decide.NormThreshold(threshold=20.0), range(len(u))
    monitor, other = rs.Monitor(bank, test=test), rs.Monitor(bank, test=test)
    fleet = rs.Fleet(monitor, plants=plants)
    made: list[rs.Fleet] = []
    in_numpy(lambda: made.append(rs.Fleet(other, plants=plants)))()
    target, source = np.empty((len(u), 13)), np.hstack([u, y])

    def steps(one: rs.Monitor, count: int) -> None:
        for k in range(count):
            one.step(u[k], y[k])

    for _ in range(40):
        fleet.tick(None, u, y)
        made[0].tick(None, u, y)
    taken = rounds.medians(
        {
            "copy": lambda: np.copyto(target, source),
            "steps": lambda: steps(monitor, 2000),
            "steps in NumPy": in_numpy(lambda: steps(other, 200)),
            "tick": lambda: fleet.tick(None, u, y),
            "tick in NumPy": in_numpy(lambda: made[0].tick(None, u, y)),
        }
    )
    return [
        ("Monitor.step of a bank of 8, in µs", "", 1e6 * taken["steps"] / 2000, ""),
        ("Monitor.step of a bank of 8 in NumPy, times as long", "", 10 * taken["steps in NumPy"] / taken["steps"], ""),
        (f"tick of {len(u):,} banks of 8, in copies", "", taken["tick"] / taken["copy"], "104 bytes a plant"),
        ("tick of as many in NumPy, times as long", "", taken["tick in NumPy"] / taken["tick"], ""),
    ]


def time_of_children() -> float:
    """Return the processor time of processes that have ended, in seconds."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def imports() -> list[tuple[str, str, float, str]]:
    """Return the processor time of new processes that import the package, compiled as an installed one is."""
    base = "import numpy, scipy.linalg"
    lines = (base, f"{base}, residua", f"{base}, residua; residua.Monitor, residua.design.kalman_filter")
    runs: list[list[float]] = [[] for _ in lines]
    with tempfile.TemporaryDirectory() as folder:
        environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
        environment["PYTHONPYCACHEPREFIX"] = folder
        for k in range(16):
            for line, taken in zip(lines, runs, strict=True):
                before = time_of_children()
                subprocess.run([sys.executable, "-c", line], check=True, env=environment)
                if k:  # the first one compiles
                    taken.append(time_of_children() - before)
    alone, imported, used = (median(taken) for taken in runs)
    return [
        ("import residua, above NumPy and scipy.linalg, in seconds", "0.25", imported - alone, ""),
        ("the same, and Monitor and kalman_filter", "0.25", used - alone, ""),
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--plants", type=int, default=PLANTS)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    rounds = Rounds(options.rounds)
    of_banks = banks(rounds, SAMPLES // 4, options.plants // 50)
    rows = [*one_series(rounds), *one_sample(rounds), *fleets(rounds, options.plants), *of_banks, *imports()]
    for row in rows:
        print(f"{row[0]:<75} {row[1]:>6} {row[2]:>9.3g}  {row[3]}")
    print(f"{platform.machine()}, Python {platform.python_version()}, NumPy {np.__version__}")
    if options.out:
        with options.out.open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(["what", "at most", "measured", "remark"])
            writer.writerows([(label, most, f"{value:.3g}", remark) for label, most, value, remark in rows])


if __name__ == "__main__":
    main()
