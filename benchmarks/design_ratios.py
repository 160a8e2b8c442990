"""Times of designs beside those of a textbook, and of another state of the source, by the number of states.

Processor time of one thread. Each round runs in a process of its own, in turn with either source, on new plants; what
counts is the median of the rounds. The textbook's are the filters of ``tests/textbook_filters.py`` with their poles,
which check nothing::

    python benchmarks/design_ratios.py [../before/src] [--rounds 5] [--out docs/data/design_ratios.csv]
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent / "tests")]
STATES = (4, 20, 50, 100, 200)
DESIGNS = ("kalman_filter", "unknown_input_observer", "detection_filter", "decoupled_residual")
#: Times of small plants are those of so many plants together.
PLANTS = {4: 20, 20: 10, 50: 4, 100: 2, 200: 1}


def _timed(call: Callable[[Any], Any], plants: list[Any]) -> float:
    """Return the processor time of a call for each of some plants, in ms."""
    start = time.process_time()
    for plant in plants:
        call(plant)
    return 1000 * (time.process_time() - start) / len(plants)


def one_round(seed: int, states: list[int]) -> dict[str, list[float]]:
    """Return the times of a design and of the textbook's, by its name and the number of states."""
    from design_times import plant

    import residua as rs

    filters = import_module("textbook_filters").FILTERS

    found = {}
    for first, n in enumerate([4, *states]):  # once for imports
        seeds = range(2 * len(DESIGNS) * PLANTS.get(n, 1))
        made = [plant(n, max(n // 4, 3), 1000 * (seed + 100 * (not first)) + k, True) for k in seeds]
        for name in DESIGNS:
            own = name in ("kalman_filter", "detection_filter")
            fresh = [made.pop() for _ in range(2 * PLANTS.get(n, 1))]
            fresh = [p.without_disturbances() if own else p for p in fresh]
            fresh = [p.without_faults(p.faults[1:]) for p in fresh]
            book: Callable[[Any], Any] = filters[name]
            ours = _timed(getattr(rs.design, name), fresh[::2])
            theirs = _timed(lambda p, book=book: [np.linalg.eigvals(s.A) for s, *_ in book(p)], fresh[1::2])
            found[f"{name} {n}"] = [ours, theirs]
    return found


def rounds(source: Path, seed: int, states: list[int]) -> dict[str, list[float]]:
    """Return the times of a round in a process of its own."""
    environment = os.environ | {"PYTHONPATH": str(source), "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, __file__, "--one", str(seed), "--states", *map(str, states)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return json.loads(done.stdout.splitlines()[-1])


def main() -> None:
    """Run the rounds and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("before", nargs="?", type=Path, help="the src folder of another state of the source")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--states", type=int, nargs="*", default=STATES)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--one", type=int, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.one is not None:
        print(json.dumps(one_round(asked.one, asked.states)))
        return
    now, before = [], []
    for seed in range(asked.rounds):
        if asked.before:
            before.append(rounds(asked.before, seed, asked.states))
        now.append(rounds(HERE.parent / "src", seed, asked.states))
    header = ["design", "states", *(["before, ms"] if before else []), "ms", "textbook, ms", "ratio"]
    rows = [header]
    for name in DESIGNS:
        for n in asked.states:
            key = f"{name} {n}"
            ours, theirs = (median(one[key][k] for one in now) for k in (0, 1))
            earlier = [f"{median(one[key][0] for one in before):.3g}"] if before else []
            rows.append([name, str(n), *earlier, f"{ours:.3g}", f"{theirs:.3g}", f"{ours / theirs:.1f}"])
    for line in rows:
        print(f"{line[0]:<24}" + "".join(f"{cell:>14}" for cell in line[1:]))
    if asked.out:
        with asked.out.open("w", newline="", encoding="utf-8") as file:
            csv.writer(file, lineterminator="\n").writerows(rows)


if __name__ == "__main__":
    main()
