"""When zeros that rounding may have moved, lost or made are taken from rational numbers instead.

Numbers of few digits are exact, and what they give in rational numbers is the answer. Others may be rounded ones, which
make a structure less degenerate, never more: of them what is more degenerate than what was found is taken, and what
was found without zeros at which the pencil surely has full rank.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.linear.poles.deflation import Matrices, Matrix
from residua.linear.poles.rational_zeros import (
    MODULAR,
    RATIONAL,
    characteristic_polynomial,
    rational_roots,
    reduced,
)
from residua.linear.poles.zero_structure import scatter_of
from residua.linear.systems.units import matrix_units
from residua.tolerances import RESIDUE, above_rounding

#: Rank of the transfer matrix, and its zeros; none where they could not be computed.
Found = tuple[int, NDArray[np.complex128] | None]

#: Numbers of states and channels up to which it takes milliseconds.
SMALL = 24
#: A pencil whose last singular value is above this, relative to the largest, in even units, has full rank.
_FULL = 1e-8
#: Steps to the nearest zero, and how far it may be from where it was found, relative to its size.
_STEPS, _NEAR = 30, 0.25
#: Numbers of no more binary digits, of the 53 that they have, are exact.
_DIGITS = 32


def may_have_moved(zeros: NDArray[np.complex128] | None, n: int, scale: float) -> bool:
    """Tell whether zeros are not there, or so near to one another that rounding may have scattered one that they are.

    So many of a system with ``n`` states as are within the reach of the rounding of one of that multiplicity.
    """
    if zeros is None or not np.all(np.isfinite(zeros)):
        return True
    others = zeros[zeros != 0]
    if not others.size:
        return False
    reach = np.array([scatter_of(m, n, scale) for m in range(2, max(len(zeros), 2) + 1)])
    if np.abs(others).min() <= reach[0]:
        return True
    apart = np.sort(np.abs(others[:, None] - zeros), axis=1)[:, 1:]
    return bool(np.any(apart <= 2 * reach[: apart.shape[1]]))


def settled(M: Matrices, found: Found, *, unless_alike: bool = False) -> Found:
    """Return the zeros and the rank of a system in comparable units from rational numbers, or those found.

    Parameters
    ----------
    M : tuple of ndarray
    found : tuple
        What floating-point numbers gave.
    unless_alike : bool
        Whether to leave as many zeros as there are where they were found.
    """
    n, (rank, zeros) = len(M[0]), found
    if n + max(M[3].shape) > SMALL:
        return found
    structure = _structure(M)
    if unless_alike and zeros is not None and structure == (rank, len(zeros)):
        return found
    if not are_exact(*M) and (zeros is None or not _is_more_degenerate(structure, (rank, len(zeros)), M[3].shape)):
        if zeros is None or not np.all(np.isfinite(zeros)):
            return found
        left = zeros[~_refuted(M, rank, zeros)]
        return (rank, left) if structure == (rank, len(left)) else found
    exact = _exact_zeros(M, structure[1])
    return found if exact is None else (structure[0], exact)


def are_exact(*matrices: Matrix) -> bool:
    """Tell whether all numbers have so few digits that none of them was rounded."""
    whole = np.concatenate([np.frexp(M)[0].ravel() for M in matrices]) * 2.0**_DIGITS
    return bool(np.all(whole == np.rint(whole)))


def _exact_zeros(M: Matrices, count: int) -> NDArray[np.complex128] | None:
    """Return so many zeros of a system from rational numbers, if these are not too long and their roots are found."""
    if not count:
        return np.zeros(0, dtype=complex)
    polynomial = characteristic_polynomial(reduced(*M, RATIONAL).A)
    return None if polynomial is None else rational_roots(polynomial)


@dataclass(frozen=True, eq=False)
class HiddenPart:
    """What no output sees of a pair.

    Attributes
    ----------
    basis : ndarray, shape (n, hidden)
    modes : ndarray of complex, shape (hidden,), or None
        None where the numbers may be rounded, and the modes with them.
    """

    basis: Matrix
    modes: NDArray[np.complex128] | None


def settled_hidden_part(A: Matrix, C: Matrix, modes: NDArray[np.complex128]) -> HiddenPart | None:
    """Return the hidden part of a pair in comparable units from rational numbers, or nothing to go by that found.

    Parameters
    ----------
    A : ndarray, shape (n, n)
    C : ndarray, shape (p, n)
    modes : ndarray of complex
        The hidden modes that floating-point numbers gave.
    """
    count, exact = counted_hidden(A, C), are_exact(A, C)
    if count is None:
        return None
    M = _without_inputs(A, C)
    if not exact and count <= len(modes):
        fewer = count < len(modes) and count == np.count_nonzero(~_refuted(M, 0, modes))
        if not fewer:
            return None
    rows = reduced(*M, RATIONAL).basis if count else []
    basis = np.array([[float(x) for x in row] for row in rows]).reshape(len(A), count)
    return HiddenPart(basis, _exact_zeros(M, count) if exact else None)


def counted_hidden(A: Matrix, C: Matrix) -> int | None:
    """Return how many states no output sees, in rational numbers; nothing of a large pair."""
    return _structure(_without_inputs(A, C))[1] if len(A) + len(C) <= SMALL else None


def _without_inputs(A: Matrix, C: Matrix) -> Matrices:
    return A, np.zeros((len(A), 0)), C, np.zeros((len(C), 0))


def even_pencil_at(M: Matrices, dynamic: NDArray) -> tuple[NDArray, NDArray[np.float64], NDArray[np.float64]]:
    """Return the pencil of a system at a point, ``s E`` given, in units of its rows and columns that even it out."""
    A, B, C, D = M
    pencil = above_rounding(dynamic - A, np.abs(dynamic) + np.abs(A), RESIDUE)  # what cancels is not scaled up
    P = np.block([[pencil, -B], [C, D]])
    rows, columns = matrix_units(np.abs(P))
    return rows[:, None] * P * columns, rows, columns


def _refuted(M: Matrices, rank: int, zeros: NDArray[np.complex128]) -> NDArray[np.bool_]:
    """Tell at which zeros the pencil surely has its full rank, so that steps with rounding have made them."""
    return np.array([not _is_near_zero(M, len(M[0]) + rank, z) for z in zeros], dtype=bool)


def _is_near_zero(M: Matrices, full: int, found: complex) -> bool:
    """Tell whether the pencil has less than its full rank near a zero that was found, by Newton steps to where it has.

    Steps with rounding of the norm of all may have moved a zero of slow states far beyond the rounding of their rates.
    """
    n, z = len(M[0]), complex(found)
    for _ in range(_STEPS):
        P, rows, columns = even_pencil_at(M, z * np.eye(n))
        U, s, Vh = np.linalg.svd(P)
        if s[full - 1] <= _FULL * s[0]:
            return True
        slope = (U[:n, full - 1].conj() * rows[:n]) @ (columns[:n] * Vh[full - 1, :n].conj())
        if slope == 0:
            return False
        z -= complex(s[full - 1] / slope)
        if abs(z - found) > _NEAR * abs(found):
            return False
    return False


def _structure(M: Matrices) -> tuple[int, int]:
    """Return the normal rank and the number of zeros."""
    left = reduced(*M, MODULAR)
    return left.rank, len(left.A)


def _is_more_degenerate(exact: tuple[int, int], found: tuple[int, int], shape: tuple[int, int]) -> bool:
    """Tell whether rounding of the numbers could not have made what is there of what was found."""
    if exact[0] != found[0]:
        return exact[0] < found[0]
    # a square system has the more finite zeros the fewer are infinite; of others any is one too many
    return exact[1] < found[1] if shape == (exact[0], exact[0]) else exact[1] > found[1]
