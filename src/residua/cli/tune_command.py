"""The command ``tune``: the norm test with the least delay, by simulated faults."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from residua.cli import screen
from residua.cli.guard import warn
from residua.cli.shared_options import AsJson, Samples, Seed, Within, check_file, check_outputs, checked_rate
from residua.monitor import Monitor
from residua.validate import load_scenarios, tune as tune_monitor
from residua.validate.tuning import PERSISTENCES, WINDOWS
from residua.visible import echo


def tune(
    monitor: Annotated[Path, typer.Argument(metavar="MONITOR.json", help="Monitor that is not fitted yet.")],
    scenarios: Annotated[Path, typer.Option("--scenarios", metavar="FAULTS.toml", help="Faults to detect soon.")],
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
    samples: Samples = 5000,
    seed: Seed = 0,
    within: Within = None,
    as_json: AsJson = False,
) -> None:
    """Choose window, persistence and threshold by simulated runs.

    Of all that have the rate of false alarms, those with the least delay are written.
    """
    check_file(monitor, "monitor")
    check_outputs([output], [monitor, scenarios])
    with screen.progress() as bar:
        made = tune_monitor(
            Monitor.load(monitor),
            load_scenarios(scenarios),
            false_alarm_rate=false_alarm_rate,
            windows=_samples(windows, "--windows", WINDOWS),
            persistences=_samples(persistences, "--persistences", PERSISTENCES),
            runs=runs,
            samples=samples,
            seed=seed,
            within=within,
            progress=lambda stage, done, total: bar(done, total),
        )
    made.monitor.reset()
    made.monitor.save(output)
    table, best = made.table(), made.best
    if as_json:
        screen.print_json(
            {
                "monitor": output,
                "window": best.window,
                "persistence": best.persistence,
                "threshold": best.threshold,
                "candidates": screen.records(table.columns()),
                "notes": best.campaign.notes,
            }
        )
    else:
        title = f"for {false_alarm_rate:g} of the fault-free samples in alarm"
        screen.show_table(table.header, table.cells(), title=title)
        screen.say(
            f"best: window {best.window}, persistence {best.persistence}, threshold {best.threshold:.4g}",
            f"written: {output}",
        )
    for note in best.campaign.notes:
        warn(note)


def _samples(text: str | None, name: str, default: tuple[int, ...]) -> tuple[int, ...]:
    """Return the numbers of samples in a list, or the default without one."""
    if text is None:
        return default
    parts = [part.strip() for part in text.split(",")]
    if not all(part.isdecimal() and int(part) for part in parts):
        raise typer.BadParameter(f"expected numbers of samples, such as 1,5,20, got {echo(text)}", param_hint=name)
    return tuple(dict.fromkeys(int(part) for part in parts))
