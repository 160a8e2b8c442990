"""Stable modes, and those that may be stable only by rounding."""

from __future__ import annotations

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

_EPS = float(np.finfo(float).eps)
#: What a hidden mode must be inside the stability region by: a slower one does not die out in any time that counts.
_INSIDE = 1e-10


def is_stable_mode(
    modes: ArrayLike, dt: float = 0, margin: float = 0, *, uncertainty: ArrayLike = 0
) -> NDArray[np.bool_]:
    """Tell which modes are stable; the boundary counts as unstable.

    Continuous time: ``Re(s) < -margin``. Sampled: ``abs(z) < exp(-margin * dt)``, the same decay rate.

    Parameters
    ----------
    modes : array_like of complex
        Eigenvalues of ``A``, in 1/s when ``dt`` is 0.
    dt : float
        0 for continuous time, otherwise the sample step in seconds.
    margin : float
        Decay rate in 1/s that must be exceeded.
    uncertainty : array_like
        Distance by which each mode must be inside, for what rounding may have done to it.

    Returns
    -------
    ndarray of bool

    Examples
    --------
    >>> is_stable_mode([-1, 0, 1j])
    array([ True, False, False])
    >>> is_stable_mode([0.5, 0.95], dt=0.1, margin=1)
    array([ True, False])
    """
    modes = np.asarray(modes, dtype=complex)
    inside = np.asarray(uncertainty, dtype=float)
    if dt:
        return np.abs(modes) + inside < np.exp(-margin * dt)
    return np.real(modes) + inside < -margin


def dies_out(modes: NDArray, uncertainty: NDArray, dt: float, size: float) -> NDArray[np.bool_]:
    """Tell which hidden modes count as stable, for everything that has to live with them.

    Inside the stability region by more than their uncertainty and 1e-10 on top: of the radius of the unit disk for
    sampled systems, of ``size`` for continuous ones.

    Parameters
    ----------
    modes : ndarray of complex
    uncertainty : ndarray
        See `modes_with_uncertainty`.
    dt : float
    size : float
        Spectral norm of ``A`` in balanced units.

    Returns
    -------
    ndarray of bool
    """
    return is_stable_mode(modes, dt, uncertainty=uncertainty + _INSIDE * (1.0 if dt else size))


def modes_with_uncertainty(
    A: NDArray[np.float64], perturbation: float = 0.0
) -> tuple[NDArray[np.complex128], NDArray[np.float64]]:
    """Return eigenvalues and what a perturbation of ``A`` may do to each, from its condition number.

    Parameters
    ----------
    A : ndarray, shape (n, n)
    perturbation : float
        Norm of the perturbation that comes on top of rounding.

    Returns
    -------
    modes : ndarray of complex
    uncertainty : ndarray
    """
    n = A.shape[0]
    if not n:
        return np.zeros(0, complex), np.zeros(0)
    modes, left, right = scipy.linalg.eig(A, left=True, right=True)
    cosine = np.abs(np.sum(left.conj() * right, axis=0))
    moved = n * _EPS * float(np.linalg.norm(A)) + perturbation
    # A defective mode has cosine 0; the floor gives it the sqrt(eps) that a double mode moves by.
    return modes.astype(complex), moved / np.maximum(cosine, np.sqrt(_EPS))


def hidden_modes(
    A: NDArray[np.float64], Q: NDArray[np.float64], k: int, perturbation: float
) -> tuple[NDArray[np.complex128], NDArray[np.float64]]:
    """Return the modes of the part that columns ``k`` on of an orthogonal ``Q`` span, and their uncertainty.

    Parameters are those of `modes_with_uncertainty`: the perturbation is that of the part.
    """
    return modes_with_uncertainty(Q[:, k:].T @ A @ Q[:, k:], perturbation)
