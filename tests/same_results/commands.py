"""What the commands print and write."""

from __future__ import annotations

import contextlib
import io
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

import residua as rs
from residua.cli import main
from same_results.ledger import Ledger
from same_results.monitors import note_page_text
from same_results.plants import Case, case

#: The methods that the command line has had from the first.
METHODS = (
    *("auto", "robust-detection-filter", "detection-filter", "kalman-filter", "unknown-input-observer"),
    *(
        "luenberger-observer",
        "sensor-fault-bank",
        "actuator-fault-bank",
        "structured-bank",
        "structured-parity",
        "matched-filters",
    ),
    "fault-estimator",
)
#: Generated plants that the commands see.
NUMBERS = range(0, 70, 14)


@contextlib.contextmanager
def _inside(folder: Path) -> Iterator[None]:
    """Work in a folder, so that no path of this machine is printed."""
    before = Path.cwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)


def _said(*argv: str) -> tuple[Any, ...]:
    """Return the exit status of a command, and what it printed."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        status = main([*argv])
    said = (text.getvalue().replace(str(Path.cwd()), "FOLDER") for text in (out, err))
    return status, *said


def measure_commands(ledger: Ledger, folder: Path) -> None:
    """Measure the demos, and every command on a few plants."""
    with _inside(folder):
        for demo in ("jet-engine", "three-tank"):
            ledger.note(f"demo {demo}", "screen", *_said("demo", demo, "-o", demo))
            note_page_text(ledger, f"demo {demo}", Path(demo, f"{demo}.html").read_text(encoding="utf-8"))
        for number in NUMBERS:
            _commands(ledger, case(number), number)
        _run_on(ledger, "three tank by hand", "three-tank/three_tank.toml", "three-tank/normal.csv")


def _commands(ledger: Ledger, one: Case, number: int) -> None:
    """Measure the commands on one plant: what is asked before a design, and designs by turns."""
    name = f"plant{number}.toml"
    rs.plant.save_plant(one.plant, name)
    ledger.note(one.name, "plant file", Path(name).read_text(encoding="utf-8"))
    for command in (["analyze"], ["suggest"] if number % 4 else ["codes", "--quality", "weak"]):
        ledger.note(f"{one.name}/{command[0]}", "screen", *_said(command[0], name, *command[1:]))
    plant = one.plant
    for recording, (u, y) in (("normal", one.normal), ("faulty", one.faulty)):
        header = ",".join(["time", *(f'"{x}"' for x in (*plant.inputs, *plant.outputs))])
        step = plant.dt or 0.05
        rows = np.column_stack([step * np.arange(len(y)), u, y])
        np.savetxt(f"{recording}{number}.csv", rows, delimiter=",", header=header, comments="")
    for k, method in enumerate(METHODS):
        if k % 3 == number % 3:
            step = [] if plant.is_discrete else ["--dt", "0.05"]
            _made(ledger, f"{one.name}/{method}", name, f"normal{number}.csv", f"faulty{number}.csv", method, step)


def _made(
    ledger: Ledger, case_name: str, plant: str, normal: str, faulty: str, method: str, options: list[str]
) -> None:
    """Design, fit and run by commands."""
    said = _said("design", plant, "-o", "made.json", "--method", method, "--isolation-window", "15", *options)
    ledger.note(f"{case_name}/design", "screen", *said)
    if said[0]:
        return
    said = _said("fit", "made.json", normal, "-o", "made.json", "--false-alarm-rate", "0.02")
    ledger.note(f"{case_name}/fit", "screen", *said)
    if said[0]:
        return
    written = ["--report", "made.html", "--alarms", "made.jsonl", "--residuals", "made.csv"]
    said = _said("run", "made.json", faulty, *written)
    ledger.note(f"{case_name}/run", "screen", *said)
    if said[0] < 2:
        note_page_text(ledger, f"{case_name}/run", Path("made.html").read_text(encoding="utf-8"))
        for ending in ("jsonl", "csv"):
            ledger.note(f"{case_name}/run", f".{ending}", re.sub(r"\r", "", Path(f"made.{ending}").read_text("utf-8")))


def _run_on(ledger: Ledger, name: str, plant: str, normal: str) -> None:
    """Measure three methods on the recordings of a demo."""
    for method in ("kalman-filter", "sensor-bank", "matched-filters"):
        _made(ledger, f"{name}/{method}", plant, normal, "three-tank/leak.csv", method, [])
