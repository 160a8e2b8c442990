"""Arguments and options that several commands share, and checks of their values."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Annotated

import typer

from residua.errors import DataError, FileFormatError, SettingError
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
        help="Fraction of fault-free samples in alarm; by default 5 / rows of the fit, between 1e-4 and 1e-2.",
    ),
]
MonitorFile = Annotated[Path, typer.Argument(metavar="MONITOR.json", help="Monitor that design, learn or fit wrote.")]
PlantFile = Annotated[Path, typer.Argument(metavar="PLANT.toml", help="Plant file.", show_default=False)]
NormalFiles = Annotated[
    list[Path], typer.Argument(metavar="NORMAL.csv...", help="Fault-free recordings; each has a start of its own.")
]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON instead of text.")]


def signed(call: Callable[..., None], parameters: Iterable[inspect.Parameter], text: str | None) -> Callable[..., None]:
    """Give a function the parameters that Typer turns into options, and its help text."""
    named = [one.replace(kind=inspect.Parameter.KEYWORD_ONLY) for one in parameters]
    call.__signature__ = inspect.Signature(named)  # pyright: ignore[reportFunctionMemberAccess]
    call.__annotations__ = {one.name: one.annotation for one in named}
    call.__doc__ = text
    return call


def checked_positive(value: float | None) -> float | None:
    """Return a positive finite number, or raise."""
    if value is not None and not 0 < value < float("inf"):
        raise typer.BadParameter(f"must be positive, got {value:g}")
    return value


Samples = Annotated[int, typer.Option(min=1, metavar="N", help="Samples of a run.")]
Seed = Annotated[int, typer.Option(min=0, metavar="N", help="Seed of the simulated runs.")]
Within = Annotated[
    float | None,
    typer.Option(callback=checked_positive, metavar="SECONDS", help="Time after its onset to detect a fault."),
]


def check_step(dt: float | None, of_plant: float) -> None:
    """Raise if a step of recordings differs from that of a sampled plant."""
    if dt is not None and of_plant and abs(dt - of_plant) > SAME * of_plant:
        raise SettingError(
            f"the plant is sampled every {of_plant:g} s, and --dt is {dt:g} s: leave --dt out, or give a plant file "
            "for that step"
        )


#: Endings of files, and the kind of file that has them.
_KINDS = {".json": "monitor"} | dict.fromkeys(
    (".csv", ".tsv", ".txt", ".dat", ".log", ".gz", ".parquet", ".mat", ".npz", ".xlsx"), "recording"
)
#: Advice where one kind of file is wanted, and another one is given.
_INSTEAD = {
    (
        "plant file",
        "recording",
    ): "without a model, 'residua learn' makes a monitor of it, 'residua identify' a plant file",
    ("plant file", "monitor"): "give the plant file from which the monitor was designed",
    ("monitor", "recording"): "the monitor comes first, then the recordings",
    ("monitor", "plant file"): "make a monitor from it first: residua design {path} -o MONITOR.json",
    ("recording", "plant file"): "give a log of measured inputs and outputs, such as a CSV file",
    ("recording", "monitor"): "give a log of measured inputs and outputs, such as a CSV file",
    ("configuration", "plant file"): "'residua live --example' prints a configuration",
    ("configuration", "recording"): "'residua live --example' prints a configuration; 'residua run' judges a recording",
    ("configuration", "monitor"): "name the monitor in a configuration; 'residua live --example' prints one",
}


def _kind(path: Path) -> str | None:
    """Return the kind of a file; among TOML files, plant files contain a mark."""
    if path.suffix.lower() == ".toml" and path.is_file():
        with path.open("rb") as file:
            return "plant file" if b"residua-plant/" in file.read(10_000) else None
    return _KINDS.get(path.suffix.lower())


def check_file(path: Path, wanted: str) -> None:
    """Raise unless the file exists, and its ending allows the wanted kind.

    Parameters
    ----------
    path : Path
    wanted : {"plant file", "monitor", "recording", "configuration"}
    """
    check_input(path, wanted)
    found = _kind(path)
    if found is not None and (wanted, found) in _INSTEAD:
        raise FileFormatError(f"{path} is a {found}, not a {wanted}: {_INSTEAD[wanted, found].format(path=path)}")


def check_order(command: str, monitor: Path, recordings: Sequence[Path]) -> None:
    """Raise if a recording is in the place of the monitor, and the monitor among the recordings."""
    names = [monitor, *recordings]
    monitors = [path for path in recordings if _kind(path) == "monitor"]
    if _kind(monitor) == "recording" and len(monitors) == 1:
        rest = " ".join(str(path) for path in names if path != monitors[0])
        raise DataError(f"the monitor comes first: residua {command} {monitors[0]} {rest}")


def check_recordings(paths: Sequence[Path]) -> None:
    """Raise unless every recording is a file, without repeats."""
    for path in paths:
        check_file(path, "recording")
    twice = next((path for path in paths if [real(p) for p in paths].count(real(path)) > 1), None)
    if twice is not None:
        raise DataError(f"{twice} is given twice: give each recording once")


def check_outputs(outputs: Iterable[Path | None], inputs: Iterable[Path] = ()) -> None:
    """Raise unless every output can be written.

    Parameters
    ----------
    outputs : iterable of Path or None
        ``None`` stands for an output that is not wanted.
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
