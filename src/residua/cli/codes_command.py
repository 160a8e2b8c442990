"""The command ``codes``: coding sets that a plant allows."""

from __future__ import annotations

from dataclasses import replace
from enum import StrEnum
from typing import Annotated, Any

import typer

from residua.analysis import coding
from residua.cli import screen
from residua.cli.guard import in_cli_words
from residua.cli.methods import CHOICE_TIME
from residua.cli.option_types import parse_rows
from residua.cli.shared_options import AsJson, PlantFile, check_file
from residua.plant.plant_file import load_plant

#: Attainable rows that are listed without being asked for.
_LISTED = 40


class Quality(StrEnum):
    """Isolating quality of a coding set."""

    strong = "strong"
    weak = "weak"


def _structure(text: str | None) -> str | None:
    if text is not None:
        try:
            parse_rows(text)
        except ValueError as error:
            raise typer.BadParameter(str(error)) from None
    return text


def codes(
    plant: PlantFile,
    structure: Annotated[
        str | None,
        typer.Option(
            callback=_structure,
            metavar="LIST",
            help="Rows to check, one for each residual, with 0 or 1 for each fault: 011,101.",
        ),
    ] = None,
    quality: Annotated[
        Quality, typer.Option(help="strong: no code becomes another when residuals stay silent. weak: all differ.")
    ] = Quality.strong,
    constant: Annotated[
        bool, typer.Option("--constant", help="Only residuals that respond for as long as a constant fault lasts.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Choose a coding set: the faults to which each residual answers."""
    check_file(plant, "plant file")
    model = load_plant(plant)
    if structure:
        space = coding.attainable(model, parse_rows(structure), constant=constant)
        asked = coding.CodingSet(space.structure, space.faults, space.residuals)
        if as_json:
            screen.print_json(_values(space, asked))
        else:
            screen.say(str(space), "", str(asked))
        return
    with screen.patience(f"looking for the rows of {model.name}"):
        space = coding.attainable(model, constant=constant)
    with screen.patience(f"choosing among {len(space.residuals)} rows, for {CHOICE_TIME:g} s at most"):
        chosen = coding.choose(model, quality=quality.value, constant=constant, time_limit=CHOICE_TIME)
    if as_json:
        screen.print_json(_values(space, chosen))
        return
    if len(space.residuals) > _LISTED:
        screen.say(f"{model.name}: {len(space.residuals)} rows are attainable; --structure checks those that you name")
    else:  # r1, r2, ... are the residuals of the choice, and of a bank that is made of it
        screen.say(str(replace(space, residuals=tuple(f"row {k + 1}" for k in range(len(space.residuals))))))
    screen.say("", in_cli_words(str(chosen)), f"as an option: --structure {','.join(chosen.digits)}")


def _values(space: coding.Attainability, chosen: coding.CodingSet) -> dict[str, Any]:
    """Return attainable rows and a coding set as values for JSON."""
    return {
        "plant": space.plant.name,
        "faults": space.faults,
        "rows": [
            {"row": digits, "attainable": bool(attainable), "reason": space.reasons.get(name)}
            for digits, attainable, name in zip(space.digits, space.attainable, space.residuals, strict=True)
        ],
        "coding_set": {
            "rows": chosen.digits,
            "quality": chosen.quality,
            "undetectable": chosen.undetectable,
            "inseparable": chosen.inseparable,
            "notes": [in_cli_words(note) for note in chosen.notes],
        },
    }
