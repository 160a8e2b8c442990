"""The star norm: the smallest ellipsoid of a one-parameter family that holds all states."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.errors import AccuracyError
from residua.linear.norms.impulse_terms import StableSystem, doubled_sum
from residua.linear.subspaces.rank import spectral_norm

Matrix = NDArray[np.float64]
#: In place of the logarithm of a size that does not exist.
_TOO_LARGE = 1e3


@dataclass(frozen=True, eq=False)
class Ellipsoid:
    """All states that inputs of unit size reach from zero lie in ``x' Q^-1 x <= 1``.

    Attributes
    ----------
    Q : ndarray, shape (n, n)
        ``Q = A Q A' / (1 - rate) + B B' / rate``, in the units of the original system.
    rate : float
        ``1 - 1 / a`` of the star norm.
    bound : float
        ``largest singular value of (C Q C')^(1/2)``, plus that of ``D``.
    """

    Q: Matrix
    rate: float
    bound: float


def star_ellipsoid(system: StableSystem, *, xtol: float = 1e-10) -> Ellipsoid:
    r"""Search the one parameter of the star norm.

    :math:`Q(\lambda) = \sum_k (1-\lambda)^{-k} \lambda^{-1} A^k B B^T A^{kT}`. Each coefficient is log-convex in
    :math:`\lambda`, sums and maxima of log-convex functions are log-convex, and so the bound has one minimum only:
    the search cannot end in another.
    """
    direct = spectral_norm(system.D)
    n, m = system.B.shape
    if not n or not m or not np.any(system.B) or not np.any(system.C):
        return Ellipsoid(np.zeros((n, n)), 0.5, direct)
    room = 1 - system.radius**2
    middle = ellipsoid_shape(system.A, system.B, room / 2)
    seen = middle is None or _spread(system.C, middle) > 1e-24 * np.trace(middle) * float(np.sum(system.C**2))
    C = system.C if seen else np.eye(n)  # outputs that no input reaches leave the choice to the states

    def rate_of(t: float) -> float:
        # A logistic scale resolves both ends; the optimum of a slow system lies near the middle of it.
        return room / (1 + np.exp(-t))

    def size(t: float) -> float:
        Q = ellipsoid_shape(system.A, system.B, rate_of(t))
        # larger than any logarithm, and finite: the search lays parabolas through its points
        return _TOO_LARGE if Q is None else float(np.log(max(_spread(C, Q), np.finfo(float).tiny)))

    from scipy.optimize import minimize_scalar  # slow to import, and not needed to run a monitor

    minimum = minimize_scalar(size, bounds=(-12.0, 25.0), method="bounded", options={"xatol": xtol**0.5})
    rate = rate_of(float(minimum.x))
    Q = ellipsoid_shape(system.A, system.B, rate)
    if Q is None:  # a search that begins where nothing is solved does not find its way out
        rate = rate_of(min(np.linspace(-12.0, 25.0, 75), key=size))
        Q = ellipsoid_shape(system.A, system.B, rate)
    if Q is None:
        raise AccuracyError(
            f"the Lyapunov equation of the star norm was not solved (spectral radius {system.radius:.12g}): "
            "a pole is too near to the stability boundary"
        )
    return Ellipsoid(Q, rate, float(np.sqrt(max(_spread(system.C, Q), 0.0))) + direct)


def _spread(C: Matrix, Q: Matrix) -> float:
    return float(np.linalg.eigvalsh(C @ Q @ C.T)[-1])


def ellipsoid_shape(A: Matrix, B: Matrix, rate: float) -> Matrix | None:
    """Return ``Q = A Q A' / (1 - rate) + B B' / rate``, or None if it was not solved."""
    W, first = B @ B.T / rate, A / np.sqrt(1 - rate)
    Q = doubled_sum(first, W)
    if Q is None or not np.linalg.norm(first @ Q @ first.T + W - Q) <= 1e-10 * np.linalg.norm(Q):
        return None
    return (Q + Q.T) / 2
