"""Variances of many residuals from few observations each, shrunk towards a common value."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.errors import DataError
from residua.words import counted

#: Steps of Newton's method, of which six are enough.
_MOST_STEPS = 50


@dataclass(frozen=True, eq=False)
class ModeratedVariances:
    """Variances shrunk towards a common value.

    Attributes
    ----------
    variances : ndarray, shape (residuals,)
    freedom : ndarray, shape (residuals,)
        Degrees of freedom of Student's distribution of a new observation divided by its root, whole or not.
    prior : float
        The common value.
    prior_freedom : float
        How many observations the common value counts for; infinite where the variances differ by chance alone.
    """

    variances: NDArray[np.float64]
    freedom: NDArray[np.float64]
    prior: float
    prior_freedom: float


def moderated_variances(variances: ArrayLike, freedom: ArrayLike) -> ModeratedVariances:
    r"""Return shrunk variances, for residuals with few observations each.

    A limit from three fault-free days has two degrees of freedom: at one in a thousand it is 22 times the scatter.
    If many residuals have few observations, all variances together show the usual variance of such a residual. With the
    prior :math:`d_0 s_0^2 / \sigma^2 \sim \chi^2_{d_0}`, of which both numbers are estimated from the mean and the
    variance of the logarithms,

    .. math:: \tilde s_i^2 = \frac{d_0 s_0^2 + d_i s_i^2}{d_0 + d_i}, \qquad
              r_i / \tilde s_i \sim t_{d_0 + d_i}

    Guaranteed: variances that differ by no more than chance become one; those that differ by far more stay nearly as
    they are. The result does not depend on the unit that all residuals have in common.

    Parameters
    ----------
    variances : array_like, shape (residuals,)
        Estimated, of residuals in comparable units (divided by their own scatter within a day, for example).
    freedom : array_like, shape (residuals,)
        Degrees of freedom of each, zero where a residual has no observation: it gets the common value.

    Returns
    -------
    ModeratedVariances

    Raises
    ------
    DataError
        If the shapes do not fit, a variance is not positive where it has freedom, or fewer than two have any.

    Notes
    -----
    Assumes: Gaussian residuals, independent variances. Observations of the same days are not independent; then the
    common value is less certain than it counts for. The freedom is never more than that of all variances together.

    References
    ----------
    Smyth (2004), Statistical Applications in Genetics and Molecular Biology 3(1), article 3.

    Examples
    --------
    >>> from residua.decide import moderated_variances
    >>> made = moderated_variances([0.2, 1.1, 0.9, 2.1], [2, 3, 3, 4])
    >>> made.prior_freedom, made.freedom.tolist()
    (inf, [12.0, 12.0, 12.0, 12.0])
    >>> made = moderated_variances([0.01, 1.0, 100.0], [10, 10, 10])
    >>> made.variances.round(2).tolist(), made.freedom.round(1).tolist()
    ([0.01, 0.96, 95.7], [10.4, 10.4, 10.4])
    """
    from scipy.special import digamma, polygamma  # slow to import, and needed only here

    s2, d = _checked(variances, freedom)
    some = d > 0
    logs = np.log(s2[some]) - digamma(d[some] / 2) + np.log(d[some] / 2)
    beyond_chance = float(np.var(logs, ddof=1) - np.mean(polygamma(1, d[some] / 2)))
    if beyond_chance <= 0:
        prior = float(np.exp(logs.mean()))
        return ModeratedVariances(np.full(len(d), prior), np.full(len(d), d.sum()), prior, np.inf)
    half = _inverse_trigamma(beyond_chance)
    prior = float(np.exp(logs.mean() + digamma(half) - np.log(half)))
    shared = (2 * half * prior + d * np.where(some, s2, 0.0)) / (2 * half + d)
    return ModeratedVariances(shared, np.minimum(2 * half + d, d.sum()), prior, 2 * half)


def _checked(variances: ArrayLike, freedom: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    s2, d = np.asarray(variances, dtype=float), np.asarray(freedom, dtype=float)
    if s2.ndim != 1 or d.shape != s2.shape:
        raise DataError(f"variances and freedom must have one entry per residual, got shapes {s2.shape} and {d.shape}")
    if not (np.isfinite(d) & (d >= 0)).all():
        raise DataError("freedom must be finite and zero or more: the observations of a residual less what they fit")
    if (some := int(np.count_nonzero(d))) < 2:
        raise DataError(f"{counted(some, 'residual')} with any freedom: it takes two to have something in common")
    if not (np.isfinite(s2) & (s2 > 0))[d > 0].all():
        raise DataError("a variance with freedom must be finite and positive; leave out a residual that never moves")
    return s2, d


def _inverse_trigamma(value: float) -> float:
    """Return the inverse of the trigamma function, by Newton's method.

    It begins below the place. The reciprocal of the function is convex, so that every step goes up and none too far.
    """
    from scipy.special import polygamma

    x, eps = 0.5 + 1 / value, float(np.finfo(float).eps)
    if value < eps:  # it is one over its argument there, to the last digit
        return 1 / value
    for _ in range(_MOST_STEPS):
        now = float(polygamma(1, x))
        step = now * (1 - now / value) / float(polygamma(2, x))
        x += step
        if abs(step) <= eps * x:
            break
    return x


__all__ = ["ModeratedVariances", "moderated_variances"]
