"""Numbers and names in sentences: one wording for pages, screens and printed results."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from threading import local
from typing import Any

_unit_of_rates: ContextVar[float] = ContextVar("unit of rates", default=1.0)


class _Asked(local):
    """How many times a thread has asked for the unit of rates."""

    times = 0


_asked = _Asked()


@contextmanager
def rates_in(unit: float) -> Iterator[None]:
    """Within this, rates are worked on in that many 1/s; texts say them in 1/s all the same."""
    token = _unit_of_rates.set(_unit_of_rates.get() * unit)
    try:
        yield
    finally:
        _unit_of_rates.reset(token)


def unit_of_rates() -> float:
    """Return the unit in which rates are worked on here, in 1/s: what texts multiply them by."""
    _asked.times += 1
    return _unit_of_rates.get()


def times_unit_was_asked() -> int:
    """Return how often this thread has asked for that unit: what is made without asking has it in no text."""
    return _asked.times


def unit_of_rates_unasked() -> float:
    """Return that unit to one who keeps results by it, and asks for it where a result has it in a text."""
    return _unit_of_rates.get()


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


def lead_text(lead: float) -> str:
    """Return a lead in twice the logarithm of the likelihood; below a tenth it means nothing."""
    return f"{lead:.1f}" if lead < 1000 else f"{lead:,.0f}"


def percent(part: int, whole: int) -> str:
    """Return a share in per cent that reads 0 or 100 only where it is exactly that."""
    share = 100 * part / whole if whole else 0.0
    if 0 < share < 0.01:
        return "< 0.01 %"
    if 99.99 < share < 100:
        return "> 99.99 %"
    return f"{math.floor(100 * share + 1e-6) / 100:g} %"


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
