"""The calls that :func:`residua.suggest` considers for a plant: of every method that a plant alone can feed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from residua.analysis.diagnosability import Diagnosability
from residua.design.catalogue import methods
from residua.design.core.method import Chosen, Method
from residua.plant import Plant

#: Seconds for the choice of a coding set; what was found by then is taken.
_CHOICE_TIME = 5.0


@dataclass(frozen=True)
class Candidate:
    """A call, and why it makes no sense here, where it makes none.

    Attributes
    ----------
    method : Method
    options : mapping of str to value
        What is asked of it.
    pointless : str
        Why it makes no sense; empty where it does.
    made : dict
        Arguments that were made from the plant already, which candidates share.
    """

    method: Method
    options: Mapping[str, Any] = field(default_factory=dict)
    pointless: str = ""
    made: dict[Chosen, Any] = field(default_factory=dict, repr=False)

    @property
    def call(self) -> str:
        """The line of code."""
        given = [one.code for one in self.method.chosen.values()]
        given += [f"{name}={_typed(value)}" for name, value in self.options.items()]
        return f"{self.method.called}({', '.join(['plant', *given])})"

    def run(self, plant: Plant) -> Any:
        """Make the call."""
        chosen = {name: self._made(one, plant) for name, one in self.method.chosen.items()}
        return self.method.function(plant, **chosen, **self.options)

    def _made(self, one: Chosen, plant: Plant) -> Any:
        if one not in self.made:
            self.made[one] = one.make(plant, _CHOICE_TIME)
        return self.made[one]


def candidates(plant: Plant, known: Diagnosability | None) -> Iterator[Candidate]:
    """Yield what could serve, the more usual first.

    Parameters
    ----------
    plant : Plant
    known : Diagnosability or None
        Of this plant; ``None`` where it was not examined.
    """
    made: dict[Chosen, Any] = {}
    for one in methods():
        asked = {option.name for option in one.options if option.required} - set(one.chosen)
        if one.takes_a_plant and not asked:
            why = one.missing(plant, known)
            calls = tuple(one.calls(plant, known)) or ({},)
            yield from (Candidate(one, options, why, made) for options in calls)


def _typed(value: Any) -> str:
    """Return a value as it is typed."""
    if isinstance(value, str):
        return f'"{value}"'
    return repr(list(value)) if isinstance(value, tuple) else repr(value)
