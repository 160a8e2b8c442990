"""Calls, files and frames of the package in designs of four states and in a monitor: how far it is to SciPy or C.

Only functions of the package count, and none of what imports it. The plant of a design is new, so that nothing of it is
kept. A second tree is an earlier one, for the columns "before"::

    PYTHONPATH=src python benchmarks/call_depth.py
    PYTHONPATH=src python benchmarks/call_depth.py --before ../before/src --csv docs/data/call_depth.csv
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

import residua as rs

PACKAGE = str(Path(rs.__file__).resolve().parent) + os.sep
SCIPY = f"{os.sep}scipy{os.sep}"
#: Modules of the package in C.
COMPILED = ("_fused", "_recursion")
HEADER = ("calls", "files", "SciPy or C at frame", "deepest frame")


def plant(seed: int) -> rs.Plant:
    """Return the vertical take-off aircraft in other units, with a disturbance, noise and two faults."""
    p = rs.library.vtol()
    B = getattr(p, "Bu", None)  # the name in earlier trees
    B = p.B if B is None else B
    disturbed = rs.Plant(p.A * (1 + seed / 8), B, p.C, name="vtol").with_disturbances(B[:, [1]])
    return disturbed.with_faults({"f1": B[:, 0]}).with_noise(process=1.0, measurement=0.1)


def singular(p: rs.Plant) -> rs.Plant:
    """Return a plant whose last state obeys an algebraic equation."""
    B = getattr(p, "Bu", None)
    B = p.B if B is None else B
    return rs.Plant(p.A, B, p.C, E=np.diag([1.0, 1, 1, 0]), name="singular")


DESIGNS: dict[str, Callable[[rs.Plant], Any]] = {
    "kalman_filter": lambda p: rs.design.kalman_filter(p.without_disturbances()),
    "unknown_input_observer": rs.design.unknown_input_observer,
    "detection_filter": lambda p: rs.design.detection_filter(p.without_disturbances()),
    "robust_detection_filter": rs.design.robust_detection_filter,
    "luenberger_observer": lambda p: rs.design.luenberger_observer(p.without_disturbances()),
    "reduced_order_observer": rs.design.reduced_order_observer,
    "descriptor_observer": lambda p: rs.design.descriptor_observer(singular(p)),
    "perfect_observer": lambda p: rs.design.perfect_observer(p, least_order=True),
    "inverse_form_observer": lambda p: rs.design.inverse_form_observer(p.without_disturbances()),
    "eigenstructure_assignment": lambda p: rs.design.eigenstructure_assignment(p, insensitive_to="f1"),
    "fault_estimator": lambda p: rs.design.fault_estimator(p.without_disturbances(), faults="f1"),
    "sensor_fault_estimators": rs.design.sensor_fault_estimators,
}


def monitor_calls() -> dict[str, Callable[[], Any]]:
    """Return calls of a monitor of three tanks: first it is fitted, then it runs."""
    plant = rs.library.three_tank()
    normal = rs.library.simulate_three_tank(3000)
    leak = 0.05 * (np.arange(1500) >= 600)
    faulty = rs.library.simulate_three_tank(1500, faults={"leak 3": leak}, seed=1)
    rs.Monitor(rs.design.kalman_filter(plant)).fit(normal.u, normal.y).run(faulty.u, faulty.y)  # imports
    monitor = rs.Monitor(rs.design.kalman_filter(plant))
    return {
        "Monitor.fit": lambda: monitor.fit(normal.u, normal.y),
        "Monitor.run, no fault": lambda: monitor.run(normal.u[:1500], normal.y[:1500]),
        "Monitor.run, a leak": lambda: monitor.run(faulty.u, faulty.y),
        "Monitor.step, first": lambda: monitor.step(faulty.u[0], faulty.y[0]),
        "Monitor.step, second": lambda: monitor.step(faulty.u[1], faulty.y[1]),
    }


def counted(call: Callable[[], Any]) -> tuple[int, int, int, int]:
    """Return calls, files, frames where SciPy or C is first reached (0: never), and the most frames."""
    calls, files, first, most = 0, set[str](), 0, 0

    def look(frame: FrameType, event: str, called: Any) -> None:
        nonlocal calls, first, most
        name = frame.f_code.co_filename
        inside = event == "call" and name.startswith(PACKAGE)
        in_scipy = event == "call" and SCIPY in name
        in_c = event == "c_call" and str(called.__module__).rpartition(".")[2] in COMPILED
        if not (inside or (not first and (in_scipy or in_c))):
            return
        depth, at = 0, frame
        while at is not None:
            depth += at.f_code.co_filename.startswith(PACKAGE)
            at = at.f_back
        if inside:
            calls, most = calls + 1, max(most, depth)
            files.add(name)
        else:
            first = depth

    sys.setprofile(look)
    try:
        call()
    finally:
        sys.setprofile(None)
    return calls, len(files), first, most


def counts() -> dict[str, tuple[int, int, int, int]]:
    """Return the counts of every design and call of a monitor."""
    found = {}
    for name, design in DESIGNS.items():
        design(plant(1))  # imports
        subject = plant(2)
        found[name] = counted(lambda design=design, subject=subject: design(subject))
    return found | {name: counted(call) for name, call in monitor_calls().items()}


def main() -> None:
    """Print the table, and write it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--before", type=Path, help="source tree of an earlier package")
    parser.add_argument("--csv", type=Path, help="file to write as well")
    parser.add_argument("--json", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    found = counts()
    if options.json:
        print(json.dumps(found))
        return
    columns = {"": found}
    if options.before is not None:
        environment = {**os.environ, "PYTHONPATH": str(options.before)}
        answer = subprocess.run(
            [sys.executable, __file__, "--json"], env=environment, stdout=subprocess.PIPE, check=True
        )
        columns = {", before": json.loads(answer.stdout), ", now": found}
    header = ["call", *(f"{title}{when}" for title in HEADER for when in columns)]
    rows = [[name, *(str(c[name][k]) for k in range(len(HEADER)) for c in columns.values())] for name in found]
    for row in (header, *rows):
        print("".join(f"{cell:<{28 if k == 0 else 10}}" for k, cell in enumerate(row)))
    if options.csv is not None:
        with options.csv.open("w", encoding="utf-8", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows([header, *rows])


if __name__ == "__main__":
    main()
