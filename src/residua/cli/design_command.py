"""The command ``design``: its options are those of the methods in the registry."""

from __future__ import annotations

import inspect
from collections.abc import Sequence
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from residua.cli import methods, screen
from residua.cli.analyze_command import twins
from residua.cli.fit_command import thresholds
from residua.cli.guard import in_cli_words
from residua.cli.option_types import in_plain_words
from residua.cli.shared_options import (
    AsJson,
    FalseAlarmRate,
    PlantFile,
    check_file,
    check_outputs,
    check_step,
    checked_positive,
    signed,
)
from residua.decide import Directional, Matched, MultiscaleEWMA, NormThreshold, Structured, TestSettings
from residua.decide.directional import direction_test
from residua.decide.isolation import IsolationSettings
from residua.decide.sizes import fault_unit
from residua.decide.structured import codes_of
from residua.design import MatchedFilters, ResidualGenerator
from residua.design.core.generator import as_generator
from residua.errors import ModelError
from residua.monitor import Monitor
from residua.monitor.specification import chosen_isolation
from residua.plant.plant_file import load_plant
from residua.plant.toml_entry import suggestion

#: The window of matched filters where none is given.
_WINDOW = 50


def _method(name: str) -> str:
    """Return the name of an offered method."""
    known, name = methods.offered(), name.replace("_", "-")
    if name != methods.AUTO and name not in known:
        names = [methods.AUTO, *known]
        raise typer.BadParameter(f"{suggestion(name, names).strip()} is not one of {', '.join(names)}")
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
        typer.Option(callback=_method, metavar="NAME", help="auto: the first design of 'residua suggest'."),
    ] = methods.AUTO,
    list_methods: Annotated[
        bool,
        typer.Option("--methods", callback=_list_methods, is_eager=True, help="List the methods and their needs."),
    ] = False,
    show_call: Annotated[
        bool,
        typer.Option("--show-call", help="Print the design as a line of Python; without --output, only print it."),
    ] = False,
    dt: Annotated[
        float | None,
        typer.Option(callback=checked_positive, metavar="S", help="Step of the recordings, for a continuous plant."),
    ] = None,
    false_alarm_rate: FalseAlarmRate = None,
    persistence: Annotated[
        int | None,
        typer.Option(
            min=1,
            metavar="N",
            help="Test the norm of the residual: samples in a row over its threshold that raise an alarm; 3 with "
            "--window alone.",
        ),
    ] = None,
    window: Annotated[
        int | None,
        typer.Option(
            min=1,
            metavar="N",
            help="Test the norm of the residual: samples over which it is summed; 1 with --persistence alone. Of "
            "matched-filters: arrival times that are compared, 50.",
        ),
    ] = None,
    isolation_window: Annotated[
        int | None,
        typer.Option(
            min=1,
            metavar="N",
            help="Samples over which a direction or a code is read; 128 for a direction beside the bank of means, else "
            "50.",
        ),
    ] = None,
    as_json: AsJson = False,
    **asked: Any,
) -> None:
    """Design a monitor for a plant file.

    Each method has options of its own: 'residua design --help METHOD' shows them, 'residua design --methods' lists the
    methods. By default a bank of means tests the residual; --persistence and --window test its norm instead.
    """
    check_file(plant, "plant file")
    if output is None and not show_call:
        raise typer.BadParameter("name the monitor to write, such as MONITOR.json", param_hint="'--output' / '-o'")
    check_outputs([output], [plant])
    model = load_plant(plant)
    check_step(dt, model.dt)
    name, why = method, ""
    given = {option: value for option, value in asked.items() if value is not None}
    first = None
    if method == methods.AUTO:
        with screen.patience(f"looking for the design that sees most of {model.name}"):
            model, name, first, why = methods.choose(model, dt)
    try:
        call = methods.call_of(name, given, {"window": window or _WINDOW}, dt)
    except methods.OptionError as error:
        raise typer.BadParameter(error.why, param_hint=error.option) from None
    if first is not None:
        call = replace(first, values={**first.values, **call.values}, settings=call.settings)
    python = {"call": call.code(model)} if show_call else {}
    made = monitor = None
    if output is not None:
        made = methods.make(model, name, call, why=why)
        monitor = _monitor(made, call, persistence, window, false_alarm_rate, isolation_window, dt)
        monitor.save(output)
    if as_json:
        known = {} if monitor is None else {"monitor": output, **_values(made, monitor)}
        screen.print_json({"method": name, "because": why, **python, **known})
        return
    lines = [f"call: {one}" for one in python.values()]
    chosen = f"method: {name}" + (f", because {why}" if why else "")
    if output is None or monitor is None:
        screen.say(chosen, *lines)
        return
    screen.say(chosen, in_cli_words(str(_evidence(monitor))), *lines)
    header, rows, notes = _seen(made, monitor)
    if rows:
        screen.show_table(header, rows)
    screen.say(*notes, _readiness(monitor, output), f"written: {output}")


def _monitor(
    made: Any,
    call: methods.Call,
    persistence: int | None,
    window: int | None,
    rate: float | None,
    isolation_window: int | None,
    dt: float | None,
) -> Monitor:
    """Return the monitor of a design, with the test and isolation that the options request."""
    if isinstance(made, MatchedFilters):  # they sum over their window by themselves
        persistence, window = persistence or 3, None
    # of noise that is assumed there is no threshold before a fit
    source = "data" if "with_assumed_noise" in call.subject else "auto"
    test: TestSettings = MultiscaleEWMA(false_alarm_rate=rate, source=source)
    if persistence is not None or window is not None:
        test = NormThreshold(whiten=source, persistence=persistence or 3, window=window or 1, false_alarm_rate=rate)
    isolate: Any = "auto" if isolation_window is None else _isolation(made, isolation_window)
    return Monitor(made, test=test, isolate=isolate, dt=dt)


def _values(made: Any, monitor: Monitor) -> dict[str, Any]:
    """Return the evidence of a design, and its view of each fault, as values for JSON."""
    header, rows, notes = _seen(made, monitor)
    columns = dict(zip(header, zip(*rows, strict=True), strict=True)) if rows else {}
    fitted = monitor.is_fitted
    return {
        "evidence": in_cli_words(str(_evidence(monitor))).splitlines(),
        "faults": screen.records(columns) if columns else [],
        "notes": notes,
        "thresholds": list(monitor.norm_test.part_thresholds) or [monitor.norm_test.threshold] if fitted else None,
        "basis": monitor.norm_test.basis if fitted else None,
    }


def method_in(arguments: Sequence[str]) -> str | None:
    """Return the method for which help is requested: the one named beside ``--help``."""
    if not {"--help", "-h"} & set(arguments):
        return None
    known = methods.offered()
    words = (word.rpartition("=")[2].replace("_", "-") for word in arguments)
    return next((word for word in words if word in known), None)


def with_method_options(arguments: Sequence[str]) -> Any:
    """Return the command with the options of all methods; its help shows those of the named method."""
    shown = method_in(arguments)
    written = inspect.signature(design, eval_str=True).parameters.values()
    fixed = [one for one in written if one.kind is not one.VAR_KEYWORD]
    of_methods = [_parameter(one, shown) for one in methods.options({one.name for one in fixed})]

    def command(**options: Any) -> None:
        design(**options)

    return signed(command, [*fixed, *of_methods], _text(shown))


def _text(method: str | None) -> str | None:
    """Return the text of the help, with the requirements of a method."""
    if method is None:
        return design.__doc__
    one = methods.offered()[method]
    return f"Design a monitor by {method}.\n\nNeeds: {one.needs}. Exists when: {one.condition}."


def _parameter(one: methods.Shared, shown: str | None) -> inspect.Parameter:
    """Return an option of methods as a parameter of the command."""
    kind, text = bool if one.form.is_flag else str, None
    if shown in one.methods:
        own = {option.name: option.text for option in methods.offered()[shown].options}
        text = in_plain_words(own[one.name])
    option = partial(typer.Option, *one.flags, help=text, show_default=False, hidden=shown not in one.methods)
    option = option() if one.form.is_flag else option(metavar=one.form.metavar)
    annotation = Annotated[kind | None, option]
    return inspect.Parameter(one.name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=annotation)


def _isolation(made: Any, window: int) -> IsolationSettings:
    """Return the isolation suited to the design, over so many samples."""
    isolate = chosen_isolation("auto", as_generator(made), made)
    has_window = any(one.name == "window" for one in fields(isolate))  # pyright: ignore[reportArgumentType]
    return replace(isolate, window=window) if has_window else isolate  # pyright: ignore


def _evidence(monitor: Monitor) -> object:
    """Return the evidence of the running filter: sampled, if the step is known."""
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


#: A table of faults: its header, its rows, and lines that go with it.
_Seen = tuple[Sequence[str], list[list[Any]], list[str]]


def _seen(made: Any, monitor: Monitor) -> _Seen:
    """Return the view of a design on each fault, and the faults that look the same."""
    isolate = monitor.isolate
    if isinstance(isolate, Matched):
        return responses(made)
    if isinstance(isolate, Structured):
        return codes(as_generator(made), isolate)
    if isinstance(isolate, Directional) and monitor.design.plant.faults:
        return signatures(as_generator(made), isolate)
    return (), [], []


def signatures(generator: ResidualGenerator, isolate: Directional) -> _Seen:
    """Return the direction of the residual for each fault, and the faults that look the same."""
    test = direction_test(isolate, generator.subspaces, generator.steady_directions, np.eye(generator.n_residuals))
    n = generator.n_residuals
    rows = []
    for name in generator.faults:
        k = generator.subspaces[name].shape[1]
        steady = float(np.linalg.norm(generator.steady_directions[name]))
        if k == 0:
            shape = "no response"
        elif k == n:
            shape = "steady direction only" if steady else "no fixed direction"
        else:
            shape = "line" if k == 1 else "plane" if k == 2 else f"{k}-dimensional"
        rows.append([name, shape, steady, ", ".join(twins(test.groups, name))])
    header = ["fault", "signature", "steady residual per unit", "cannot be told from"]
    notes = [f"never named, since they have no signature: {', '.join(test.unjudged)}"] if test.unjudged else []
    return header, rows, notes


def codes(generator: ResidualGenerator, isolate: Structured) -> _Seen:
    """Return the members of a bank that fire for each fault, and the faults of one code."""
    test = codes_of(generator, isolate)
    rows = []
    for name in generator.faults:
        columns = [(g, name in test.settled[g]) for g, group in enumerate(test.groups) if name in group]
        for g, later in sorted(columns, key=lambda column: column[1]) or [(None, False)]:
            code = np.zeros(len(test.members), dtype=bool) if g is None else test.codes[:, g]
            alike = [] if g is None else [other for other in test.groups[g] if other != name]
            label = f"{name}, settled" if later else name
            rows.append([label, *("x" if on else "." for on in code), ", ".join(alike)])
    notes = []
    if any(test.settled):
        notes.append("settled: members that a fault still fires once it is constant")
    if test.unjudged:
        notes.append(f"never named, since they have no code: {', '.join(test.unjudged)}")
    if not test.strongly_isolating:
        notes.append("a code is part of another: a pattern with members silent is not read as degraded")
    return ["fault", *test.members, "cannot be told from"], rows, notes


def responses(matched: MatchedFilters) -> _Seen:
    """Return the deviations of fault sizes by matched filters, and the faults that look the same."""
    half, whole = matched.deviation(matched.window // 2), matched.deviation()
    plant = matched.generator.plant
    rows = []
    for name in matched.faults:
        note = "not seen" if name in matched.unseen else "vanishes" if name in matched.vanishing else "stays"
        alike = [] if name in matched.unseen else twins(matched.groups, name)
        rows.append([name, note, half[name], whole[name], fault_unit(plant, name), ", ".join(alike)])
    header = ["fault", "once constant", f"deviation of its size after {matched.window // 2} samples"]
    header += [f"after {matched.window}", "unit", "cannot be told from"]
    return header, rows, ["a fault of about six deviations is detected within that many samples"]
