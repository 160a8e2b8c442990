"""What global searches have in common: settings that say how long they go on, and how they end."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from residua.robust.estimators.search_box import BoxedCost, check_switch, check_whole
from residua.robust.estimators.search_result import SearchResult

#: Steps at the start and at the end, as fractions of the box, and how many are taken at most.
_FIRST, _LAST, _MOST = 0.02, 1e-6, 150
#: Improvement within ``patience`` generations that counts as none, relative to the cost.
_TOLERANCE = 1e-4


class Search(Protocol):
    """The settings that every search has."""

    @property
    def population(self) -> int:
        """Points of one generation."""
        ...

    @property
    def generations(self) -> int:
        """Generations at most."""
        ...

    @property
    def patience(self) -> int:
        """Generations without an improvement after which it ends."""
        ...

    @property
    def polish(self) -> bool:
        """Whether a local search follows."""
        ...

    @property
    def seed(self) -> int:
        """Of everything that is drawn."""
        ...


def check_ending(search: Search, *, least: int) -> None:
    """Raise unless the settings that searches share are right; ``least`` is the smallest population."""
    check_whole(search.population, "population", least)
    check_whole(search.generations, "generations", 1)
    check_whole(search.patience, "patience", 1)
    check_whole(search.seed, "seed", 0)
    check_switch(search.polish, "polish")


def settled(history: list[float], patience: int) -> bool:
    """Tell whether the last ``patience`` generations brought next to nothing, relative to the cost."""
    if len(history) <= patience:
        return False
    return history[-1 - patience] <= history[-1] + _TOLERANCE * abs(history[-1])


def concluded(search: Search, box: BoxedCost, history: list[float], method: str) -> SearchResult:
    """Return the best point of a box after a local search, if one is wanted."""
    _, before = box.checked_best()
    if search.polish:
        polish(box, search.seed)
    x, best = box.checked_best()
    ended = "settled" if settled(history, search.patience) else "generations used up"
    return SearchResult(x, best, before, box.evaluations, len(history) - 1, np.array(history), ended, method)


def polish(box: BoxedCost, seed: int) -> None:
    r"""Improve the best point of a box by a pattern search: steps along random orthogonal directions, and on the last.

    At each step :math:`x \pm s (u - l) \circ q_i` for all columns of a random orthogonal matrix, and on along the last
    improvement, all at once; ``s`` grows by a half where one is better, and halves where none is. Never makes it worse:
    the box remembers the best of all points that were looked at.

    References
    ----------
    Kolda, Lewis and Torczon (2003), SIAM Review 45(3), 385-482.
    """
    rng = np.random.default_rng([seed, 0])
    d, size, last = box.dimension, _FIRST, np.zeros(box.dimension)
    for _ in range(_MOST):
        point, cost = box.checked_best()
        directions = np.linalg.qr(rng.standard_normal((d, d)))[0] * (size * np.sqrt(d)) * box.width
        trial = [point + directions, point - directions, point + np.outer([0.5, 1.0, 2.0], last)]
        box(np.vstack(trial[: 3 if last.any() else 2]))
        moved, value = box.checked_best()
        last = moved - point
        size = min(1.5 * size, _FIRST) if value < cost else size / 2
        if size < _LAST:
            break
