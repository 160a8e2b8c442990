"""A real-coded genetic algorithm over a box: seeded, and able to go on where it was interrupted."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.decide.checks import is_number
from residua.errors import FileFormatError, SettingError
from residua.files import read_bytes, write_text
from residua.json_files import check_checksum, dumps, loads
from residua.records import float_out
from residua.robust.estimators.global_search import (
    Cost,
    Matrix,
    SearchBox,
    SearchProgress,
    SearchResult,
    check_settings,
    settled,
)

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
#: Settings that say when a search ends, not how it goes, and so may differ where it goes on.
_ENDS = ("generations", "patience", "polish")
_FORMAT = "residua-genetic-search"
#: How far the cost of a point may differ, relatively, from what it was: libraries round differently.
_RESUMED = 1e-6


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
        check_settings(self, least=4)
        for name in ("crossover", "mutation", "selection"):
            value = getattr(self, name)
            if not (is_number(value) and 0 <= value <= 1) or (name == "selection" and value in (0, 1)):
                where = "between 0 and 1" if name == "selection" else "in [0, 1]"
                raise SettingError(f"{name} must be a number {where}, got {value!r}")

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
            If it is no checkpoint, or is damaged.
        """
        box = SearchBox(cost, lower, upper, start)
        whose = settings_of(self) | {name: getattr(box, name).tolist() for name in ("lower", "upper", "starts")}
        loaded = None if checkpoint is None or not Path(checkpoint).exists() else _loaded(Path(checkpoint), whose, box)
        if loaded is None:
            points = box.first_population(np.random.default_rng(self.seed), self.population)
            points, costs = _ranked(points, box(points))
            history: list[float] = []
        else:
            points, costs, history = loaded
        while len(history) <= self.generations and not settled(history, self.patience):
            if history:
                points, costs = self._next(points, costs, len(history), box)
            history.append(float(costs[0]))
            if checkpoint is not None:
                content = {
                    "format": _FORMAT,
                    "search": whose,
                    "points": points.tolist(),
                    "costs": list(map(float_out, costs)),
                    "history": list(map(float_out, history)),
                    "evaluations": box.evaluations,
                }
                write_text(Path(checkpoint), dumps(content))  # the file appears whole or not at all
            if progress is not None:
                progress(len(history) - 1, self.generations, history[-1])
        return box.concluded(history, "genetic", patience=self.patience, polish=self.polish, seed=self.seed)

    def _next(
        self, points: Matrix, costs: NDArray[np.float64], number: int, box: SearchBox
    ) -> tuple[Matrix, NDArray[np.float64]]:
        """Return the next generation, ranked; its random numbers are those of its number, wherever it is bred."""
        rng = np.random.default_rng([self.seed, number])
        ranks = np.arange(len(points))
        mates = self._mates(rng, len(ranks))
        better, worse = points[np.minimum(ranks, mates)], points[np.maximum(ranks, mates)]
        crossed = rng.random(len(ranks)) < self.crossover
        children = np.where(crossed[:, None], _crossed(rng, better, worse), points)
        mutated = (rng.random(len(ranks)) < self.mutation) | ~crossed
        children = box.inside(children)
        children = np.where(mutated[:, None], _mutated(rng, children, box), children)
        new = box(children)
        taken = new <= costs
        return _ranked(np.where(taken[:, None], children, points), np.where(taken, new, costs))

    def _mates(self, rng: np.random.Generator, count: int) -> NDArray[np.intp]:
        """Return the rank of a mate for every rank, never the same."""
        chances = np.cumsum(self.selection * (1 - self.selection) ** np.arange(count))
        drawn = np.minimum(np.searchsorted(chances / chances[-1], rng.random(count), side="right"), count - 1)
        ranks = np.arange(count)
        return np.where(drawn == ranks, (ranks + rng.integers(1, count, size=count)) % count, drawn)


def _crossed(rng: np.random.Generator, a: Matrix, b: Matrix) -> Matrix:
    """Return a child of every pair, ``a`` the better parent."""
    pairs, d = a.shape
    kind = np.searchsorted(np.cumsum(_SHARES) / np.sum(_SHARES), rng.random((pairs, 1)), side="right")
    part, spread, reach = rng.random((pairs, 1)), rng.random((pairs, d)), _REACH * rng.random((pairs, 1))
    arithmetic = part * a + (1 - part) * b
    blended = a + ((1 + 2 * _ALPHA) * spread - _ALPHA) * (b - a)
    return np.select([kind == 0, kind == 1], [arithmetic, blended], a + reach * (a - b))


def _mutated(rng: np.random.Generator, points: Matrix, box: SearchBox) -> Matrix:
    """Return points with one number, or that and some others, moved towards a rim of the box."""
    count, d = points.shape
    one = np.arange(d) == rng.integers(d, size=(count, 1))
    several = (rng.random((count, 1)) < 0.5) & (rng.random((count, d)) < _SEVERAL)
    age = np.maximum(rng.random((count, 1)) ** _DEGREE, 1e-6)
    step = 1 - (1 - rng.random((count, d))) ** age  # of (0, 1]: zero would be a jump to the rim
    up = rng.random((count, d)) < 0.5
    moved = np.where(up, points + (box.upper - points) * step, points - (points - box.lower) * step)
    return box.inside(np.where(one | several, moved, points))


def _ranked(points: Matrix, costs: NDArray[np.float64]) -> tuple[Matrix, NDArray[np.float64]]:
    order = np.argsort(costs, kind="stable")
    return points[order], costs[order]


def settings_of(search: Any) -> dict[str, Any]:
    """Return the settings that make the way of a search; those that say when it ends may differ."""
    return {name: value for name, value in asdict(search).items() if name not in _ENDS}


def _loaded(path: Path, whose: dict[str, Any], box: SearchBox) -> tuple[Matrix, NDArray[np.float64], list[float]]:
    """Read the points of the last generation, their costs and the history of a search."""
    try:
        content = loads(read_bytes(path, "checkpoint"), path.name)
        if content.get("format") != _FORMAT or not check_checksum(content, path.name):
            raise ValueError(f'no "format": {_FORMAT!r} in it, or it was edited')
    except (ValueError, FileFormatError) as error:
        raise FileFormatError(
            f"{path.name} is no checkpoint of a genetic search ({error}): delete it to begin anew"
        ) from error
    points, costs, history = (np.array(content[name], dtype=float) for name in ("points", "costs", "history"))
    other = next((name for name, value in whose.items() if content["search"].get(name) != value), "")
    if other or not np.allclose(box(points), costs, rtol=_RESUMED, atol=0.0):
        what = f"its {other} is not the same" if other else "its points have another cost now"
        raise SettingError(
            f"{path.name} belongs to another search: {what}; delete it to begin anew, or give another checkpoint"
        )
    box.evaluations = content["evaluations"]
    box.best, box.point = float(costs[0]), points[0]  # to the last bit
    return points, costs, history.tolist()
