"""Public names of a room that stand in a room above it, imported when they are first asked for."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def names_from_above(facade: str, above: Mapping[str, str]) -> Callable[[str], Any]:
    """Return the ``__getattr__`` of a module whose public names stand partly in rooms that import it.

    Parameters
    ----------
    facade : str
        The module's own name.
    above : mapping
        By public name, the module that defines it.
    """

    def get(name: str) -> Any:
        if name in above:
            return getattr(import_module(above[name]), name)
        raise AttributeError(f"module {facade!r} has no attribute {name!r}")

    return get
