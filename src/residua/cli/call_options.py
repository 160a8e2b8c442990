"""Options that stand for the arguments of a Python call, each as NAME=VALUE: ``--read dt=60 --read decimal=,``."""

from __future__ import annotations

import ast
import re
import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from typing import Annotated, Any

import typer

from residua.cli import screen
from residua.cli.guard import ARGUMENTS
from residua.cli.option_types import form_of, in_plain_words
from residua.design.core.method import Option, options_of, signature_of
from residua.plant.toml_entry import suggestion

_TRUTHS = {"": True, "true": True, "yes": True, "false": False, "no": False}


@dataclass(frozen=True)
class Arguments:
    """Arguments of a function, with types and texts from its signature and docstring.

    Attributes
    ----------
    flag : str
        The option.
    module, function : str
    beside : tuple of str
        Arguments that the command has in another form.
    """

    flag: str
    module: str
    function: str
    beside: tuple[str, ...]

    @cached_property
    def options(self) -> dict[str, Option]:
        """The arguments by their names."""
        call = getattr(import_module(self.module), self.function)
        found = options_of(call, signature_of(call))
        return {one.name: one for one in found if one.name not in self.beside and form_of(one) is not None}

    def checked(self, texts: list[str] | None) -> list[str] | None:
        """Return the texts if they can be read; ``help`` lists the arguments instead."""
        if texts and "help" in texts:
            rows = [(one.name, _metavar(one), _first_sentence(one)) for one in self.options.values()]
            screen.show_table((f"{self.flag} NAME=VALUE", "value", "meaning"), rows)
            raise typer.Exit
        self.values(texts)
        return texts

    def values(self, texts: list[str] | None) -> dict[str, Any]:
        """Return the arguments as values."""
        values: dict[str, Any] = {}
        for text in texts or ():
            name, value = self._read(text)
            if name in values and not (isinstance(value, tuple) and isinstance(values[name], tuple)):
                raise typer.BadParameter(f"{name} is given twice")
            values[name] = (*values.get(name, ()), *value) if isinstance(value, tuple) else value
        return values

    def _read(self, text: str) -> tuple[str, Any]:
        name, sign, value = (part.strip() for part in text.partition("="))
        name = name.replace("-", "_")
        if name not in self.options:
            known = ", ".join(self.options)
            raise typer.BadParameter(f"there is no argument{suggestion(name, self.options)}; there are {known}")
        form = form_of(self.options[name])
        assert form is not None
        if form.is_flag and value.lower() in _TRUTHS and bool(sign) == bool(value):
            return name, _TRUTHS[value.lower()]
        if not sign or form.is_flag:
            raise typer.BadParameter(f"write {name}={_metavar(self.options[name])}, got {text!r}")
        try:
            read = form.read(value)
        except ValueError as error:
            raise typer.BadParameter(f"{name}: {error}") from None
        parts = (*read, *read.values()) if isinstance(read, Mapping) else read if isinstance(read, tuple) else ()
        if "" in parts:
            raise typer.BadParameter(f"{name}: a name is empty")
        return name, read

    def in_words(self, text: str) -> str:
        """Return a message with these arguments as on the command line."""
        names, flag = "|".join(self.options), self.flag
        text = text.replace("columns must be a mapping {channel: column} here", "columns= takes CHANNEL=COLUMN here")
        text = text.replace("columns={channel: column}", f'{flag} "columns=CHANNEL=COLUMN;..."')
        text = text.replace("columns=[...]", f'{flag} "columns=NAME,NAME,..."')
        text = text.replace(" of read_recording and recording_from_frame", "")
        text = re.sub(rf"\b({names})=(\{{'.*\}}|\{{\".*\}}|\['.*'\])", self._literal, text)
        text = re.sub(rf"\b({names})=True\b", rf"{flag} \1", text)
        text = re.sub(rf"\b({names})=False\b", rf"{flag} \1=false", text)
        text = re.sub(rf"\b({names})='([^']*)'", rf"{flag} \1=\2", text)
        text = re.sub(rf"(?<!{flag} )\b({names})=(?=[,;. )]|$)", rf"{flag} \1=", text)
        return re.sub(rf"(?<!{flag} )\b(fill_gaps\b|transpose(?= is for))", rf"{flag} \1", text)

    def _literal(self, found: re.Match[str]) -> str:
        """Return columns or marks that Python wrote as options for a shell."""
        try:
            given = ast.literal_eval(found[2])
        except (ValueError, SyntaxError):  # not alone: something of the same kind follows in the text
            return found[0]
        values = given if isinstance(given, list) else [";".join(f"{name}={value}" for name, value in given.items())]
        return " ".join(f"{self.flag} {quoted(f'{found[1]}={value}')}" for value in values)


def _metavar(option: Option) -> str:
    form = form_of(option)
    assert form is not None
    return "true|false" if form.is_flag else form.metavar


def _first_sentence(option: Option) -> str:
    return re.split(r"\. (?=[A-Z])", in_plain_words(option.text))[0].rstrip(".")


def quoted(text: str) -> str:
    """Return a text as one argument of a command, quoted for all shells if possible."""
    return shlex.quote(text) if set(text) & set('"$`\\!') else f'"{text}"'


READ = Arguments("--read", "residua.recording.recording", "read_recording", ("plant",))
MODEL = Arguments("--model", "residua.identify", "subspace", ("y", "inputs", "outputs", "dt", "progress"))
ARGUMENTS.update({one.flag: one.in_words for one in (READ, MODEL)})

Read = Annotated[
    list[str] | None,
    typer.Option(
        READ.flag,
        callback=READ.checked,
        is_eager=True,
        metavar="NAME=VALUE",
        help="An argument of residua.read_recording, such as dt=60 or decimal=, (one option for each); 'help' lists "
        "them.",
    ),
]
Model = Annotated[
    list[str] | None,
    typer.Option(
        MODEL.flag,
        callback=MODEL.checked,
        is_eager=True,
        metavar="NAME=VALUE",
        help="An argument of residua.identify.subspace, such as order=4 (one option for each); 'help' lists them.",
    ),
]

__all__ = ["MODEL", "READ", "Arguments", "Model", "Read", "quoted"]
