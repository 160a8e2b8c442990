"""The smallest degree at which something exists that exists at every higher one too."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")


def at_smallest_degree(attempt: Callable[[int], T | None], low: int, high: int, at_high: T) -> T:
    """Return what an attempt gives at the smallest degree from ``low`` on at which it gives something.

    By bisection: ``at_high`` is what it gives at ``high``, and where it gives something once it does so ever after.
    """
    while low < high:
        middle = (low + high) // 2
        solution = attempt(middle)
        if solution is None:
            low = middle + 1
        else:
            high, at_high = middle, solution
    return at_high
