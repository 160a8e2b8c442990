"""The commands ``validate`` and ``tune``: campaigns of simulated faults for a saved monitor."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from residua.cli import screen
from residua.cli.checks import check_outputs, checked_positive, checked_rate
from residua.cli.guard import warn
from residua.files import check_input
from residua.monitor import Monitor
from residua.validate import campaign, load_scenarios, tune as tune_monitor
from residua.validate.tuning import PERSISTENCES, WINDOWS
from residua.visible import echo

#: What is tried where no list is given.
_DEFAULTS = {"--windows": WINDOWS, "--persistences": PERSISTENCES}


def validate(
    monitor: Annotated[Path, typer.Argument(metavar="MONITOR.json", help="What design or fit wrote.")],
    scenarios: Annotated[
        Path | None,
        typer.Option(
            "--scenarios", metavar="FAULTS.toml", help="What fails, how and how much; none: false alarms alone."
        ),
    ] = None,
    runs: Annotated[int, typer.Option(min=1, metavar="N", help="Runs of each case.")] = 1000,
    samples: Annotated[int, typer.Option(min=1, metavar="N", help="Samples of a run.")] = 5000,
    seed: Annotated[int, typer.Option(min=0, metavar="N", help="Other numbers, other runs.")] = 0,
    within: Annotated[
        float | None,
        typer.Option(
            callback=checked_positive, metavar="SECONDS", help="After its onset, in which a fault has to be seen."
        ),
    ] = None,
    workers: Annotated[int, typer.Option(min=1, metavar="N", help="Processes; more than one needs joblib.")] = 1,
    resume: Annotated[
        Path | None,
        typer.Option(
            "--resume", metavar="RUNS.npz", help="Save runs there now and then, and go on from what it holds."
        ),
    ] = None,
    report: Annotated[
        Path | None, typer.Option("--report", metavar="OUT.html", help="Write a page with tables and pictures.")
    ] = None,
) -> None:
    """Count false alarms, misses, delays and wrong names over simulated runs of the monitor's own plant."""
    check_input(monitor, "a monitor")
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
    summary, _, _ = str(made).partition("\n\n")
    screen.say(*summary.split("\n"))
    if made.cases:
        for title, table in (("detection", made.table()), ("who was named", made.confusion())):
            screen.show_table(table.header, table.cells(), title=title)
        screen.say(*(str(one) for one in made.detection_probabilities() if len(one.sizes) > 1))
    for note in made.notes:
        warn(note)
    screen.say(*(f"written: {path}" for path in (report, resume) if path is not None))


def tune(
    monitor: Annotated[Path, typer.Argument(metavar="MONITOR.json", help="What design wrote, not fitted.")],
    scenarios: Annotated[Path, typer.Option("--scenarios", metavar="FAULTS.toml", help="What is to be seen soon.")],
    false_alarm_rate: Annotated[
        float, typer.Option(callback=checked_rate, metavar="RATE", help="Fraction of fault-free samples in alarm.")
    ],
    output: Annotated[Path, typer.Option("--output", "-o", metavar="OUT.json", help="Monitor to write: the best one.")],
    windows: Annotated[
        str | None, typer.Option("--windows", metavar="LIST", help="Samples over which the residual is summed.")
    ] = None,
    persistences: Annotated[
        str | None, typer.Option("--persistences", metavar="LIST", help="Samples in a row that raise an alarm.")
    ] = None,
    runs: Annotated[int, typer.Option(min=1, metavar="N", help="Runs of each case.")] = 200,
    samples: Annotated[int, typer.Option(min=1, metavar="N", help="Samples of a run.")] = 5000,
    seed: Annotated[int, typer.Option(min=0, metavar="N", help="Other numbers, other runs.")] = 0,
    within: Annotated[
        float | None,
        typer.Option(
            callback=checked_positive, metavar="SECONDS", help="After its onset, in which a fault has to be seen."
        ),
    ] = None,
) -> None:
    """Choose window, persistence and threshold by simulated runs: the least delay for a rate of false alarms."""
    check_input(monitor, "a monitor")
    check_outputs([output], [monitor, scenarios])
    tried = [_samples(text, name) for text, name in ((windows, "--windows"), (persistences, "--persistences"))]
    with screen.progress() as bar:
        made = tune_monitor(
            Monitor.load(monitor),
            load_scenarios(scenarios),
            false_alarm_rate=false_alarm_rate,
            windows=tried[0],
            persistences=tried[1],
            runs=runs,
            samples=samples,
            seed=seed,
            within=within,
            progress=lambda stage, done, total: bar(done, total),
        )
    made.monitor.reset()
    made.monitor.save(output)
    table, best = made.table(), made.best
    screen.show_table(table.header, table.cells(), title=f"for {false_alarm_rate:g} of the fault-free samples in alarm")
    for note in best.campaign.notes:
        warn(note)
    screen.say(
        f"best: window {best.window}, persistence {best.persistence}, threshold {best.threshold:.4g}",
        f"written: {output}",
    )


def _samples(text: str | None, name: str) -> tuple[int, ...]:
    """Return the numbers of samples in a list, or those that are tried without one."""
    if text is None:
        return _DEFAULTS[name]
    parts = [part.strip() for part in text.split(",")]
    if not all(part.isdecimal() and int(part) for part in parts):
        raise typer.BadParameter(f"expected numbers of samples, such as 1,5,20, got {echo(text)}", param_hint=name)
    return tuple(dict.fromkeys(int(part) for part in parts))
