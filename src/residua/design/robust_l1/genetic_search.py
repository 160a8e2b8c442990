"""A real-coded genetic algorithm over a box: seeded, and able to go on where it was interrupted."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from residua.design.robust_l1.genetic_checkpoint import Progressed, load_checkpoint, save_checkpoint
from residua.design.robust_l1.polish import polish
from residua.design.robust_l1.search_box import (
    BoxedCost,
    Cost,
    Matrix,
    SearchProgress,
    check_number,
    check_switch,
    check_whole,
    first_population,
    starting_points,
)
from residua.design.robust_l1.search_result import SETTLED, USED_UP, SearchResult, settled

#: Improvement within ``patience`` generations that counts as none, relative to the cost.
_TOLERANCE = 1e-4
#: How often each crossover is taken: arithmetic, BLX-alpha, heuristic.
_SHARES = (1, 4, 4)
#: How far BLX-alpha goes beyond the parents, as a fraction of their distance.
_ALPHA = 0.5
#: Degree of non-uniformity of mutations: the larger, the more of them are small.
_DEGREE = 5.0


@dataclass(frozen=True)
class GeneticSearch:
    r"""Global search by a real-coded genetic algorithm.

    A generation of ``N`` points has as many children; the best ``N`` of both live on (so that the best is never lost).

    *Selection*, normalised geometric ranking: the point of rank ``k`` (0 is the best) becomes a parent with probability
    :math:`q (1-q)^k / (1 - (1-q)^N)`. The parents of a pair are different points, ``a`` the better one of them.

    *Crossover*, with probability ``crossover``, one of

    - arithmetic (1 of 9): :math:`\lambda a + (1-\lambda) b` and :math:`\lambda b + (1-\lambda) a`, one
      :math:`\lambda \in [0, 1]`;
    - BLX-0.5 (4 of 9): each number uniform on the interval of the parents' numbers, longer by half on both sides;
    - heuristic (4 of 9): :math:`a + \rho (a - b)`, one :math:`\rho \in [0, 1]` for each child.

    Arithmetic crossover only contracts, and is the rarest for that.

    *Mutation*, non-uniform, with probability ``mutation``, and of every child that is a copy: one number of the child,
    or half of all, moves up or down, :math:`x + (u - x)(1 - \rho^{e})` or :math:`x - (x - l)(1 - \rho^{e})`, with
    :math:`\rho \in [0, 1]` and :math:`e = \tau^5`. In the literature :math:`\tau` falls from 1 to 0 with the
    generations; here it is drawn from [0, 1] for every child, so that all sizes occur at any time, and a search with
    more generations goes on as one with fewer has begun.

    Children outside of the box are moved to its rim.

    Parameters
    ----------
    population : int
        ``N``; more where more starts are given.
    generations : int
        At most.
    crossover, mutation : float
        Probabilities.
    selection : float
        ``q``.
    patience : int
        Generations without an improvement of 1e-4, relatively, that end the search.
    polish : bool
        Whether a local search follows.
    seed : int

    References
    ----------
    Joines and Houck (1994), IEEE Conf. Evolutionary Computation (ranking); Eshelman and Schaffer (1993), Foundations of
    Genetic Algorithms 2 (BLX); Wright (1991), Foundations of Genetic Algorithms (heuristic crossover); Michalewicz
    (1992), Genetic Algorithms + Data Structures = Evolution Programs (non-uniform mutation); robust l1 fault
    detection, section 3.

    Examples
    --------
    >>> from residua.design import GeneticSearch
    >>> found = GeneticSearch(generations=80).minimise(lambda x: ((x - 1) ** 2).sum(axis=1), [-3, -3], [3, 3])
    >>> found.x.round(3)
    array([1., 1.])
    """

    population: int = 80
    generations: int = 200
    crossover: float = 0.8
    mutation: float = 0.5
    selection: float = 0.03
    patience: int = 40
    polish: bool = True
    seed: int = 0

    def __post_init__(self) -> None:
        """Check the settings."""
        check_whole(self.population, "population", 4)
        check_whole(self.generations, "generations", 1)
        check_whole(self.patience, "patience", 1)
        check_whole(self.seed, "seed", 0)
        check_number(self.crossover, "crossover", 0.0, 1.0)
        check_number(self.mutation, "mutation", 0.0, 1.0)
        check_number(self.selection, "selection", 0.0, 1.0, inside=True)
        check_switch(self.polish, "polish")

    def minimise(
        self,
        cost: Cost,
        lower: ArrayLike,
        upper: ArrayLike,
        *,
        start: ArrayLike | None = None,
        progress: SearchProgress | None = None,
        checkpoint: str | Path | None = None,
    ) -> SearchResult:
        """Search the smallest cost in a box.

        Parameters
        ----------
        cost : callable
            From points, shape (k, d), to their costs, shape (k,); NaN counts as infinite.
        lower, upper : array_like, shape (d,)
        start : array_like, shape (s, d), optional
            Points of the first generation; what is found is no worse than any of them.
        progress : callable, optional
            Called with (generations done, of how many, smallest cost).
        checkpoint : str or Path, optional
            A JSON file, written after every generation. Where it is there, the search goes on from it, to the same bits
            as without an interruption; with more ``generations`` than it was begun with, too.

        Returns
        -------
        SearchResult

        Raises
        ------
        SettingError
            If the checkpoint is that of another search; it says in what it differs.
        FileFormatError
            If it is no checkpoint.
        """
        box = BoxedCost(cost, lower, upper)
        starts = starting_points(start, box)
        now = None if checkpoint is None else load_checkpoint(checkpoint, self, box, starts)
        if now is None:
            points = first_population(np.random.default_rng(self.seed), box, starts, self.population)
            now = _ranked(Progressed(points, box(points), [], 0))
        while len(now.history) <= self.generations and not settled(now.history, self.patience, _TOLERANCE):
            if now.history:
                now = self._next(now, box)
            now = Progressed(now.points, now.costs, [*now.history, float(now.costs[0])], box.evaluations)
            if checkpoint is not None:
                save_checkpoint(checkpoint, now, self, box, starts)
            if progress is not None:
                progress(len(now.history) - 1, self.generations, now.history[-1])
        box.remember(now.points[0], float(now.costs[0]))  # which it has not seen where another run found it
        _, before = box.checked_best()
        if self.polish:
            polish(box, self.seed)
        x, best = box.checked_best()
        ended = SETTLED if settled(now.history, self.patience, _TOLERANCE) else USED_UP
        done = len(now.history) - 1
        return SearchResult(x, best, before, box.evaluations, done, np.array(now.history), ended, "genetic")

    def _next(self, now: Progressed, box: BoxedCost) -> Progressed:
        """Return the next generation, ranked; its random numbers are those of its number, wherever it is bred."""
        rng = np.random.default_rng([self.seed, len(now.history)])
        better, other = now.points[self._parents(rng, len(now.points))]
        children, copied = self._crossed(rng, better, other)
        children = box.inside(children)
        mutated = (rng.random(len(children)) < self.mutation) | copied
        children = np.where(mutated[:, None], _mutated(rng, children, box), children)
        costs = box(children)
        both = Progressed(np.vstack([now.points, children]), np.append(now.costs, costs), now.history, 0)
        return _ranked(both, len(now.points))

    def _parents(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """Return pairs of ranks, the better one first, shape (2, half of the population)."""
        chances = np.cumsum(self.selection * (1 - self.selection) ** np.arange(count))
        pairs = np.searchsorted(chances / chances[-1], rng.random((2, (count + 1) // 2)), side="right")
        pairs = np.minimum(pairs, count - 1)
        shifted = (pairs[0] + 1 + rng.integers(count - 1, size=pairs.shape[1])) % count
        return np.sort(np.stack([pairs[0], np.where(pairs[0] == pairs[1], shifted, pairs[1])]), axis=0)

    def _crossed(self, rng: np.random.Generator, a: Matrix, b: Matrix) -> tuple[Matrix, np.ndarray]:
        """Return two children of every pair, and which of them are copies."""
        pairs, d = a.shape
        shares = np.cumsum(_SHARES) / np.sum(_SHARES)
        kind = np.searchsorted(shares, rng.random(pairs), side="right")
        kind = np.where(rng.random(pairs) < self.crossover, kind, len(_SHARES))[:, None]
        part, spread, reach = rng.random((pairs, 1)), rng.random((2, pairs, d)), rng.random((2, pairs, 1))
        copies = np.stack([a, b])
        arithmetic = np.stack([part * a + (1 - part) * b, part * b + (1 - part) * a])
        blended = a + ((1 + 2 * _ALPHA) * spread - _ALPHA) * (b - a)
        heuristic = a + reach * (a - b)
        children = np.select([kind == 0, kind == 1, kind == 2], [arithmetic, blended, heuristic], copies)
        copied = (children == a).all(axis=2) | (children == b).all(axis=2)
        return children.reshape(2 * pairs, d), copied.ravel()


def _mutated(rng: np.random.Generator, points: Matrix, box: BoxedCost) -> Matrix:
    """Return points with one number, or about half of all, moved towards a rim of the box."""
    count, d = points.shape
    one = np.arange(d) == rng.integers(d, size=(count, 1))
    several = (rng.random((count, 1)) < 0.5) & (rng.random((count, d)) < 0.5)
    age = np.maximum(rng.random((count, 1)) ** _DEGREE, 1e-6)
    step = 1 - rng.random((count, d)) ** age
    up = rng.random((count, d)) < 0.5
    moved = np.where(up, points + (box.upper - points) * step, points - (points - box.lower) * step)
    return box.inside(np.where(one | several, moved, points))


def _ranked(now: Progressed, count: int | None = None) -> Progressed:
    order = np.argsort(now.costs, kind="stable")[:count]
    return Progressed(now.points[order], now.costs[order], now.history, now.evaluations)
