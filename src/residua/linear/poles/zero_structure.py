"""Eigenvalues at zero, counted by ranks and taken out before any other is computed.

Rounding scatters an eigenvalue of multiplicity ``m`` by the ``m``-th root of it: that of a chain of six integrators by
a thousandth of the norm. Its multiplicity is the sum of the numbers of null vectors that are left, one level after the
other, when those of the level before are divided out, each a decision about a rank, which rounding does not move.

References
----------
V. N. Kublanovskaya, On a method of solving the complete eigenvalue problem for a degenerate matrix, USSR Comput. Math.
Math. Phys. 6 (1966) 1-14. P. Van Dooren, The computation of Kronecker's canonical form of a singular pencil, Linear
Algebra Appl. 27 (1979) 103-140.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from residua.linear.subspaces.parts import strong_parts
from residua.linear.subspaces.rank import row_and_null_basis

Matrix = NDArray[np.float64]


def rounding_of(count: int) -> float:
    """Return what orthogonal steps leave of a zero in a matrix of this size, relative to its norm."""
    return 10 * count * float(np.finfo(float).eps)


def scatter_of(multiplicity: int, count: int, size: float) -> float:
    """Return how far rounding scatters so many of ``count`` eigenvalues of a matrix from zero."""
    return size * rounding_of(count) ** (1 / multiplicity) if multiplicity else 0.0


def without_zero_eigenvalues(A: Matrix, E: Matrix | None, size: float) -> tuple[Matrix, Matrix | None, int]:
    """Take the eigenvalues at zero out of ``A``, or of the pencil ``A - sE``, by orthogonal steps.

    Parameters
    ----------
    A : ndarray, shape (n, n)
        In units in which all entries are comparable.
    E : ndarray, shape (n, n), or None
        Invertible; the identity when ``None``.
    size : float
        Norm of ``A``, or of what ``A`` was computed from: singular values that are rounding beside it are zero.

    Returns
    -------
    A, E : ndarray
        What is left, with the other eigenvalues.
    count : int
        How many were taken out.
    """
    n = len(A)
    rounding = rounding_of(n)
    while len(A):
        kept, null, decision = row_and_null_basis(A, rtol=rounding, scale=size)
        if decision.rank == len(A):
            break
        if E is None:
            A = kept.T @ A @ kept
        else:  # the rows that the null vectors reach through E go with them
            left = np.linalg.qr(E @ null, mode="complete")[0][:, null.shape[1] :]
            A, E = left.T @ A @ kept, left.T @ E @ kept
    return A, E, n - len(A)


def explicit_poles(A: NDArray) -> NDArray[np.complex128]:
    """Return the eigenvalues of a matrix; those that ranks count at zero are zero, as those of integrators."""
    return np.concatenate([np.zeros(0, dtype=complex), *(_poles(A[np.ix_(part, part)]) for part in strong_parts(A))])


def _poles(A: NDArray) -> NDArray[np.complex128]:
    balanced = scipy.linalg.matrix_balance(A)[0] if len(A) > 1 else A
    size = float(np.linalg.norm(balanced))
    poles = np.linalg.eigvals(balanced).astype(complex)
    rest, _, count = without_zero_eigenvalues(balanced, None, size)
    # ranks alone are no proof: far from normal, a matrix with poles of size one may be near to a singular one
    near = np.abs(poles) <= scatter_of(count, len(A), size)
    found = np.count_nonzero(near)
    if found > count:
        return np.concatenate([np.zeros(count, dtype=complex), np.linalg.eigvals(rest)])
    return np.where(near, 0.0, poles) if found == count else poles
