"""Tail of a statistic by the generalised Pareto distribution, with the confidence of a rate."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from residua.tolerances import SAME

#: Shapes of tails under consideration, and their prior: lighter than an exponential one to
#: one without a variance; mean and deviation.
_SHAPES, _PRIOR = np.arange(-10, 20) / 20, (0.1, 0.25)
#: Scales that are thought of, in means of the excesses.
_SCALES = np.geomspace(0.2, 5.0, 33)
#: Excesses that the likelihood is computed of.
_MOST = 500
#: Where the distribution of a number is one, whatever the number is.
_BEYOND = 1e12
#: Parts of themselves that a level and a bound of a rate are known to.
_CLOSE, _ROUGHLY = SAME, 0.005


@dataclass(frozen=True, eq=False)
class ParetoTail:
    r"""Excesses of a statistic over a level, with a posterior over generalised Pareto distributions.

    .. math:: P(J > u + y) = \zeta \left(1 + \frac{\xi y}{\sigma}\right)^{-1/\xi}, \qquad
              p(\xi, \sigma) \propto p_0(\xi)\, \sigma^{-1} \prod_i p(y_i | \xi, \sigma)^{1/\tau}

    with :math:`\tau` excesses to one independent one. The rate over a level then has a distribution, by a grid of
    shapes and scales: its mean is what is expected, and its quantiles are the interval. Nothing is maximised, so that
    few excesses give wide intervals, and no failures.

    Attributes
    ----------
    start : float
        u.
    excesses : ndarray
    rate : float
        The fraction of samples over u.
    worth : float
        The number of independent excesses.

    References
    ----------
    Pickands (1975), Annals of Statistics 3(1), 119-131 (the distribution); Davison and Smith (1990), Journal of the
    Royal Statistical Society B 52(3), 393-442 (excesses over a level, and dependent ones).
    """

    start: float
    excesses: NDArray[np.float64]
    rate: float
    worth: float

    @cached_property
    def _posterior(self) -> tuple[float, NDArray[np.float64]]:
        """Mean of the excesses, and the weights of shapes and scales."""
        y = self.excesses
        if len(y) > _MOST:  # as many that stand for all of them
            y = np.sort(y)[(np.arange(_MOST) + 0.5).astype(int) * len(y) // _MOST]
        mean = float(y.mean()) if len(y) else 0.0
        if not mean > 0:
            return 0.0, np.ones((1, 1))
        shape, scale, each = _SHAPES[:, None, None], _SCALES[None, :, None], (y / mean)[None, None, :]
        inside = 1 + shape * each / scale
        logs = np.log(np.maximum(inside, np.finfo(float).tiny))
        each = np.where(shape == 0, each / scale, (1 / np.where(shape == 0, 1, shape) + 1) * logs)
        each = np.where(inside > 0, each, np.inf)
        weighed = -(np.log(_SCALES)[None, :] * len(y) + each.sum(axis=2)) * self.worth / len(y)
        weighed = weighed - ((_SHAPES[:, None] - _PRIOR[0]) / _PRIOR[1]) ** 2 / 2
        weights = np.exp(weighed - weighed.max())
        return mean, weights / weights.sum()

    @property
    def shape(self) -> tuple[float, float]:
        """The shape: its mean and deviation."""
        mean, weights = self._posterior
        if not mean:
            return 0.0, 0.0
        of_shape = weights.sum(axis=1)
        middle = float(of_shape @ _SHAPES)
        return middle, float(np.sqrt(of_shape @ (_SHAPES - middle) ** 2))

    def _falls(self, level: float) -> NDArray[np.float64]:
        """Return the share of the excesses over a level, by each shape and scale."""
        mean, _ = self._posterior
        beyond = max(level - self.start, 0.0)
        if not mean:
            return np.array([[float(beyond == 0)]])
        x = beyond / (mean * _SCALES[None, :])
        shape, inside = _SHAPES[:, None], np.maximum(1 + _SHAPES[:, None] * x, 0.0)
        with np.errstate(divide="ignore", over="ignore", under="ignore"):
            return np.where(shape == 0, np.exp(-x), inside ** (-1 / np.where(shape == 0, 1, shape)))

    def expected(self, level: float) -> float:
        """Return the expected fraction of samples over a level."""
        return self.rate * float(np.sum(self._falls(level) * self._posterior[1]))

    def bound(self, level: float, confidence: float) -> float:
        """Return the upper confidence limit of the fraction of samples over a level (bisection).

        The rate over the start is known as well as the number of independent excesses is, which is Poisson's.
        """
        from scipy.special import gammainc

        falls, weights = self._falls(level), self._posterior[1]
        scale = self.worth / (self.rate * np.maximum(falls, 1 / _BEYOND**20))
        low, high = 0.0, min(4 * self.rate, 1.0)
        for _ in range(40):
            middle = (low + high) / 2
            share = float(np.sum(weights * gammainc(self.worth + 1, np.minimum(middle * scale, _BEYOND))))
            low, high = (middle, high) if share < confidence else (low, middle)
            if high - low <= _ROUGHLY * high:
                break
        return high

    def level(self, rate: float) -> float:
        """Return the level with an expected fraction of samples over it (bisection)."""
        mean, _ = self._posterior
        low, high = self.start, self.start + mean
        if not mean or self.expected(low) <= rate:
            return low
        while self.expected(high) > rate and np.isfinite(high):
            low, high = high, high + 2 * (high - self.start)
        for _ in range(60):
            middle = (low + high) / 2
            low, high = (middle, high) if self.expected(middle) > rate else (low, middle)
            if high - low <= _CLOSE * high:
                break
        return high


__all__ = ["ParetoTail"]
