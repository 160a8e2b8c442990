"""Matrices of polynomials as values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.arrays import frozen
from residua.errors import ModelError


@dataclass(frozen=True, eq=False)
class PolynomialMatrix:
    r"""A matrix whose entries are polynomials in one variable, ``z`` or ``s``.

    .. math:: P(z) = P_0 + P_1 z + \dots + P_k z^k

    Attributes
    ----------
    coefficients : ndarray, shape (degree + 1, rows, columns)
        ``P_0, P_1, ...``: the lowest power first. High coefficients that are exactly zero are left out.

    Examples
    --------
    >>> from residua.linear import PolynomialMatrix
    >>> P = PolynomialMatrix.from_entries([[[1, -0.9], [2, -0.9]]])
    >>> P.evaluate([0.9])[0].tolist()
    [[0j, (0.9+0j)]]
    """

    coefficients: NDArray[np.float64]

    def __post_init__(self) -> None:
        C = np.asarray(self.coefficients, dtype=float)
        if C.ndim != 3 or not len(C):
            raise ModelError(f"coefficients must have the shape (degree + 1, rows, columns), got {C.shape}")
        if not np.isfinite(C).all():
            raise ModelError("the coefficients of a polynomial matrix must be finite numbers")
        last = len(C)
        while last > 1 and not np.any(C[last - 1]):
            last -= 1
        object.__setattr__(self, "coefficients", frozen(C[:last]))

    @classmethod
    def from_entries(cls, entries: Sequence[Sequence[ArrayLike]]) -> PolynomialMatrix:
        """Return the matrix of rows of polynomials, each with its highest power first, as in ``numpy.polyval``.

        Parameters
        ----------
        entries : sequence of sequence of array_like
            Numbers stand for constants.

        Returns
        -------
        PolynomialMatrix

        Raises
        ------
        ModelError
            If the rows differ in length or an entry is not a list of numbers.
        """
        rows = [[_polynomial(entry) for entry in row] for row in entries]
        widths = {len(row) for row in rows}
        if len(widths) > 1:
            raise ModelError(f"the rows of a polynomial matrix must be of one length, got {sorted(widths)}")
        width = widths.pop() if widths else 0
        length = max([len(entry) for row in rows for entry in row], default=1)
        C = np.zeros((length, len(rows), width))
        for i, row in enumerate(rows):
            for j, entry in enumerate(row):
                C[: len(entry), i, j] = entry[::-1]
        return cls(C)

    @classmethod
    def constant(cls, M: ArrayLike) -> PolynomialMatrix:
        """Return a matrix of numbers as a polynomial matrix of degree zero."""
        return cls(np.atleast_2d(np.asarray(M, dtype=float))[None])

    @property
    def degree(self) -> int:
        """The highest power with a coefficient that is not zero."""
        return len(self.coefficients) - 1

    @property
    def shape(self) -> tuple[int, int]:
        """Number of rows and columns."""
        return self.coefficients.shape[1], self.coefficients.shape[2]

    @property
    def row_degrees(self) -> tuple[int, ...]:
        """The degree of each row; 0 for a row of zeros."""
        present = np.any(self.coefficients != 0, axis=2)
        return tuple(int(np.max(np.flatnonzero(column), initial=0)) for column in present.T)

    def evaluate(self, points: ArrayLike) -> NDArray[np.complex128]:
        """Return the values at some points, shape (points, rows, columns)."""
        at = np.atleast_1d(np.asarray(points, dtype=complex))[:, None, None]
        value = np.zeros((len(at), *self.shape), dtype=complex)
        for C in self.coefficients[::-1]:
            value = value * at + C
        return value

    def select(
        self, rows: ArrayLike | slice = slice(None), columns: ArrayLike | slice = slice(None)
    ) -> PolynomialMatrix:
        """Return some of the rows and columns."""
        chosen = [x if isinstance(x, slice) else np.asarray(x, dtype=np.intp) for x in (rows, columns)]
        return PolynomialMatrix(self.coefficients[:, chosen[0]][:, :, chosen[1]])

    def scaled(self, variable: float) -> PolynomialMatrix:
        """Return the same matrix in another variable: ``P(variable * x)``."""
        powers = float(variable) ** np.arange(len(self.coefficients))
        return PolynomialMatrix(self.coefficients * powers[:, None, None])

    def beside(self, *others: PolynomialMatrix) -> PolynomialMatrix:
        """Return ``[P, others...]``."""
        parts = [self, *others]
        degree = max(part.degree for part in parts)
        return PolynomialMatrix(np.concatenate([part.padded(degree) for part in parts], axis=2))

    def above(self, *others: PolynomialMatrix) -> PolynomialMatrix:
        """Return ``[P; others...]``."""
        parts = [self, *others]
        degree = max(part.degree for part in parts)
        return PolynomialMatrix(np.concatenate([part.padded(degree) for part in parts], axis=1))

    def padded(self, degree: int) -> NDArray[np.float64]:
        """Return the coefficients up to a degree, with zeros for the others."""
        more = degree + 1 - len(self.coefficients)
        return np.concatenate([self.coefficients, np.zeros((max(more, 0), *self.shape))])

    def __matmul__(self, other: PolynomialMatrix) -> PolynomialMatrix:
        P, Q = self.coefficients, other.coefficients
        if self.shape[1] != other.shape[0]:
            raise ModelError(f"cannot multiply a {self.shape} by a {other.shape} polynomial matrix")
        product = np.zeros((len(P) + len(Q) - 1, self.shape[0], other.shape[1]))
        for i, C in enumerate(P):
            product[i : i + len(Q)] += C @ Q
        return PolynomialMatrix(product)

    def __add__(self, other: PolynomialMatrix) -> PolynomialMatrix:
        if self.shape != other.shape:
            raise ModelError(f"cannot add a {self.shape} to a {other.shape} polynomial matrix")
        degree = max(self.degree, other.degree)
        return PolynomialMatrix(self.padded(degree) + other.padded(degree))

    def __neg__(self) -> PolynomialMatrix:
        return PolynomialMatrix(-self.coefficients)

    def __sub__(self, other: PolynomialMatrix) -> PolynomialMatrix:
        return self + (-other)

    def __repr__(self) -> str:
        return f"PolynomialMatrix({self.shape[0]} x {self.shape[1]}, degree {self.degree})"


def _polynomial(entry: Any) -> NDArray[np.float64]:
    """Return the coefficients of one entry, highest power first, at least one."""
    try:
        values = np.atleast_1d(np.asarray(entry, dtype=float))
    except (TypeError, ValueError) as error:
        raise ModelError(
            f"an entry of a polynomial matrix must be a number or a list of coefficients: {error}"
        ) from error
    if values.ndim != 1:
        raise ModelError(f"an entry of a polynomial matrix must be a list of coefficients, got shape {values.shape}")
    return values if values.size else np.zeros(1)
