"""Covariances of few samples, drawn towards one that is better known."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

#: With that many independent samples to each residual a covariance counts as known, and is left as it is.
KNOWN = 10.0


def oracle_approximating_intensity(correlation: NDArray[np.float64], samples: float) -> float:
    r"""Return how far a sample correlation matrix is to be drawn towards the identity: between 0 and 1.

    .. math::

       \varrho = \min\left(1, \frac{(1 - 2/p)\,\mathrm{tr}(S^2) + \mathrm{tr}^2(S)}
       {(n + 1 - 2/p)\,\left(\mathrm{tr}(S^2) - \mathrm{tr}^2(S)/p\right)}\right)

    of ``p`` Gaussian residuals and ``n`` independent samples, the least mean square error that is attained without
    knowing the true covariance. Of dependent samples, ``n`` is the number of independent ones that they are worth.

    References
    ----------
    Chen, Wiesel, Eldar and Hero (2010), IEEE Transactions on Signal Processing 58(10), 5016-5029, eq. (23).

    Examples
    --------
    >>> import numpy as np
    >>> round(oracle_approximating_intensity(np.array([[1.0, 0.5], [0.5, 1.0]]), 20), 3)
    0.4
    """
    p = len(correlation)
    if p < 2:
        return 0.0
    squares, square = float(np.sum(correlation**2)), float(np.trace(correlation)) ** 2
    apart = squares - square / p
    above = (1 - 2 / p) * squares + square
    below = (max(samples, 1.0) + 1 - 2 / p) * apart
    return 1.0 if above >= below else above / below


def shrunk(covariance: NDArray[np.float64], samples: float) -> tuple[NDArray[np.float64], float]:
    """Return a covariance that fits the number of independent samples it is from, and by how much it was changed.

    Where they are fewer than ten to a residual the correlations are drawn towards zero
    (:func:`oracle_approximating_intensity`); the variances stay, so that the outcome does not depend on units.

    Parameters
    ----------
    covariance : ndarray, shape (k, k)
    samples : float

    Returns
    -------
    covariance : ndarray, shape (k, k)
    intensity : float
    """
    moving = np.flatnonzero(np.diag(covariance) > 0)
    if len(moving) < 2 or samples >= KNOWN * len(moving):
        return covariance, 0.0
    spread = np.sqrt(np.diag(covariance)[moving])
    part = covariance[np.ix_(moving, moving)] / np.outer(spread, spread)
    intensity = oracle_approximating_intensity(part, samples)
    off = covariance * (1 - intensity)
    np.fill_diagonal(off, np.diag(covariance))
    return off, intensity


__all__ = ["KNOWN", "oracle_approximating_intensity", "shrunk"]
