"""The eigenvalues of a matrix, without rounding where it is all that they are."""

from __future__ import annotations

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from residua.linear.poles.zero_structure import scatter_of, without_zero_eigenvalues
from residua.linear.subspaces.parts import strong_parts


def explicit_poles(A: NDArray) -> NDArray[np.complex128]:
    """Return the eigenvalues of a matrix; those that ranks count at zero are zero, as those of integrators."""
    poles = [_poles_of_part(A[np.ix_(part, part)]) for part in strong_parts(A)]
    return np.concatenate([np.zeros(0, dtype=complex), *poles])


def _poles_of_part(A: NDArray) -> NDArray[np.complex128]:
    n = len(A)
    if n == 1:
        return A[0].astype(complex)
    balanced = scipy.linalg.matrix_balance(A)[0]
    size = float(np.linalg.norm(balanced))
    poles = np.linalg.eigvals(balanced).astype(complex)
    rest, _, count = without_zero_eigenvalues(balanced, None, size)
    # ranks alone are no proof: far from normal, a matrix with poles of size one may be near to a singular one
    near = np.abs(poles) <= scatter_of(count, n, size)
    found = np.count_nonzero(near)
    if found > count:
        return np.concatenate([np.zeros(count, dtype=complex), np.linalg.eigvals(rest)])
    return np.where(near, 0.0, poles) if found == count else poles
