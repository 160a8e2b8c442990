"""How much faster designs of larger plants are than those of another state of the source, in interleaved rounds.

    git worktree add ../before d3cd033
    OPENBLAS_NUM_THREADS=1 python benchmarks/design_speed.py ../before/src

Every round runs each task once with either source, each in a process of its own, so that nothing is kept from one to
the next; what counts is the processor time of the design alone, in medians. Without another source only today's times
are shown. A task that takes longer than ``--most`` seconds on the clock is stopped, and said to be.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).resolve().parent.parent / "src"


def full(n: int, outputs: int, *, faults: int = 2) -> Any:
    """Return a plant with random matrices, a disturbance, noise, and faults in the states."""
    import residua as rs

    rng = np.random.default_rng([n, outputs])
    A = rng.standard_normal((n, n)) / np.sqrt(n) - np.eye(n)
    plant = rs.Plant(A, rng.standard_normal((n, 2)), rng.standard_normal((outputs, n)))
    plant = plant.with_disturbances(rng.standard_normal((n, 1)))
    plant = plant.with_faults({f"f{i}": rng.standard_normal(n) for i in range(faults)})
    return plant.with_noise(process=1.0, measurement=0.1)


def chain(n: int) -> Any:
    """Return a chain of states between two inputs, with four sensors and two faults: heat in a rod."""
    import residua as rs

    A = -2 * np.eye(n) + np.eye(n, k=1) + np.eye(n, k=-1)
    B, C = np.zeros((n, 2)), np.zeros((4, n))
    B[0, 0] = B[-1, 1] = 1
    C[np.arange(4), [0, n // 3, 2 * n // 3, n - 1]] = 1
    return rs.Plant(A, B, C).with_faults({"f1": np.eye(n)[20], "f2": np.eye(n)[n - 30]})


def tried_by_both(plant: Any) -> Any:
    """Suggest, however long it takes, without what today's source does not try of so many states.

    Of a hundred the one before began primary residuals, unless it had spent half a minute by then, and did not end
    within ten.
    """
    from residua.design import suggestion

    own = suggestion._tried

    def tried(one: Any, plant: Any, want: str, end: float) -> Any:
        if one.method.name == "primary_residuals":
            return suggestion.Entry(one.call, one.method, None, "by neither")
        return own(one, plant, want, end)

    suggestion._tried = tried
    return suggestion.suggest(plant, seconds=1e9)


def _tasks() -> dict[str, tuple[float, Callable[[], Any], Callable[[Any], Any]]]:
    """Return for each task the ratio that was asked for, its plant and what is done with it."""
    import residua as rs

    D = rs.design
    return {
        "sensor_fault_bank, 64 states, 16 members": (8, lambda: full(64, 16), D.sensor_fault_bank),
        "parity_relations, 100 states": (4, lambda: chain(100), D.parity_relations),
        "unknown_input_observer, 200 states": (3, lambda: full(200, 50), D.unknown_input_observer),
        "kalman_filter, 200 states": (3, lambda: full(200, 50), D.kalman_filter),
        "suggest, 100 states": (4, lambda: full(100, 25), tried_by_both),
    }


#: Beyond what the source before could do: there is no ratio, and 60 s are asked for.
FIRST = "first sensor_fault_bank, 200 states, 20 faults"
NAMES = (
    "sensor_fault_bank, 64 states, 16 members",
    "parity_relations, 100 states",
    "unknown_input_observer, 200 states",
    "kalman_filter, 200 states",
    "suggest, 100 states",
)


def one(name: str) -> None:
    """Run a task and print its processor time and its time on the clock."""
    import residua as rs

    if name == FIRST:
        plant, run = full(200, 20, faults=0), rs.design.sensor_fault_bank
    else:
        _, make, run = _tasks()[name]
        plant = make()
    clock, own = time.perf_counter(), time.process_time()
    run(plant)
    print(time.process_time() - own, time.perf_counter() - clock)


def seconds(name: str, source: Path, most: float) -> float:
    """Return the processor time of a task in a process of its own, infinite if it was stopped."""
    environment = os.environ | {"PYTHONPATH": str(source), "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, __file__, "--one", name]
    try:
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=most, check=True)
    except subprocess.TimeoutExpired:
        return float("inf")
    return float(done.stdout.split()[0])


def main() -> None:
    """Run the rounds and print the ratios."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("before", nargs="?", type=Path, help="the src folder of another state of the source")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--most", type=float, default=600.0, help="seconds on the clock after which a task is stopped")
    parser.add_argument("--only", nargs="*", default=[*NAMES, FIRST], help="the tasks, by their names")
    parser.add_argument("--one", help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.one:
        one(asked.one)
        return
    print(f"{'processor time, medians':<48} {'before':>9} {'now':>9} {'ratio':>7} {'asked':>7}")
    for name in asked.only:
        compared = asked.before is not None and name != FIRST
        before, now = [], []
        for _ in range(1 if name == FIRST else asked.rounds):
            if compared:
                before.append(seconds(name, asked.before, asked.most))
            now.append(seconds(name, HERE, asked.most))
        after, wanted = statistics.median(now), "60 s" if name == FIRST else f"{_tasks()[name][0]:g}"
        earlier = f"{statistics.median(before):8.2f}s" if before else "-"
        ratio = f"{statistics.median(before) / after:.1f}" if before else "-"
        print(f"{name:<48} {earlier:>9} {after:8.2f}s {ratio:>7} {wanted:>7}", flush=True)


if __name__ == "__main__":
    main()
