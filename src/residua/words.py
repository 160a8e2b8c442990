"""Numbers and names in sentences: one wording for pages, screens and printed results."""

from __future__ import annotations

import math
from collections.abc import Iterable


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
    """Return a share in per cent that reads 0 or 100 only if it is exact."""
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
    """Return names as a phrase, the first ones and the number of others."""
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
    """Describe measurements that are used up."""
    return f"{counted(measurements, 'measurement')} {'is' if measurements == 1 else 'are all'} used up"
