"""The length of a Gaussian vector whose mean is not zero: density and tail of the noncentral chi distribution."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from residua.tolerances import TINY

Values = NDArray[np.float64]


def norm_density(length: Values, mean: Values, dimension: int) -> Values:
    r"""Return the density of the length of a Gaussian vector with unit covariance.

    .. math:: f(r) = r\, (r/m)^{k/2-1} e^{-(r^2+m^2)/2} I_{k/2-1}(r m)

    Parameters
    ----------
    length : ndarray
        Where, above zero.
    mean : ndarray
        The length of its mean; they broadcast.
    dimension : int
        Of the vector.

    Examples
    --------
    >>> import numpy as np
    >>> norm_density(np.array([1.0]), np.array([0.0]), 2).round(6)  # Rayleigh's
    array([0.606531])
    """
    from scipy.special import gammaln, ive

    r, m = np.broadcast_arrays(np.asarray(length, dtype=float), np.asarray(mean, dtype=float))
    order = dimension / 2 - 1
    product = r * m
    small = product < np.finfo(float).eps ** 0.25  # its Bessel function is its first two terms
    at = np.where(small, 1.0, product)
    central = np.exp(
        (dimension - 1) * np.log(np.maximum(r, TINY)) - (r**2 + m**2) / 2 - order * np.log(2) - gammaln(dimension / 2)
    ) * (1 + product**2 / (4 * (order + 1)))
    with np.errstate(over="ignore"):
        ratio = np.where(small, 1.0, r / np.where(small, 1.0, m)) ** order
    return np.where(small, central, r * ratio * np.exp(-((r - m) ** 2) / 2) * ive(order, at))


def norm_above(length: float, mean: Values, dimension: int) -> Values:
    """Return the probability that a Gaussian vector with unit covariance and a mean of that length is longer."""
    from scipy.special import chndtr

    return 1 - chndtr(max(length, 0.0) ** 2, dimension, np.asarray(mean, dtype=float) ** 2)


__all__ = ["norm_above", "norm_density"]
