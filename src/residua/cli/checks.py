"""Checks of values and paths that are written as options."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated

import typer

from residua.decide import MultiscaleEWMA, NormThreshold, TestSettings
from residua.errors import DataError, SettingError
from residua.files import check_input, check_output, real, special
from residua.tolerances import SAME


def checked_rate(value: float | None) -> float | None:
    """Return a rate, or raise unless it lies between 0 and 1."""
    if value is not None and not 0 < value < 1:
        raise typer.BadParameter(f"must lie between 0 and 1, got {value:g}")
    return value


FalseAlarmRate = Annotated[
    float | None,
    typer.Option(
        callback=checked_rate,
        metavar="RATE",
        help="Fraction of fault-free samples in alarm; by default what the log can carry: 5 / rows, between 1e-4 and "
        "1e-2.",
    ),
]

Persistence = Annotated[
    int | None,
    typer.Option(
        min=1,
        metavar="N",
        help="Instead of the bank of means: samples in a row over a threshold on the norm that raise an alarm; 3 with "
        "--average alone.",
    ),
]
Average = Annotated[
    int | None,
    typer.Option(
        min=1,
        metavar="N",
        help="Instead of the bank of means: samples over which the residual is summed before its norm is tested; 1 "
        "with --persistence alone.",
    ),
]


def settings_of_test(
    persistence: int | None, average: int | None, rate: float | None, *, needs_data: bool = False
) -> TestSettings:
    """Return the test that options ask for: a norm where one of its own is given, else the bank of means.

    ``needs_data``: whether only a fit gives it a threshold.
    """
    if persistence is None and average is None:
        return MultiscaleEWMA(false_alarm_rate=rate, source="data" if needs_data else "auto")
    whiten = "data" if needs_data else "auto"
    return NormThreshold(whiten=whiten, persistence=persistence or 3, window=average or 1, false_alarm_rate=rate)


def checked_positive(value: float | None) -> float | None:
    """Return a positive finite number, or raise."""
    if value is not None and not 0 < value < float("inf"):
        raise typer.BadParameter(f"must be positive, got {value:g}")
    return value


def check_sample_time(sample_time: float | None, dt: float) -> None:
    """Raise where a step of recordings is said to be another than that of a sampled plant."""
    if sample_time is not None and dt and abs(sample_time - dt) > SAME * dt:
        raise SettingError(
            f"the plant is sampled, dt={dt:g} s, and --sample-time is {sample_time:g} s: leave it out, or give a "
            "plant file for that step"
        )


def check_recordings(paths: Sequence[Path]) -> None:
    """Raise unless every fault-free recording is a file, and none is given twice."""
    for path in paths:
        check_input(path, "a recording")
    twice = next((path for path in paths if [real(p) for p in paths].count(real(path)) > 1), None)
    if twice is not None:
        raise DataError(f"{twice} is given twice: data that are counted twice seem to tell more than they do")


def check_outputs(outputs: Iterable[Path | None], inputs: Iterable[Path] = ()) -> None:
    """Raise unless every output can be written.

    Parameters
    ----------
    outputs : iterable of Path or None
        ``None`` stands for an output that was not asked for.
    inputs : iterable of Path
        Files that must not be overwritten.
    """
    taken = {real(path): "is read by this command" for path in inputs}
    for path in outputs:
        if path is None:
            continue
        check_output(path)
        if special(path):
            continue
        if real(path) in taken:
            raise DataError(f"{path} {taken[real(path)]}; give the output another name")
        taken[real(path)] = "is given for two outputs"
