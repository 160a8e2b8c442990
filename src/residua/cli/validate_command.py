"""The command ``validate``: a campaign of simulated faults for a saved monitor."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from residua.cli import screen
from residua.cli.guard import warn
from residua.cli.shared_options import (
    AsJson,
    MonitorFile,
    Samples,
    Seed,
    Within,
    check_file,
    check_outputs,
)
from residua.monitor import Monitor
from residua.validate import campaign, load_scenarios


def validate(
    monitor: MonitorFile,
    scenarios: Annotated[
        Path | None,
        typer.Option(
            "--scenarios", metavar="FAULTS.toml", help="Faults, their shapes and sizes; none: false alarms only."
        ),
    ] = None,
    runs: Annotated[int, typer.Option(min=1, metavar="N", help="Runs of each case.")] = 1000,
    samples: Samples = 5000,
    seed: Seed = 0,
    within: Within = None,
    workers: Annotated[int, typer.Option(min=1, metavar="N", help="Processes; more than one needs joblib.")] = 1,
    resume: Annotated[
        Path | None,
        typer.Option("--resume", metavar="RUNS.npz", help="Save runs there now and then, and resume from them."),
    ] = None,
    report: Annotated[
        Path | None, typer.Option("--report", metavar="OUT.html", help="Write a page with tables and charts.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Count false alarms, misses and delays in simulated runs.

    The runs are of the plant for which the monitor was designed, which needs noise; wrong names are counted too.
    """
    check_file(monitor, "monitor")
    check_outputs([report, resume], [monitor] if scenarios is None else [monitor, scenarios])
    faults = () if scenarios is None else load_scenarios(scenarios)
    watch = Monitor.load(monitor)
    with screen.progress() as bar:
        made = campaign(
            watch,
            faults,
            runs=runs,
            samples=samples,
            seed=seed,
            within=within,
            workers=workers,
            resume=resume,
            progress=lambda stage, done, total: bar(done, total),
        )
    if report is not None:
        made.to_html(report)
    written = [path for path in (report, resume) if path is not None]
    summary, _, _ = str(made).partition("\n\n")
    tables = (("detection", made.table()), ("named", made.confusion())) if made.cases else ()
    probabilities = [str(one) for one in made.detection_probabilities() if len(one.sizes) > 1] if made.cases else []
    if as_json:
        rate = made.false_alarm_rate()
        screen.print_json(
            {
                "plant": made.plant,
                "runs": made.runs,
                "samples": made.samples,
                "seed": made.seed,
                "false_alarm_rate": {"value": rate.value, "low": rate.low, "high": rate.high},
                **{title: screen.records(table.columns()) for title, table in tables},
                "detection_probabilities": probabilities,
                "notes": made.notes,
                "written": written,
            }
        )
    else:
        screen.say(*summary.split("\n"))
        for title, table in tables:
            screen.show_table(table.header, table.cells(), title=title)
        screen.say(*probabilities, *(f"written: {path}" for path in written))
    for note in made.notes:
        warn(note)
