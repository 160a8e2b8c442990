"""List of commands; each is imported when it is called."""

from __future__ import annotations

import inspect
import re
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from residua import __version__
from residua.cli.guard import guarded, speak_of

#: The commands, and their lines in the list; each stands in a module of its name.
COMMANDS = {
    "identify": "Identify a plant with its noise from fault-free recordings.",
    "learn": "Learn a monitor from fault-free recordings, without a model.",
    "analyze": "Show which faults of a plant can be detected and isolated.",
    "codes": "Choose a coding set: the faults to which each residual answers.",
    "suggest": "Compare the designs for a plant by the faults that they see.",
    "design": "Design a monitor for a plant file.",
    "validate": "Count false alarms, misses and delays in simulated runs.",
    "tune": "Choose window, persistence and threshold by simulated runs.",
    "fit": "Set the threshold of a monitor from fault-free recordings.",
    "run": "Look for faults in recordings.",
    "live": "Watch live data: store alarms, send them on, show a page.",
    "export": "Write a monitor as C, Structured Text, FMU or ONNX.",
    "demo": "Run an example on simulated data.",
}

#: Words that others use for commands.
_MEANT = {
    **dict.fromkeys(("train", "calibrate"), "fit"),
    **dict.fromkeys(("detect", "diagnose", "check", "monitor", "predict"), "run"),
    **dict.fromkeys(("watch", "stream", "serve"), "live"),
    "simulate": "validate",
    "help": "--help",
    "version": "--version",
}


class Commands(TyperGroup):
    """Group of the commands: the list shows their summaries, a call imports one, and errors end in one line."""

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        self.commands = {name: TyperCommand(name, help=line) for name, line in COMMANDS.items()}

    def make_context(self, *args: Any, **kwargs: Any) -> Any:
        """Read the arguments; options such as ``--version`` print at once."""
        with guarded():
            return super().make_context(*args, **kwargs)

    def invoke(self, ctx: Any) -> Any:
        """Run the chosen command."""
        with guarded():
            return super().invoke(ctx)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Import the command that is called, or raise with the one that was probably meant."""
        word = args[0]
        if word in _MEANT:
            ctx.fail(f"No such command {word!r}. Did you mean 'residua {_MEANT[word]}'?")
        if word not in COMMANDS and Path(word).is_file():
            first = {".toml": "analyze", ".json": "run"}.get(Path(word).suffix, "learn")
            ctx.fail(f"{word} is a file. Name a command first, such as: residua {first} {word}")
        name, listed, rest = super().resolve_command(ctx, args)
        if name is None:
            return name, listed, rest
        called = command(name, rest)
        speak_of(called)
        return name, called, rest


def command(name: str, arguments: list[str]) -> Any:
    """Return a command with its options; those of ``design`` depend on the method named by the arguments."""
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
    "4 with --strict: no alarm, from a monitor that cannot see a lasting fault. "
    "RESIDUA_TRACEBACK=1 shows the traceback of an error.",
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
