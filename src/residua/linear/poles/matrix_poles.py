"""The eigenvalues of a matrix, without rounding where it is all that they are."""

from __future__ import annotations

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from residua.linear.poles.zero_structure import rounding_of
from residua.linear.subspaces.parts import strong_parts
from residua.linear.systems.scaling import scaling

#: A pole of more than this fraction of the size of its matrix is not zero: a triple zero is scattered by about as much.
_NEAR_ZERO = 1e-5


def explicit_poles(A: NDArray) -> NDArray[np.complex128]:
    """Return the eigenvalues of a matrix; those that may be nothing but rounding of zero are zero.

    Those of parts without couplings both ways are computed by themselves: nothing scatters them.
    """
    parts = [A[np.ix_(part, part)] for part in strong_parts(A)]
    poles = (part[0].astype(complex) if len(part) == 1 else _poles_of_part(part) for part in parts)
    return np.concatenate([np.zeros(0, dtype=complex), *poles])


def _poles_of_part(A: NDArray) -> NDArray[np.complex128]:
    n = len(A)
    units = scaling(A, np.zeros((n, 0)), np.zeros((0, n)), np.zeros((0, 0)), sampled=False)
    balanced = A / units.states[:, None] * units.states / units.rate
    poles, size = np.linalg.eigvals(balanced).astype(complex), float(np.linalg.norm(balanced))
    if np.abs(poles).min() <= _NEAR_ZERO * size:
        poles, left, right = scipy.linalg.eig(balanced, left=True, right=True)
        overlap = np.abs(np.sum(left.conj() * right, axis=0))
        zero = is_rounding_of_zero(poles, overlap, size) & (np.abs(poles) <= _NEAR_ZERO * size)
        poles = np.where(zero, 0.0, poles)
    return np.asarray(units.rate * poles, dtype=complex)


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
