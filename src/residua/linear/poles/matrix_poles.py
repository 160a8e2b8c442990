"""The eigenvalues of a matrix, without rounding where it is all that they are."""

from __future__ import annotations

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from residua.linear.systems.array_cache import cached_by_entries
from residua.linear.systems.units import system_units


def explicit_poles(A: NDArray) -> NDArray[np.complex128]:
    """Return the eigenvalues of a matrix; those that may be nothing but rounding of zero are zero."""
    return _kept_poles(A).copy()  # which results of designs hold


@cached_by_entries
def _kept_poles(A: NDArray) -> NDArray[np.complex128]:
    if len(A) and np.all(A):  # all states are one part: to find them is slower than to see that
        return _poles_of_part(A)
    from scipy.sparse.csgraph import connected_components  # slow to import; parts of a cascade have their own poles

    count, part = connected_components(A != 0, connection="strong") if len(A) else (0, np.zeros(0, dtype=int))
    chosen = [np.flatnonzero(part == i) for i in range(count)]
    return np.concatenate([np.zeros(0, dtype=complex), *(_poles_of_part(A[np.ix_(i, i)]) for i in chosen)])


def _poles_of_part(A: NDArray) -> NDArray[np.complex128]:
    if len(A) == 1:
        return A[0].astype(complex)
    T = system_units(A, np.zeros((len(A), 0)), np.zeros((0, len(A))), np.zeros((0, 0))).states
    balanced = scipy.linalg.matrix_balance(A / T[:, None] * T)[0]
    size = float(np.linalg.norm(balanced))
    if is_regular(balanced, size):
        return np.linalg.eigvals(balanced).astype(complex)
    poles, left, right = scipy.linalg.eig(balanced, left=True, right=True)
    overlap = np.abs(np.sum(left.conj() * right, axis=0))
    return np.where(is_rounding_of_zero(poles, overlap, size), 0.0, poles).astype(complex)


def is_regular(A: NDArray, size: float) -> bool:
    """Tell whether no rounding makes a square matrix singular: then none of its eigenvalues is zero, however scattered.

    Parameters
    ----------
    A : ndarray, shape (n, n)
    size : float
        Norm of ``A``, or of what ``A`` was computed from.
    """
    return bool(np.linalg.norm(A, -2) > _rounding(len(A)) * size) if len(A) else True


def _rounding(count: int) -> float:
    return 10 * count * float(np.finfo(float).eps)


def is_rounding_of_zero(values: NDArray, overlap: NDArray, size: float) -> NDArray[np.bool_]:
    r"""Tell which eigenvalues of a matrix, or of a pencil ``A - sE``, may be nothing but rounding of zero.

    Rounding scatters a zero of multiplicity ``m`` by :math:`|A| \epsilon^{1/m}`, and to first order any eigenvalue by
    :math:`\epsilon |A| / |w^H E v|`, with its unit eigenvectors: what is within both is zero. Of a matrix that
    :func:`is_regular` none is.

    Parameters
    ----------
    values : ndarray of complex, shape (n,)
    overlap : ndarray, shape (n,)
        :math:`|w^H v|`, or :math:`|w^H E v|`.
    size : float
        Norm of ``A``, or of what ``A`` was computed from.
    """
    count = len(values)
    rounding = _rounding(count)
    zero = np.zeros(count, dtype=bool)
    for m in range(1, count + 1):
        near = np.abs(values) <= size * rounding ** (1 / m)
        if np.count_nonzero(near) >= m:
            zero = near & (np.abs(values) * overlap <= rounding * size)
    return zero
