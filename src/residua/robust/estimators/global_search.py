"""Global searches over a box: their common parts, and SciPy's differential evolution."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.errors import DesignError, SettingError

Matrix = NDArray[np.float64]
#: Costs of many points at once: shape ``(k, d)`` in, ``(k,)`` out.
Cost = Callable[[Matrix], NDArray[np.float64]]
#: Told once per generation: how many are done, of how many, and the smallest cost.
SearchProgress = Callable[[int, int, float], None]
#: Points near a start lie this far from it, as powers of ten of the width of the box.
_NEAR = (-4.0, -0.5)
#: Steps of the local search at its start and at its end, as fractions of the box, and how many are taken at most.
_FIRST, _LAST, _MOST = 0.02, 1e-6, 150
#: Improvement within ``patience`` generations that counts as none, relative to the cost.
_SETTLED = 1e-4
#: Chance of a number to come from the mixture of differential evolution.
_RECOMBINATION = 0.9


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


class SearchBox:
    """A cost over a box, which checks what it returns, counts, and remembers the best point.

    Parameters
    ----------
    cost : callable
        Takes points of shape ``(k, d)`` and returns their costs, shape ``(k,)``. NaN counts as infinite.
    lower, upper : array_like, shape (d,)
        Corners of the box.
    start : array_like, shape (s, d), optional
        Points to begin with, which are moved into the box.

    Attributes
    ----------
    starts : ndarray, shape (s, d)
    evaluations : int
        Points whose cost was computed so far.
    best : float
        The smallest cost so far, infinite before the first.
    point : ndarray, shape (d,)
        Where it was attained first.

    Raises
    ------
    SettingError
        If the box is empty or not finite, or the starts do not fit.
    """

    def __init__(self, cost: Cost, lower: ArrayLike, upper: ArrayLike, start: ArrayLike | None = None) -> None:
        if not callable(cost):
            raise SettingError(f"cost must be a function of points (k, d) that returns (k,) numbers, got {cost!r}")
        try:
            low, high, starts = (np.array([] if value is None else value, float) for value in (lower, upper, start))
        except (TypeError, ValueError) as error:
            raise SettingError(f"lower, upper and start must be real numbers: {error}") from error
        if low.ndim != 1 or low.shape != high.shape or not len(low):
            raise SettingError(f"lower and upper must be lists of as many numbers, got {low.shape} and {high.shape}")
        # the span of the box is a number of its own that must not overflow
        if not (np.isfinite(high - low).all() and np.all(low < high)):
            raise SettingError(
                f"lower must be below upper everywhere and both finite, got {low} and {high}: leave out of the search "
                "what cannot vary"
            )
        d = len(low)
        starts = np.atleast_2d(starts) if starts.size else np.zeros((0, d))
        if starts.ndim != 2 or starts.shape[1] != d or not np.isfinite(starts).all():
            raise SettingError(f"start must be finite points, shape (s, {d}), got shape {starts.shape}")
        self.cost, self.lower, self.upper, self.width = cost, low, high, high - low
        self.starts = self.inside(starts)
        self.evaluations, self.best, self.point = 0, np.inf, (low + high) / 2

    def __call__(self, points: Matrix) -> NDArray[np.float64]:
        """Return the costs of points, each moved into the box first."""
        points = self.inside(points)
        values = np.asarray(self.cost(points.copy()))  # the cost may do with a copy what it likes
        if values.shape != (len(points),) or values.dtype.kind not in "fiu":
            raise SettingError(
                f"cost must return one real number per point: {len(points)} points gave an array of shape "
                f"{values.shape} and type {values.dtype}"
            )
        values = np.where(np.isnan(values), np.inf, values).astype(float)
        if np.any(values == -np.inf):
            raise SettingError("cost returned minus infinity: it has no minimum over this box; bound it from below")
        self.evaluations += len(points)
        k = int(np.argmin(values))
        if values[k] < self.best:
            self.best, self.point = float(values[k]), points[k].copy()
        return values

    def inside(self, points: Matrix) -> Matrix:
        """Return points moved to the nearest of the box."""
        return np.clip(points, self.lower, self.upper)

    def first_population(self, rng: np.random.Generator, count: int) -> Matrix:
        r"""Return the points that a search begins with: the starts, points near them, and points all over the box.

        Of what the starts leave of ``count``, half lies near them, in turn, at
        :math:`x = s + 10^{-e} (u - l) \circ g`, :math:`g` standard normal and :math:`e` uniform, a new one per point,
        so that every scale from a third of the box to a ten-thousandth occurs. The other half, and all without starts,
        is a Latin hypercube: along every axis one point in each of as many equal intervals.

        References
        ----------
        McKay, Beckman and Conover (1979), A comparison of three methods for selecting values of input variables.
        """
        d, s = len(self.lower), len(self.starts)
        near = max(count - s, 0) // 2 if s else 0
        scales = 10.0 ** rng.uniform(*_NEAR, (near, 1))
        close = self.starts[np.arange(near) % max(s, 1)] + scales * self.width * rng.standard_normal((near, d))
        rest = max(count - s, 0) - near
        strata = np.argsort(rng.random((d, rest)), axis=1).T
        spread = self.lower + (strata + rng.random((rest, d))) / max(rest, 1) * self.width
        return np.vstack([self.starts, self.inside(np.vstack([close, spread]))])

    def concluded(self, history: list[float], method: str, *, patience: int, polish: bool, seed: int) -> SearchResult:
        r"""Return the best point, if it is wanted after a local search.

        That is a pattern search: at each step :math:`x \pm s (u - l) \circ q_i` for all columns of a random orthogonal
        matrix, and on along the last improvement, all at once; ``s`` grows by a half where one is better, and halves
        where none is.

        References
        ----------
        Kolda, Lewis and Torczon (2003), SIAM Review 45(3), 385-482.
        """
        before, d = self.best, len(self.lower)
        if not np.isfinite(before):
            raise DesignError(
                f"none of {self.evaluations} points of the box has a finite cost: start from one that has (start=), "
                "or let the cost tell how far from usable a point is"
            )
        rng, size, last = np.random.default_rng([seed, 0]), _FIRST, np.zeros(d)
        for _ in range(_MOST if polish else 0):
            point, cost = self.point, self.best
            directions = np.linalg.qr(rng.standard_normal((d, d)))[0] * (size * np.sqrt(d)) * self.width
            trial = [point + directions, point - directions, point + np.outer([0.5, 1.0, 2.0], last)]
            self(np.vstack(trial[: 3 if last.any() else 2]))
            last = self.point - point
            size = min(1.5 * size, _FIRST) if self.best < cost else size / 2
            if size < _LAST:
                break
        ended = "settled" if settled(history, patience) else "generations used up"
        return SearchResult(
            self.point, self.best, before, self.evaluations, len(history) - 1, np.array(history), ended, method
        )


def check_settings(search: Any, least: int) -> None:
    """Raise unless the settings that searches share are right; ``least`` is the smallest population."""
    for name, smallest in {"population": least, "generations": 1, "patience": 1, "seed": 0}.items():
        value = getattr(search, name)
        if not isinstance(value, (int, np.integer)) or isinstance(value, bool) or value < smallest:
            raise SettingError(f"{name} must be a whole number, at least {smallest}, got {value!r}")
    if not isinstance(search.polish, (bool, np.bool_)):
        raise SettingError(f"polish must be True or False, got {search.polish!r}")


def settled(history: list[float], patience: int) -> bool:
    """Tell whether the last ``patience`` generations brought next to nothing, relative to the cost."""
    return len(history) > patience and history[-1 - patience] <= history[-1] + _SETTLED * abs(history[-1])


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
        check_settings(self, least=5)

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

        box = SearchBox(cost, lower, upper, start)
        rng = np.random.default_rng(self.seed)
        first = box.first_population(rng, self.population)
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
        return box.concluded(
            history, "differential evolution", patience=self.patience, polish=self.polish, seed=self.seed
        )
