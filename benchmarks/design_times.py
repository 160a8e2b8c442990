"""How long designs take by the number of states, and with which power of it they grow: a table of the page on speed.

Processor time of one thread, medians of interleaved rounds, each with plants of its own, since a design that is asked
for again finds what it kept. Plants have random matrices, an output for every four states (three at least), two
inputs, a disturbance, noise, and two faults; a bank has sensor faults of up to eight outputs instead. The slope is
that of the logarithms from 50 states on, by least squares; ``suggest`` has none, as it tries fewer methods for more
than 60 states.

    python benchmarks/design_times.py [--rounds 3] [--out docs/data/design_times.csv]
"""

from __future__ import annotations

import argparse
import csv
import os
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

STATES = (4, 8, 16, 25, 50, 100, 200)
#: Below, times are those of calls that hardly depend on the number of states.
FROM = 50


def plant(n: int, outputs: int, seed: int, faults: bool) -> Any:
    """Return a plant with random matrices."""
    import residua as rs

    rng = np.random.default_rng([n, outputs, seed])
    A = rng.standard_normal((n, n)) / np.sqrt(n) - np.eye(n)
    made = rs.Plant(A, rng.standard_normal((n, 2)), rng.standard_normal((outputs, n)))
    made = made.with_disturbances(rng.standard_normal((n, 1)))
    if faults:
        made = made.with_faults({f"f{i + 1}": rng.standard_normal(n) for i in range(2)})
    return made.with_noise(process=1.0, measurement=0.1)


def calls(n: int, seed: int) -> dict[str, Callable[[], Any]]:
    """Return the designs to time, each with its plant made."""
    import residua as rs

    one, other = plant(n, max(n // 4, 3), seed, True), plant(n, max(n // 4, 3), seed, False)
    watched = other.with_sensor_faults(other.outputs[:8])
    made: dict[str, Callable[[], Any]] = {
        name: partial(getattr(rs.design, name), one)
        for name in (
            "kalman_filter",
            "luenberger_observer",
            "unknown_input_observer",
            "detection_filter",
            "decoupled_residual",
            "parity_relations",
        )
    }
    made["sensor_fault_bank"] = lambda: rs.design.sensor_fault_bank(watched)
    made["suggest"] = lambda: rs.suggest(one, seconds=1e4)
    return made


def seconds(call: Callable[[], Any]) -> float:
    """Return the processor time of a design; what has no result takes its time as well."""
    from residua.errors import ResiduaError

    start = time.thread_time()
    try:
        call()
    except ResiduaError as error:
        print(f"refused: {error}", file=sys.stderr)
        return float("nan")
    return time.thread_time() - start


def slope(states: np.ndarray, times: np.ndarray) -> float:
    """Return the slope of the logarithms over the larger plants."""
    large = states >= FROM
    return float(np.polyfit(np.log(states[large]), np.log(times[large]), 1)[0])


def main() -> None:
    """Run the rounds, print the table and write it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--states", type=int, nargs="*", default=STATES)
    parser.add_argument("--out", type=Path)
    asked = parser.parse_args()
    if os.environ.get("OPENBLAS_NUM_THREADS") != "1":  # it is read when NumPy is loaded
        os.execve(sys.executable, [sys.executable, *sys.argv], os.environ | {"OPENBLAS_NUM_THREADS": "1"})
    for call in calls(4, asked.rounds).values():  # imports, and what is made once
        seconds(call)
    times: dict[str, dict[int, list[float]]] = {}
    for k in range(asked.rounds):
        for n in asked.states:
            for name, call in calls(n, k).items():
                times.setdefault(name, {}).setdefault(n, []).append(seconds(call))
    header = ["design", *(f"{n} states" for n in asked.states), "slope"]
    rows = []
    for name, by_states in times.items():
        medians = np.array([median(by_states[n]) for n in asked.states])
        grows = "" if name == "suggest" else f"{slope(np.array(asked.states), medians):.1f}"
        rows.append([name, *(f"{t:.3g}" for t in medians), grows])
    for row in [header, *rows]:
        print(f"{row[0]:<24}" + "".join(f"{cell:>12}" for cell in row[1:]))
    if asked.out:
        with asked.out.open("w", newline="", encoding="utf-8") as file:
            csv.writer(file, lineterminator="\n").writerows([header, *rows])


if __name__ == "__main__":
    main()
