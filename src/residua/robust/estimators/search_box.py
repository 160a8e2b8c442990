"""A cost over a box: what every search checks before it starts, and the points that it starts with."""

from __future__ import annotations

from collections.abc import Callable
from math import isfinite

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


class BoxedCost:
    """A cost over a box, which checks what it returns, counts, and remembers the best point.

    Parameters
    ----------
    cost : callable
        Takes points of shape ``(k, d)`` and returns their costs, shape ``(k,)``. NaN counts as infinite.
    lower, upper : array_like, shape (d,)
        Corners of the box.

    Attributes
    ----------
    evaluations : int
        Points whose cost was computed so far.
    best : float
        The smallest cost so far, infinite before the first.
    point : ndarray, shape (d,)
        Where it was attained first.

    Raises
    ------
    SettingError
        If the box is empty or not finite.
    """

    def __init__(self, cost: Cost, lower: ArrayLike, upper: ArrayLike) -> None:
        if not callable(cost):
            raise SettingError(f"cost must be a function of points (k, d) that returns (k,) numbers, got {cost!r}")
        self._cost = cost
        self.lower, self.upper = _bounds(lower, upper)
        self.width = self.upper - self.lower
        self.dimension = len(self.lower)
        self.evaluations = 0
        self.best = np.inf
        self.point = (self.lower + self.upper) / 2

    def __call__(self, points: Matrix) -> NDArray[np.float64]:
        """Return the costs of points, each moved into the box first."""
        points = self.inside(points)  # a copy too: the cost may do with it what it likes
        values = self.values(points.copy())
        self.evaluations += len(points)
        k = int(np.argmin(values))
        self.remember(points[k], float(values[k]))
        return values

    def remember(self, point: Matrix, value: float) -> None:
        """Take a point whose cost is known for the best so far, if it is."""
        if value < self.best:
            self.best, self.point = value, point.copy()

    def values(self, points: Matrix) -> NDArray[np.float64]:
        """Return the costs of points without counting them."""
        values = np.asarray(self._cost(points))
        if values.shape != (len(points),) or values.dtype.kind not in "fiu":
            raise SettingError(
                f"cost must return one real number per point: {len(points)} points gave an array of shape "
                f"{values.shape} and type {values.dtype}"
            )
        values = np.where(np.isnan(values), np.inf, values).astype(float)
        if np.any(values == -np.inf):
            raise SettingError("cost returned minus infinity: it has no minimum over this box; bound it from below")
        return values

    def inside(self, points: Matrix) -> Matrix:
        """Return points moved to the nearest of the box."""
        return np.clip(points, self.lower, self.upper)

    def checked_best(self) -> tuple[Matrix, float]:
        """Return the best point and its cost, or say that there is none."""
        if not np.isfinite(self.best):
            raise DesignError(
                f"none of {self.evaluations} points of the box has a finite cost: start from one that has (start=), "
                "or let the cost tell how far from usable a point is"
            )
        return self.point, self.best


def _bounds(lower: ArrayLike, upper: ArrayLike) -> tuple[Matrix, Matrix]:
    """Return the corners of a box, checked."""
    low, high = (_numbers(bound, name) for bound, name in ((lower, "lower"), (upper, "upper")))
    if low.ndim != 1 or low.shape != high.shape or not len(low):
        raise SettingError(f"lower and upper must be lists of as many numbers, got shapes {low.shape} and {high.shape}")
    # the span of the box is a number of its own that must not overflow
    if not (np.isfinite(low).all() and np.isfinite(high).all() and np.isfinite(high - low).all()):
        raise SettingError("lower and upper must be finite")
    if not np.all(low < high):
        k = int(np.argmin(low < high))
        raise SettingError(
            f"lower must be below upper everywhere; at position {k} they are {low[k]:g} and {high[k]:g}: leave out of "
            "the search what cannot vary"
        )
    return low, high


def starting_points(start: ArrayLike | None, box: BoxedCost) -> Matrix:
    """Return the starting points of a search, moved into the box; shape ``(s, d)``, ``s`` may be zero."""
    if start is None:
        return np.zeros((0, box.dimension))
    points = np.atleast_2d(_numbers(start, "start"))
    if points.size == 0:
        return np.zeros((0, box.dimension))
    if points.ndim != 2 or points.shape[1] != box.dimension or not np.isfinite(points).all():
        raise SettingError(
            f"start must be finite points of {box.dimension} numbers, shape (s, {box.dimension}), got shape "
            f"{points.shape}"
        )
    return box.inside(points)


def _numbers(value: ArrayLike, name: str) -> Matrix:
    """Return real numbers as an array of their own, in one order in memory."""
    try:
        return np.array(value, dtype=float, order="C")
    except (TypeError, ValueError) as error:
        raise SettingError(f"{name} must be real numbers, got {value!r}") from error


def first_population(rng: np.random.Generator, box: BoxedCost, starts: Matrix, count: int) -> Matrix:
    r"""Return the points that a search begins with: the starts, points near them, and points all over the box.

    Of what the starts leave of ``count``, half lies near them, in turn, at
    :math:`x = s + 10^{-e} (u - l) \circ g`, :math:`g` standard normal and :math:`e` uniform, a new one per point,
    so that every scale from a third of the box to a ten-thousandth occurs. The other half, and all without starts, is a
    Latin hypercube: along every axis one point in each of as many equal intervals. More starts than ``count`` all
    belong to the first population.

    Parameters
    ----------
    rng : numpy.random.Generator
    box : BoxedCost
    starts : ndarray, shape (s, d)
    count : int

    Returns
    -------
    ndarray, shape (max(s, count), d)

    References
    ----------
    McKay, Beckman and Conover (1979), A comparison of three methods for selecting values of input variables.
    """
    left = max(count - len(starts), 0)
    near = left // 2 if len(starts) else 0
    centres = starts[np.arange(near) % max(len(starts), 1)]
    scales = 10.0 ** rng.uniform(*_NEAR, (near, 1))
    close = centres + scales * box.width * rng.standard_normal((near, box.dimension))
    return np.vstack([starts, box.inside(close), latin_hypercube(rng, box, left - near)])


def latin_hypercube(rng: np.random.Generator, box: BoxedCost, count: int) -> Matrix:
    """Return ``count`` points of the box with one in each of ``count`` equal intervals along every axis."""
    strata = np.argsort(rng.random((box.dimension, count)), axis=1).T
    fractions = (strata + rng.random((count, box.dimension))) / max(count, 1)
    return box.inside(box.lower + fractions * box.width)


def check_whole(value: object, name: str, least: int) -> None:
    """Raise unless a setting is a whole number."""
    number = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    if not number or value < least:  # pyright: ignore
        raise SettingError(f"{name} must be a whole number, at least {least}, got {value!r}")


def check_number(value: object, name: str, least: float, most: float, *, inside: bool = False) -> None:
    """Raise unless a setting is a number of an interval, or of its inside."""
    number = isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)
    if number and isfinite(value) and (least < value < most if inside else least <= value <= most):  # pyright: ignore
        return
    where = f"between {least:g} and {most:g}" if inside else f"in [{least:g}, {most:g}]"
    raise SettingError(f"{name} must be a number {where}, got {value!r}")


def check_switch(value: object, name: str) -> None:
    """Raise unless a setting is true or false."""
    if not isinstance(value, (bool, np.bool_)):
        raise SettingError(f"{name} must be True or False, got {value!r}")
