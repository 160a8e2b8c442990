"""Differential evolution, SciPy's, over a box."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from residua.robust.estimators.search_box import (
    BoxedCost,
    Cost,
    SearchProgress,
    first_population,
    starting_points,
)
from residua.robust.estimators.search_ending import check_ending, concluded, settled
from residua.robust.estimators.search_result import SearchResult

#: Chance of a number to come from the mixture.
_RECOMBINATION = 0.9


@dataclass(frozen=True)
class DifferentialEvolution:
    r"""Global search by differential evolution: SciPy's, all points of a generation at once.

    Each point competes with a mixture of it with :math:`a + F (b - a) + F (c - d)`: ``b`` the best point, ``a``, ``c``
    and ``d`` drawn from the others, :math:`F \in [0.5, 1]` drawn for each generation (``randtobest1bin``). Nine in ten
    numbers come from the latter: the costs of gains have valleys that are narrow and oblique, and numbers that change
    one by one do not follow these.

    Parameters
    ----------
    population : int
        Points of a generation; more if there are more starts.
    generations : int
        At most.
    patience : int
        Generations without an improvement of 1e-4, relatively, that end the search.
    polish : bool
        Whether a local search follows.
    seed : int

    References
    ----------
    Storn and Price (1997), J. Global Optimization 11, 341-359.

    Examples
    --------
    >>> import numpy as np
    >>> from residua.design import DifferentialEvolution
    >>> best = DifferentialEvolution(generations=60).minimise(lambda x: ((x - 1) ** 2).sum(axis=1), [-3, -3], [3, 3])
    >>> best.x.round(3)
    array([1., 1.])
    """

    population: int = 60
    generations: int = 200
    patience: int = 40
    polish: bool = True
    seed: int = 0

    def __post_init__(self) -> None:
        """Check the settings."""
        check_ending(self, least=5)

    def minimise(
        self,
        cost: Cost,
        lower: ArrayLike,
        upper: ArrayLike,
        *,
        start: ArrayLike | None = None,
        progress: SearchProgress | None = None,
    ) -> SearchResult:
        """Search the smallest cost in a box.

        Parameters
        ----------
        cost : callable
            From points, shape (k, d), to their costs, shape (k,); NaN counts as infinite.
        lower, upper : array_like, shape (d,)
        start : array_like, shape (s, d), optional
            Points of the first generation; the result is no worse than any of them.
        progress : callable, optional
            Called with (generations done, of how many, smallest cost).

        Returns
        -------
        SearchResult
        """
        from scipy.optimize import differential_evolution  # slow to import, and not needed to run a monitor

        box = BoxedCost(cost, lower, upper)
        rng = np.random.default_rng(self.seed)
        first = first_population(rng, box, starting_points(start, box), self.population)
        box(first)  # in their own units; SciPy scales them, and words errors of the cost its own way
        history = [box.best]

        def record(*_: Any, **__: Any) -> bool:
            history.append(box.best)
            if progress is not None:
                progress(len(history) - 1, self.generations, box.best)
            return settled(history, self.patience)

        with warnings.catch_warnings(), np.errstate(invalid="ignore"):
            warnings.simplefilter("ignore", RuntimeWarning)  # of infinite costs, which it takes the spread of
            differential_evolution(
                lambda x: box(x.T),
                np.column_stack([box.lower, box.upper]),
                init=first,
                strategy="randtobest1bin",
                recombination=_RECOMBINATION,
                maxiter=self.generations,
                vectorized=True,
                updating="deferred",
                polish=False,
                tol=0.0,
                atol=0.0,
                seed=rng,
                callback=record,
            )
        return concluded(self, box, history, "differential evolution")
