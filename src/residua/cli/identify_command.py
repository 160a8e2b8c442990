"""The command ``identify``, and the options of models that ``learn`` shares."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from residua.cli import screen
from residua.cli.call_options import MODEL, READ, Model, Read
from residua.cli.guard import in_cli_words
from residua.cli.recordings import read_channels
from residua.cli.shared_options import AsJson, NormalFiles, check_outputs, check_recordings
from residua.errors import SettingError
from residua.identify import subspace
from residua.identify.fit_report import FitReport
from residua.identify.identified_model import idle_inputs, with_channel_faults
from residua.plant import Plant
from residua.recording.recording import Recording
from residua.report.model_page import write_model_page
from residua.visible import echo, listed
from residua.words import listing


def checked_names(text: str | None) -> str | None:
    """Return a list with commas unchanged, or raise if a name is empty or repeated."""
    if text is not None:
        parts = parse_names(text)
        twice = next((name for name in parts if parts.count(name) > 1), None)
        if not all(parts) or twice:
            raise typer.BadParameter(f"{echo(twice)} occurs twice" if twice else "a name is empty")
    return text


def parse_names(text: str | None) -> list[str]:
    """Return the names of a list with commas."""
    return [] if text is None else [part.strip() for part in text.split(",")]


Inputs = Annotated[
    str | None, typer.Option("--inputs", metavar="LIST", callback=checked_names, help="Columns that drive the plant.")
]
Outputs = Annotated[
    str | None,
    typer.Option(
        "--outputs", metavar="LIST", callback=checked_names, help="Measured columns; all others when omitted."
    ),
]
SensorFaults = Annotated[
    bool, typer.Option("--sensor-faults/--no-sensor-faults", help="A fault of every output in the plant.")
]
ActuatorFaults = Annotated[
    bool, typer.Option("--actuator-faults/--no-actuator-faults", help="A fault of every input in the plant.")
]


def part(one: Recording, start: float, stop: float) -> Recording:
    """Return the rows of a recording from one fraction of its length to another."""
    first, last = (int(np.ceil(fraction * len(one))) for fraction in (start, stop))
    rows = slice(first, last)
    return replace(one, time=one.time[rows], u=one.u[rows], y=one.y[rows])


def fault_text(plant: Plant) -> str:
    """Return a line on the faults of a plant, and the inputs without one."""
    idle = idle_inputs(plant)
    why = f"; none of {listed(idle)}, which has no effect in the model" if idle else ""
    if not plant.faults:
        return f"no faults in the plant{why}: add [[faults]] to the plant file before a design"
    return f"faults: {listing(plant.faults)}{why}"


def identify(
    normal: NormalFiles,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="PLANT.toml", help="Plant file to write.")],
    inputs: Inputs = None,
    outputs: Outputs = None,
    report: Annotated[
        Path | None, typer.Option("--report", metavar="FIT.html", help="Write a page with charts.")
    ] = None,
    sensor_faults: SensorFaults = True,
    actuator_faults: ActuatorFaults = True,
    no_faults: Annotated[bool, typer.Option("--no-faults", help="No faults in the plant file.")] = False,
    model: Model = None,
    as_json: AsJson = False,
    read: Read = None,
) -> None:
    """Identify a plant with its noise from fault-free recordings."""
    check_recordings(normal)
    check_outputs([output, report], normal)
    data = read_channels(normal, parse_names(inputs), parse_names(outputs), READ.values(read))
    settings = checked_model(MODEL.values(model), data)
    found = subspace(data, **channels_of(data, outputs), **settings)
    plant = with_channel_faults(
        found.plant, sensors=sensor_faults and not no_faults, actuators=actuator_faults and not no_faults
    )
    plant.to_toml(output)
    written = [output]
    if report is not None:
        held_out = settings.get("held_out", MODEL.options["held_out"].default)
        last = [part(one, 1 - held_out, 1) for one in data]
        shown = [one for one in last if np.isfinite(np.hstack([one.u, one.y])).all(axis=1).any()]
        in_words = replace(found.report, notes=tuple(map(in_cli_words, found.report.notes)))
        write_model_page(replace(found, report=in_words), shown or data, report)
        written.append(report)
    if as_json:
        screen.print_json({**report_values(found.report), "faults": plant.faults, "written": written})
        return
    screen.say(*map(in_cli_words, str(found.report).splitlines()), fault_text(plant))
    screen.say(*(f"written: {path}" for path in written))


def report_values(report: FitReport) -> dict[str, Any]:
    """Return the report of a model as values for JSON."""
    facts = report.held_out or report.fitted
    simulated = facts.simulated_fit
    return {
        "model": {
            "method": report.method,
            "order": len(report.poles),
            "dt": report.dt,
            "samples": report.samples,
            "poles": report.poles,
            "held_out": report.held_out is not None,
            "outputs": [
                {
                    "output": name,
                    "error": facts.error[k],
                    "fit": facts.fit[k],
                    "simulated_fit": None if simulated is None else simulated[k],
                }
                for k, name in enumerate(report.outputs)
            ],
            "remarks": [in_cli_words(line) for line in report.remarks],
        },
        "inputs": report.inputs,
        "outputs": report.outputs,
    }


def channels_of(data: Sequence[Recording], outputs: str | None) -> dict[str, Any]:
    """Return the channels of recordings as arguments of a call, without outputs that were not named."""
    channels, m = list(data[0].columns), data[0].u.shape[1]
    return {"inputs": channels[:m], "outputs": None if outputs is None else channels[m:]}


def checked_model(model: dict[str, Any], data: Sequence[Recording]) -> dict[str, Any]:
    """Return the arguments of a model, or raise if a unit is for no channel."""
    channels = list(data[0].columns)
    absent = [one for one in model.get("units", ()) if one not in channels]
    if absent:
        raise SettingError(f"--model units=: no channel {listed(absent)}; the channels are {listed(channels)}")
    return model
