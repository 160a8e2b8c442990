"""The command ``learn``: from fault-free recordings to a monitor, with a check on rows that nothing of it has seen."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from residua.cli import screen
from residua.cli.checks import FalseAlarmRate, check_outputs, check_recordings
from residua.cli.guard import in_cli_words, warn
from residua.cli.identify_command import (
    ActuatorFaults,
    Channels,
    Delay,
    Feedthrough,
    HowStates,
    MaxOrder,
    Method,
    Normal,
    Order,
    Outputs,
    Past,
    SensorFaults,
    Units,
    checked_names,
    fault_text,
    parse_names,
    settings_of,
)
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
from residua.monitor import learn as learn_monitor


class Form(StrEnum):
    """The form of the relations between channels, or a route without them."""

    auto = "auto"
    static = "static"
    curve = "curve"
    lags = "lags"
    horizon = "horizon"
    innovation = "innovation"
    variates = "variates"


def learn(
    normal: Normal,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="MONITOR.json", help="Monitor to write.")],
    inputs: Annotated[
        str | None,
        typer.Option("--inputs", metavar="LIST|none", help="Columns that drive the plant; guessed when omitted."),
    ] = None,
    outputs: Outputs = None,
    order: Order = None,
    max_order: MaxOrder = None,
    past: Past = None,
    method: HowStates = Method.pbsid,
    feedthrough: Feedthrough = False,
    delay: Delay = None,
    form: Annotated[
        Form, typer.Option("--form", help="How channels are compared with each other; by a check when omitted.")
    ] = Form.auto,
    sensor_faults: SensorFaults = True,
    actuator_faults: ActuatorFaults = True,
    false_alarm_rate: FalseAlarmRate = None,
    units: Units = None,
    force: Annotated[
        bool, typer.Option("--force", help="Write a monitor of which nothing can be expected too.")
    ] = False,
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
    """Learn a monitor from fault-free recordings: identify a plant, compare channels, check, fit.

    The last quarter of each recording is a check of all that was made of the rest: it chooses how channels are
    compared, by false alarms and by faults put into it, and raises thresholds that it exceeds. Then all rows are used.
    """
    check_recordings(normal)
    check_outputs([output], normal)
    reading = Reading(time, dt, variable, fill_gaps, tolerance, day_first, time_format, decimal, columns, transpose)
    named = [] if inputs in (None, "none") else parse_names(checked_names(inputs))
    data = Channels(named, parse_names(outputs)).read(normal, reading)
    options = settings_of(data, outputs, order, max_order, past, method, feedthrough, delay, units)
    channels = {name: options.pop(name) for name in ("inputs", "outputs")}
    learnt = learn_monitor(
        data,
        **({} if inputs is None else channels),
        false_alarm_rate=false_alarm_rate,
        form=form.value,
        sensor_faults=sensor_faults,
        actuator_faults=actuator_faults,
        force=force,
        model=options,
    )
    learnt.monitor.save(output)
    check = learnt.monitor.fit_check
    assert check is not None
    report = str(learnt.report).splitlines() if learnt.report is not None else []
    screen.say(*map(in_cli_words, report))
    screen.say(*map(in_cli_words, learnt.notes))
    screen.say(*map(in_cli_words, learnt.lines), fault_text(learnt.monitor.design.plant), check.false_alarms)
    screen.show_visible(check)
    screen.say(f"written: {output}")
    for note in check.notes:
        warn(in_cli_words(note))
