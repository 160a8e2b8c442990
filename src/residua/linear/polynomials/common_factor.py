"""The factor that polynomials share, and the polynomials without it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from residua.errors import ModelError
from residua.linear.polynomials.polynomial_basis import PolynomialBasis
from residua.linear.polynomials.polynomial_matrix import PolynomialMatrix
from residua.tolerances import TINY

#: A common factor is divided out when what is left of the division is below this fraction.
_DIVISION = 1e-9


@dataclass(frozen=True, eq=False)
class PrimitivePart:
    """A polynomial matrix without the factor that all its entries share.

    Attributes
    ----------
    matrix : PolynomialMatrix
        The matrix without the factor.
    factor : ndarray
        Coefficients of the common factor, monic, highest power first; ``[1]`` when there is none.
    roots : ndarray
        Its roots.
    error : float
        What the division leaves, relative to the size of each entry.
    """

    matrix: PolynomialMatrix
    factor: NDArray[np.float64]
    roots: NDArray[np.complex128]
    error: float


def primitive_part(P: PolynomialMatrix, *, rtol: float = 1e-9, variable: float = 1.0) -> PrimitivePart:
    r"""Divide out the common factor of all entries of a polynomial matrix, :math:`P(z) = c(z) P_0(z)`.

    The degree of the factor is the dimension, less one, of the space of all :math:`Q` of the degree of ``P`` that are
    parallel to it, :math:`Q_i P_j = Q_j P_i`; the smallest such ``Q`` is what is left. Both come from
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
    >>> primitive = primitive_part(PolynomialMatrix.from_entries([[[1, -0.9, 0.2], [0.7, -0.35]]]))  # (z - 0.5) in both
    >>> primitive.roots.real.round(12).tolist(), primitive.matrix.degree
    ([0.5], 1)
    """
    basis = PolynomialBasis.powers(P.degree + 1, variable)
    powers = variable ** np.arange(P.degree + 1.0)[:, None]
    flat = P.coefficients.reshape(P.degree + 1, -1) * powers
    left, roots, error = without_common_factor(flat, basis, rtol=rtol)
    matrix = PolynomialMatrix((left / powers[: len(left)]).reshape(len(left), *P.shape))
    factor = np.asarray(np.atleast_1d(np.poly(roots)).real, dtype=float)
    return PrimitivePart(matrix, factor, roots, error)


def without_common_factor(
    x: NDArray[np.float64], basis: PolynomialBasis, *, rtol: float = 1e-9
) -> tuple[NDArray[np.float64], NDArray[np.complex128], float]:
    """Return polynomials in a basis divided by their monic common factor, its roots, and what the division leaves.

    Parameters
    ----------
    x : ndarray, shape (degree + 1, polynomials)
        Coefficients.
    basis : PolynomialBasis
    rtol : float
        Singular values below this fraction of the largest count as zero.

    Raises
    ------
    ModelError
        If all are zero.
    """
    sizes = np.abs(x).max(axis=0, initial=0.0)
    present = np.abs(x / np.where(sizes > 0, sizes, 1.0)).max(axis=1, initial=0.0) > 1e-13
    k = int(np.max(np.flatnonzero(present), initial=0))
    x = x[: k + 1]  # a degree that is not there would count as a factor with its root at infinity
    points = _circle(basis, k)
    values = basis.values(points, k)
    size = np.abs(values @ x).max(axis=0)
    used = np.flatnonzero(size)
    if not len(used):
        raise ModelError("polynomials that are all zero have no common factor")
    V = (values @ x)[:, used] / size[used]
    none = np.zeros(0, dtype=np.complex128)
    if k == 0:
        return x, none, 0.0
    most = _parallel(V, values, rtol).shape[1] - 1
    for common in range(most, 0, -1):
        degree = k - common
        Q = _parallel(V, values[:, : degree + 1], rtol)
        if Q.shape[1] == 0:
            continue
        q = Q[:, -1].reshape(degree + 1, len(used))
        W = values[:, : degree + 1] @ q
        roots, scale, error = _factor(V, W, points, common)
        if error < _DIVISION:
            left = np.zeros((degree + 1, x.shape[1]))
            left[:, used] = q * size[used] * scale
            return left, roots, error
    return x, none, 0.0


def _circle(basis: PolynomialBasis, degree: int) -> NDArray[np.complex128]:
    """Return points around the nodes, off the real axis."""
    real, imaginary = basis.real[:degree], basis.imaginary[:degree]
    center = float(real.mean()) if len(real) else 0.0
    radius = float(np.max(np.hypot(real - center, imaginary), initial=0.0))
    radius = 1.5 * max(radius, float(np.median(basis.sizes[:degree])) if degree else 1.0)
    count = 2 * degree + 2
    circle = np.exp(2j * np.pi * (np.arange(count) + 0.25) / count).astype(np.complex128)
    return np.complex128(center) + radius * circle


def _parallel(V: NDArray[np.complex128], values: NDArray[np.complex128], rtol: float) -> NDArray[np.float64]:
    """Return a basis, as columns, of the polynomial vectors of a degree that are multiples of ``V`` everywhere."""
    width = V.shape[1]
    unit = V / np.maximum(np.linalg.norm(V, axis=1, keepdims=True), TINY)
    level = np.maximum(np.abs(values).max(axis=0), TINY)
    blocks = []
    for v, elements in zip(unit, values / level, strict=True):
        off = np.eye(width) - np.outer(v, v.conj())  # annihilates what is parallel to v, from the left
        blocks.append(np.kron(elements[None, :], off))
    M = np.asarray(np.vstack(blocks), dtype=np.complex128)
    M = np.vstack([M.real, M.imag])
    triangle = scipy.linalg.qr(M, mode="r", check_finite=False)[0][: M.shape[1]]
    _, s, Vh = np.linalg.svd(triangle)
    return Vh[int(np.count_nonzero(s > rtol * s[0])) :].T / np.repeat(level, width)[:, None]


def _factor(
    V: NDArray[np.complex128], W: NDArray[np.complex128], points: NDArray[np.complex128], degree: int
) -> tuple[NDArray[np.complex128], float, float]:
    """Return the roots of ``c`` and its leading coefficient with ``V = c W``, and how far it misses."""
    center = float(points.mean().real)
    radius = float(np.abs(points - center).max())
    at = ((points - center) / radius)[:, None] ** np.arange(degree + 1)
    c = (W.conj() * V).sum(axis=1) / np.maximum((np.abs(W) ** 2).sum(axis=1), TINY)
    whole = np.vstack([at.real, at.imag])
    fitted = np.asarray(np.linalg.lstsq(whole, np.concatenate([c.real, c.imag]), rcond=None)[0], dtype=float)
    error = float(np.abs(V - (at @ fitted)[:, None] * W).max())
    roots: NDArray[np.complex128] = np.roots(fitted[::-1]).astype(np.complex128) * radius
    return roots + np.complex128(center), float(fitted[-1] / radius**degree), error
