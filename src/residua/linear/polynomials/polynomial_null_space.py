"""Polynomial rows that annihilate a polynomial matrix."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.linear.polynomials.polynomial_matrix import PolynomialMatrix
from residua.linear.subspaces.rank import DEFAULT_RTOL, RankDecision, decide_rank, left_null_basis
from residua.linear.systems.scaling import even_units
from residua.tolerances import RESIDUE, above_rounding


@dataclass(frozen=True, eq=False)
class NullVectors:
    """Polynomial rows ``x(z)`` with ``x P = 0``.

    Attributes
    ----------
    vectors : ndarray, shape (count, degree + 1, rows of P)
        Lowest power first; orthonormal in balanced units of the rows.
    decision : RankDecision
        The rank of the block Toeplitz matrix that they annihilate.
    units : ndarray, shape (rows of P,)
        ``vectors / units`` is orthonormal when the variable is not scaled.
    """

    vectors: NDArray[np.float64]
    decision: RankDecision
    units: NDArray[np.float64]

    @property
    def degree(self) -> int:
        """The highest power."""
        return self.vectors.shape[1] - 1


def left_null_vectors(
    P: PolynomialMatrix, degree: int, *, rtol: float = DEFAULT_RTOL, variable: float = 1.0
) -> NullVectors:
    r"""Return all polynomial rows ``x(z)`` of at most a degree with ``x(z) P(z) = 0``.

    With :math:`x = \sum_i x_i z^i` and :math:`P = \sum_i P_i z^i` these are the left null vectors of the block
    Toeplitz matrix

    .. math::

       [x_0 \; \dots \; x_k]
       \begin{bmatrix} P_0 & \dots & P_d \\ & \ddots & & \ddots \\ & & P_0 & \dots & P_d \end{bmatrix} = 0,

    computed from its singular values, in balanced units.

    Parameters
    ----------
    P : PolynomialMatrix
    degree : int
    rtol : float
        Singular values below this fraction of the largest count as zero.
    variable : float
        The size at which powers of the variable are compared: the balanced matrix is that of ``z / variable``.

    Returns
    -------
    NullVectors

    Examples
    --------
    >>> from residua.linear import PolynomialMatrix, left_null_vectors
    >>> P = PolynomialMatrix.from_entries([[[2, -0.9]], [[1, -0.9]]])  # 2 z - 0.9 above z - 0.9
    >>> left_null_vectors(P, 0).vectors.shape, left_null_vectors(P, 1).vectors.shape
    ((0, 1, 2), (1, 2, 2))
    """
    balanced, units = _balanced(P, variable)
    W, decision = left_null_basis(_toeplitz(balanced, degree), rtol=rtol)
    vectors = W.T.reshape(W.shape[1], degree + 1, len(units))
    size = np.abs(vectors).max(axis=(1, 2), keepdims=True, initial=0.0)
    powers = variable ** -np.arange(degree + 1.0)
    return NullVectors(above_rounding(vectors, size, RESIDUE) * powers[:, None] * units, decision, units)


def shortest_left_null_vectors(
    P: PolynomialMatrix, *, most: int, rtol: float = DEFAULT_RTOL, variable: float = 1.0
) -> NullVectors | None:
    """Return the polynomial rows of the smallest degree that annihilate a polynomial matrix.

    Parameters
    ----------
    P : PolynomialMatrix
    most : int
        The highest degree to look at.
    rtol, variable : float
        As for :func:`left_null_vectors`.

    Returns
    -------
    NullVectors or None
        ``None`` when there is none up to that degree.
    """
    balanced, rows = _balanced(P, variable)[0], P.shape[0]

    def exists(degree: int) -> bool:
        return decide_rank(_toeplitz(balanced, degree), rtol=rtol).rank < rows * (degree + 1)

    if rows == 0 or not exists(most):
        return None
    shortest = bisect_left(range(most + 1), True, key=exists)
    return left_null_vectors(P, shortest, rtol=rtol, variable=variable)


def _balanced(P: PolynomialMatrix, variable: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the coefficients with rows and columns of one size, without zero columns, and the factors of the rows."""
    C = P.scaled(variable).coefficients
    rows, columns = even_units(np.sqrt((C**2).sum(axis=0)))
    C = C * rows[:, None] * columns
    return C[:, :, np.any(C != 0, axis=(0, 1))], rows


def _toeplitz(C: NDArray[np.float64], degree: int) -> NDArray[np.float64]:
    """Return the block Toeplitz matrix of a polynomial matrix for multipliers up to a degree."""
    length, rows, columns = C.shape
    T = np.zeros((degree + 1, rows, degree + length, columns))
    for i in range(degree + 1):
        T[i, :, i : i + length] = C.transpose(1, 0, 2)
    return T.reshape((degree + 1) * rows, (degree + length) * columns)
