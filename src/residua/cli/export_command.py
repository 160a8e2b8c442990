"""The command ``export``: a monitor as code for machines without Python."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from residua.cli import screen
from residua.cli.shared_options import MonitorFile, check_file
from residua.errors import SettingError
from residua.export import to_c, to_fmu, to_onnx, to_structured_text
from residua.monitor import Monitor


class Target(StrEnum):
    """The language or format."""

    c = "c"
    st = "st"
    fmu2 = "fmu2"
    fmu3 = "fmu3"
    onnx = "onnx"


class Precision(StrEnum):
    """The numbers of the code."""

    double = "double"
    float = "float"


def export(
    monitor: MonitorFile,
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
        str | None, typer.Option("--name", metavar="NAME", help="Name of the files and of the code in them.")
    ] = None,
    precision: Annotated[Precision, typer.Option(help="Precision of the numbers.")] = Precision.double,
    hold: Annotated[
        bool,
        typer.Option("--hold", help="Hold missing values, where a Kalman filter would go on with other outputs."),
    ] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace files of an earlier export.")] = False,
) -> None:
    """Write a monitor as C, Structured Text, FMU or ONNX."""
    check_file(monitor, "monitor")
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
        most = "no bound is known" if model.bound is None else f"{max(model.bound, default=0.0):.2g} at most"
        screen.say(f"written: {model.path}, residuals off by rounding: {most}")
        return
    write = {Target.c: to_c, Target.st: to_structured_text}[to]
    made = write(watch, output, name=name, precision=precision.value, missing=missing, overwrite=overwrite)
    screen.say(*(f"written: {path}" for path in sorted(made.iterdir())))
