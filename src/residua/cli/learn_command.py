"""The command ``learn``: a monitor from fault-free recordings, checked on held-out rows."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from residua.cli import screen
from residua.cli.call_options import MODEL, READ, Model, Read
from residua.cli.fit_command import check_values, show_visible
from residua.cli.guard import in_cli_words, warn
from residua.cli.identify_command import (
    ActuatorFaults,
    Outputs,
    SensorFaults,
    channels_of,
    checked_model,
    checked_names,
    fault_text,
    parse_names,
    report_values,
)
from residua.cli.recordings import read_channels
from residua.cli.shared_options import AsJson, FalseAlarmRate, NormalFiles, check_outputs, check_recordings
from residua.monitor import learn as learn_monitor
from residua.monitor.learning import ROUTES


def learn(
    normal: NormalFiles,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="MONITOR.json", help="Monitor to write.")],
    inputs: Annotated[
        str | None,
        typer.Option("--inputs", metavar="LIST|none", help="Columns that drive the plant; guessed when omitted."),
    ] = None,
    outputs: Outputs = None,
    form: Annotated[
        str, typer.Option("--form", metavar="|".join(ROUTES), help="Relations between channels; chosen when omitted.")
    ] = "auto",
    sensor_faults: SensorFaults = True,
    actuator_faults: ActuatorFaults = True,
    false_alarm_rate: FalseAlarmRate = None,
    model: Model = None,
    force: Annotated[
        bool, typer.Option("--force", help="Write the monitor even if it is not expected to see faults.")
    ] = False,
    as_json: AsJson = False,
    read: Read = None,
) -> None:
    """Learn a monitor from fault-free recordings, without a model.

    A plant is identified, and relations between channels are fitted. The last quarter of each recording is held out: it
    chooses the relations, by false alarms and by simulated faults, and raises thresholds that it exceeds. The final fit
    uses all rows.
    """
    check_recordings(normal)
    check_outputs([output], normal)
    named = [] if inputs in (None, "none") else parse_names(checked_names(inputs))
    data = read_channels(normal, named, parse_names(outputs), READ.values(read))
    learnt = learn_monitor(
        data,
        **({} if inputs is None else channels_of(data, outputs)),
        false_alarm_rate=false_alarm_rate,
        form=form,
        sensor_faults=sensor_faults,
        actuator_faults=actuator_faults,
        force=force,
        model=checked_model(MODEL.values(model), data),
    )
    learnt.monitor.save(output)
    check = learnt.monitor.fit_check
    assert check is not None
    notes = list(map(in_cli_words, learnt.notes))
    plant = learnt.monitor.design.plant
    if as_json:
        tried = [
            {"form": one.form, "false_alarms": one.false_alarms, "seen": one.seen, "failed": one.failed}
            for one in learnt.tried
        ]
        values = {} if learnt.report is None else report_values(learnt.report)
        channels = {"inputs": learnt.inputs, "outputs": learnt.outputs, "guessed": learnt.guessed}
        more = {"chosen": learnt.chosen, "tried": tried, "faults": plant.faults, "recording_notes": notes}
        screen.print_json({"monitor": output, **values, **channels, **more, **check_values(check)})
    else:
        report = str(learnt.report).splitlines() if learnt.report is not None else []
        screen.say(*map(in_cli_words, report), *notes)
        screen.say(*map(in_cli_words, learnt.lines), fault_text(plant), check.false_alarms)
        show_visible(check)
        screen.say(f"written: {output}")
    for note in check.notes:
        warn(in_cli_words(note))
