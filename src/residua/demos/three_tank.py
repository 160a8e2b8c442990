"""Three tanks and a leak: all steps from a plant file and recordings to the faulty component."""

from __future__ import annotations

from pathlib import Path

from numpy.typing import NDArray

from residua.analysis import diagnosability
from residua.demos.outcome import Outcome
from residua.design import kalman_filter
from residua.library import SimulatedRecording, simulate_three_tank, three_tank as library_tank, three_tank_fault
from residua.monitor import Diagnosis, Monitor
from residua.plant import Plant, load_plant, save_plant
from residua.recording.table_writer import write_table
from residua.report.page import Section, write_demo_page

#: Fault 9 of the benchmark: a hole at the bottom of tank 3 that grows from 200 s on.
NUMBER, ONSET = 9, 200.0
NORMAL_STEPS, STEPS = 40_000, 2001
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
    plant = load_plant(save_plant(library_tank(), folder / "three_tank.toml"))
    fault = three_tank_fault(NUMBER, STEPS, onset=ONSET)
    recordings = {
        "normal": simulate_three_tank(NORMAL_STEPS, seed=SEEDS["normal"]),
        "healthy": simulate_three_tank(STEPS, seed=SEEDS["healthy"]),
        "leak": simulate_three_tank(STEPS, faults=fault, seed=SEEDS["leak"]),
    }
    for name, recording in recordings.items():
        write_table(folder / f"{name}.csv", _columns(recording, plant))
    monitor = Monitor(kalman_filter(plant))
    normal = recordings["normal"]
    monitor.fit(normal.u, normal.y, time=normal.time)
    monitor.save(folder / "tank.json")
    healthy, leak = (_diagnose(monitor, recordings[name], f"{name}.csv") for name in ("healthy", "leak"))
    (actual,) = fault
    alike = diagnosability(plant).groups
    lines = _lines(healthy, leak, actual, alike)
    page = write_demo_page(
        [
            Section("A leak in tank 3", diagnosis=leak, actual=actual),
            Section("A healthy recording", diagnosis=healthy, actual=()),
            Section("The same from the command line", paragraphs=f"In {folder}:", commands=_COMMANDS),
        ],
        folder / "three-tank.html",
        "Three tanks: what has failed?",
        introduction=(*lines, _INTRODUCTION),
    )
    by_hand = (f"The same from the command line, in {folder}:", *(f"  {command}" for command in _COMMANDS))
    return Outcome((*lines, *by_hand), (), page, surprises(healthy, leak, actual, alike))


def surprises(healthy: Diagnosis, leak: Diagnosis, actual: str, groups: tuple[tuple[str, ...], ...]) -> tuple[str, ...]:
    """Return the results that differ from the expected ones."""
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


_COMMANDS = (
    "residua design three_tank.toml -o tank.json",
    "residua fit tank.json normal.csv -o tank.json",
    "residua run tank.json leak.csv --report leak.html",
)
_INTRODUCTION = (
    "The recordings are simulated with the published nonlinear model of the Amira DTS200 laboratory plant, whose level "
    "controllers hide faults. The monitor has only the linearised model in three_tank.toml and normal.csv."
)


def _columns(recording: SimulatedRecording, plant: Plant) -> dict[str, NDArray]:
    channels = dict(zip((*plant.inputs, *plant.outputs), (*recording.u.T, *recording.y.T), strict=True))
    return {"time": recording.time} | channels


def _diagnose(monitor: Monitor, recording: SimulatedRecording, source: str) -> Diagnosis:
    found = monitor.run(recording.u, recording.y, time=recording.time, source=source)
    assert isinstance(found, Diagnosis)
    return found


def _lines(healthy: Diagnosis, leak: Diagnosis, actual: str, groups: tuple[tuple[str, ...], ...]) -> tuple[str, ...]:
    alarm = leak.main_alarm
    found = "no fault found"
    if alarm is not None:
        named = alarm.candidates[0].name if alarm.candidates else "no name"
        word = f" ({alarm.word.kind})" if alarm.word else ""
        found = f"{named}{word}; alarm at {alarm.raised:g} s, {alarm.raised - ONSET:g} s after the leak began"
    quiet = f"{healthy.false_alarm_fraction:.2%} of {int(healthy.decided.sum())} samples in alarm"
    alike = "; ".join(" = ".join(group) for group in groups if len(group) > 1)
    return (
        "Three tanks joined by pipes, two pumps, three level sensors. Which component fails?",
        f"Truth in leak.csv:  {actual}, a hole at the bottom of tank 3 that grows from {ONSET:g} s on",
        f"Diagnosis:          {found}",
        f"healthy.csv:        {quiet}",
        f"Look alike:         {alike} (no method tells them apart here)",
    )
