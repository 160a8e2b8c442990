"""The commands."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from residua import __version__
from residua.cli import identify_command, learn_command, live_command, plant_commands, screen, validate_command
from residua.cli.checks import FalseAlarmRate, check_outputs, check_recordings
from residua.cli.design_command import Commands, thresholds
from residua.cli.guard import CANNOT_TELL, FAULT, NO_FAULT, UNLIKE, GuardedGroup, in_cli_words, warn
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
    in_words_of_options,
)
from residua.demos import Outcome
from residua.errors import AccuracyError, DataError, SettingError
from residua.export import to_c, to_fmu, to_onnx, to_structured_text
from residua.files import check_input
from residua.monitor import Diagnosis, Monitor
from residua.monitor.inputs import settling_reason
from residua.monitor.streaming import judged_file, write_outputs
from residua.recording.recording import Recording
from residua.recording.table_writer import check_table
from residua.report.verdict import verdict
from residua.visible import echo

app = typer.Typer(
    cls=Commands,
    help="Model-based fault detection and isolation: from a plant file and a recording to the faulty component.",
    epilog="Exit status: 0 done, or no alarm; 1 an alarm was raised; 2 error; 3 no alarm, on data unlike the fit; "
    "4 with --strict: no alarm, of a monitor that sees too little to tell. "
    "RESIDUA_TRACEBACK=1 shows where an error comes from.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
demos = typer.Typer(cls=GuardedGroup, help="Runs on data that the package makes itself.", no_args_is_help=True)
app.add_typer(demos, name="demo")


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"residua {__version__}")
        raise typer.Exit


MonitorFile = Annotated[Path, typer.Argument(metavar="MONITOR.json", help="What design or fit wrote.")]


@app.callback()
def _common(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and stop.")
    ] = False,
) -> None:
    pass


app.command()(identify_command.identify)
app.command()(learn_command.learn)
app.command()(plant_commands.analyze)
app.command()(plant_commands.codes)
app.command()(plant_commands.suggest)
app.command()(validate_command.validate)
app.command()(validate_command.tune)
app.command()(live_command.live)


@app.command()
def fit(
    monitor: MonitorFile,
    normal: Annotated[
        list[Path], typer.Argument(metavar="NORMAL.csv...", help="Fault-free recordings; each has a start of its own.")
    ],
    output: Annotated[Path, typer.Option("--output", "-o", metavar="OUT.json", help="Monitor to write.")],
    false_alarm_rate: FalseAlarmRate = None,
    held_out: Annotated[
        float, typer.Option(metavar="PART", help="Last part of each recording that only checks the fit.")
    ] = 0.2,
    transient: Annotated[
        str,
        typer.Option(metavar="SAMPLES|auto", help="Samples at each start to leave out; auto: those that are unlike."),
    ] = "0",
    force: Annotated[bool, typer.Option("--force", help="Fit recordings too that look faulty.")] = False,
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
    """Set the threshold from fault-free data."""
    check_input(monitor, "a monitor")
    check_recordings(normal)
    check_outputs([output], normal)
    watch = Monitor.load(monitor)
    reading = Reading(time, dt, variable, fill_gaps, tolerance, day_first, time_format, decimal, columns, transpose)
    data = [reading.read(path, watch) for path in normal]
    watch.fit(
        data if len(data) > 1 else data[0],
        false_alarm_rate=false_alarm_rate,
        held_out=held_out,
        transient=_start_left_out(transient),
        force=force,
    )
    runs = [_run(watch, one) for one in data]
    watch.reset()
    watch.save(output)
    check = watch.fit_check
    assert check is not None
    screen.say(
        thresholds(watch),
        *([check.false_alarms] if check.false_alarms else []),
        f"basis: {watch.norm_test.basis}",
        _fitted_samples(runs),
        *([] if watch.norm_test.is_bound or len(runs) > 1 else [_ONE_DAY]),
        *(f"{one.source}: {note}" for one in data for note in one.notes),
    )
    screen.show_visible(check)
    screen.say(f"written: {output}")
    for note in check.notes:
        warn(in_cli_words(note))


def _start_left_out(text: str) -> int | str:
    """Return the samples that are left out at a start."""
    if text != "auto" and not text.isdecimal():
        why = f"must be a whole number of samples, or auto, got {echo(text)}"
        raise typer.BadParameter(why, param_hint="--transient")
    return text if text == "auto" else int(text)


def _fitted_samples(runs: list[Diagnosis]) -> str:
    """Say how many samples a fit has seen, and what became of them."""
    judged = sum(int(one.decided.sum()) for one in runs)
    number, span = sum(len(one.time) for one in runs), sum(map(_span, runs))
    several = f" in {len(runs)} recordings" if len(runs) > 1 else ""
    incomplete = sum(one.n_missing for one in runs)
    return (
        f"fault-free samples: {number}{several} over {span:.6g} s, {judged} judged "
        f"({incomplete} incomplete, the rest while the filter settles)"
    )


#: What one recording cannot show.
_ONE_DAY = (
    "this holds for days like the one that was fitted: fit several recordings where load, season or operation differ, "
    "and run one that was not fitted"
)


@app.command()
def run(
    monitor: MonitorFile,
    recording: Annotated[Path, typer.Argument(metavar="DATA.csv", help="CSV or other text, Parquet, .mat or .npz.")],
    report: Annotated[
        Path | None, typer.Option("--report", metavar="OUT.html", help="Write a page with charts.")
    ] = None,
    alarms: Annotated[
        Path | None, typer.Option("--alarms", metavar="OUT.jsonl", help="Write one JSON object per alarm and line.")
    ] = None,
    residuals: Annotated[
        Path | None,
        typer.Option("--residuals", metavar="OUT.csv", help="Write residuals, statistic, scores; .csv or .parquet."),
    ] = None,
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
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing; the exit status tells.")] = False,
    strict: Annotated[
        bool, typer.Option("--strict", help="Exit status 4 where a monitor without an alarm sees too little to tell.")
    ] = False,
) -> None:
    """Look for faults in a recording: exit status 0 no alarm, 1 an alarm, 2 error, 3 data unlike those of the fit."""
    check_input(monitor, "a monitor")
    check_input(recording, "a recording")
    check_outputs([report, alarms, residuals], [monitor, recording])
    if residuals is not None:
        check_table(residuals)
    watch = Monitor.load(monitor)
    watch.norm_test  # noqa: B018 (a monitor without a threshold says so before a long file is read)
    reading = Reading(time, dt, variable, fill_gaps, tolerance, day_first, time_format, decimal, columns, transpose)
    with _diagnosed(watch, recording, reading) as diagnosis:
        written = write_outputs(diagnosis, report=report, alarms=alarms, residuals=residuals)
        if not quiet:
            screen.show_diagnosis(diagnosis)
            if diagnosis.origin:
                screen.say(f"times count from {diagnosis.origin}")
            screen.say(*(f"written: {path}" for path in written))
        if not diagnosis.decided.any():
            waits = not diagnosis.missing.all()
            settles = f": {settling_reason(watch.generator, watch.settling_samples)}" if waits else ""
            raise DataError(
                f"{recording}: no sample could be judged, so this is not a verdict: {len(diagnosis.time)} samples, "
                f"{diagnosis.n_missing} of them incomplete; {diagnosis.why_undecided}{settles}"
            )
        raise typer.Exit(_status(diagnosis, strict))


def _status(diagnosis: Diagnosis, strict: bool) -> int:
    """Return the exit status of a run."""
    if diagnosis.fault_detected:
        return FAULT
    kind = verdict(diagnosis).kind
    if diagnosis.is_unlike_the_fit or kind == "outside":
        return UNLIKE
    return CANNOT_TELL if strict and kind == "cannot tell" else NO_FAULT


#: Bytes of a file from which on it is read piece by piece: about 300 MB of memory at once otherwise.
STREAMED = 50_000_000


@contextmanager
def _diagnosed(watch: Monitor, recording: Path, reading: Reading) -> Iterator[Diagnosis]:
    """Yield the diagnosis of a recording, whose arrays are on the disk where it is large."""
    if recording.stat().st_size < STREAMED:
        yield _run(watch, reading.read(recording, watch))
        return
    with ExitStack() as kept:
        with screen.progress() as bar, in_words_of_options():
            whole = kept.enter_context(judged_file(watch, recording, reading.options(watch), bar))
        if whole is not None:
            yield replace(whole, notes=tuple(map(in_cli_words, whole.notes)))
            return
    yield _run(watch, reading.read(recording, watch))


def _run(watch: Monitor, data: Recording) -> Diagnosis:
    with screen.progress() as bar:
        diagnosis = watch.run(data, progress=bar)
    assert isinstance(diagnosis, Diagnosis)
    return replace(diagnosis, notes=tuple(map(in_cli_words, diagnosis.notes)))


def _span(diagnosis: Diagnosis) -> float:
    return float(diagnosis.time[-1] - diagnosis.time[0]) if len(diagnosis.time) else 0.0


class Target(StrEnum):
    """What a monitor is written as."""

    c = "c"
    st = "st"
    fmu2 = "fmu2"
    fmu3 = "fmu3"
    onnx = "onnx"


class Precision(StrEnum):
    """The numbers of the code."""

    double = "double"
    float = "float"


@app.command()
def export(
    monitor: Annotated[Path, typer.Argument(metavar="MONITOR.json", help="What design or fit wrote.")],
    output: Annotated[
        Path,
        typer.Option("--output", "-o", metavar="PATH", help="Folder, made if absent; or NAME.fmu, NAME.onnx."),
    ],
    to: Annotated[
        Target,
        typer.Option(
            "--to",
            help="C99, Structured Text (IEC 61131-3), a Functional Mock-up Unit (FMI 2 or 3), or ONNX.",
        ),
    ] = Target.c,
    name: Annotated[
        str | None, typer.Option("--name", metavar="NAME", help="Of the files and of what is in them.")
    ] = None,
    precision: Annotated[Precision, typer.Option(help="Of the numbers.")] = Precision.double,
    hold: Annotated[
        bool,
        typer.Option("--hold", help="Hold what is missing, where a Kalman filter would go on with other outputs."),
    ] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace files of an earlier export.")] = False,
) -> None:
    """Write a monitor as code: for a controller, an embedded computer, a simulation."""
    check_input(monitor, "a monitor")
    missing = "hold" if hold else "as monitored"
    watch = Monitor.load(monitor)
    if to in (Target.fmu2, Target.fmu3):
        if precision is not Precision.double:
            raise SettingError("a Functional Mock-up Unit computes in double precision: leave --precision out")
        version = "2.0" if to is Target.fmu2 else "3.0"
        unit = to_fmu(watch, output, version=version, name=name, missing=missing, overwrite=overwrite)
        binary = f"with a binary for {unit.platform}" if unit.platform else f"without a binary: {unit.why}"
        renamed = [f"signal {old!r} is {new!r} in the unit" for old, new in unit.renamed.items()]
        screen.say(f"written: {unit.path}, {binary}", *renamed)
        return
    if to is Target.onnx:
        model = to_onnx(watch, output, name=name, precision=precision.value, missing=missing, overwrite=overwrite)
        most = "no bound can be said" if model.bound is None else f"{max(model.bound, default=0.0):.2g} at most"
        screen.say(f"written: {model.path}, residuals off by rounding: {most}")
        return
    write = {Target.c: to_c, Target.st: to_structured_text}[to]
    made = write(watch, output, name=name, precision=precision.value, missing=missing, overwrite=overwrite)
    screen.say(*(f"written: {path}" for path in sorted(made.iterdir())))


Folder = Annotated[
    Path, typer.Option("--output", "-o", metavar="DIR", help="Folder for what the demo writes; made when absent.")
]


@demos.command("jet-engine")
def jet_engine(output: Folder = Path("residua-demo")) -> None:
    """A jet engine with sensor faults: the disturbance-decoupled filter against the plain one."""
    from residua.demos import jet_engine as demo

    _folder(output)
    _present(demo.run(output))


@demos.command("three-tank")
def three_tank(output: Folder = Path("residua-demo")) -> None:
    """Three tanks with a leak: the whole way from a plant file and recordings to the faulty component."""
    from residua.demos import three_tank as demo

    _folder(output)
    _present(demo.run(output))


def _present(outcome: Outcome) -> None:
    screen.say(*outcome.lines)
    for table in outcome.tables:
        screen.show_table(table.header, table.rows, title=table.caption)
    screen.say(f"report page: {outcome.page.resolve()}")
    if outcome.surprises:
        raise AccuracyError(f"the demo did not come out as it should: {'; '.join(outcome.surprises)}")


def _folder(path: Path) -> None:
    if path.exists() and not path.is_dir():
        raise DataError(f"{path} is a file; the demo needs a folder")
    path.mkdir(parents=True, exist_ok=True)
