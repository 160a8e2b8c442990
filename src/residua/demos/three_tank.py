"""Three tanks and a leak: the whole way from a plant file and recordings to the faulty component."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from residua.analysis import diagnosability
from residua.decide import NormThreshold
from residua.demos.outcome import Outcome
from residua.design import kalman_filter
from residua.library import ThreeTankRecording, simulate_three_tank, three_tank as library_tank, three_tank_fault
from residua.monitor import Diagnosis, Monitor
from residua.plant import Plant
from residua.plant.plant_file import FORMAT, load_plant
from residua.report.page import Section, write_demo_page
from residua.report.tables import Table

#: Fault 9 of the benchmark: a hole at the bottom of tank 3 that grows from 200 s on.
NUMBER, ONSET = 9, 200.0
NORMAL_STEPS, STEPS = 12_000, 2001
#: Samples in a row over the threshold that raise an alarm: the leak grows slowly, there is time.
PERSISTENCE = 10
SEEDS = {"normal": 1, "healthy": 2, "leak": 3}


def run(folder: Path) -> Outcome:
    """Write plant file and recordings, fit a monitor, diagnose, and write the page.

    Parameters
    ----------
    folder : Path
        Exists. Besides the page it gets ``three_tank.toml``, ``normal.csv``, ``healthy.csv``, ``leak.csv`` and
        ``tank.json``, for the commands of the command line.

    Returns
    -------
    Outcome
    """
    (folder / "three_tank.toml").write_text(plant_file(library_tank()), encoding="utf-8")
    plant = load_plant(folder / "three_tank.toml")
    fault = three_tank_fault(NUMBER, STEPS, onset=ONSET)
    recordings = {
        "normal": simulate_three_tank(NORMAL_STEPS, seed=SEEDS["normal"]),
        "healthy": simulate_three_tank(STEPS, seed=SEEDS["healthy"]),
        "leak": simulate_three_tank(STEPS, faults=fault, seed=SEEDS["leak"]),
    }
    for name, recording in recordings.items():
        _write_csv(recording, plant, folder / f"{name}.csv")
    monitor = Monitor(kalman_filter(plant), test=NormThreshold(persistence=PERSISTENCE))
    normal = recordings["normal"]
    monitor.fit(normal.u, normal.y, time=normal.time)
    monitor.save(folder / "tank.json")
    healthy, leak = (_diagnose(monitor, recordings[name], f"{name}.csv") for name in ("healthy", "leak"))
    (actual,) = fault
    table = _candidates(leak)
    lines = (*_lines(monitor, healthy, leak, actual), *_commands(folder))
    page = write_demo_page(
        [
            Section("The diagnosis in short", paragraphs=lines, table=table),
            Section("A leak in tank 3", diagnosis=leak, actual=actual),
            Section("A healthy recording", diagnosis=healthy, actual=()),
        ],
        folder / "three-tank.html",
        "Three tanks: what has failed?",
        introduction=_INTRODUCTION,
    )
    groups = diagnosability(plant).groups
    return Outcome(lines, (table,), page, surprises(healthy, leak, actual, groups))


def surprises(healthy: Diagnosis, leak: Diagnosis, actual: str, groups: tuple[tuple[str, ...], ...]) -> tuple[str, ...]:
    """Return what came out otherwise than it should."""
    out = []
    if healthy.false_alarm_fraction > 0.01:
        out.append(f"{healthy.false_alarm_fraction:.2%} of the healthy samples are in alarm")
    if leak.onset is not None and leak.onset < ONSET:
        out.append(f"the alarm begins at {leak.onset:g} s, before the leak at {ONSET:g} s")
    twins = next((group for group in groups if actual in group), (actual,))
    if not leak.candidates or not set(leak.candidates[0].faults) & set(twins):
        named = leak.candidates[0].name if leak.candidates else "nothing"
        out.append(f"the monitor names {named}, {actual} was expected")
    return tuple(out)


_INTRODUCTION = (
    "Three connected tanks, two pumps, level controllers that hide faults, and noise: the published nonlinear model of "
    "the Amira DTS200 laboratory plant, simulated with fixed seeds. The monitor knows only the linearised model in "
    f"three_tank.toml and a fault-free recording. At t = {ONSET:g} s a hole begins to grow at the bottom of tank 3.",
)


def _diagnose(monitor: Monitor, recording: ThreeTankRecording, source: str) -> Diagnosis:
    found = monitor.run(recording.u, recording.y, time=recording.time, source=source)
    assert isinstance(found, Diagnosis)
    return found


def _candidates(leak: Diagnosis) -> Table:
    rows = [[k, c.name, round(c.score, 4), round(c.distance, 4)] for k, c in enumerate(leak.candidates, 1)]
    return Table(["rank", "candidate", "score", "distance"], rows, caption="Candidates of the longest alarm")


def _lines(monitor: Monitor, healthy: Diagnosis, leak: Diagnosis, actual: str) -> tuple[str, ...]:
    main = leak.main_alarm
    if main is None:
        outcome = f"Leak: no fault was found, though {actual} is there from {ONSET:g} s on."
    else:
        named = main.candidates[0].name if main.candidates else "nothing"
        outcome = (
            f"Leak ({actual}, from {ONSET:g} s on): alarm raised at {main.raised:g} s, "
            f"{main.raised - ONSET:g} s after it began; the monitor names {named}."
        )
    return (
        f"Threshold {monitor.threshold:.4g}: {monitor.norm_test.basis}.",
        f"Healthy recording: {healthy.false_alarm_fraction:.2%} of {int(healthy.decided.sum())} judged samples "
        "in alarm.",
        outcome,
        *(f"This monitor cannot tell apart: {', '.join(group)}." for group in leak.groups if len(group) > 1),
    )


def _commands(folder: Path) -> tuple[str, ...]:
    return (
        f"The same by hand, in {folder}: "
        f"residua design three_tank.toml -o tank.json --persistence {PERSISTENCE}; "
        "residua fit tank.json normal.csv -o tank.json; residua run tank.json leak.csv --report leak.html",
    )


def _write_csv(recording: ThreeTankRecording, plant: Plant, path: Path) -> None:
    header = ",".join(["time", *plant.inputs, *plant.outputs])
    rows = np.column_stack([recording.time, recording.u, recording.y])
    np.savetxt(path, rows, delimiter=",", fmt="%.10g", header=header, comments="")


def plant_file(plant: Plant) -> str:
    """Return a plant without disturbances as the text of a plant file.

    Parameters
    ----------
    plant : Plant
        With diagonal noise covariances and no ``E``.

    Returns
    -------
    str
    """
    lines = [f'format = "{FORMAT}"', f"name = {json.dumps(plant.name)}", f"dt = {plant.dt!r}", "", "[matrices]"]
    lines += [f"{key} = {_numbers(M)}" for key, M in zip("ABC", (plant.A, plant.Bu, plant.C), strict=True)]
    point = plant.operating_point
    for group, names, values in (
        ("inputs", plant.inputs, point.inputs),
        ("outputs", plant.outputs, point.outputs),
        ("states", plant.states, None),
    ):
        lines += ["", f"[{group}]", f"names = {json.dumps(names)}"]
        lines.append(f"units = {json.dumps([plant.units.get(name, '') for name in names])}")
        if values is not None:
            lines.append(f"operating_point = {_numbers(np.array(values))}")
    lines += ["", "[noise]", f"process = {_numbers(np.diag(plant.process_noise))}"]
    lines.append(f"measurement = {_numbers(np.diag(plant.measurement_noise))}")
    for i, fault in enumerate(plant.fault_list):
        lines += ["", "[[faults]]"]
        lines += [f"{key} = {json.dumps(getattr(fault, key))}" for key in ("name", "kind", "component")]
        lines += [f"state = {_numbers(plant.Bf[:, i])}", f"output = {_numbers(plant.Df[:, i])}"]
    return "\n".join(lines) + "\n"


def _numbers(values: NDArray[np.float64]) -> str:
    return json.dumps(values.tolist())
