"""The command ``design``: its options are those of the methods in the registry."""

from __future__ import annotations

import inspect
import re
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from residua.cli import methods, screen
from residua.cli.checks import (
    Average,
    FalseAlarmRate,
    Persistence,
    check_outputs,
    check_sample_time,
    checked_positive,
    settings_of_test,
)
from residua.cli.guard import GuardedGroup, in_cli_words, note
from residua.cli.plant_commands import PlantFile
from residua.decide import Directional, Matched, Structured
from residua.decide.isolation import IsolationSettings
from residua.design import MatchedFilters
from residua.design.core.brought import as_generator
from residua.errors import ModelError, SettingError
from residua.files import check_input
from residua.monitor import Monitor
from residua.monitor.setup import chosen_isolation
from residua.plant.plant_file import load_plant
from residua.plant.toml_entry import suggestion

#: Methods that are listed at an option in the help, and where the first sentence of its text ends.
_LISTED, _SENTENCE = 4, r"(?<=\.) "

#: Samples within which matched filters look for an arrival, where no window is given.
_WINDOW = 50


def _method(name: str) -> str:
    """Return the name of a method that is offered, its present one."""
    known, former, name = methods.offered(), methods.former_names(), name.replace("_", "-")
    if name in former:
        note(f"--method {name} is called {former[name]} now, as its function is; the old name is deprecated")
        name = former[name]
    if name != methods.AUTO and name not in known:
        names = [methods.AUTO, *known]
        raise typer.BadParameter(f"{suggestion(name, names).strip()} is none of {', '.join(names)}")
    return name


def _list_methods(wanted: bool) -> None:
    if wanted:
        screen.show_table(methods.HEADER, methods.table())
        beside = {one.name: methods.in_python_only(one) for one in methods.methods()}
        screen.say(f"in Python only: {'; '.join(f'{name}, {why}' for name, why in beside.items() if why)}")
        raise typer.Exit


def design(
    plant: PlantFile,
    output: Annotated[Path | None, typer.Option("--output", "-o", metavar="OUT.json", help="Monitor to write.")] = None,
    method: Annotated[
        str,
        typer.Option(callback=_method, metavar="NAME", help="auto: what 'residua suggest' puts first."),
    ] = methods.AUTO,
    list_methods: Annotated[
        bool,
        typer.Option("--methods", callback=_list_methods, is_eager=True, help="List the methods: what each needs."),
    ] = False,
    show_call: Annotated[
        bool, typer.Option("--show-call", help="Print the design as a line of Python; without --output no more.")
    ] = False,
    sample_time: Annotated[
        float | None,
        typer.Option(callback=checked_positive, metavar="S", help="Step of the recordings, for a continuous plant."),
    ] = None,
    false_alarm_rate: FalseAlarmRate = None,
    persistence: Persistence = None,
    average: Average = None,
    window: Annotated[
        int | None,
        typer.Option(
            min=1,
            metavar="N",
            help="Samples over which the direction of the residual, the code of a bank, or an arrival is judged; by "
            "default 128 for a direction beside the bank of means, and 50 otherwise.",
        ),
    ] = None,
    **asked: Any,
) -> None:
    """Design a monitor and print what it proves about itself."""
    check_input(plant, "a plant file")
    if output is None and not show_call:
        raise typer.BadParameter("give the monitor a name, OUT.json", param_hint="'--output' / '-o'")
    check_outputs([output], [plant])
    model = load_plant(plant)
    check_sample_time(sample_time, model.dt)
    name, why, given = method, "", _given(asked)
    first = None
    if method == methods.AUTO:
        with screen.patience(f"looking for the design that sees most of {model.name}"):
            model, name, first, why = methods.choose(model, sample_time)
    try:
        call = methods.call_of(name, given, {"window": window or _WINDOW}, sample_time)
    except methods.OptionError as error:
        raise typer.BadParameter(error.why, param_hint=error.option) from None
    if first is not None:
        call = replace(first, values={**first.values, **call.values}, settings=call.settings)
    chosen = f"method: {name}" + (f", because {why}" if why else "")
    if output is None:
        screen.say(chosen, f"call: {call.code(model)}")
        return
    made = methods.make(model, name, call, why=why)
    matched = isinstance(made, MatchedFilters)
    if matched and average not in (None, 1):
        raise SettingError("matched filters sum over their --window by themselves: leave out --average")
    # of noise that is assumed there is no threshold before a fit
    assumed = "with_assumed_noise" in call.subject
    test = settings_of_test(persistence or (3 if matched else None), average, false_alarm_rate, needs_data=assumed)
    isolate: Any = "auto" if window is None else _isolation(made, window)
    monitor = Monitor(made, test=test, isolate=isolate, dt=sample_time)
    isolate = monitor.isolate
    monitor.save(output)
    screen.say(chosen, in_cli_words(str(_evidence(monitor))))
    if show_call:
        screen.say(f"call: {call.code(model)}")
    if isinstance(isolate, Matched):
        screen.show_responses(made)
    elif isinstance(isolate, Structured):
        screen.show_codes(as_generator(made), isolate)
    elif model.faults and isinstance(isolate, Directional):
        screen.show_signatures(as_generator(made), isolate)
    screen.say(_readiness(monitor, output), f"written: {output}")


def _given(asked: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in asked.items() if value is not None}


def design_command() -> Any:
    """Return the command, with an option for every option of a method that is registered now."""
    written = inspect.signature(design, eval_str=True).parameters.values()
    fixed = [one for one in written if one.kind is not one.VAR_KEYWORD]
    of_methods = [_parameter(one) for one in methods.options({one.name for one in fixed})]
    at = next(k for k, one in enumerate(fixed) if one.name == "false_alarm_rate")

    def command(**options: Any) -> None:
        design(**options)

    parameters = [*fixed[:at], *of_methods, *fixed[at:]]
    command.__signature__ = inspect.Signature([one.replace(kind=one.KEYWORD_ONLY) for one in parameters])  # pyright: ignore
    command.__annotations__ = {one.name: one.annotation for one in parameters}
    command.__doc__ = design.__doc__
    single = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    single.command("design")(command)
    return typer.main.get_command(single)


class Commands(GuardedGroup):
    """The commands, of which ``design`` has the options of all methods that are registered when it is called."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Return their names: from data to a model, what looks at a plant, then ``design``, then what runs."""
        names = super().list_commands(ctx)
        border = names.index("fit")
        return [*names[:border], "design", *names[border:]]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a command by its name."""
        return design_command() if cmd_name == "design" else super().get_command(ctx, cmd_name)


def _parameter(one: methods.Shared) -> inspect.Parameter:
    """Return an option of methods as a parameter of the command."""
    kind = bool if one.form.is_flag else str
    of = ", ".join(one.methods) if len(one.methods) <= _LISTED else f"{len(one.methods)} methods, see --methods"
    text = f"{re.split(_SENTENCE, one.text)[0].rstrip('.')}. Of {of}." if one.text else f"Of {of}."
    option = partial(typer.Option, *one.flags, help=text, rich_help_panel="Options of methods", show_default=False)
    option = option() if one.form.is_flag else option(metavar=one.form.metavar)
    annotation = Annotated[kind | None, option]
    return inspect.Parameter(one.name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=annotation)


def _isolation(made: Any, window: int) -> IsolationSettings:
    """Return how faults are named: as the design is made to be read, over so many samples."""
    isolate = chosen_isolation("auto", as_generator(made), made)
    has_window = any(one.name == "window" for one in fields(isolate))  # pyright: ignore[reportArgumentType]
    return replace(isolate, window=window) if has_window else isolate  # pyright: ignore


def _evidence(monitor: Monitor) -> object:
    """Return the evidence of what will run: the sampled filter, where the step is known."""
    try:
        return monitor.generator.evidence
    except ModelError:  # a continuous design whose step is not known yet
        return monitor.design.evidence


def _readiness(monitor: Monitor, path: Path) -> str:
    if monitor.is_fitted:
        test = monitor.norm_test
        what = thresholds(monitor).replace("threshold: ", "threshold ")
        return f"{what}: {test.basis}; 'residua fit' sets it from fault-free data"
    return f"no threshold yet: residua fit {path} NORMAL.csv -o {path}"


def thresholds(monitor: Monitor) -> str:
    """Return the threshold, or those of the members of a bank."""
    test = monitor.norm_test
    if not test.part_names:
        return f"threshold: {test.threshold:.6g}"
    limits = zip(test.part_names, test.part_thresholds, strict=True)
    return f"thresholds: {', '.join(f'{name} {limit:.6g}' for name, limit in limits)}"
