"""The command ``demo``: examples on simulated data."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from residua.cli import screen
from residua.errors import AccuracyError, DataError
from residua.plant.toml_entry import suggestion

if TYPE_CHECKING:
    from residua.demos import Outcome

#: The demos, and their modules.
DEMOS = {"three-tank": "residua.demos.three_tank", "jet-engine": "residua.demos.jet_engine"}


def _known(name: str) -> str:
    """Return the name of a demo, or raise with the one that was probably meant."""
    if name in DEMOS:
        return name
    begun = [known for known in DEMOS if name and known.startswith(name.lower())]
    meant = f" {name!r} (did you mean {begun[0]!r}?)" if begun else suggestion(name, DEMOS)
    raise typer.BadParameter(f"there is no demo{meant}; there are {' and '.join(DEMOS)}")


def demo(
    name: Annotated[
        str, typer.Argument(metavar="three-tank|jet-engine", callback=_known, help="Example.", show_default=False)
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="DIR", help="Folder for plant file, recordings and page.")
    ] = Path("residua-demo"),
) -> None:
    """Run an example on simulated data.

    three-tank: three tanks with a leak, the whole way from a plant file and recordings to the faulty component.

    jet-engine: sensor faults of a jet engine, seen by a filter that decouples disturbances and by a plain one.
    """
    if output.exists() and not output.is_dir():
        raise DataError(f"{output} is a file; name a folder")
    output.mkdir(parents=True, exist_ok=True)
    present(import_module(DEMOS[name]).run(output))


def present(outcome: Outcome) -> None:
    """Print the outcome of a demo, or raise if it is not as expected."""
    screen.say(*outcome.lines)
    for table in outcome.tables:
        screen.show_table(table.header, table.rows, title=table.caption)
    screen.say(f"report page: {outcome.page.resolve()}")
    if outcome.surprises:
        raise AccuracyError(f"the demo did not come out as it should: {'; '.join(outcome.surprises)}")
