"""Polynomial rows that annihilate a polynomial matrix, and polynomials without their common factor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from residua.errors import ModelError
from residua.linear.balancing import evened, without_residue
from residua.linear.polynomial_matrix import PolynomialMatrix
from residua.linear.rank import DEFAULT_RTOL, RankDecision, decide_rank, left_null_basis

#: A common factor is divided out when what is left of the division is below this fraction.
_DIVISION = 1e-9


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

    found from its singular values, in balanced units.

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
    return _null_vectors(W, decision, units, degree, variable)


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
    balanced, units = _balanced(P, variable)
    rows = P.shape[0]

    def exists(degree: int) -> bool:
        return decide_rank(_toeplitz(balanced, degree), rtol=rtol).rank < rows * (degree + 1)

    if rows == 0 or not exists(most):
        return None
    low, high = 0, most
    while low < high:
        middle = (low + high) // 2
        low, high = (low, middle) if exists(middle) else (middle + 1, high)
    W, decision = left_null_basis(_toeplitz(balanced, low), rtol=rtol)
    return _null_vectors(W, decision, units, low, variable)


def _null_vectors(
    W: NDArray[np.float64], decision: RankDecision, units: NDArray[np.float64], degree: int, variable: float
) -> NullVectors:
    """Return null vectors of the balanced Toeplitz matrix in the units of the polynomial matrix."""
    powers = variable ** -np.arange(degree + 1.0)
    vectors = W.T.reshape(W.shape[1], degree + 1, len(units))
    size = np.abs(vectors).max(axis=(1, 2), initial=0.0)
    vectors = np.where(np.abs(vectors) > 1e-15 * size[:, None, None], vectors, 0.0)
    return NullVectors(vectors * powers[:, None] * units, decision, units)


def _balanced(P: PolynomialMatrix, variable: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the coefficients with rows and columns of one size, without zero columns, and the factors of the rows."""
    C = P.scaled(variable).coefficients
    W = without_residue(np.sqrt((C**2).sum(axis=0)))
    rows, columns = evened(W, np.ones(W.shape[0]), np.ones(W.shape[1]), sweeps=4)
    C = C * rows[:, None] * columns
    return C[:, :, np.any(C != 0, axis=(0, 1))], rows


def _toeplitz(C: NDArray[np.float64], degree: int) -> NDArray[np.float64]:
    """Return the block Toeplitz matrix of a polynomial matrix for multipliers up to a degree."""
    length, rows, columns = C.shape
    T = np.zeros((degree + 1, rows, degree + length, columns))
    for i in range(degree + 1):
        T[i, :, i : i + length] = C.transpose(1, 0, 2)
    return T.reshape((degree + 1) * rows, (degree + length) * columns)


@dataclass(frozen=True, eq=False)
class PrimitivePart:
    """A polynomial matrix without the factor that all its entries share.

    Attributes
    ----------
    matrix : PolynomialMatrix
        What is left.
    factor : ndarray
        Coefficients of the common factor, monic, highest power first; ``[1]`` when there is none.
    roots : ndarray
        Its roots.
    error : float
        What the division leaves, relative to the largest coefficient of each entry.
    """

    matrix: PolynomialMatrix
    factor: NDArray[np.float64]
    roots: NDArray[np.complex128]
    error: float


def primitive_part(P: PolynomialMatrix, *, rtol: float = 1e-9, variable: float = 1.0) -> PrimitivePart:
    r"""Divide out the common factor of all entries of a polynomial matrix, :math:`P(z) = c(z) P_0(z)`.

    The degree of the factor is the dimension, less one, of the space of all :math:`Q` of the degree of ``P`` that are
    parallel to it, :math:`Q_i P_j = Q_j P_i`; the smallest such ``Q`` is what is left. Both are found from
    singular values, at points on the circle ``|z| = variable``. The division is undone when it does not come out.

    Parameters
    ----------
    P : PolynomialMatrix
        Not zero.
    rtol : float
        Singular values below this fraction of the largest count as zero.
    variable : float
        The size of the variable that matters.

    Returns
    -------
    PrimitivePart

    Raises
    ------
    ModelError
        If all entries are zero.

    Examples
    --------
    >>> from residua.linear import PolynomialMatrix, primitive_part
    >>> found = primitive_part(PolynomialMatrix.from_entries([[[1, -0.9, 0.2], [0.7, -0.35]]]))  # (z - 0.5) in both
    >>> found.roots.real.round(12).tolist(), found.matrix.degree
    ([0.5], 1)
    """
    C = P.scaled(variable).coefficients.reshape(P.degree + 1, -1)
    size = np.abs(C).max(axis=0, initial=0.0)
    used = np.flatnonzero(size)
    if not len(used):
        raise ModelError("a polynomial matrix of zeros has no primitive part")
    V = C[:, used] / size[used]
    whole = PrimitivePart(P, np.ones(1), np.zeros(0, dtype=complex), 0.0)
    if P.degree == 0:
        return whole
    most = _parallel(V, P.degree, rtol).shape[1] - 1
    for common in range(most, 0, -1):
        Q = _parallel(V, P.degree - common, rtol)
        if Q.shape[1] == 0:
            continue
        left = Q[:, -1].reshape(P.degree - common + 1, len(used))
        c, error = _quotient(V, left)
        if error < _DIVISION:
            return _divided(P, left * size[used], c, used, variable, error)
    return whole


def _divided(
    P: PolynomialMatrix,
    left: NDArray[np.float64],
    c: NDArray[np.float64],
    used: NDArray[np.intp],
    variable: float,
    error: float,
) -> PrimitivePart:
    """Return the result in the variable of ``P``, with a monic factor."""
    powers = variable ** np.arange(len(c), dtype=float)
    c = c / powers  # coefficients in z, lowest first
    lead = c[-1]
    out = np.zeros((len(left), P.shape[0] * P.shape[1]))
    out[:, used] = left * lead / (variable ** np.arange(len(left), dtype=float))[:, None]
    factor = (c / lead)[::-1]
    return PrimitivePart(
        PolynomialMatrix(out.reshape(len(left), *P.shape)), factor, np.roots(factor).astype(complex), error
    )


def _parallel(V: NDArray[np.float64], degree: int, rtol: float) -> NDArray[np.float64]:
    """Return a basis, as columns, of the polynomial vectors of a degree that are multiples of ``V`` everywhere."""
    width = V.shape[1]
    count = len(V) + degree + 1
    points = np.exp(2j * np.pi * (np.arange(count) + 0.25) / count)
    powers = points[:, None] ** np.arange(max(len(V), degree + 1))
    values = powers[:, : len(V)] @ V
    values = values / np.maximum(np.linalg.norm(values, axis=1, keepdims=True), 1e-300)
    blocks = []
    for v, power in zip(values, powers[:, : degree + 1], strict=True):
        off = np.eye(width) - np.outer(v, v.conj())  # annihilates what is parallel to v, from the left
        blocks.append(np.kron(power[None, :], off))
    M = np.vstack(blocks)
    M = np.vstack([M.real, M.imag])
    triangle = scipy.linalg.qr(M, mode="r", check_finite=False)[0][: M.shape[1]]
    _, s, Vh = np.linalg.svd(triangle)
    return Vh[int(np.count_nonzero(s > rtol * s[0])) :].T


def _quotient(V: NDArray[np.float64], left: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Return ``c`` with ``V = c left`` by least squares, and how far it misses."""
    length = len(V) - len(left) + 1
    columns = []
    for shift in range(length):
        column = np.zeros_like(V)
        column[shift : shift + len(left)] = left
        columns.append(column.ravel())
    M = np.array(columns).T
    c = np.linalg.lstsq(M, V.ravel(), rcond=None)[0]
    return c, float(np.abs(M @ c - V.ravel()).max())
