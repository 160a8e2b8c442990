"""The options of a function, from its signature and the numpydoc of its parameters."""

from __future__ import annotations

import inspect
import re
import types
import typing
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from residua.errors import SettingError

#: The beginning of a parameter in numpydoc: names, and what they are.
_HEAD = re.compile(r"^(?P<names>\w+(?:, \w+)*)(?: : (?P<kind>.*))?$")


@dataclass(frozen=True)
class Option:
    """A parameter of a design function beside the plant.

    Attributes
    ----------
    name : str
    annotation : type
        The type of its values.
    default : object
        ``inspect.Parameter.empty`` without one.
    text : str
        The text of its docstring.
    choices : tuple of str
        The texts that it may be, where only some are.
    """

    name: str
    annotation: Any
    default: Any
    text: str
    choices: tuple[str, ...]

    @property
    def required(self) -> bool:
        """Whether it has no default."""
        return self.default is inspect.Parameter.empty

    @property
    def kinds(self) -> tuple[Any, ...]:
        """The types that it may be, each by itself."""
        return kinds_of(self.annotation)


def options_of(function: Callable[..., Any], signature: inspect.Signature) -> tuple[Option, ...]:
    """Return the options of a function with this signature: all parameters after the first but ``*args``, ``**kw``."""
    described, found = parameters_in(inspect.getdoc(function) or ""), []
    for one in list(signature.parameters.values())[1:]:
        if one.kind not in _ANY_NUMBER:
            kind, text = described.get(one.name, ("", ""))
            braces = re.match(r"\{(.*?)\}", kind)
            choices = re.findall(r'"([^"]*)"', braces[1]) if braces else []
            for part in kinds_of(one.annotation):
                if typing.get_origin(part) is typing.Literal:
                    choices += [value for value in typing.get_args(part) if isinstance(value, str)]
            found.append(Option(one.name, one.annotation, one.default, text, tuple(choices)))
    return tuple(found)


#: The kinds of parameters that stand for any number of arguments, none too.
_ANY_NUMBER = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)


def signature_of(function: Callable[..., Any]) -> inspect.Signature:
    """Return the signature of a function, its annotations as types; raise where one of them has no meaning."""
    try:
        return inspect.signature(function, eval_str=True)
    except Exception as error:  # an annotation is an expression of anybody's
        raise SettingError(
            f"the annotations of {function.__name__} cannot be read: {error}; import or define what they name above "
            "the function, and not under 'if TYPE_CHECKING:'"
        ) from error


def kinds_of(annotation: Any) -> tuple[Any, ...]:
    """Return the members of a union, those of its members too; any other type by itself."""
    annotation = getattr(annotation, "__value__", annotation)  # an alias by ``type``
    if isinstance(annotation, types.UnionType) or typing.get_origin(annotation) is typing.Union:
        return tuple(kind for part in typing.get_args(annotation) for kind in kinds_of(part))
    return (annotation,)


def parameters_in(docstring: str) -> Mapping[str, tuple[str, str]]:
    """Return what a docstring says under ``Parameters``: by name, the kind and the description."""
    lines = docstring.splitlines()
    title = next(
        (k for k in range(len(lines) - 1) if lines[k] == "Parameters" and lines[k + 1].startswith("---")), None
    )
    table: dict[str, tuple[str, str]] = {}
    if title is None:
        return table
    names: tuple[str, ...] = ()
    for k in range(title + 2, len(lines)):
        if k + 1 < len(lines) and lines[k + 1].startswith("---"):
            break
        head = _HEAD.match(lines[k])
        if head:
            names = tuple(head["names"].split(", "))
            table |= dict.fromkeys(names, (head["kind"] or "", ""))
        elif lines[k].strip():
            table |= {name: (table[name][0], f"{table[name][1]} {lines[k].strip()}".strip()) for name in names}
    return table
