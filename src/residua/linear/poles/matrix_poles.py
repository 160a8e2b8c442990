"""The eigenvalues of a matrix, without rounding where it is all that they are."""

from __future__ import annotations

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from residua.linear.poles.zero_structure import rounding_of, scatter_of, without_zero_eigenvalues
from residua.linear.subspaces.parts import strong_parts
from residua.linear.systems.array_cache import cached_by_entries
from residua.linear.systems.units import state_units_and_rate


def explicit_poles(A: NDArray) -> NDArray[np.complex128]:
    """Return the eigenvalues of a matrix; those that may be nothing but rounding of zero are zero."""
    return _kept_poles(A).copy()  # which results of designs hold


@cached_by_entries
def _kept_poles(A: NDArray) -> NDArray[np.complex128]:
    parts = strong_parts(A)
    if len(parts) == 1:
        return _poles_of_part(A)
    # parts have been asked for by themselves, or those of another matrix are the same
    of_parts = (_poles_of_part(A[np.ix_(i, i)]) if len(i) == 1 else _kept_poles(A[np.ix_(i, i)]) for i in parts)
    return np.concatenate([np.zeros(0, dtype=complex), *of_parts])


def _poles_of_part(A: NDArray[np.float64]) -> NDArray[np.complex128]:
    if len(A) == 1:
        return A[0].astype(complex)
    T, rate = state_units_and_rate(A)  # so that poles come out the same in whatever units, that of time too
    return np.asarray(rate * _poles_in_own_units(A / rate / T[:, None] * T), dtype=complex)


@cached_by_entries
def _poles_in_own_units(A: NDArray[np.float64]) -> NDArray[np.complex128]:
    balanced = scipy.linalg.matrix_balance(A)[0]
    size = float(np.linalg.norm(balanced))
    rest, _, count, regular = without_zero_eigenvalues(balanced, None, size)
    return _poles(balanced, rest, count, size) if regular else _poles_of_large(balanced, size)


def _poles(A: NDArray[np.float64], rest: NDArray[np.float64], count: int, size: float) -> NDArray[np.complex128]:
    """Return the eigenvalues of a matrix, of which ranks count some at zero and leave the rest.

    Ranks alone are no proof: far from normal, a matrix with poles of size one may be near to a singular one.
    """
    poles = np.linalg.eigvals(A).astype(complex)
    near = np.abs(poles) <= scatter_of(count, len(A), size)
    if np.count_nonzero(near) == count:
        return np.where(near, 0.0, poles)
    if np.count_nonzero(near) < count:
        return poles
    return np.concatenate([np.zeros(count, dtype=complex), np.linalg.eigvals(rest)])


def _poles_of_large(A: NDArray[np.float64], size: float) -> NDArray[np.complex128]:
    """Return the eigenvalues of a matrix that may have more at zero than were counted."""
    poles, left, right = scipy.linalg.eig(A, left=True, right=True)
    overlap = np.abs(np.sum(left.conj() * right, axis=0))
    return np.where(is_rounding_of_zero(poles, overlap, size), 0.0, poles).astype(complex)


def is_rounding_of_zero(values: NDArray, overlap: NDArray, size: float) -> NDArray[np.bool_]:
    r"""Tell which eigenvalues of a matrix, or of a pencil ``A - sE``, may be nothing but rounding of zero.

    Rounding scatters a zero of multiplicity ``m`` by :math:`|A| \epsilon^{1/m}`, and to first order any eigenvalue by
    :math:`\epsilon |A| / |w^H E v|`, with its unit eigenvectors: what is within both is zero. Of a matrix that
    no rounding makes singular none is.

    Parameters
    ----------
    values : ndarray of complex, shape (n,)
    overlap : ndarray, shape (n,)
        :math:`|w^H v|`, or :math:`|w^H E v|`.
    size : float
        Norm of ``A``, or of what ``A`` was computed from.
    """
    count = len(values)
    rounding = rounding_of(count)
    zero = np.zeros(count, dtype=bool)
    for m in range(1, count + 1):
        near = np.abs(values) <= size * rounding ** (1 / m)
        if np.count_nonzero(near) >= m:
            zero = near & (np.abs(values) * overlap <= rounding * size)
    return zero
