"""The command ``fit``, and the check of a fit that ``learn`` also shows."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, cast

import typer

from residua.cli import screen
from residua.cli.call_options import READ, Read
from residua.cli.guard import in_cli_words, warn
from residua.cli.recordings import plant_of, read as read_recording
from residua.cli.shared_options import (
    AsJson,
    FalseAlarmRate,
    MonitorFile,
    NormalFiles,
    check_file,
    check_order,
    check_outputs,
    check_recordings,
)
from residua.monitor import Diagnosis, Monitor
from residua.monitor.fit_check import HEADER, FitCheck
from residua.visible import echo

#: The limit of a fit to one recording.
_ONE_DAY = (
    "this holds for days like the one that was fitted: fit several recordings where load, season or operation differ, "
    "and run one that was not fitted"
)


def fit(
    monitor: MonitorFile,
    normal: NormalFiles,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="OUT.json", help="Monitor to write.")],
    false_alarm_rate: FalseAlarmRate = None,
    held_out: Annotated[
        float, typer.Option(metavar="PART", help="Last part of each recording that only checks the fit.")
    ] = 0.2,
    transient: Annotated[
        str,
        typer.Option(metavar="SAMPLES|auto", help="Samples to leave out at each start; auto: those unlike the rest."),
    ] = "0",
    force: Annotated[bool, typer.Option("--force", help="Fit recordings too that look faulty.")] = False,
    as_json: AsJson = False,
    read: Read = None,
) -> None:
    """Set the threshold of a monitor from fault-free recordings."""
    check_order("fit", monitor, normal)
    check_file(monitor, "monitor")
    check_recordings(normal)
    check_outputs([output], normal)
    watch = Monitor.load(monitor)
    data = [read_recording(path, plant_of(watch), READ.values(read)) for path in normal]
    watch.fit(
        data if len(data) > 1 else data[0],
        false_alarm_rate=false_alarm_rate,
        held_out=held_out,
        transient=_start_left_out(transient),
        force=force,
    )
    with screen.progress() as bar:
        runs = cast("list[Diagnosis]", [watch.run(one, progress=bar) for one in data])
    watch.reset()
    watch.save(output)
    check, test = watch.fit_check, watch.norm_test
    assert check is not None
    notes = [f"{one.source}: {note}" for one in data for note in one.notes]
    if as_json:
        limits = test.part_thresholds if test.part_names else [test.threshold]
        screen.print_json(
            {
                "monitor": output,
                "thresholds": dict(zip(test.part_names or ("norm",), limits, strict=True)),
                "basis": test.basis,
                **_counts(runs),
                **check_values(check),
                "recording_notes": notes,
            }
        )
    else:
        screen.say(
            thresholds(watch),
            *([check.false_alarms] if check.false_alarms else []),
            f"basis: {test.basis}",
            _fitted_samples(_counts(runs)),
            *([] if test.is_bound or len(runs) > 1 else [_ONE_DAY]),
            *notes,
        )
        show_visible(check)
        screen.say(f"written: {output}")
    for note in check.notes:
        warn(in_cli_words(note))


def _start_left_out(text: str) -> int | str:
    """Return the number of samples left out at the start."""
    if text != "auto" and not text.isdecimal():
        why = f"must be a whole number of samples, or auto, got {echo(text)}"
        raise typer.BadParameter(why, param_hint="--transient")
    return text if text == "auto" else int(text)


def _counts(runs: list[Diagnosis]) -> dict[str, Any]:
    """Return the recordings, samples and seconds of a fit, and the number of judged and of incomplete samples."""
    return {
        "recordings": len(runs),
        "samples": sum(len(one.time) for one in runs),
        "seconds": sum(float(one.time[-1] - one.time[0]) for one in runs if len(one.time)),
        "judged": sum(int(one.decided.sum()) for one in runs),
        "incomplete": sum(one.n_missing for one in runs),
    }


def _fitted_samples(counts: dict[str, Any]) -> str:
    several = f" in {counts['recordings']} recordings" if counts["recordings"] > 1 else ""
    return (
        f"fault-free samples: {counts['samples']}{several} over {counts['seconds']:.6g} s, {counts['judged']} judged "
        f"({counts['incomplete']} incomplete, the rest while the filter settles)"
    )


def show_visible(check: FitCheck) -> None:
    """Print the explained shares of a fitted monitor, and the smallest constant faults that it sees."""
    screen.say(*([check.explains] if check.explains else []))
    if check.visible:
        screen.show_table(HEADER, [one.cells for one in check.visible])


def check_values(check: FitCheck) -> dict[str, Any]:
    """Return the check of a fit as values for JSON."""
    held = check.held_out
    return {
        "false_alarm_rate": check.aimed,
        "promised": check.promised,
        "held_out": None if held is None else {"samples": held.samples, "alarmed": held.alarmed},
        "explained": {one.output: one.share for one in check.explained},
        "smallest_faults": [
            {
                "fault": one.fault,
                "unit": one.unit,
                "soon": one.soon,
                "lasting": one.lasting,
                "detectable": one.is_detectable,
            }
            for one in check.visible
        ],
        "notes": [in_cli_words(note) for note in check.notes],
    }


def thresholds(monitor: Monitor) -> str:
    """Return the threshold, or those of the members of a bank."""
    test = monitor.norm_test
    if not test.part_names:
        return f"threshold: {test.threshold:.6g}"
    limits = zip(test.part_names, test.part_thresholds, strict=True)
    return f"thresholds: {', '.join(f'{name} {limit:.6g}' for name, limit in limits)}"
