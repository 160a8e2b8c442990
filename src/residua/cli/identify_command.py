"""The command ``identify``: from fault-free recordings to a plant file, and what ``learn`` shares with it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from residua.cli import screen
from residua.cli.checks import check_outputs, check_recordings
from residua.cli.guard import in_cli_words
from residua.cli.recording_options import (
    Columns,
    DayFirst,
    Decimal,
    DecimalMark,
    FillGaps,
    Reading,
    Step,
    TimeColumn,
    TimeFormat,
    Tolerance,
    Transpose,
    Variable,
)
from residua.errors import DataError, SettingError
from residua.identify import IdentifiedModel, subspace
from residua.identify.channel_faults import idle_inputs, with_channel_faults
from residua.monitor.inputs import with_channels
from residua.plant import Plant
from residua.recording.matching import matched_names, missing_columns
from residua.recording.recording import Recording
from residua.report.model_page import write_model_page
from residua.visible import echo, listed
from residua.words import listing

#: The largest part of a recording that may be held out.
_MOST_HELD_OUT = 0.9


class Method(StrEnum):
    """How the states are chosen."""

    pbsid = "pbsid"
    cva = "cva"
    n4sid = "n4sid"
    moesp = "moesp"


def checked_names(text: str | None) -> str | None:
    """Return a list with commas as it is, or raise where a name is empty or there twice."""
    if text is not None:
        parts = parse_names(text)
        twice = next((name for name in parts if parts.count(name) > 1), None)
        if not all(parts) or twice:
            raise typer.BadParameter(f"{echo(twice)} is there twice" if twice else "a name is empty")
    return text


def parse_names(text: str | None) -> list[str]:
    """Return the names of a list with commas."""
    return [] if text is None else [part.strip() for part in text.split(",")]


def _delays(texts: list[str] | None) -> list[str] | None:
    for text in texts or []:
        name, _, rows = text.rpartition("=")
        if not name.strip() or not rows.strip().isdecimal():
            raise typer.BadParameter(f"expected INPUT=ROWS, such as Q1=3, got {echo(text)}")
    return texts


def parse_delays(texts: list[str] | None) -> dict[str, int]:
    """Return the rows by which inputs act late."""
    pairs = [text.rpartition("=") for text in texts or []]
    return {name.strip(): int(rows) for name, _, rows in pairs}


def _units(text: str | None) -> str | None:
    if text is not None and not all(name and unit for name, unit in _pairs(text)):
        raise typer.BadParameter("expected CHANNEL=UNIT,... such as h1=cm,Q1=cm3/s")
    return text


def _pairs(text: str | None) -> list[tuple[str, str]]:
    halves = [part.rpartition("=") for part in text.split(",")] if text else []
    return [(name.strip(), unit.strip()) for name, _, unit in halves]


def _held_out(value: float) -> float:
    if not 0 <= value <= _MOST_HELD_OUT:
        raise typer.BadParameter(f"must be a fraction from 0 to {_MOST_HELD_OUT:g}, got {value:g}")
    return value


Normal = Annotated[
    list[Path], typer.Argument(metavar="NORMAL.csv...", help="Fault-free recordings; each has a start of its own.")
]
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
    typer.Option("--order", min=0, metavar="N", help="States; by an information criterion when omitted."),
]
MaxOrder = Annotated[int | None, typer.Option("--max-order", min=0, metavar="N", help="Largest order to compare.")]
Past = Annotated[
    int | None,
    typer.Option("--past", min=1, metavar="N", help="Rows of the past that a state is made of; chosen when omitted."),
]
HowStates = Annotated[
    Method, typer.Option("--method", help="pbsid is right in closed loop too; the others are for open loop.")
]
Feedthrough = Annotated[bool, typer.Option("--feedthrough", help="An input moves an output within the same row.")]
Delay = Annotated[
    list[str] | None,
    typer.Option("--delay", metavar="INPUT=ROWS", callback=_delays, help="A known delay; one option for each input."),
]
SensorFaults = Annotated[
    bool, typer.Option("--sensor-faults/--no-sensor-faults", help="A fault of every output in the plant.")
]
ActuatorFaults = Annotated[
    bool, typer.Option("--actuator-faults/--no-actuator-faults", help="A fault of every input in the plant.")
]


@dataclass(frozen=True)
class Channels:
    """Which columns are what; outputs that are not named are all other columns of the first recording."""

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
                found, names = matched_names(self.inputs, tuple(one.columns)), tuple(one.columns)
                absent = {name: name for name in self.inputs if name not in found}
                if absent:
                    advice = "give --inputs the names of columns"
                    raise missing_columns(absent, names, path.name, matched=list(found.values()), advice=advice)
                outputs = [name for name in names if name not in found.values()]
                if not outputs:
                    raise DataError(f"{path}: every column is an input; the outputs are what is left")
            recordings.append(with_channels(one, _stand_in(self.inputs, outputs)))
        return recordings


def _stand_in(inputs: Sequence[str], outputs: Sequence[str]) -> Plant:
    """Return a plant that has the channels, and no step: what is read is then these columns and no other."""
    zeros = np.zeros((1, len(inputs))), np.zeros((len(outputs), 1))
    return Plant([[-1.0]], zeros[0], zeros[1], inputs=inputs, outputs=outputs)


def part(one: Recording, start: float, stop: float) -> Recording:
    """Return the rows of a recording from one fraction of its length to another."""
    first, last = (int(np.ceil(fraction * len(one))) for fraction in (start, stop))
    rows = slice(first, last)
    return replace(one, time=one.time[rows], u=one.u[rows], y=one.y[rows])


def fault_text(plant: Plant) -> str:
    """Say which faults the plant has, and which it cannot have."""
    idle = idle_inputs(plant)
    why = f"; none of {listed(idle)}, of which the model finds no effect" if idle else ""
    if not plant.faults:
        return f"no faults in the plant{why}: a design needs some, [[faults]] in the plant file"
    return f"faults: {listing(plant.faults)}{why}"


def identified(data: Sequence[Recording], settings: Mapping[str, Any]) -> IdentifiedModel:
    """Return the model of recordings, and print what it is worth."""
    model = subspace(list(data), **settings)
    screen.say(*map(in_cli_words, str(model.report).splitlines()))
    return model


def identify(
    normal: Normal,
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
    delay: Delay = None,
    held_out: Annotated[
        float,
        typer.Option("--held-out", metavar="PART", callback=_held_out, help="Last part, on which the model is judged."),
    ] = 0.25,
    sensor_faults: SensorFaults = True,
    actuator_faults: ActuatorFaults = True,
    no_faults: Annotated[bool, typer.Option("--no-faults", help="No faults in the plant file.")] = False,
    units: Units = None,
    name: Annotated[str, typer.Option("--name", metavar="NAME", help="Of the plant.")] = "identified",
    time: TimeColumn = None,
    dt: Step = None,
    variable: Variable = None,
    fill_gaps: FillGaps = False,
    tolerance: Tolerance = None,
    day_first: DayFirst = None,
    time_format: TimeFormat = None,
    decimal: DecimalMark = Decimal.point,
    columns: Columns = None,
    transpose: Transpose = False,
) -> None:
    """Identify a plant with its noise from fault-free recordings."""
    check_recordings(normal)
    check_outputs([output, report], normal)
    reading = Reading(time, dt, variable, fill_gaps, tolerance, day_first, time_format, decimal, columns, transpose)
    data = Channels(parse_names(inputs), parse_names(outputs)).read(normal, reading)
    settings = settings_of(data, outputs, order, max_order, past, method, feedthrough, delay, units)
    model = identified(data, settings | {"held_out": held_out, "name": name})
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
    screen.say(fault_text(plant), *(f"written: {path}" for path in written))


def settings_of(
    data: Sequence[Recording],
    outputs: str | None,
    order: int | None,
    max_order: int | None,
    past: int | None,
    method: Method,
    feedthrough: bool,
    delay: list[str] | None,
    units: str | None,
) -> dict[str, Any]:
    """Return options as arguments of :func:`residua.identify.subspace`, where nobody named outputs without these."""
    channels, of = list(data[0].columns), dict(_pairs(units))
    absent = [one for one in of if one not in channels]
    if absent:
        raise SettingError(f"--units: there is no channel {listed(absent)}; there are {listed(channels)}")
    m = data[0].u.shape[1]
    return {
        "inputs": channels[:m],
        "outputs": None if outputs is None else channels[m:],
        "order": "auto" if order is None else order,
        "max_order": max_order,
        "past": "auto" if past is None else past,
        "method": method.value,
        "feedthrough": feedthrough,
        "delays": parse_delays(delay),
        "units": of,
    }
