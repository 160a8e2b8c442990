"""Eleven designs on many plants beside those of a textbook: made, near, refused for accuracy, or none exists.

Run it, with the folder of the SLICOT systems if there is one::

    .venv/bin/python benchmarks/designs_that_exist.py --data FOLDER --record RECORD

Each design is tried once, for a minute at most, and kept in the folder RECORD as soon as it is done: the same command
goes on where it was stopped. Several processes share the work with ``--part 1/2`` and ``--part 2/2``, and
``--plants`` and ``--designs`` choose by the beginnings of names. When all are done::

    .venv/bin/python benchmarks/designs_that_exist.py --record RECORD --tables docs/data

writes the tables of the page on designs that exist. The filters of the textbook are those of
``tests/textbook_filters.py``.
"""

from __future__ import annotations

# ruff: noqa: E402
import os

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import argparse
import csv
import json
import re
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent / "tests")]

import published_plants

import residua as rs
from residua.errors import AccuracyError, ResiduaError

verdict: Callable[[str, rs.Plant], str] = import_module("textbook_filters").verdict
guards: Callable[[], dict[str, tuple[str, int, int]]] = import_module("guards").guards
#: Seconds of processor time after which a design is stopped.
SECONDS = 60
#: The same of a filter of the textbook, with its leak.
SECONDS_OF_TEXTBOOK = 20
#: What takes longer is timed once more, and counts with the shorter time: the machine may have been busy.
AGAIN = 500.0
MOST_SENSOR_FAULTS = 6
#: Up to so many states a design should take a second at most.
STATES = 100
SIZES = (5, 10, 20, 30, 50, 75, 100, 200)

Row = dict[str, Any]


# ---------------------------------------------------------------------- plants


def tanks(n: int) -> tuple[Any, ...]:
    """Return tanks in a row, each emptying into the next, measured at six places."""
    return np.diag(np.ones(n - 1), -1) - np.eye(n), np.eye(n)[:, [0]], np.eye(n)[_places(n)]


def rod(n: int) -> tuple[Any, ...]:
    """Return a rod through which heat diffuses, heated at one end."""
    A = (np.diag(-2 * np.ones(n)) + np.diag(np.ones(n - 1), 1) + np.diag(np.ones(n - 1), -1)) * (n / 10) ** 2
    return A, np.eye(n)[:, [0]] * (n / 10) ** 2, np.eye(n)[_places(n)]


def chain(n: int) -> tuple[Any, ...]:
    """Return masses joined by springs and dampers, pushed at one end, positions measured."""
    k = n // 2
    K = np.diag(2 * np.ones(k)) - np.diag(np.ones(k - 1), 1) - np.diag(np.ones(k - 1), -1)
    A = np.block([[np.zeros((k, k)), np.eye(k)], [-K, -0.1 * K]])
    return A, np.eye(2 * k)[:, [k]], np.hstack([np.eye(k)[_places(k)], np.zeros((len(_places(k)), k))])


def _places(n: int) -> list[int]:
    return sorted(set(np.linspace(0, n - 1, min(6, n)).round().astype(int).tolist()))


def plants(folder: Path | None) -> Iterator[tuple[str, rs.Plant]]:
    """Yield families and plants, each with faults of actuators and sensors, and a disturbance if outputs allow it."""
    for family, make in (("tanks", tanks), ("rods", rod), ("chains", chain)):
        for n in SIZES:
            n = n + n % 2 if make is chain else n
            yield family, rs.Plant(*make(n), name=f"{make.__name__} {n}")
    for n in (10, 50, 100):
        yield "rods", rs.Plant(*rod(n), name=f"sampled rod {n}").discretize(0.1)
    yield "papers", rs.Plant(np.diag(np.ones(3), 1), np.eye(4)[:, [3]], np.eye(4), name="integrators 4")
    A = [[0, 0.4, 0, 0], [0, 0, 0.345, 0], [0, -0.524e6, -0.465e6, 0.262e6], [0, 0, 0, -1e6]]
    yield "papers", rs.Plant(A, [[0], [0], [0], [1e6]], [[1, 0, 0, 0], [0, 0, 1, 0]], name="tape drive")
    for name in ("gertler", "jet_engine", "three_tank", "vtol"):
        p = getattr(rs.library, name)()
        yield "papers", rs.Plant(p.A, p.B, p.C, p.D, dt=p.dt, name=name.replace("_", " "))
    for plant in published_plants.of_papers():
        yield "papers", plant
    for plant in published_plants.by_formula():
        yield "formulas", plant
    for path in sorted(folder.glob("*.mat")) if folder else ():
        M = {k: np.asarray(v, dtype=float) for k, v in scipy.io.loadmat(path).items() if k in "ABCDE"}
        E = None if np.array_equal(M["E"], np.eye(len(M["E"]))) else M["E"]
        dt = 1.0 if path.stem.startswith("BD02") else 0.0
        yield "SLICOT", rs.Plant(M["A"], M["B"], M["C"], M["D"], E=E, dt=dt, name=path.stem)


def with_roles(plant: rs.Plant) -> rs.Plant:
    """Return a plant with actuator faults, up to six sensor faults, and a disturbance if there is an output for it."""
    plant = plant.with_actuator_faults().with_sensor_faults(plant.outputs[:MOST_SENSOR_FAULTS])
    if plant.n_outputs > 1 and plant.n_states > 1:
        column = plant.B[:, -1] if len(plant.inputs) > 1 else np.roll(plant.B[:, 0], plant.n_states // 2)
        if np.any(column):
            plant = plant.with_disturbances({"d": column})
    return plant


# --------------------------------------------------------------------- designs


def _undisturbed(plant: rs.Plant) -> rs.Plant:
    return plant.without_disturbances()


def _one_fault(plant: rs.Plant) -> rs.Plant:
    return plant.without_faults(plant.faults[1:])


def _one_fault_undisturbed(plant: rs.Plant) -> rs.Plant:
    return _one_fault(plant.without_disturbances())


def _three_sensors(plant: rs.Plant) -> rs.Plant:
    kept = [fault.name for fault in plant.fault_list if fault.kind == "sensor"][:3]
    return plant.without_disturbances().without_faults([name for name in plant.faults if name not in kept])


def _four_faults(plant: rs.Plant) -> rs.Plant:
    return plant.without_faults(plant.faults[4:])


def _attainable(plant: rs.Plant) -> rs.design.Bank:
    """Return the bank of the first rows that are attainable."""
    return rs.design.structured_bank(plant, rs.coding.attainable(plant).digits[:4])


#: For each design what it is tried on, and the call.
DESIGNS: dict[str, tuple[Callable[[rs.Plant], rs.Plant], Callable[[rs.Plant], Any]]] = {
    "kalman_filter": (
        lambda p: p.without_disturbances().with_noise(process=1e-2, measurement=1e-2),
        rs.design.kalman_filter,
    ),
    "luenberger_observer": (_undisturbed, rs.design.luenberger_observer),
    "reduced_order_observer": (_undisturbed, lambda p: rs.design.reduced_order_observer(p, outputs=[0])),
    "unknown_input_observer": (lambda p: p, rs.design.unknown_input_observer),
    "decoupled_residual": (lambda p: p, rs.design.decoupled_residual),
    "parity_relations": (lambda p: p, rs.design.parity_relations),
    "detection_filter": (_one_fault_undisturbed, rs.design.detection_filter),
    "robust_detection_filter": (_one_fault, rs.design.robust_detection_filter),
    "fault_estimator": (_one_fault, rs.design.fault_estimator),
    "sensor_fault_bank": (_three_sensors, rs.design.sensor_fault_bank),
    "structured_bank": (_four_faults, _attainable),
}


class _TooLongError(BaseException):
    """A design takes longer than a minute; no handler of errors may keep it."""


def _stop(*_: Any) -> None:
    raise _TooLongError


def row(family: str, plant: rs.Plant, name: str, *, with_textbook: bool = True) -> Row:
    """Try a design on a plant that has its roles."""
    found = _tried(plant, name)
    if float(found["ms"]) > AGAIN and found["outcome"] in ("made", "near", "refused", "none exists"):
        again = _tried(plant, name)
        if again["outcome"] == found["outcome"]:
            found["ms"] = min(found["ms"], again["ms"], key=float)
    if with_textbook:
        try:
            signal.setitimer(signal.ITIMER_PROF, SECONDS_OF_TEXTBOOK)
            found["textbook"] = verdict(name, DESIGNS[name][0](plant))
        except _TooLongError:
            found["textbook"] = "too long"
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)
    first = {"plant": plant.name, "family": family, "states": plant.n_states, "design": name}
    return first | {key: found[key] for key in ("outcome", "textbook", "leak", "gain", "ms", "check", "reason")}


def _tried(plant: rs.Plant, name: str) -> Row:
    """Try a design on a copy of a plant, for which nothing has been computed yet."""
    subject, call = DESIGNS[name]
    fresh = subject(with_roles(rs.Plant(plant.A, plant.B, plant.C, plant.D, E=plant.E, dt=plant.dt, name=plant.name)))
    found: Row = {"textbook": "", "leak": "", "gain": "", "check": "", "reason": ""}
    signal.signal(signal.SIGPROF, _stop)
    raised: list[str] = []
    started = time.process_time()
    try:
        signal.setitimer(signal.ITIMER_PROF, SECONDS)
        with _watched() as raised:
            made = call(fresh)
        signal.setitimer(signal.ITIMER_PROF, 0)
        ended = time.process_time()
        found |= _said(made)
    except AccuracyError as error:
        ended = time.process_time()
        found |= {"outcome": "refused", "reason": str(error), "check": _check(error, raised)}
    except ResiduaError as error:
        ended = time.process_time()
        found |= {"outcome": "none exists", "reason": str(error)}
    except _TooLongError:
        ended = time.process_time()
        found |= {"outcome": "too long"}
    except Exception as error:
        ended = time.process_time()
        found |= {"outcome": "crash", "reason": f"{type(error).__name__}: {error}"}
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
    return found | {"ms": f"{1000 * (ended - started):.1f}", "reason": " ".join(found["reason"].split())[:300]}


def _check(error: AccuracyError, raised: list[str]) -> str:
    """Return the check that refused: the first cause of an error, or the last of those that a bank sums up."""
    while isinstance(error.__cause__, AccuracyError):
        error = error.__cause__
    at = error.__traceback__
    while at is not None and at.tb_next is not None:
        at = at.tb_next
    own = _guard(at.tb_frame.f_code.co_filename, at.tb_lineno) if at is not None else ""
    return own or next((name for name in reversed(raised) if name), "")


def _guard(path: str, line: int) -> str:
    """Return the name of a check in ``tests/guards.py``."""
    return next((name for name, (at, first, last) in guards().items() if at == path and first <= line <= last), "")


@contextmanager
def _watched() -> Iterator[list[str]]:
    """Collect the checks that raise, also where the error is caught."""
    raised: list[str] = []
    make = AccuracyError.__init__

    def noted(self: AccuracyError, *told: Any) -> None:
        frame = sys._getframe(1)
        raised.append(_guard(frame.f_code.co_filename, frame.f_lineno))
        make(self, *told)

    AccuracyError.__init__ = noted
    try:
        yield raised
    finally:
        AccuracyError.__init__ = make


def _said(made: Any) -> Row:
    """Return what the evidence of a design says."""
    evidence = made.evidence
    near = [note for note in evidence.notes if note.startswith("near")]
    gains = [v for k, v in evidence.conditions.items() if "gain" in k or "size of" in k]
    leaks = [*evidence.decoupling.values(), evidence.conditions.get("estimate off the state", 0.0)]
    return {
        "outcome": "near" if near else "made",
        "leak": f"{max(leaks):.1e}",
        "gain": f"{max(gains):.1e}" if gains else "",
        "reason": near[0] if near else "",
    }


# ---------------------------------------------------------------------- record


def records(folder: Path) -> list[Row]:
    """Return the rows of a record; a torn line is left out, and of what was tried again the last counts."""
    found: dict[tuple[str, str], Row] = {}
    for path in sorted(folder.glob("*.jsonl")):
        for line in path.read_text(encoding="utf-8").splitlines():
            try:
                one = json.loads(line)
            except json.JSONDecodeError:
                continue
            found[one["plant"], one["design"]] = one
    return list(found.values())


def _wanted(name: str, beginnings: list[str]) -> bool:
    return not beginnings or any(name.startswith(one) for one in beginnings)


def try_all(options: argparse.Namespace) -> None:
    """Try what a record lacks, and keep it."""
    part, parts = (int(number) for number in options.part.split("/"))
    options.record.mkdir(parents=True, exist_ok=True)
    done = {(one["plant"], one["design"]) for one in records(options.record)}
    with (options.record / f"part-{part}-of-{parts}.jsonl").open("a", encoding="utf-8") as out:
        out.write("\n")  # after a torn line
        for k, (family, plain) in enumerate(plants(options.data)):
            if k % parts != part - 1 or not _wanted(plain.name, options.plants):
                continue
            plant = with_roles(plain)
            for name in DESIGNS:
                if (plain.name, name) not in done and _wanted(name, options.designs):
                    one = row(family, plant, name)
                    out.write(json.dumps(one) + "\n")
                    out.flush()
                    print(*(one[key] for key in ("plant", "design", "outcome", "textbook", "ms")), flush=True)


# ---------------------------------------------------------------------- tables


def summary(rows: Iterable[Row], key: str, value: str) -> Row:
    """Return the counts of some rows, their leaks and their times."""
    rows = list(rows)
    outcomes = Counter(one["outcome"] for one in rows)
    leaks = [float(one["leak"]) for one in rows if one["leak"]]
    made = [one for one in rows if one["outcome"] in ("made", "near")]
    times = [float(one["ms"]) for one in made if one["states"] <= STATES]
    works = [one for one in rows if one["textbook"] == "works"]
    gains = [float(one["gain"]) for one in made if one["gain"]]
    return {
        key: value,
        "made": outcomes["made"],
        "near": outcomes["near"],
        "refused": outcomes["refused"],
        "none exists": outcomes["none exists"],
        "too long, or crash": outcomes["too long"] + outcomes["crash"],
        "textbook works": len(works),
        "and ours not": sum(one["outcome"] not in ("made", "near") for one in works),
        "median leak": _short(leaks, np.median),
        "largest leak": _short(leaks, max),
        "median gain": _short(gains, np.median),
        "median ms": f"{np.median(times):.0f}" if times else "",
        "largest ms": f"{max(times):.0f}" if times else "",
    }


def _short(values: list[float], of: Callable[[list[float]], Any]) -> str:
    return f"{of(values):.0e}" if values else ""


def checks(rows: Iterable[Row]) -> list[Row]:
    """Return how many designs each check of the evidence refused, and where the textbook works; none are left out."""
    refused = [one for one in rows if one["outcome"] == "refused"]
    counts = Counter(one["check"] for one in refused)
    works = Counter(one["check"] for one in refused if one["textbook"] == "works")
    rooms = {name for name in guards() if name.startswith(("design.", "linear.", "plant."))} | set(counts)
    order = sorted(rooms, key=lambda name: (-counts[name], name))
    return [
        {"check": f"``{name or 'another'}``", "refused": counts[name], "textbook works": works[name]} for name in order
    ]


def _in_a_cell(text: str) -> str:
    """Return a text without the marks of a page."""
    return re.sub(r"([\\*`|_])", r"\\\1", text)


def tables(rows: list[Row], folder: Path) -> None:
    """Write the tables of the documentation."""
    order = {name: k for k, name in enumerate(DESIGNS)}
    families = list(dict.fromkeys(one["family"] for one in rows))
    rows = sorted(rows, key=lambda one: (families.index(one["family"]), one["plant"], order[one["design"]]))
    whole = summary(rows, "design", "all")
    by_design = [summary((one for one in rows if one["design"] == name), "design", name) for name in DESIGNS]
    by_family = [summary((one for one in rows if one["family"] == name), "plants", name) for name in families]
    counted = {one["plants"]: len({r["plant"] for r in rows if r["family"] == one["plants"]}) for one in by_family}
    by_family = [{**one, "plants": f"{one['plants']} ({counted[one['plants']]})"} for one in by_family]
    short = [key for key in rows[0] if key not in ("family", "check")]
    opened = [one for one in rows if one["outcome"] not in ("made", "none exists")]
    opened = [{key: one[key] for key in short} | {"reason": _in_a_cell(one["reason"][:120])} for one in opened]
    for name, table in (
        ("designs_that_exist_all.csv", rows),
        ("designs_that_exist.csv", [*by_design, whole]),
        ("designs_that_exist_families.csv", by_family),
        ("designs_that_exist_refused.csv", opened or [dict.fromkeys(short, "")]),
        ("designs_that_exist_checks.csv", checks(rows)),
    ):
        with (folder / name).open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, table[0], lineterminator="\n")
            writer.writeheader()
            writer.writerows(table)
    for one in [*by_design, whole]:
        print(*one.values(), sep="\t")


def main() -> None:
    """Try designs, or write the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, help="the folder of the SLICOT systems")
    parser.add_argument("--record", type=Path, required=True, help="the folder in which what was tried is kept")
    parser.add_argument("--part", default="1/1", help="which of how many processes this is")
    parser.add_argument("--plants", nargs="*", default=[], help="beginnings of their names")
    parser.add_argument("--designs", nargs="*", default=[], help="beginnings of their names")
    parser.add_argument("--tables", type=Path, help="write the tables there, and try nothing")
    options = parser.parse_args()
    if options.tables:
        tables(records(options.record), options.tables)
    else:
        try_all(options)


if __name__ == "__main__":
    main()
