"""The table of methods: every design function with its needs and promises, from its own declaration."""

from __future__ import annotations

from importlib import import_module

from residua.design.core.method import METHODS, Method
from residua.errors import SettingError

__all__ = ["HEADER", "Method", "forget", "method", "methods", "table"]


def methods() -> tuple[Method, ...]:
    """Return all methods, one of one's own too: observers, plain residuals, those that name a fault, then its size.

    Examples
    --------
    >>> from residua.design.catalogue import methods
    >>> [one.name for one in methods() if one.state and one.noise == 'filtered'][:2]
    ['luenberger_observer', 'unknown_input_observer']
    """
    facade = import_module("residua.design")
    for name in facade.__all__:  # a method declares itself when its module is imported: those of other rooms are now
        getattr(facade, name)
    registered = list(METHODS.values())  # a copy: another thread may declare a method meanwhile
    return tuple(sorted(registered, key=lambda one: one.place))


def method(name: str) -> Method:
    """Return the record of a design function.

    Parameters
    ----------
    name : str

    Returns
    -------
    Method

    Raises
    ------
    SettingError
        If there is none of this name.

    Examples
    --------
    >>> from residua.design.catalogue import method
    >>> method("reduced_order_observer").order
    'n - p'
    """
    by_name = {one.name: one for one in methods()}
    if name not in by_name:
        raise SettingError(f"no design function is called {name!r}: there are {', '.join(by_name)}")
    return by_name[name]


def forget(name: str) -> None:
    """Take a method of one's own out of the registry.

    Parameters
    ----------
    name : str

    Raises
    ------
    SettingError
        If there is none of this name.
    """
    if METHODS.pop(name, None) is None:  # of a module that is not imported yet, or of none
        METHODS.pop(method(name).name)


HEADER = ("function", "needs", "exists when", "state", "names the fault", "size", "decouples", "singular E", "order")


def table() -> list[tuple[str, ...]]:
    """Return the records as rows of text under :data:`HEADER`, for a table in the documentation."""
    return [
        (
            f":func:`~residua.design.{one.name}`",
            one.needs if one.designs_for == "plant" else f"{one.designs_for}: {one.needs}",
            one.condition,
            one.state or "-",
            one.faults or "-",
            _mark(one.size),
            _mark(one.decouples),
            _mark(one.singular),
            one.order,
        )
        for one in methods()
    ]


def _mark(yes: bool) -> str:
    return "yes" if yes else "-"
