"""Public names of a room, imported on first use."""

from __future__ import annotations

import ast
import sys
from importlib import import_module
from importlib.machinery import PathFinder
from pathlib import Path
from types import ModuleType
from typing import Any


class _Facade(ModuleType):
    """Module of a room, which passes on names from its files, and from rooms above it."""

    _places: dict[str, str]
    _modules: dict[str, str]

    def __getattr__(self, name: str) -> Any:
        if name in self._modules:
            value: Any = import_module(self._modules[name])
        elif name in self._places:
            value = getattr(import_module(self._places[name]), name)
        else:
            raise AttributeError(f"module {self.__name__!r} has no attribute {name!r}{self._instead_of(name)}")
        self.__dict__[name] = value
        return value

    def __setattr__(self, name: str, value: Any) -> None:
        if name in self._places and isinstance(value, ModuleType):
            return  # Python's import puts a file here by its name, which is that of a function in it
        super().__setattr__(name, value)

    def _instead_of(self, name: str) -> str:
        place = f"{self.__name__}.{name}"
        if name.startswith("_") or PathFinder.find_spec(place, getattr(self, "__path__", None)) is not None:
            return ""  # tools look for such names, and an import looks for a file's name here first
        guesses = import_module("residua.wrong_guesses")
        return guesses.instead_of_name(self.__name__, name, sorted(self._modules.values()))

    def __dir__(self) -> list[str]:
        return sorted({*self._places, *self._modules})


def hand_on(facade: str) -> None:
    """Let a module pass on the names that its stub imports, each imported on first use.

    The stub ``__init__.pyi`` lies beside the module, and type checkers read it too. ``from room.file import name`` in
    it hands on a name; ``from room import file`` a whole module, if ``room`` is the package or the module itself. So an
    import reads only the files that it needs. And importing a file never waits for a room that waits for this file: as
    no imports run in a circle, threads that import at the same time meet no half-made module.

    Parameters
    ----------
    facade : str
        The module's own name.
    """
    room = sys.modules[facade]
    stub = ast.parse(Path(str(room.__file__)).with_suffix(".pyi").read_text(encoding="utf-8"))
    pairs = [
        (alias.name, str(node.module)) for node in stub.body if isinstance(node, ast.ImportFrom) for alias in node.names
    ]
    modules = {name: f"{place}.{name}" for name, place in pairs if place in ("residua", facade)}
    places = {name: place for name, place in pairs if name not in modules}
    for name in places:
        if isinstance(room.__dict__.get(name), ModuleType):  # that another thread has imported just before
            del room.__dict__[name]
    room.__dict__.update(_places=places, _modules=modules, __all__=sorted({*places, *modules}))
    room.__class__ = _Facade


__all__ = ["hand_on"]
