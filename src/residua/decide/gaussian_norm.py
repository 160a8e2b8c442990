"""Length of a Gaussian vector whose mean is not zero: density and tail of the noncentral chi distribution."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from residua.tolerances import TINY

Values = NDArray[np.float64]
#: Orders of Bessel functions from which on their logarithms are computed.
_LARGE_ORDER = 10.0


def _debye(terms: int) -> tuple[Values, ...]:
    r"""Return the polynomials of Debye's expansion, by their recurrence.

    .. math:: u_{k+1}(t) = \tfrac12 t^2 (1 - t^2) u_k'(t) + \tfrac18 \int_0^t (1 - 5 s^2) u_k(s)\, ds
    """
    P = np.polynomial.Polynomial
    out, u = [], P([1.0])
    for _ in range(terms):
        u = 0.5 * P([0, 0, 1, 0, -1]) * u.deriv() + 0.125 * (P([1, 0, -5]) * u).integ()
        out.append(u.coef)
    return tuple(out)


#: Those that are used.
_DEBYE = _debye(6)


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
    from scipy.special import gammaln

    if dimension == 1:  # both signs
        near, far = np.subtract(length, mean), np.add(length, mean)
        return (np.exp(-(near**2) / 2) + np.exp(-(far**2) / 2)) / np.sqrt(2 * np.pi)
    r, m = np.broadcast_arrays(np.asarray(length, dtype=float), np.asarray(mean, dtype=float))
    order = dimension / 2 - 1
    density = np.empty(r.shape)
    small = r * m < np.finfo(float).eps ** 0.25  # its Bessel function is its first two terms
    at, center = r[small], m[small]
    density[small] = np.exp(
        (dimension - 1) * np.log(np.maximum(at, TINY))
        - (at**2 + center**2) / 2
        - order * np.log(2)
        - gammaln(dimension / 2)
    ) * (1 + (at * center) ** 2 / (4 * (order + 1)))
    at, center = r[~small], m[~small]
    if order >= _LARGE_ORDER:
        logs = (
            np.log(at) + order * np.log(at / center) - (at - center) ** 2 / 2 + _log_scaled_bessel(order, at * center)
        )
        density[~small] = np.exp(logs)
        return density
    with np.errstate(over="ignore"):
        weight = at * (at / center) ** order if order else at
    density[~small] = weight * np.exp(-((at - center) ** 2) / 2) * _scaled_bessel(order, at * center)
    return density


def _scaled_bessel(order: float, x: Values) -> Values:
    """Return the modified Bessel function of the first kind times ``exp(-x)``, with a faster way for few dimensions."""
    from scipy.special import i0e, i1e, ive

    if order == 0:
        return i0e(x)
    if order == 1:
        return i1e(x)
    if order == 0.5:
        return -np.expm1(-2 * x) / np.sqrt(2 * np.pi * x)
    return ive(order, x)


def _log_scaled_bessel(order: float, x: Values) -> Values:
    r"""Return the logarithm of the scaled Bessel function for large orders, where the function itself underflows.

    By Debye's uniform expansion (Olver 1974, section 10.7), to 1e-9 from an order of ten on.
    """
    root = np.hypot(1.0, x / order)
    t = 1 / root
    eta = root + np.log(x / order) - np.log1p(root)
    series = np.ones_like(t)
    for k, polynomial in enumerate(_DEBYE, 1):
        series += np.polynomial.polynomial.polyval(t, polynomial) / order**k
    return order * eta - x - np.log(2 * np.pi * order) / 2 + np.log(t) / 2 + np.log(series)


def norm_above(length: float, mean: Values, dimension: int) -> Values:
    """Return the probability that a Gaussian vector with unit covariance and a mean of that length exceeds a length."""
    from scipy.special import chndtr

    return 1 - chndtr(max(length, 0.0) ** 2, dimension, np.asarray(mean, dtype=float) ** 2)


__all__ = ["norm_above", "norm_density"]
