"""A real-coded genetic algorithm over a box: seeded, and able to go on where it was interrupted."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.robust.estimators.genetic_checkpoint import Progressed, fingerprint, load_checkpoint, save_checkpoint
from residua.robust.estimators.search_box import (
    BoxedCost,
    Cost,
    Matrix,
    SearchProgress,
    check_number,
    first_population,
    starting_points,
)
from residua.robust.estimators.search_ending import check_ending, concluded, settled
from residua.robust.estimators.search_result import SearchResult

#: How often each crossover is taken: arithmetic, BLX-alpha, heuristic.
_SHARES = (1, 3, 6)
#: How far BLX-alpha goes beyond the parents, as a fraction of their distance.
_ALPHA = 0.5
#: Longest step of the heuristic crossover, in distances of the parents.
_REACH = 2.0
#: Degree of non-uniformity of mutations: the larger, the more of them are small.
_DEGREE = 5.0
#: Chance of each further number to change where a mutation changes several.
_SEVERAL = 0.3


@dataclass(frozen=True)
class GeneticSearch:
    r"""Global search by a real-coded genetic algorithm.

    Each of the ``N`` points of a generation has one child, with a mate; the child takes its place where it is no worse
    (crowding: the best is never lost, and neither are the differences between points that lie far apart, as long as
    each improves where it is. When instead the best ``N`` of all live on, a population in a narrow valley collapses).

    *Selection* of the mate, normalised geometric ranking: the point of rank ``k`` (0 is the best) is drawn with
    probability :math:`q (1-q)^k / (1 - (1-q)^N)`. Of parent and mate, ``a`` is the better and ``b`` the worse.

    *Crossover*, with probability ``crossover``, one of

    - arithmetic (1 of 10): :math:`\lambda a + (1-\lambda) b`, one :math:`\lambda \in [0, 1]`;
    - BLX-0.5 (3 of 10): each number uniform on the interval of the parents' numbers, longer by half on both sides;
    - heuristic (6 of 10): :math:`a + \rho (a - b)`, one :math:`\rho \in [0, 2]`; in the literature up to 1.

    Arithmetic crossover only contracts, and is the rarest for that. The heuristic one keeps to the directions in which
    the population extends, whatever the axes, and stretches it; it is the most frequent, for the costs of gains have
    valleys that are narrow and oblique.

    *Mutation*, non-uniform, with probability ``mutation``, and of every child without a crossover: one number of it,
    or that and three in ten of the others, moves up or down, :math:`x + (u - x)(1 - \rho^{e})` or
    :math:`x - (x - l)(1 - \rho^{e})`, with :math:`\rho \in [0, 1]` and :math:`e = \tau^5`. In the literature
    :math:`\tau` falls from 1 to 0 with the generations; here it is drawn from [0, 1] for every child, so that all
    sizes occur at any time, and a search with more generations goes on as one with fewer has begun.

    Children outside of the box are moved to its rim.

    Parameters
    ----------
    population : int
        ``N``; more if there are more starts.
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
    (1992), Genetic Algorithms + Data Structures = Evolution Programs (arithmetic crossover, non-uniform mutation); De
    Jong (1975), An analysis of the behavior of a class of genetic adaptive systems, and Mahfoud (1992), Parallel
    Problem Solving from Nature 2 (crowding); robust l1 fault detection, section 3.

    Examples
    --------
    >>> from residua.design import GeneticSearch
    >>> best = GeneticSearch(generations=80).minimise(lambda x: ((x - 1) ** 2).sum(axis=1), [-3, -3], [3, 3])
    >>> best.x.round(3)
    array([1., 1.])
    """

    population: int = 80
    generations: int = 200
    crossover: float = 0.8
    mutation: float = 0.2
    selection: float = 0.08
    patience: int = 40
    polish: bool = True
    seed: int = 0

    def __post_init__(self) -> None:
        """Check the settings."""
        check_ending(self, least=4)
        check_number(self.crossover, "crossover", 0.0, 1.0)
        check_number(self.mutation, "mutation", 0.0, 1.0)
        check_number(self.selection, "selection", 0.0, 1.0, inside=True)

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
            Points of the first generation; the result is no worse than any of them.
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
        whose = {} if checkpoint is None else fingerprint(self, box, starts)
        now = None if checkpoint is None else load_checkpoint(checkpoint, whose, box)
        if now is None:
            points = first_population(np.random.default_rng(self.seed), box, starts, self.population)
            now = _ranked(Progressed(points, box(points), [], 0))
        while len(now.history) <= self.generations and not settled(now.history, self.patience):
            if now.history:
                now = self._next(now, box)
            now = Progressed(now.points, now.costs, [*now.history, float(now.costs[0])], box.evaluations)
            if checkpoint is not None:
                save_checkpoint(checkpoint, now, whose)
            if progress is not None:
                progress(len(now.history) - 1, self.generations, now.history[-1])
        box.remember(now.points[0], float(now.costs[0]))  # which it has not seen if it comes from another run
        return concluded(self, box, now.history, "genetic")

    def _next(self, now: Progressed, box: BoxedCost) -> Progressed:
        """Return the next generation, ranked; its random numbers are those of its number, wherever it is bred."""
        rng = np.random.default_rng([self.seed, len(now.history)])
        own = np.arange(len(now.points))
        mates = self._mates(rng, len(own))
        better, worse = now.points[np.minimum(own, mates)], now.points[np.maximum(own, mates)]
        crossed = rng.random(len(own)) < self.crossover
        children = np.where(crossed[:, None], _crossed(rng, better, worse), now.points)
        mutated = (rng.random(len(own)) < self.mutation) | ~crossed
        children = box.inside(children)
        children = np.where(mutated[:, None], _mutated(rng, children, box), children)
        costs = box(children)
        taken = costs <= now.costs
        points = np.where(taken[:, None], children, now.points)
        return _ranked(Progressed(points, np.where(taken, costs, now.costs), now.history, 0))

    def _mates(self, rng: np.random.Generator, count: int) -> NDArray[np.intp]:
        """Return the rank of a mate for every rank, never the same."""
        chances = np.cumsum(self.selection * (1 - self.selection) ** np.arange(count))
        drawn = np.minimum(np.searchsorted(chances / chances[-1], rng.random(count), side="right"), count - 1)
        own = np.arange(count)
        return np.where(drawn == own, (own + rng.integers(1, count, size=count)) % count, drawn)


def _crossed(rng: np.random.Generator, a: Matrix, b: Matrix) -> Matrix:
    """Return a child of every pair, ``a`` the better parent."""
    pairs, d = a.shape
    kind = np.searchsorted(np.cumsum(_SHARES) / np.sum(_SHARES), rng.random((pairs, 1)), side="right")
    part, spread, reach = rng.random((pairs, 1)), rng.random((pairs, d)), _REACH * rng.random((pairs, 1))
    arithmetic = part * a + (1 - part) * b
    blended = a + ((1 + 2 * _ALPHA) * spread - _ALPHA) * (b - a)
    return np.select([kind == 0, kind == 1], [arithmetic, blended], a + reach * (a - b))


def _mutated(rng: np.random.Generator, points: Matrix, box: BoxedCost) -> Matrix:
    """Return points with one number, or that and some others, moved towards a rim of the box."""
    count, d = points.shape
    one = np.arange(d) == rng.integers(d, size=(count, 1))
    several = (rng.random((count, 1)) < 0.5) & (rng.random((count, d)) < _SEVERAL)
    age = np.maximum(rng.random((count, 1)) ** _DEGREE, 1e-6)
    step = 1 - (1 - rng.random((count, d))) ** age  # of (0, 1]: zero would be a jump to the rim
    up = rng.random((count, d)) < 0.5
    moved = np.where(up, points + (box.upper - points) * step, points - (points - box.lower) * step)
    return box.inside(np.where(one | several, moved, points))


def _ranked(now: Progressed) -> Progressed:
    order = np.argsort(now.costs, kind="stable")
    return Progressed(now.points[order], now.costs[order], now.history, now.evaluations)
