"""The command ``learn``: from fault-free recordings to a monitor, with a check on rows that nothing of it has seen."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from residua.cli import screen
from residua.cli.checks import Average, FalseAlarmRate, Persistence, check_outputs, check_recordings, settings_of_test
from residua.cli.design_command import thresholds
from residua.cli.guard import in_cli_words, warn
from residua.cli.identify_command import (
    ActuatorFaults,
    Channels,
    Delay,
    Feedthrough,
    HowStates,
    Inputs,
    MaxOrder,
    Method,
    Normal,
    Order,
    Outputs,
    Past,
    SensorFaults,
    Units,
    fault_text,
    identified,
    parse_names,
    part,
    settings_of,
    with_fault_list,
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
from residua.design import kalman_filter
from residua.monitor import Monitor
from residua.recording.recording import Recording

#: Of each recording: where the model's part ends, and where that of the threshold ends; the rest is the check.
_MODEL, _THRESHOLD = 0.5, 0.75
#: Rows for each output from which on a threshold is fitted on rows that the model is not from: with them the covariance
#: of the residuals is known to a tenth.
_ENOUGH = 100


def learn(
    normal: Normal,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="MONITOR.json", help="Monitor to write.")],
    inputs: Inputs = None,
    outputs: Outputs = None,
    order: Order = None,
    max_order: MaxOrder = None,
    past: Past = None,
    method: HowStates = Method.pbsid,
    feedthrough: Feedthrough = False,
    delay: Delay = None,
    sensor_faults: SensorFaults = True,
    actuator_faults: ActuatorFaults = True,
    false_alarm_rate: FalseAlarmRate = None,
    persistence: Persistence = None,
    average: Average = None,
    units: Units = None,
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
    """Learn a monitor from fault-free recordings: identify a plant, design its Kalman filter, fit, check.

    The model is from the first half of each recording, the threshold from the next quarter, where that is long enough,
    and the last quarter is for the check alone.
    """
    check_recordings(normal)
    check_outputs([output], normal)
    reading = Reading(time, dt, variable, fill_gaps, tolerance, day_first, time_format, decimal, columns, transpose)
    data = Channels(parse_names(inputs), parse_names(outputs)).read(normal, reading)
    settings = settings_of(data, order, max_order, past, method, feedthrough, delay, units)
    before = [part(one, 0.0, _THRESHOLD) for one in data]
    model = identified(before, settings | {"held_out": 1 - _MODEL / _THRESHOLD})
    plant = with_fault_list(model.plant, sensors=sensor_faults, actuators=actuator_faults)
    monitor = Monitor(kalman_filter(plant), test=settings_of_test(persistence, average, false_alarm_rate))
    rows = _fit(monitor, data)
    monitor.save(output)
    check = monitor.fit_check
    assert check is not None
    screen.say(
        fault_text(plant),
        rows,
        in_cli_words(f"{thresholds(monitor)}: {monitor.norm_test.basis}"),
        check.false_alarms,
        f"written: {output}",
    )
    for note in check.notes:
        warn(in_cli_words(note))
    if check.held_out is None:
        warn("too few samples of the last quarter can be judged, so the monitor is unchecked: give longer recordings")


def _fit(monitor: Monitor, data: Sequence[Recording]) -> str:
    """Fit the threshold, hold the last quarter of each recording out as the check, and say on which rows."""
    unseen = [part(one, _MODEL, _THRESHOLD) for one in data]
    complete = [int(np.isfinite(np.hstack([one.u, one.y])).all(axis=1).sum()) for one in unseen]
    needed = _ENOUGH * monitor.design.plant.n_outputs
    if sum(complete) >= needed and min(complete) > 2 * monitor.settling_samples:
        monitor.fit([part(one, _MODEL, 1.0) for one in data], held_out=(1 - _THRESHOLD) / (1 - _MODEL))
        return f"threshold from {sum(complete)} rows that the model is not from, the third quarter of each recording"
    monitor.fit(list(data), held_out=1 - _THRESHOLD)
    return (
        "threshold from all rows before the last quarter, those of the model included: its own are judged too well, "
        f"but {sum(complete)} others are fewer than {needed}, or too few in a recording for the filter to settle"
    )
