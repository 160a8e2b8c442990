"""The list of commands; each is imported when it is called."""

from __future__ import annotations

import inspect
import re
from importlib import import_module
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from residua import __version__
from residua.cli.guard import GuardedGroup, speak_of

#: The commands, and their lines in the list; each stands in a module of its name.
COMMANDS = {
    "identify": "Identify a plant with its noise from fault-free recordings.",
    "learn": "Learn a monitor from fault-free recordings, without a model.",
    "analyze": "Show which faults of a plant can be detected and isolated.",
    "codes": "Choose a coding set: which residual answers to which fault.",
    "suggest": "Compare the designs for a plant by the faults that each sees.",
    "design": "Design a monitor for a plant file.",
    "validate": "Count false alarms, misses and delays in simulated runs.",
    "tune": "Choose window, persistence and threshold by simulated runs.",
    "fit": "Set the threshold of a monitor from fault-free recordings.",
    "run": "Look for faults in recordings.",
    "live": "Watch live data: store alarms, send them on, show a page.",
    "export": "Write a monitor as C, Structured Text, FMU or ONNX.",
    "demo": "Run an example on simulated data.",
}


class Commands(GuardedGroup):
    """The commands: the list shows their summaries, and a call imports one."""

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        self.commands = {name: TyperCommand(name, help=line) for name, line in COMMANDS.items()}

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Import the command that is called."""
        name, listed, rest = super().resolve_command(ctx, args)
        if name is None:
            return name, listed, rest
        called = command(name, rest)
        speak_of(called)
        return name, called, rest


def command(name: str, arguments: list[str]) -> Any:
    """Return a command with its options; those of ``design`` depend on the method that the arguments name."""
    module = import_module(f"residua.cli.{name}_command")
    function = module.with_method_options(arguments) if name == "design" else getattr(module, name)
    alone = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
    text = re.sub(r"(?<!\n)\n(?!\n)", " ", inspect.cleandoc(function.__doc__ or ""))  # Typer keeps the ends of lines
    alone.command(name, help=text)(function)
    return typer.main.get_command(alone)


app = typer.Typer(
    cls=Commands,
    help="Model-based fault detection and isolation: from a plant file and a recording to the faulty component.",
    epilog="Exit status: 0 done, or no alarm; 1 an alarm was raised; 2 error; 3 no alarm, on data unlike the fit; "
    "4 with --strict: no alarm, of a monitor that sees too little to tell. "
    "RESIDUA_TRACEBACK=1 shows where an error comes from.",
    no_args_is_help=True,
    rich_markup_mode=None,  # its tables cut names
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"residua {__version__}")
        raise typer.Exit


@app.callback()
def _common(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and stop.")
    ] = False,
) -> None:
    pass
