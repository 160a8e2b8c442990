"""Numbers and names in sentences: one wording for pages, screens and printed results."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any


@dataclass(eq=False)
class UnitOfRates:
    """A unit in which rates are worked on, and whether a text has asked for it.

    Attributes
    ----------
    value : float
        In 1/s.
    asked : bool
        What is made while it is false has the unit in no text, and is the same in any.
    around : UnitOfRates or None
        The unit outside, of which this is a multiple: who asks for this one has asked for that one too.
    """

    value: float
    around: UnitOfRates | None = None
    asked: bool = False

    def ask(self) -> float:
        """Return the unit to one who writes it into a text."""
        one: UnitOfRates | None = self
        while one is not None:
            one.asked = True
            one = one.around
        return self.value


_unit: ContextVar[UnitOfRates | None] = ContextVar("unit of rates", default=None)


@contextmanager
def rates_in(unit: float) -> Iterator[UnitOfRates]:
    """Within this, rates are worked on in that many 1/s; texts say them in 1/s all the same."""
    around = _unit.get()
    here = UnitOfRates(unit if around is None else around.value * unit, around)
    token = _unit.set(here)
    try:
        yield here
    finally:
        _unit.reset(token)


def unit_of_rates() -> float:
    """Return the unit in which rates are worked on here, in 1/s: what texts multiply them by."""
    here = _unit.get()
    return 1.0 if here is None else here.ask()


def as_given(value: Any, power: float = 1.0) -> Any:
    """Return an option with a power of a rate in it as it was given, for a text that says what is wrong with it."""
    if hasattr(value, "tolist"):
        value = value.tolist()  # of an array, or a number of NumPy
    factor = unit_of_rates() ** power
    if factor == 1.0 or value is None or isinstance(value, (str, bytes, bool)):
        return value
    if isinstance(value, Mapping):
        return {name: as_given(one, power) for name, one in value.items()}
    if isinstance(value, Sequence):
        return [as_given(one, power) for one in value]
    try:
        return value * factor
    except TypeError:  # no number: it was not converted either
        return value


def number(value: float | None, digits: int = 4) -> str:
    """Return a number as short text; a dash when there is none."""
    if value is None or math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    return f"{value:.{digits}g}".replace("-", "−").replace("e+", "e")


def score(value: float) -> str:
    """Return a correlation with three decimals; a dash when it was not judged."""
    return f"{round(value, 3) + 0.0:.3f}" if math.isfinite(value) else "–"  # no -0


def percent(part: int, whole: int) -> str:
    """Return a share in per cent that reads 0 or 100 only where it is exactly that."""
    share = 100 * part / whole if whole else 0.0
    if 0 < share < 0.01:
        return "< 0.01 %"
    if 99.99 < share < 100:
        return "> 99.99 %"
    return f"{math.floor(100 * share + 1e-6) / 100:g} %"


def one_in(rate: float) -> str:
    """Return a rate as one in so many: ``1 in 2,000``, of two digits."""
    many = float(f"{1 / rate:.2g}")
    return f"1 in {many:,.0f}" if many >= 10 else f"1 in {many:g}"


def some(names: Iterable[str], most: int = 10) -> str:
    """Return names as a phrase, the first ones and how many there are besides."""
    items = list(names)
    more = len(items) - most
    return listing(items if more < 2 else [*items[:most], f"{more} more"])


def listing(names: Iterable[str], last: str = "and") -> str:
    """Return names as a phrase: ``a, b and c``."""
    items = list(names)
    if len(items) < 2:
        return "".join(items)
    return f"{', '.join(items[:-1])} {last} {items[-1]}"


def counted(count: int, noun: str) -> str:
    """Return a number with its noun."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def used_up(measurements: int) -> str:
    """Return that so many measurements are used up."""
    return f"{counted(measurements, 'measurement')} {'is' if measurements == 1 else 'are all'} used up"
