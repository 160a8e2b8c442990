"""Every observer on every SLICOT benchmark system: it holds, or it is refused with the reason.

Run it with the folder of the data::

    .venv/bin/python benchmarks/observer_table.py --data FOLDER

It writes ``docs/data/observers_on_benchmarks.csv`` (one row per system), ``observers_on_benchmarks_counts.csv`` and
``observers_on_benchmarks_reasons.csv``, and ends with status 1 when a design did neither: raised something else,
warned, failed an independent check (``observer_checks.py``), or took longer than a minute.
"""

from __future__ import annotations

# ruff: noqa: E402
import os

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")  # the designs run side by side, each in a process of its own

import argparse
import csv
import json
import multiprocessing
import sys
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io
import scipy.linalg

sys.path.insert(0, str(Path(__file__).parent))  # for whoever imports this file from elsewhere

from observer_checks import TOLERANCE, Asked, CheckError, check

import residua as rs
from residua.errors import AccuracyError, DesignError

OUTPUT = Path(__file__).resolve().parent.parent / "docs" / "data"
LIMIT = 60.0  # seconds of processor time for a design
PATIENCE = 4.0  # by how much a clock may run ahead of the processor, on a busy machine
MOST_FAULTS = 8
ASKS = ("default", "margin", "poles")


# ------------------------------------------------------------------------ the plants


@lru_cache(maxsize=2)
def system(folder: Path, name: str) -> rs.Plant:
    """Return a benchmark system; the sampled ones have a step of 1."""
    data = scipy.io.loadmat(folder / f"{name}.mat")
    matrices = {key: np.asarray(data[key], dtype=float) for key in "ABCDE"}
    E = matrices["E"]
    return rs.Plant(
        matrices["A"],
        matrices["B"],
        matrices["C"],
        matrices["D"],
        E=None if np.array_equal(E, np.eye(len(E))) else E,
        dt=1.0 if name.startswith("BD02") else 0.0,
        name=name,
    )


def plant_for(kind: str, folder: Path, name: str) -> rs.Plant:
    """Return the plant in the form that a function is tried on.

    ``plain``: without faults. ``faults``: a fault on every actuator and sensor, the first 8 of each kind.
    ``disturbed``: the same, with the first input as disturbance where there are at least two inputs and two outputs.
    ``noise``: unit process and measurement noise. ``few``: at most 6 faults.
    """
    plant = system(folder, name)
    if kind == "disturbed" and len(plant.inputs) > 1 and plant.n_outputs > 1:
        B, D = plant.B, plant.D
        direction = {"u1": (B[:, 0], D[:, 0])}
        plant = rs.Plant(
            plant.A, B[:, 1:], plant.C, D[:, 1:], E=plant.E, dt=plant.dt, name=name, inputs=plant.inputs[1:]
        ).with_disturbances(direction)
    if kind == "noise":
        plant = plant.with_noise(process=1.0, measurement=1.0)
    if kind == "plain":
        return plant
    most = 3 if kind == "few" else MOST_FAULTS
    used = [i for i in range(len(plant.inputs)) if plant.B[:, i].any() or plant.D[:, i].any()]
    return plant.with_actuator_faults(used[:most]).with_sensor_faults(range(min(most, plant.n_outputs)))


def rate(plant: rs.Plant) -> float:
    """Return the geometric mean of the sizes of the plant's nonzero poles in 1/s; half a sample at most."""
    poles = scipy.linalg.eigvals(plant.A, plant.E)
    if plant.dt:
        return 0.5
    sizes = np.abs(poles)
    A = plant.A if plant.E is None else np.linalg.solve(plant.E, plant.A)
    sizes = sizes[sizes > 1e-6 * float(np.linalg.norm(A))]  # the others may be rounding of zero
    return float(np.exp(np.log(sizes).mean())) if sizes.size else 1.0


def pole_list(plant: rs.Plant, count: int) -> tuple[float, ...]:
    """Return real poles, the first of them double: between the plant's mean rate and twice that, or 0.1 to 0.5."""
    if not count:
        return ()
    steps = np.maximum(np.arange(count) - 1, 0) / max(count - 1, 1)
    return tuple(0.1 + 0.4 * steps) if plant.dt else tuple(-rate(plant) * (1 + steps))


# --------------------------------------------------------------------- the functions


@dataclass(frozen=True)
class Function:
    """A design function as it is tried: on which plant, how it is called, and with which requests for poles."""

    title: str
    plant: str
    call: Callable[..., Any]
    asks: tuple[str, ...] = ASKS


def _bank(kind: str, scheme: str) -> Callable[..., Any]:
    return lambda plant, **asked: getattr(rs.design, f"{kind}_fault_bank")(plant, scheme=scheme, **asked)


def _estimator(kind: str) -> Callable[..., Any]:
    def call(plant: rs.Plant, **asked: Any) -> Any:
        names = [fault.name for fault in plant.fault_list if fault.kind == kind]
        return rs.design.fault_estimator(plant, faults=names if kind == "actuator" else names[:1], **asked)

    return call


def _attainable(plant: rs.Plant, **asked: Any) -> Any:
    """Design a row for every fault: it ignores that one, and sees all that the rank conditions let it see."""
    isolable = rs.diagnosability(plant).isolable
    rows = np.unique(isolable.T[isolable.any(axis=0)], axis=0)
    if not len(rows):
        raise DesignError("no structure is attainable: diagnosability says that no fault can be told from another")
    return rs.design.structured_bank(plant, rows, **asked)


def _plain(function: str) -> Callable[..., Any]:
    return lambda plant, **asked: getattr(rs.design, function)(plant, **asked)


def _least(plant: rs.Plant, **asked: Any) -> Any:
    return rs.design.perfect_observer(plant, least_order=True, **asked)


FUNCTIONS = {
    "luenberger_observer": Function("Luenberger", "plain", _plain("luenberger_observer")),
    "reduced_order_observer": Function("reduced-order", "plain", _plain("reduced_order_observer")),
    "unknown_input_observer": Function("unknown-input", "disturbed", _plain("unknown_input_observer")),
    "descriptor_observer": Function("descriptor", "disturbed", _plain("descriptor_observer")),
    "perfect_observer": Function("perfect", "disturbed", _plain("perfect_observer"), ("default",)),
    "perfect_observer, least order": Function("perfect, least order", "plain", _least, ("default",)),
    "fault_estimator, actuators": Function("estimator, all actuators", "faults", _estimator("actuator")),
    "fault_estimator, a sensor": Function("estimator, first sensor", "faults", _estimator("sensor")),
    "sensor_fault_bank, generalized": Function("sensors, generalized", "faults", _bank("sensor", "generalized")),
    "sensor_fault_bank, dedicated": Function("sensors, dedicated", "faults", _bank("sensor", "dedicated")),
    "actuator_fault_bank, generalized": Function("actuators, generalized", "faults", _bank("actuator", "generalized")),
    "actuator_fault_bank, dedicated": Function("actuators, dedicated", "faults", _bank("actuator", "dedicated")),
    "structured_bank": Function("structured bank", "few", _attainable, ("default", "margin")),
    "decoupled_residual": Function("decoupled residual", "disturbed", _plain("decoupled_residual")),
    "kalman_filter": Function("Kalman", "noise", _plain("kalman_filter"), ("default",)),
    "detection_filter": Function("detection filter", "few", _plain("detection_filter")),
    "robust_detection_filter": Function("robust detection filter", "disturbed", _plain("robust_detection_filter")),
}


# ---------------------------------------------------------------------- one outcome


@dataclass(frozen=True)
class Task:
    """One call: a function on a system with a request."""

    system: str
    function: str
    ask: str


@dataclass(frozen=True)
class Outcome:
    """What became of it: ``ok``, ``refused``, or a third thing that must not be."""

    system: str
    function: str
    ask: str
    outcome: str
    identity: float = 0.0
    pole: float = 0.0
    seconds: float = 0.0
    reason: str = ""


def free_poles(made: Any, plant: rs.Plant) -> int:
    """Return how many poles a design let choose."""
    if isinstance(made, rs.design.Observer):
        return made.order - len(made.evidence.fixed_poles)
    if isinstance(made, rs.design.Bank):
        counts = {free_poles(one, plant) for one in made.observers.values()}
        return counts.pop() if len(counts) == 1 else plant.n_states
    if isinstance(made, rs.design.FaultEstimator):
        return free_poles(made.observer, plant)
    if made.method == "decoupled residual":
        return made.system.n_states
    return plant.n_states


def _largest_order(task: Task, plant: rs.Plant) -> int:
    """Return the order of an observer of which nothing is known: n, or n less the independent outputs."""
    reduced = task.function in ("reduced_order_observer", "descriptor_observer")
    return plant.n_states - int(np.linalg.matrix_rank(plant.C)) if reduced else plant.n_states


def request(task: Task, plant: rs.Plant, function: Function) -> Asked:
    """Return the poles or the margin to ask for; the number of poles is found from a design that chose its own."""
    if task.ask == "default":
        return Asked()
    if task.ask == "margin":
        return Asked(margin=0.5 * rate(plant))
    try:
        count = free_poles(function.call(plant), plant)
    except (DesignError, AccuracyError):
        count = _largest_order(task, plant)
    return Asked(poles=pole_list(plant, count))


def attempt(task: Task, folder: Path, tell: Callable[[str], None] = lambda phase: None) -> Outcome:
    """Design and check once, in this process."""
    function = FUNCTIONS[task.function]
    key = (task.system, task.function, task.ask)
    phase = "the plant"
    started, seconds = time.process_time(), 0.0
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            plant = plant_for(function.plant, folder, task.system)
            asked = request(task, plant, function)
            options = (
                {"margin": asked.margin} if asked.margin else {"poles": asked.poles} if task.ask == "poles" else {}
            )
            phase = "design"
            tell(phase)
            started = time.process_time()
            try:
                made = function.call(plant, **options)
            except (DesignError, AccuracyError) as error:
                seconds = time.process_time() - started
                return Outcome(*key, "refused", seconds=seconds, reason=f"{type(error).__name__}: {error}")
            seconds = time.process_time() - started
            phase = "check"
            tell(phase)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = check(made, plant, asked)
        if seconds > LIMIT:
            return Outcome(*key, "third", found.identity, found.pole, seconds, f"took {seconds:.0f} s")
        if found.pole > TOLERANCE:
            return Outcome(*key, "third", found.identity, found.pole, seconds, f"a pole is off by {found.pole:.2g}")
        return Outcome(*key, "ok", found.identity, found.pole, seconds)
    except CheckError as error:
        return Outcome(*key, "third", seconds=seconds, reason=f"check failed: {error}")
    except Exception as error:
        at = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{Path(at.filename).name}:{at.lineno}"
        return Outcome(*key, "third", seconds=seconds, reason=f"{type(error).__name__} in {phase}, {where}: {error}")


# ------------------------------------------------------------------- many, side by side


def _child(task: Task, folder: Path, pipe: Connection) -> None:
    pipe.send(attempt(task, folder, pipe.send))
    pipe.close()


@dataclass
class _Running:
    task: Task
    process: Any
    pipe: Connection
    phase: str
    since: float


def run_all(tasks: Iterable[Task], folder: Path, jobs: int = 2) -> Iterator[Outcome]:
    """Yield the outcome of every task, each in a process of its own with a time limit."""
    method = "fork" if "fork" in multiprocessing.get_all_start_methods() else "spawn"
    context: Any = multiprocessing.get_context(method)
    waiting, running = list(tasks)[::-1], []
    while waiting or running:
        while waiting and len(running) < jobs:
            task = waiting.pop()
            ours, theirs = context.Pipe(duplex=False)
            process = context.Process(target=_child, args=(task, folder, theirs))
            process.start()
            theirs.close()
            running.append(_Running(task, process, ours, "the plant and its order", time.perf_counter()))
        wait([one.pipe for one in running], timeout=1.0)
        for one in list(running):
            outcome = _news(one)
            if outcome is not None:
                one.process.join()
                running.remove(one)
                yield outcome


def _news(one: _Running) -> Outcome | None:
    """Return the outcome of a process when it has one or has run out of time."""
    task = one.task
    try:
        if one.pipe.poll():
            message = one.pipe.recv()
            if isinstance(message, Outcome):
                return message
            one.phase, one.since = message, time.perf_counter()
    except EOFError:
        return Outcome(task.system, task.function, task.ask, "third", reason=f"the process died in {one.phase}")
    spent = time.perf_counter() - one.since
    if spent > PATIENCE * LIMIT:
        one.process.kill()
        return Outcome(
            task.system, task.function, task.ask, "third", seconds=spent, reason=f"{one.phase} took over {spent:.0f} s"
        )
    return None


# ------------------------------------------------------------------------- the tables


def all_tasks(folder: Path, systems: Iterable[str] = (), functions: Iterable[str] = ()) -> list[Task]:
    """Return the calls for the chosen systems and functions, all when none are chosen."""
    names = list(systems) or sorted(path.stem for path in folder.glob("BD*.mat"))
    chosen = list(functions) or list(FUNCTIONS)
    return [Task(name, function, ask) for name in names for function in chosen for ask in FUNCTIONS[function].asks]


def earlier(output: Path = OUTPUT) -> list[Outcome]:
    """Return the outcomes of the last run, as far as the tables keep them."""
    path = output / "observers_on_benchmarks_all.csv"
    if not path.exists():
        return []
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.reader(file))[1:]
    return [
        Outcome(*row[:4], float(row[4] or 0), float(row[5] or 0), float(row[6]), row[7])  # pyright: ignore[reportArgumentType]
        for row in rows
    ]


def write_tables(outcomes: list[Outcome], folder: Path, output: Path = OUTPUT) -> None:
    """Write the CSV files that the documentation shows."""
    output.mkdir(parents=True, exist_ok=True)
    index = {entry["name"]: entry for entry in json.loads((folder / "index.json").read_text(encoding="utf-8"))}
    by_key = {(one.system, one.function, one.ask): one for one in outcomes}
    systems = sorted({one.system for one in outcomes})
    _write(output / "observers_on_benchmarks.csv", _matrix(systems, by_key, index))
    _write(output / "observers_on_benchmarks_counts.csv", _counts(outcomes))
    _write(output / "observers_on_benchmarks_reasons.csv", _reasons(systems, by_key))
    _write(output / "observers_on_benchmarks_all.csv", _everything(systems, by_key))


def _write(path: Path, rows: list[list[Any]]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(rows)


def _matrix(systems: list[str], by_key: dict, index: dict) -> list[list[Any]]:
    """Return one row per system: how many of the requests a function met, of how many."""
    rows: list[list[Any]] = [["system", "n", "m", "p", *(one.title for one in FUNCTIONS.values())]]
    for name in systems:
        facts = index[name]
        cells = []
        for key, function in FUNCTIONS.items():
            found = [by_key[name, key, ask].outcome for ask in function.asks if (name, key, ask) in by_key]
            held = found.count("ok")
            cells.append("ok" if held == len(found) else "-" if not held else f"{held} of {len(found)}")
        rows.append([name, facts["n"], facts["m"], facts["p"], *cells])
    return rows


def _counts(outcomes: list[Outcome]) -> list[list[Any]]:
    rows: list[list[Any]] = [
        ["function", "plant", "calls", "hold", "refused: condition", "refused: accuracy", "neither"]
        + ["worst identity", "worst pole", "slowest (s)"]
    ]
    for key, function in FUNCTIONS.items():
        own = [one for one in outcomes if one.function == key]
        held = [one for one in own if one.outcome == "ok"]
        refused = Counter(one.reason.split(":")[0] for one in own if one.outcome == "refused")
        rows.append(
            [key, function.plant, len(own), len(held), refused["DesignError"], refused["AccuracyError"]]
            + [sum(one.outcome == "third" for one in own)]
            + [f"{max((one.identity for one in held), default=0.0):.0e}"]
            + [f"{max((one.pole for one in held), default=0.0):.0e}"]
            + [f"{max((one.seconds for one in own), default=0.0):.1f}"]
        )
    whole = [sum(int(row[k]) for row in rows[1:]) for k in range(2, 7)]
    rows.append(["all", "", *whole, "", "", ""])
    return rows


def _reasons(systems: list[str], by_key: dict) -> list[list[Any]]:
    """Return the reason of every refusal; once where the requests were refused for the same."""
    rows: list[list[Any]] = [["system", "function", "asked for", "reason"]]
    for name in systems:
        for key, function in FUNCTIONS.items():
            told: dict[str, list[str]] = {}
            for ask in function.asks:
                one = by_key.get((name, key, ask))
                if one is not None and one.outcome != "ok":
                    told.setdefault(one.reason, []).append(ask)
            rows += [[name, key, ", ".join(asks), _cut(reason)] for reason, asks in told.items()]
    return rows


def _everything(systems: list[str], by_key: dict) -> list[list[Any]]:
    rows: list[list[Any]] = [
        ["system", "function", "asked for", "outcome", "identity", "pole error", "seconds", "reason"]
    ]
    for name in systems:
        for key, function in FUNCTIONS.items():
            for ask in function.asks:
                one = by_key.get((name, key, ask))
                if one is not None:
                    numbers = [f"{one.identity:.1e}", f"{one.pole:.1e}"] if one.outcome == "ok" else ["", ""]
                    rows.append([name, key, ask, one.outcome, *numbers, f"{one.seconds:.2f}", _cut(one.reason)])
    return rows


def _cut(reason: str, most: int = 400) -> str:
    """Return a reason without line breaks; long lists of poles are cut."""
    reason = " ".join(reason.split())
    return reason if len(reason) <= most else reason[: most - 3].rsplit(" ", 1)[0] + " ..."


def main(arguments: list[str] | None = None) -> int:
    """Run what the command line asks for; return 1 when something neither held nor was refused."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, help="folder with the .mat files, or the one above it")
    parser.add_argument("--system", action="append", default=[], help="only this system (repeatable)")
    parser.add_argument("--function", action="append", default=[], choices=list(FUNCTIONS), help="only this function")
    parser.add_argument("--update", action="store_true", help="keep the rest of the tables as it is")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    options = parser.parse_args(arguments)
    folder = options.data or Path(os.environ.get("RESIDUA_SHARED_DATA", ""))
    folder = folder / "slicot_benchmarks" if (folder / "slicot_benchmarks").is_dir() else folder
    if not list(folder.glob("BD*.mat")):
        parser.error("no BD*.mat in the folder: give --data or set RESIDUA_SHARED_DATA")
    tasks = all_tasks(folder, options.system, options.function)
    outcomes, begun = [], time.perf_counter()
    for outcome in run_all(tasks, folder, options.jobs):
        outcomes.append(outcome)
        _progress(outcome, len(outcomes), len(tasks), time.perf_counter() - begun)
    whole = not (options.system or options.function)
    if options.update:
        done = {(one.system, one.function, one.ask) for one in outcomes}
        rest = [one for one in earlier() if (one.system, one.function, one.ask) not in done]
        write_tables(outcomes + rest, folder)
    elif whole:
        write_tables(outcomes, folder)
    print(dict(Counter(one.outcome for one in outcomes)))
    third = [one for one in outcomes if one.outcome == "third"]
    for one in third:
        print(f"NEITHER: {one.system} {one.function} {one.ask}: {one.reason}")
    return 1 if third else 0


def _progress(outcome: Outcome, done: int, total: int, spent: float) -> None:
    line = f"{done:>5}/{total} {spent:6.0f} s  {outcome.system} {outcome.function}, {outcome.ask}: {outcome.outcome}"
    if sys.stdout.isatty():
        print(f"\r{line:<110}"[:111], end="" if done < total else "\n", flush=True)
    elif done % 50 == 0 or done == total or outcome.outcome == "third":
        print(line, flush=True)


if __name__ == "__main__":
    sys.exit(main())
