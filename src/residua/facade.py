"""Public names of a room, imported on first use."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from importlib import import_module
from importlib.machinery import PathFinder
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


def hand_on(facade: str, names: Mapping[str, tuple[str, ...]], modules: Iterable[str] = ()) -> None:
    """Let a module pass on names that other modules define, each imported on first use.

    So an import reads only the files that it needs. And importing a file never waits for a room that waits for this
    file: as no imports run in a circle, threads that import at the same time meet no half-made module.

    Parameters
    ----------
    facade : str
        The module's own name.
    names : mapping
        By the module that defines them. They are in the module's ``__all__`` too, and imported for type checkers.
    modules : iterable of str
        Whole modules that are handed on, each by the last part of its name.
    """
    room = sys.modules[facade]
    room.__dict__["_places"] = {name: place for place, some in names.items() for name in some}
    room.__dict__["_modules"] = {module.rpartition(".")[2]: module for module in modules}
    room.__class__ = _Facade
    for name in room.__dict__["_places"]:
        if isinstance(room.__dict__.get(name), ModuleType):  # that another thread has imported just before
            del room.__dict__[name]
