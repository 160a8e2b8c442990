"""Options for reading a recording, and reading it."""

from __future__ import annotations

import ast
import csv
import inspect
import re
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer

from residua.cli import screen
from residua.cli.shared_options import signed
from residua.errors import ModelError, ResiduaError
from residua.monitor import Monitor
from residua.plant import Plant
from residua.recording.columns import ReadOptions
from residua.recording.recording import Recording, read_recording


class Decimal(StrEnum):
    """The decimal mark."""

    point = "point"
    comma = "comma"

    @property
    def mark(self) -> str:
        """The mark itself."""
        return "." if self is Decimal.point else ","


def _positive(value: float | None) -> float | None:
    if value is not None and not 0 < value < float("inf"):
        raise typer.BadParameter(f"must be positive, got {value:g}")
    return value


def _columns(text: str | None) -> str | None:
    if text is not None:
        try:
            parse_columns(text)
        except ValueError as error:
            raise typer.BadParameter(str(error)) from None
    return text


TimeColumn = Annotated[
    str | None, typer.Option("--time", metavar="NAME", help="Column with the times, in seconds or dates.")
]
Step = Annotated[
    float | None,
    typer.Option(
        "--dt",
        metavar="S",
        callback=_positive,
        help="Step in seconds, where there are no times or they are not used; with --fill-gaps the step of the grid.",
    ),
]
Variable = Annotated[str | None, typer.Option("--variable", metavar="NAME", help="Array of a .mat or .npz file.")]
FillGaps = Annotated[
    bool, typer.Option("--fill-gaps", help="Put the rows on a grid of equal steps; missing rows become gaps.")
]
Tolerance = Annotated[
    float | None,
    typer.Option(
        "--tolerance",
        metavar="PART",
        callback=_positive,
        help="Largest irregularity of the times, in steps: 0.01; with --fill-gaps 0.1.",
    ),
]
DayFirst = Annotated[
    bool | None, typer.Option("--day-first/--month-first", help="Order of day and month in dates such as 3/4/2026.")
]
TimeFormat = Annotated[
    str | None, typer.Option("--time-format", metavar="FORMAT", help="Format of dates, such as %d-%b-%Y %H:%M:%S.")
]
DecimalMark = Annotated[Decimal, typer.Option("--decimal", help="Decimal mark of text.")]
Columns = Annotated[
    str | None,
    typer.Option(
        "--columns",
        metavar="LIST",
        callback=_columns,
        help="CHANNEL=COLUMN,... where names differ; or the names of all columns in order, where the file has none.",
    ),
]
Transpose = Annotated[
    bool, typer.Option("--transpose", help="Time runs along the rows of a matrix, or of text without a header.")
]
MissingMarks = Annotated[
    list[str] | None,
    typer.Option(
        "--missing",
        metavar="MARK",
        help="A text or number that stands for a missing value, such as -9999; one option for each. Bad, No Data, N/A "
        "and other marks of historians are known.",
    ),
]


def parse_columns(text: str) -> dict[str, str] | list[str]:
    """Return ``channel=column`` pairs as a mapping, names alone as a list; pairs with a comma are quoted."""
    parts = [part.strip() for part in next(csv.reader([text], skipinitialspace=True)) or [""]]
    if not all(parts):
        raise ValueError("a name is empty")
    pairs = [[half.strip() for half in part.split("=", 1)] for part in parts]
    if all(len(pair) == 1 for pair in pairs):
        return parts
    if not all(len(pair) == 2 and all(pair) for pair in pairs):
        raise ValueError("give either CHANNEL=COLUMN for each, or the names of all columns")
    names = [pair[0] for pair in pairs]
    if len(set(names)) < len(names):
        raise ValueError("a channel is named twice")
    return {pair[0]: pair[1] for pair in pairs}


@dataclass(frozen=True)
class Reading:
    """Options for reading recordings, shared by several commands."""

    time: TimeColumn = None
    dt: Step = None
    variable: Variable = None
    fill_gaps: FillGaps = False
    tolerance: Tolerance = None
    day_first: DayFirst = None
    time_format: TimeFormat = None
    decimal: DecimalMark = Decimal.point
    columns: Columns = None
    transpose: Transpose = False
    missing: MissingMarks = None

    def read(self, path: Path, watch: Monitor) -> Recording:
        """Read a recording for a monitor."""
        return self.read_channels(path, _plant_of(watch))

    def options(self, watch: Monitor) -> ReadOptions:
        """Return the options, with the plant of a monitor."""
        return ReadOptions(
            _plant_of(watch),
            self.time,
            self.dt,
            self._columns,
            self.variable,
            self.tolerance,
            self.fill_gaps,
            self.day_first,
            self.time_format,
            self.decimal.mark,
            self.transpose,
            self.missing or (),
        )

    @property
    def _columns(self) -> Mapping[str, str] | Sequence[str] | None:
        return None if self.columns is None else parse_columns(self.columns)

    def read_channels(self, path: Path, plant: Plant | None) -> Recording:
        """Read a recording for the channels of a plant; without one, every column as an output."""
        columns = self._columns
        with screen.reading(path), in_words_of_options():
            recording = read_recording(
                path,
                plant,
                time=self.time,
                dt=self.dt,
                columns=columns,
                variable=self.variable,
                tolerance=self.tolerance,
                fill_gaps=self.fill_gaps,
                dayfirst=self.day_first,
                time_format=self.time_format,
                decimal=self.decimal.mark,
                transpose=self.transpose,
                missing=self.missing or (),
            )
        return replace(recording, notes=tuple(map(reading_words, recording.notes)))


def with_reading(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command the options of :class:`Reading` in place of its last argument, ``reading``."""
    own = list(inspect.signature(command, eval_str=True).parameters.values())[:-1]
    kinds = get_type_hints(Reading, include_extras=True)
    options = [
        inspect.Parameter(one.name, inspect.Parameter.KEYWORD_ONLY, default=one.default, annotation=kinds[one.name])
        for one in fields(Reading)
    ]

    def reads(**given: Any) -> None:
        reading = Reading(**{one.name: given.pop(one.name) for one in options})
        command(**given, reading=reading)

    return signed(reads, [*own, *options], command.__doc__)


def _plant_of(watch: Monitor) -> Plant:
    """Return the plant of a monitor, sampled if its step is known."""
    try:
        return watch.generator.plant
    except ModelError:
        return watch.design.plant


#: Words of Python about reading, as patterns, and those of the command line.
_WORDS = {
    r"fill_gaps=True of read_recording and recording_from_frame": "--fill-gaps",
    r"\bfill_gaps(=True)?\b": "--fill-gaps",
    r"dayfirst=True\b": "--day-first",
    r"dayfirst=False\b": "--month-first",
    r"time_format=(?=[,; ])": "--time-format",
    r"decimal=','": "--decimal comma",
    r"columns=\{channel: column\}": "--columns CHANNEL=COLUMN",
    r"columns=\[\.\.\.\]": '--columns "NAME,NAME,..."',
    r"columns must be a mapping \{channel: column\} here": "--columns takes CHANNEL=COLUMN here",
    r"\b(time|dt|variable|tolerance)=(?=[,;. )]|$)": r"--\1",
    r"\bdt=(?= says)": "--dt",
    r"\btranspose is for": "--transpose is for",
}


def reading_words(text: str) -> str:
    """Return a message about reading in terms of the command line."""
    for python, here in _WORDS.items():
        text = re.sub(python, here, text)
    return _LITERALS.sub(_option, text)


#: Columns and marks as Python writes them.
_LITERALS = re.compile(r"\b(columns|missing)=(\{'.*\}|\{\".*\}|\['.*'\])")


def _option(found: re.Match[str]) -> str:
    """Return the options for a mapping of columns, or for marks, as for a shell."""
    try:
        given = ast.literal_eval(found[2])
    except (ValueError, SyntaxError):  # not alone: something of the same kind follows in the text
        return found[0]
    if isinstance(given, list):
        return " ".join(f"--missing {quoted(mark)}" for mark in given)
    pairs = [f"{channel}={column}" for channel, column in given.items()]
    return "--columns " + quoted(",".join(f'"{pair}"' if "," in pair else pair for pair in pairs))


def quoted(text: str) -> str:
    """Return a text as one argument of a command, quoted for all shells if possible."""
    return shlex.quote(text) if set(text) & set('"$`\\!') else f'"{text}"'


@contextmanager
def in_words_of_options() -> Iterator[None]:
    """Put errors about reading in terms of the command line."""
    try:
        yield
    except ResiduaError as error:
        raise type(error)(reading_words(str(error))) from error
