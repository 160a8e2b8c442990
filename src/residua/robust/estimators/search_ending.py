"""What global searches have in common: settings that say how long they go on, and how they end."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from residua.robust.estimators.polish import polish
from residua.robust.estimators.search_box import BoxedCost, check_switch, check_whole
from residua.robust.estimators.search_result import SearchResult

if TYPE_CHECKING:
    from residua.robust.estimators.differential_evolution import DifferentialEvolution
    from residua.robust.estimators.genetic_search import GeneticSearch

#: Improvement within ``patience`` generations that counts as none, relative to the cost.
_TOLERANCE = 1e-4


def check_ending(search: DifferentialEvolution | GeneticSearch, *, least: int) -> None:
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


def concluded(
    search: DifferentialEvolution | GeneticSearch, box: BoxedCost, history: list[float], method: str
) -> SearchResult:
    """Return the best point of a box after a local search, if one is wanted."""
    _, before = box.checked_best()
    if search.polish:
        polish(box, search.seed)
    x, best = box.checked_best()
    ended = "settled" if settled(history, search.patience) else "generations used up"
    return SearchResult(x, best, before, box.evaluations, len(history) - 1, np.array(history), ended, method)
