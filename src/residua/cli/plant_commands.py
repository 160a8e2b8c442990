"""The commands that look at a plant before anything is designed: analyze, codes, suggest."""

from __future__ import annotations

import json
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from residua.analysis import coding, diagnosability
from residua.cli import screen
from residua.cli.guard import in_cli_words
from residua.cli.methods import CHOICE_TIME
from residua.cli.option_types import parse_rows
from residua.design.suggestion import suggest as suggestion
from residua.files import check_input
from residua.plant.plant_file import load_plant

#: Attainable rows that are listed without being asked for.
_LISTED = 40


class Quality(StrEnum):
    """How well a coding set shall isolate."""

    strong = "strong"
    weak = "weak"


def _rows(text: str | None) -> str | None:
    if text is not None:
        try:
            parse_rows(text)
        except ValueError as error:
            raise typer.BadParameter(str(error)) from None
    return text


PlantFile = Annotated[Path, typer.Argument(metavar="PLANT.toml", help="Plant file.", show_default=False)]
Rows = Annotated[
    str | None,
    typer.Option(
        callback=_rows,
        metavar="LIST",
        help="Who fires when what fails: 0 and 1 for each residual, such as 011,101.",
    ),
]


def analyze(
    plant: PlantFile,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")] = False,
) -> None:
    """Tell which faults can be detected and told apart, and why the others cannot."""
    check_input(plant, "a plant file")
    answer = diagnosability(load_plant(plant))
    if as_json:
        typer.echo(json.dumps(screen.diagnosability_values(answer), indent=2))
    else:
        screen.show_diagnosability(answer)


def codes(
    plant: PlantFile,
    rows: Rows = None,
    quality: Annotated[
        Quality, typer.Option(help="How well the choice shall isolate; strong: also when residuals stay silent.")
    ] = Quality.strong,
    constant: Annotated[
        bool, typer.Option("--constant", help="Only residuals that answer for as long as a constant fault lasts.")
    ] = False,
) -> None:
    """Tell which coding sets a plant allows, and choose one: which residual shall answer to which fault."""
    check_input(plant, "a plant file")
    model = load_plant(plant)
    if rows:
        space = coding.attainable(model, parse_rows(rows), constant=constant)
        screen.say(str(space), "", str(coding.CodingSet(space.structure, space.faults, space.residuals)))
        return
    with screen.patience(f"looking for the rows of {model.name}"):
        space = coding.attainable(model, constant=constant)
    if len(space.residuals) > _LISTED:
        screen.say(f"{model.name}: {len(space.residuals)} rows are attainable; --rows tells about those that you name")
    else:  # r1, r2, ... are the residuals of the choice, and of a bank that is made of it
        screen.say(str(replace(space, residuals=tuple(f"row {k + 1}" for k in range(len(space.residuals))))))
    with screen.patience(f"choosing among {len(space.residuals)} rows, for {CHOICE_TIME:g} s at most"):
        chosen = coding.choose(model, quality=quality.value, constant=constant, time_limit=CHOICE_TIME)
    screen.say("", in_cli_words(str(chosen)), f"as an option: --rows {','.join(chosen.digits)}")


def suggest(
    plant: PlantFile,
    want: Annotated[
        str | None, typer.Option(metavar="name|size|state", help="What to know; by what the plant has when omitted.")
    ] = None,
) -> None:
    """Tell which design function to call for a plant, by the faults that each design sees in its noise."""
    check_input(plant, "a plant file")
    model = load_plant(plant)
    with screen.patience(f"trying designs for {model.name}"):
        found = suggestion(model, want=want)
    screen.say(str(found))
