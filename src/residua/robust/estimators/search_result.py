"""The result of a global search, and how it ended."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class SearchResult:
    """The best point of a search over a box.

    Attributes
    ----------
    x : ndarray, shape (d,)
        The point, in the box.
    cost : float
        Its cost, finite: no other point that was looked at has a smaller one.
    unpolished : float
        The smallest cost before the local search.
    evaluations : int
        Points whose cost was computed, those of the local search included.
    generations : int
        Generations that were bred after the first population.
    history : ndarray, shape (generations + 1,)
        Smallest cost so far, in the first population and after every generation; never rises.
    ended : {"settled", "generations used up"}
        Whether the search came to rest. One that used up its generations may find a better point with more.
    method : {"genetic", "differential evolution"}
    """

    x: NDArray[np.float64]
    cost: float
    unpolished: float
    evaluations: int
    generations: int
    history: NDArray[np.float64]
    ended: str
    method: str

    def __str__(self) -> str:
        before = "" if self.cost == self.unpolished else f" ({self.unpolished:.6g} before the polish)"
        return (
            f"{self.method} search: cost {self.cost:.6g}{before} after {self.generations} generations, "
            f"{self.evaluations} evaluations; {self.ended}"
        )
