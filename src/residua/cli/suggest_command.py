"""The command ``suggest``: designs for a plant, best first."""

from __future__ import annotations

from typing import Annotated

import typer

from residua.cli import methods, screen
from residua.cli.shared_options import AsJson, PlantFile, check_file
from residua.design.suggestion import suggest as suggestion
from residua.plant.plant_file import load_plant


def suggest(
    plant: PlantFile,
    want: Annotated[
        str | None,
        typer.Option(metavar="name|size|state", help="Wanted: the fault, its size, or the state; chosen when omitted."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Compare the designs for a plant by the faults that they see."""
    check_file(plant, "plant file")
    model = load_plant(plant)
    with screen.patience(f"trying designs for {model.name}"):
        found = suggestion(model, want=want)
    if not as_json:
        screen.say(str(found))
        return
    designs = [
        {
            "method": methods.method_name(one.method),
            "call": one.call,
            "works": one.works,
            "reason": one.reason,
            "left_out": one.left_out,
            "names": one.names,
            "estimates": one.estimates,
            "smallest_sizes": one.sizes,
        }
        for one in found.entries
    ]
    best = None if found.best is None else methods.method_name(found.best.method)
    screen.print_json({"plant": model.name, "want": found.want, "best": best, "designs": designs, "notes": found.notes})
