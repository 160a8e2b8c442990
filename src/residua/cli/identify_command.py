"""The command ``identify``, and the options of models that ``learn`` shares."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from residua.cli import screen
from residua.cli.guard import in_cli_words
from residua.cli.recording_options import Reading, with_reading
from residua.cli.shared_options import AsJson, NormalFiles, check_outputs, check_recordings
from residua.errors import DataError, SettingError
from residua.identify import subspace
from residua.identify.fit_report import FitReport
from residua.identify.identified_model import idle_inputs, with_channel_faults
from residua.monitor.inputs import with_channels
from residua.plant import Plant
from residua.recording.matching import required_columns
from residua.recording.recording import Recording
from residua.report.model_page import write_model_page
from residua.visible import echo, listed
from residua.words import listing

#: The largest part of a recording that may be held out.
_MOST_HELD_OUT = 0.9


class Method(StrEnum):
    """Subspace method for the states."""

    pbsid = "pbsid"
    cva = "cva"
    n4sid = "n4sid"
    moesp = "moesp"


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


def _delays(text: str | None) -> str | None:
    if not all(name and rows.isdecimal() for name, rows in _pairs(text)):
        raise typer.BadParameter(f"expected INPUT=ROWS,... such as Q1=3, got {echo(text)}")
    return text


def _units(text: str | None) -> str | None:
    if not all(name and unit for name, unit in _pairs(text)):
        raise typer.BadParameter("expected CHANNEL=UNIT,... such as h1=cm,Q1=cm3/s")
    return text


def _pairs(text: str | None) -> list[tuple[str, str]]:
    halves = [part.rpartition("=") for part in text.split(",")] if text else []
    return [(name.strip(), value.strip()) for name, _, value in halves]


def _held_out(value: float) -> float:
    if not 0 <= value <= _MOST_HELD_OUT:
        raise typer.BadParameter(f"must be a fraction from 0 to {_MOST_HELD_OUT:g}, got {value:g}")
    return value


Inputs = Annotated[
    str | None, typer.Option("--inputs", metavar="LIST", callback=checked_names, help="Columns that drive the plant.")
]
Outputs = Annotated[
    str | None,
    typer.Option(
        "--outputs", metavar="LIST", callback=checked_names, help="Measured columns; all others when omitted."
    ),
]
Units = Annotated[
    str | None, typer.Option("--units", metavar="LIST", callback=_units, help="CHANNEL=UNIT,... for tables and charts.")
]
Order = Annotated[
    int | None,
    typer.Option("--order", min=0, metavar="N", help="Number of states; by an information criterion when omitted."),
]
MaxOrder = Annotated[int | None, typer.Option("--max-order", min=0, metavar="N", help="Largest order to compare.")]
Past = Annotated[
    int | None,
    typer.Option("--past", min=1, metavar="N", help="Past rows from which a state is made; chosen when omitted."),
]
HowStates = Annotated[
    Method, typer.Option("--method", help="pbsid holds in closed loop too; the others are for open loop.")
]
Feedthrough = Annotated[bool, typer.Option("--feedthrough", help="An input acts on an output within the same row.")]
Delays = Annotated[
    str | None,
    typer.Option("--delays", metavar="LIST", callback=_delays, help="INPUT=ROWS,... for inputs with a known delay."),
]
SensorFaults = Annotated[
    bool, typer.Option("--sensor-faults/--no-sensor-faults", help="A fault of every output in the plant.")
]
ActuatorFaults = Annotated[
    bool, typer.Option("--actuator-faults/--no-actuator-faults", help="A fault of every input in the plant.")
]


@dataclass(frozen=True)
class Channels:
    """Columns of inputs and outputs; without outputs, all other columns of the first recording."""

    inputs: list[str]
    outputs: list[str]

    def read(self, paths: Sequence[Path], reading: Reading) -> list[Recording]:
        """Return the recordings, with the inputs in ``u`` and the outputs in ``y``."""
        both = sorted(set(self.inputs) & set(self.outputs))
        if both:
            them = "it" if len(both) == 1 else "them"
            raise SettingError(f"{listed(both)} cannot be an input and an output: leave {them} out of one")
        outputs, recordings = self.outputs, []
        for path in paths:
            one = reading.read_channels(path, _stand_in(self.inputs, outputs) if outputs else None)
            if not outputs:
                advice = "give --inputs the names of columns"
                found = required_columns(self.inputs, tuple(one.columns), path.name, advice=advice)
                outputs = [name for name in one.columns if name not in found.values()]
                if not outputs:
                    raise DataError(f"{path}: every column is an input; leave the outputs out of --inputs")
            recordings.append(with_channels(one, _stand_in(self.inputs, outputs)))
        return recordings


def _stand_in(inputs: Sequence[str], outputs: Sequence[str]) -> Plant:
    """Return a plant with these channels and no step, so that only these columns are read."""
    zeros = np.zeros((1, len(inputs))), np.zeros((len(outputs), 1))
    return Plant([[-1.0]], zeros[0], zeros[1], inputs=inputs, outputs=outputs)


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


@with_reading
def identify(
    normal: NormalFiles,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="PLANT.toml", help="Plant file to write.")],
    inputs: Inputs = None,
    outputs: Outputs = None,
    report: Annotated[
        Path | None, typer.Option("--report", metavar="FIT.html", help="Write a page with charts.")
    ] = None,
    order: Order = None,
    max_order: MaxOrder = None,
    past: Past = None,
    method: HowStates = Method.pbsid,
    feedthrough: Feedthrough = False,
    delays: Delays = None,
    held_out: Annotated[
        float,
        typer.Option("--held-out", metavar="PART", callback=_held_out, help="Last part, which only checks the model."),
    ] = 0.25,
    sensor_faults: SensorFaults = True,
    actuator_faults: ActuatorFaults = True,
    no_faults: Annotated[bool, typer.Option("--no-faults", help="No faults in the plant file.")] = False,
    units: Units = None,
    name: Annotated[str, typer.Option("--name", metavar="NAME", help="Name of the plant.")] = "identified",
    as_json: AsJson = False,
    *,
    reading: Reading,
) -> None:
    """Identify a plant with its noise from fault-free recordings."""
    check_recordings(normal)
    check_outputs([output, report], normal)
    data = Channels(parse_names(inputs), parse_names(outputs)).read(normal, reading)
    settings = settings_of(data, outputs, order, max_order, past, method, feedthrough, delays, units)
    model = subspace(data, **settings, held_out=held_out, name=name)
    plant = with_channel_faults(
        model.plant, sensors=sensor_faults and not no_faults, actuators=actuator_faults and not no_faults
    )
    plant.to_toml(output)
    written = [output]
    if report is not None:
        last = [part(one, 1 - held_out, 1) for one in data]
        shown = [one for one in last if np.isfinite(np.hstack([one.u, one.y])).all(axis=1).any()]
        told = replace(model.report, notes=tuple(map(in_cli_words, model.report.notes)))
        write_model_page(replace(model, report=told), shown or data, report)
        written.append(report)
    if as_json:
        screen.print_json({**report_values(model.report), "faults": plant.faults, "written": written})
        return
    screen.say(*map(in_cli_words, str(model.report).splitlines()), fault_text(plant))
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


def settings_of(
    data: Sequence[Recording],
    outputs: str | None,
    order: int | None,
    max_order: int | None,
    past: int | None,
    method: Method,
    feedthrough: bool,
    delays: str | None,
    units: str | None,
) -> dict[str, Any]:
    """Return options as arguments of :func:`residua.identify.subspace`, without those of unnamed outputs."""
    channels, of = list(data[0].columns), dict(_pairs(units))
    absent = [one for one in of if one not in channels]
    if absent:
        raise SettingError(f"--units: no channel {listed(absent)}; the channels are {listed(channels)}")
    m = data[0].u.shape[1]
    return {
        "inputs": channels[:m],
        "outputs": None if outputs is None else channels[m:],
        "order": "auto" if order is None else order,
        "max_order": max_order,
        "past": "auto" if past is None else past,
        "method": method.value,
        "feedthrough": feedthrough,
        "delays": {name: int(rows) for name, rows in _pairs(delays)},
        "units": of,
    }
