"""Which modes are stable, and which may be so only by rounding."""

from __future__ import annotations

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from residua.linear.poles.zero_structure import rounding_of, scatter_of, without_zero_eigenvalues
from residua.linear.subspaces.parts import connected_parts, strong_parts
from residua.tolerances import TINY

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


def may_die_out(modes: NDArray, uncertainty: NDArray, dt: float, size: float) -> NDArray[np.bool_]:
    """Tell which hidden modes that do not count as stable may be, as rounding may have scattered them from one place.

    Parameters are those of `dies_out`.
    """
    loose = uncertainty > np.sqrt(_EPS) * size
    reach = scatter_of(int(np.count_nonzero(loose)), max(len(modes), 1), size)
    inside = is_stable_mode(modes, dt, uncertainty=-np.maximum(uncertainty, reach))
    return loose & inside & ~dies_out(modes, uncertainty, dt, size)


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
    size = float(np.linalg.norm(A))
    modes = modes.astype(complex)
    modes[_modes_at_zero(A, modes, size, perturbation)] = 0.0
    return modes, moved / np.maximum(cosine, np.sqrt(_EPS))


def hidden_modes(
    A: NDArray[np.float64], Q: NDArray[np.float64], k: int, perturbation: float
) -> tuple[NDArray[np.complex128], NDArray[np.float64]]:
    """Return the modes of the hidden part of a matrix, and what rounding may have done to each.

    They are eigenvalues of the whole, which parts without couplings both ways have apart: no chain of states scatters
    them there, and no basis is rounded. Where those of the hidden block alone are less sharp, they only say which.

    Parameters
    ----------
    A : ndarray, shape (n, n)
    Q : ndarray, shape (n, n)
        Orthogonal; its columns from ``k`` on span the hidden part.
    k : int
    perturbation : float
        Norm of what the hidden block is off by, on top of rounding.

    Returns
    -------
    modes : ndarray of complex
    uncertainty : ndarray
    """
    block = Q[:, k:].T @ A @ Q[:, k:]
    modes, moved = _without_scatter(block, *modes_with_uncertainty(block, perturbation), perturbation)
    parts = strong_parts(A)
    if not modes.size or len(parts) == 1 or moved.max() <= np.sqrt(_EPS) * float(np.linalg.norm(A)):
        return modes, moved
    from scipy.optimize import linear_sum_assignment  # slow to import

    apart = [modes_with_uncertainty(A[np.ix_(part, part)]) for part in parts]
    poles, own = (np.concatenate(both) for both in zip(*apart, strict=True))
    distance = np.abs(modes[:, None] - poles)
    chosen = np.asarray(linear_sum_assignment(distance)[1])
    # a pole of another part that is as near may be the one, or one from which rounding has scattered this mode
    left = np.setdiff1d(np.arange(poles.size), chosen)
    size = float(np.linalg.norm(block))
    loose = moved > np.sqrt(_EPS) * size
    scattered = scatter_of(int(np.count_nonzero(loose)), len(block), size, perturbation / max(size, TINY))
    reach = np.maximum(2 * np.diagonal(distance[:, chosen]), np.where(loose, scattered, 0.0))
    near = distance[:, left] <= reach[:, None]
    other = np.where(near, np.abs(poles[chosen][:, None] - poles[left]), 0.0).max(axis=1, initial=0.0)
    known = np.maximum(own[chosen], other)
    return (poles[chosen], known) if known.max() < moved.max() else (modes, moved)


def _without_scatter(
    A: NDArray[np.float64], modes: NDArray[np.complex128], moved: NDArray[np.float64], perturbation: float
) -> tuple[NDArray[np.complex128], NDArray[np.float64]]:
    """Return modes that rounding may have scattered from one real place, with all of them there if ranks count as many.

    It is their mean, which rounding does not scatter: had it, ranks would not count them all there.
    """
    n, size = len(A), float(np.linalg.norm(A))
    loose = np.flatnonzero((moved > np.sqrt(_EPS) * size) & (modes != 0))
    if len(loose) < 2:
        return modes, moved
    more = perturbation / size
    balanced = scipy.linalg.matrix_balance(A)[0]
    known = float(np.linalg.norm(balanced)) + perturbation / rounding_of(n)
    modes, moved = modes.copy(), moved.copy()
    near = np.abs(modes[loose][:, None] - modes[loose]) <= scatter_of(len(loose), n, size, more)
    for group in connected_parts(near):
        own, m = loose[group], len(group)
        mean = complex(modes[own].mean())
        if m < 2 or abs(mean.imag) > np.sqrt(_EPS) * abs(mean):
            continue
        reach = scatter_of(m, n, size, more)
        if np.abs(modes[own] - mean.real).max() > reach:
            continue
        if without_zero_eigenvalues(balanced - mean.real * np.eye(n), None, known)[2] == m:
            modes[own], moved[own] = mean.real, rounding_of(n) * size + perturbation
    return modes, moved


def _modes_at_zero(
    A: NDArray[np.float64], modes: NDArray[np.complex128], size: float, perturbation: float
) -> NDArray[np.intp]:
    """Return the modes that ranks count at zero, if they are no further from it than rounding scatters so many.

    Ranks alone are no proof: a chain of slow modes in turned coordinates is near to a singular matrix, too.
    """
    n, distance, more = len(A), np.abs(modes), perturbation / max(size, TINY)
    if distance.min() > scatter_of(n, n, size, more):
        return np.zeros(0, dtype=int)
    balanced = scipy.linalg.matrix_balance(A)[0]
    known = float(np.linalg.norm(balanced)) + perturbation / rounding_of(n)
    count = without_zero_eigenvalues(balanced, None, known)[2]
    nearest = np.argsort(distance, kind="stable")[:count]
    return nearest if np.all(distance[nearest] <= scatter_of(count, n, size, more)) else nearest[:0]
