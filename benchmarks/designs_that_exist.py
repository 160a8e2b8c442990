"""Every design on many plants: made, near, refused for accuracy, or none exists; leak, gain, time, and the textbook's.

Run it, with the folder of the SLICOT systems if there is one::

    .venv/bin/python benchmarks/designs_that_exist.py --data FOLDER --out docs/data

It writes ``designs_that_exist.csv``, a row for each plant and design, and ``designs_that_exist_counts.csv``, a row for
each design. Whether the filter of a textbook works is that of ``tests/textbook_filters.py``: stable, with a leak below
1e-6.
"""

from __future__ import annotations

# ruff: noqa: E402
import os

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import argparse
import csv
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

import residua as rs
from residua.design.core.leak import leak
from residua.errors import AccuracyError, ResiduaError
from residua.tolerances import LEAK
from textbook_filters import FILTERS, NoFilterError

SECONDS = 60
MOST_SENSOR_FAULTS = 6


def chain(n: int, coupling: float = 1.0) -> tuple[Any, ...]:
    """Return tanks in a row, each emptying into the next, measured at six places."""
    A = -np.eye(n) + coupling * np.diag(np.ones(n - 1), -1)
    return A, np.eye(n)[:, [0]], np.eye(n)[_places(n)]


def rod(n: int) -> tuple[Any, ...]:
    """Return a rod through which heat diffuses, heated at one end."""
    A = (np.diag(-2 * np.ones(n)) + np.diag(np.ones(n - 1), 1) + np.diag(np.ones(n - 1), -1)) * (n / 10) ** 2
    return A, np.eye(n)[:, [0]] * (n / 10) ** 2, np.eye(n)[_places(n)]


def masses(n: int) -> tuple[Any, ...]:
    """Return masses joined by springs and dampers, pushed at one end, positions measured."""
    k = n // 2
    K = np.diag(2 * np.ones(k)) - np.diag(np.ones(k - 1), 1) - np.diag(np.ones(k - 1), -1)
    A = np.block([[np.zeros((k, k)), np.eye(k)], [-K, -0.1 * K]])
    B = np.zeros((2 * k, 1))
    B[k] = 1
    return A, B, np.hstack([np.eye(k)[_places(k)], np.zeros((len(_places(k)), k))])


def integrators(n: int) -> tuple[Any, ...]:
    """Return integrators in a row."""
    return np.diag(np.ones(n - 1), 1), np.eye(n)[:, [-1]], np.eye(n)[_places(n)]


def _places(n: int) -> list[int]:
    return sorted(set(np.linspace(0, n - 1, min(6, n)).round().astype(int).tolist()))


def plants(folder: Path | None) -> Iterator[rs.Plant]:
    """Yield the plants, each with faults of actuators and sensors and a disturbance where there are outputs for it."""
    for make in (chain, rod, masses):
        for n in (5, 10, 20, 30, 50, 75, 100):
            n = n + n % 2 if make is masses else n
            A, B, C = make(n)
            yield _with_roles(rs.Plant(A, B, C, name=f"{make.__name__} {n}"))
    for n in (10, 50, 100):
        A, B, C = rod(n)
        yield _with_roles(rs.Plant(A, B, C, name=f"sampled rod {n}").discretize(0.1))
    yield _with_roles(rs.Plant(*integrators(4), name="integrators 4"))
    A = [[0, 0.4, 0, 0], [0, 0, 0.345, 0], [0, -0.524e6, -0.465e6, 0.262e6], [0, 0, 0, -1e6]]
    yield _with_roles(rs.Plant(A, [[0], [0], [0], [1e6]], [[1, 0, 0, 0], [0, 0, 1, 0]], name="tape drive"))
    for path in sorted(folder.glob("*.mat")) if folder else ():
        M = {k: np.asarray(v, dtype=float) for k, v in scipy.io.loadmat(path).items() if k in "ABCDE"}
        E = None if np.array_equal(M["E"], np.eye(len(M["E"]))) else M["E"]
        dt = 1.0 if path.stem.startswith("BD02") else 0.0
        yield _with_roles(rs.Plant(M["A"], M["B"], M["C"], M["D"], E=E, dt=dt, name=path.stem))


def _with_roles(plant: rs.Plant) -> rs.Plant:
    plant = plant.with_actuator_faults().with_sensor_faults(plant.outputs[:MOST_SENSOR_FAULTS])
    if plant.n_outputs > 1 and plant.n_states > 1:
        column = plant.B[:, -1] if len(plant.inputs) > 1 else np.roll(plant.B[:, 0], plant.n_states // 2)
        if np.any(column):
            plant = plant.with_disturbances({"d": column})
    return plant


def _sensors(plant: rs.Plant) -> rs.Plant:
    """Return a plant with the faults of its first sensors alone, and no disturbance."""
    kept = [fault.name for fault in plant.fault_list if fault.kind == "sensor"][:3]
    return plant.without_disturbances().without_faults([name for name in plant.faults if name not in kept])


def _structured(plant: rs.Plant) -> rs.design.Bank:
    """Return the bank of the first attainable rows of the first faults."""
    few = plant.without_faults(plant.faults[4:])
    return rs.design.structured_bank(few, rs.coding.attainable(few).digits[:4])


def _one_fault(plant: rs.Plant) -> rs.Plant:
    return plant.without_faults(plant.faults[1:])


DESIGNS: dict[str, Callable[[rs.Plant], Any]] = {
    "kalman_filter": lambda p: rs.design.kalman_filter(p.with_noise(process=1e-2, measurement=1e-2)),
    "luenberger_observer": rs.design.luenberger_observer,
    "reduced_order_observer": lambda p: rs.design.reduced_order_observer(p.without_disturbances(), outputs=[0]),
    "unknown_input_observer": rs.design.unknown_input_observer,
    "decoupled_residual": rs.design.decoupled_residual,
    "parity_relations": lambda p: rs.design.parity_relations(p),
    "detection_filter": lambda p: rs.design.detection_filter(_one_fault(p.without_disturbances())),
    "fault_estimator": lambda p: rs.design.fault_estimator(_one_fault(p)),
    "sensor_fault_bank": lambda p: rs.design.sensor_fault_bank(_sensors(p)),
    "robust_detection_filter": lambda p: rs.design.robust_detection_filter(_one_fault(p)),
    "structured_bank": lambda p: _structured(p),
}


def textbook(plant: rs.Plant, name: str) -> str:
    """Return whether the filter of a textbook works on a plant; empty where there is none for the design."""
    if name not in FILTERS:
        return ""
    try:
        system, T = FILTERS[name](PLANTS[name](plant).explicit())
        return "works" if leak(system, PLANTS[name](plant).explicit(), T).gains.max(initial=0.0) <= LEAK else "leaks"
    except (NoFilterError, np.linalg.LinAlgError, ValueError, ResiduaError):
        return "none"


#: The plants that the filters of a textbook are tried on.
PLANTS: dict[str, Callable[[rs.Plant], rs.Plant]] = {
    "kalman_filter": rs.Plant.without_disturbances,
    "luenberger_observer": rs.Plant.without_disturbances,
    "unknown_input_observer": lambda p: p,
    "detection_filter": lambda p: _one_fault(p.without_disturbances()),
}


def row(plant: rs.Plant, name: str) -> dict[str, Any]:
    """Try a design on a plant."""
    started, found = time.process_time(), {"outcome": "", "leak": "", "gain": "", "reason": ""}
    try:
        signal.signal(signal.SIGALRM, _too_long)
        signal.alarm(SECONDS)
        made = DESIGNS[name](plant)
        evidence = made.evidence
        leaks = [v for k, v in evidence.decoupling.items()]
        found["outcome"] = "near" if any(note.startswith("near") for note in evidence.notes) else "made"
        found["leak"] = f"{max(leaks, default=0.0):.1e}"
        gain = [v for k, v in evidence.conditions.items() if "gain" in k or "size of K" in k]
        found["gain"] = f"{max(gain, default=0.0):.1e}"
    except AccuracyError as error:
        found |= {"outcome": "refused", "reason": str(error)[:150]}
    except ResiduaError as error:
        found |= {"outcome": "none exists", "reason": str(error)[:150]}
    except TimeoutError:
        found |= {"outcome": "too long"}
    except Exception as error:
        found |= {"outcome": "crash", "reason": f"{type(error).__name__}: {error}"[:150]}
    finally:
        signal.alarm(0)
    ms = 1000 * (time.process_time() - started)
    found |= {"textbook": textbook(plant, name), "ms": f"{ms:.1f}"}
    return {"plant": plant.name, "states": plant.n_states, "design": name, **found}


def _summary(name: str, rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the counts of a design, its leaks and its times."""
    outcomes = Counter(one["outcome"] for one in rows)
    leaks = [float(one["leak"]) for one in rows if one["leak"]]
    times = [float(one["ms"]) for one in rows if one["outcome"] in ("made", "near")]
    refused = [one for one in rows if one["outcome"] == "refused"]
    return {
        "design": name,
        "made": outcomes["made"],
        "near": outcomes["near"],
        "refused": len(refused),
        "where the textbook works": sum(one["textbook"] == "works" for one in refused),
        "none exists": outcomes["none exists"],
        "too long or crash": outcomes["too long"] + outcomes["crash"],
        "median leak": f"{np.median(leaks):.0e}" if leaks else "",
        "largest leak": f"{max(leaks):.0e}" if leaks else "",
        "median ms": f"{np.median(times):.0f}" if times else "",
        "largest ms": f"{max(times):.0f}" if times else "",
    }


def _too_long(*_: Any) -> None:
    raise TimeoutError


def main() -> None:
    """Make the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--designs", nargs="*", default=list(DESIGNS))
    options = parser.parse_args()
    rows = []
    for plant in plants(options.data):
        for name in options.designs:
            rows.append(row(plant, name))
        print(plant.name, *(f"{r['outcome']}:{r['ms']}" for r in rows[-len(options.designs) :]), flush=True)
    with (options.out / "designs_that_exist.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)
    summary = [_summary(name, [one for one in rows if one["design"] == name]) for name in options.designs]
    with (options.out / "designs_that_exist_counts.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, summary[0])
        writer.writeheader()
        writer.writerows(summary)
    for one in summary:
        print(*one.values())


if __name__ == "__main__":
    sys.exit(main())
