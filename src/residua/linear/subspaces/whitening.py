"""Scaling that makes a covariance the identity."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

#: In units of each residual's own spread, variances below this fraction of the largest are raised to it: a
#: combination of residuals that never moved on fault-free data must not turn rounding into alarms.
VARIANCE_FLOOR = 1e-8


def whitening_matrix(covariance: NDArray[np.float64], *, floor: float = VARIANCE_FLOOR) -> NDArray[np.float64]:
    r"""Return ``M`` with :math:`M^T \Sigma M = I` for a covariance :math:`\Sigma`.

    Parameters
    ----------
    covariance : ndarray, shape (k, k)
    floor : float
        Eigenvalues of the correlation matrix below this fraction of the largest are raised to it. A residual
        that never moved at all gets the smallest spread among the others.

    Returns
    -------
    ndarray, shape (k, k)
        Apply as ``r @ M``. The identity when the covariance is zero.

    Examples
    --------
    >>> import numpy as np
    >>> from residua.decide import whitening_matrix
    >>> M = whitening_matrix(np.diag([4.0, 1.0]))
    >>> (M.T @ np.diag([4.0, 1.0]) @ M).round(12) + 0.0
    array([[1., 0.],
           [0., 1.]])
    """
    values, vectors, spread = _axes(covariance)
    largest = float(values[-1]) if values.size else 0.0
    if largest <= 0:
        return np.eye(len(covariance))
    return vectors / np.sqrt(np.maximum(values, floor * largest)) / spread[:, None]


def moving_directions(covariance: NDArray[np.float64], *, floor: float = VARIANCE_FLOOR) -> int:
    """Return in how many independent directions noise moves residuals: those that ``whitening_matrix`` makes even.

    Fewer than there are residuals where decoupling made some of them combinations of the others: the square of a
    whitened residual then has that many degrees of freedom.

    Parameters
    ----------
    covariance : ndarray, shape (k, k)
    floor : float
        As for :func:`whitening_matrix`.

    Returns
    -------
    int
        All of them for a covariance of zero, for which the whitening is the identity.
    """
    values, _, _ = _axes(covariance)
    largest = float(values.max(initial=0.0))
    return int(np.sum(values > floor * largest)) if largest > 0 else len(covariance)


def _axes(covariance: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the eigenvalues of the correlation matrix, smallest first, its axes, and the spread of each residual."""
    covariance = (covariance + covariance.T) / 2
    spread = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    spread = np.where(spread > 0, spread, spread[spread > 0].min(initial=np.inf) if spread.any() else 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(spread, spread))
    return values, vectors, spread
