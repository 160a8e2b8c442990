"""Polynomial rows that annihilate a pencil, in a basis that suits its poles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from residua.linear.polynomials.banded_null_space import BlockBand, FactoredBand, least_squares
from residua.linear.polynomials.degree_search import at_smallest_degree
from residua.linear.polynomials.polynomial_basis import PolynomialBasis
from residua.linear.subspaces.parts import row_parts
from residua.linear.subspaces.rank import RankDecision, decide_rank, left_null_basis
from residua.linear.systems.array_cache import Latest, cached_by_contents, entries
from residua.linear.systems.balancing import evened
from residua.tolerances import RESIDUE, above_rounding

#: Singular values below this fraction of the largest count as zero. No rounding accumulates before the singular values
#: are taken, and what is zero comes out near 1e-16: a larger one would take a nearly exact relation for an exact one.
PENCIL_RTOL = 1e-13
#: Rows of stacked pencils up to which all singular values are computed; above, only the smallest, at a thousandth of
#: the time from a few thousand rows on.
_DENSE = 300


@dataclass(frozen=True, eq=False)
class Pencil:
    """``P0 + z P1``, with the basis in which polynomials that multiply it from the left are written.

    Attributes
    ----------
    P0, P1 : ndarray, shape (rows, columns)
    basis : PolynomialBasis
        With one node more than the highest degree that is asked for.
    rows, columns : ndarray
        Units in which the entries are of one size.
    """

    P0: NDArray[np.float64]
    P1: NDArray[np.float64]
    basis: PolynomialBasis
    rows: NDArray[np.float64]
    columns: NDArray[np.float64]

    def products(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the coefficients of ``x(z) (P0 + z P1)`` for coefficients of shape (degree + 1, rows)."""
        out = self.basis.times_variable(x) @ self.P1
        out[:-1] += x @ self.P0
        return out


@dataclass(frozen=True, eq=False)
class PencilNullVectors:
    """Polynomial rows ``x(z)`` with ``x (P0 + z P1) = 0``.

    Attributes
    ----------
    vectors : ndarray, shape (count, degree + 1, rows)
        Coefficients in the basis of the pencil.
    decision : RankDecision
        The rank of the block matrix that they annihilate; of a large one with its largest singular value and its
        smallest ones.
    units : ndarray, shape (degree + 1, rows)
        ``vectors / units`` is orthonormal.
    """

    vectors: NDArray[np.float64]
    decision: RankDecision
    units: NDArray[np.float64]

    @property
    def degree(self) -> int:
        """The highest degree."""
        return self.vectors.shape[1] - 1


def pencil(
    P0: NDArray[np.float64], P1: NDArray[np.float64], basis: PolynomialBasis, *, canonical: bool = False
) -> Pencil:
    """Return a pencil with units in which its entries are of one size; ``canonical``: they are nearly so already."""
    W, moving = np.abs(P0), np.nonzero(P1)  # most entries are the same for all elements of the basis
    static, moved = P0[moving], np.abs(P1[moving])
    if basis.count:
        spread = np.abs(static + np.multiply.outer(basis.real, P1[moving])) + np.multiply.outer(basis.sizes, moved)
        W[moving] = np.sqrt((spread**2).mean(axis=0))
    else:
        W[moving] += moved
    rows, columns = evened(W, np.ones(W.shape[0]), np.ones(W.shape[1])) if canonical else evened(W)
    return Pencil(P0, P1, basis, rows, columns)


@cached_by_contents
def pencil_null_vectors(problem: Pencil, degree: int, *, rtol: float = PENCIL_RTOL) -> PencilNullVectors:
    r"""Return all polynomial rows ``x(z)`` of at most a degree with ``x(z) (P_0 + z P_1) = 0``.

    With coefficients in Newton's basis, :math:`z N_j = \rho_j N_{j+1} + a_j N_j - \beta_j N_{j-1}`, the coefficient of
    :math:`N_j` in the product is

    .. math:: \rho_{j-1} x_{j-1} P_1 + x_j (P_0 + a_j P_1) - \beta_{j+1} x_{j+1} P_1 = 0,

    a block bidiagonal (with pairs of nodes: tridiagonal) system whose left null space follows from its singular
    values. Nodes at the poles keep its blocks from being alike, which powers of ``z`` do not.

    Parameters
    ----------
    problem : Pencil
    degree : int
    rtol : float
        Singular values below this fraction of the largest count as zero, in balanced units.

    Returns
    -------
    PencilNullVectors
        Orthonormal in balanced units.
    """
    band, units = _block_band(problem, degree)
    W, decision = _left_null_basis(band, problem, rtol)
    vectors = W.T.reshape(W.shape[1], degree + 1, len(problem.rows))
    size = np.abs(vectors).max(axis=(1, 2), initial=0.0)
    vectors = above_rounding(vectors, size[:, None, None], RESIDUE)
    return PencilNullVectors(vectors * units, decision, units)


def _left_null_basis(band: BlockBand, problem: Pencil, rtol: float) -> tuple[NDArray, RankDecision]:
    """Return the left null space of the stacked pencil, part by part where nothing connects the rows of the pencil."""
    parts = row_parts((problem.P0 != 0) | (problem.P1 != 0))
    degree, count = len(band.blocks) - 1, len(problem.rows)
    if _is_large(band):
        scale, found = band.largest(), []
        for part in parts:
            one = band.of_rows(part)
            nothing = np.eye(one.rows), np.zeros(one.rows)  # of rows that are zero
            found.append(FactoredBand.of(one, scale).left_null_basis(rtol) if one.blocks.size else nothing)
        W = _side_by_side([basis for basis, _ in found], parts, degree, count)
        return W, _decision_of_smallest([values for _, values in found], scale, rtol, band.rows)
    T = band.dense()
    if len(parts) < 2:
        return left_null_basis(T, rtol=rtol)
    whole = decide_rank(T, rtol=rtol)
    scale = float(whole.singular_values.max(initial=0.0))
    bases = []
    for part in parts:
        rows = (np.arange(degree + 1)[:, None] * count + part).ravel()
        bases.append(left_null_basis(T[rows][:, np.any(T[rows], axis=0)], rtol=rtol, scale=scale)[0])
    W = _side_by_side(bases, parts, degree, count)
    return (W, whole) if W.shape[1] == len(T) - whole.rank else left_null_basis(T, rtol=rtol)


def _decision_of_smallest(parts: list[NDArray], scale: float, rtol: float, rows: int) -> RankDecision:
    """Return the rank of a matrix of some rows of which the largest and the smallest singular values are known."""
    s = np.sort(np.concatenate(parts))[::-1]
    rank = rows - int(np.count_nonzero(s <= rtol * scale))
    if len(s) < rows:
        s = np.concatenate([[scale], s])
    return RankDecision(rank, s, rtol * scale, rank - int(np.count_nonzero(s > rtol * scale)))


def _side_by_side(bases: list[NDArray], parts: list[NDArray[np.int_]], degree: int, count: int) -> NDArray:
    """Return bases of parts of the rows of a pencil, as columns, as those of all of its ``count`` rows."""
    wholes = []
    for basis, part in zip(bases, parts, strict=True):
        whole = np.zeros((degree + 1, count, basis.shape[1]))
        whole[:, part] = basis.reshape(degree + 1, len(part), basis.shape[1])
        wholes.append(whole.reshape((degree + 1) * count, basis.shape[1]))
    return np.hstack(wholes)


def _is_large(band: BlockBand) -> bool:
    """Tell whether all singular values would take too long."""
    return band.rows > _DENSE and bool(band.blocks.any())


def _exists(problem: Pencil, degree: int, rtol: float) -> bool:
    """Tell whether a pencil has null vectors of at most a degree, in the units in which they are computed then."""
    band = _block_band(problem, degree)[0]
    if not _is_large(band):
        return decide_rank(band.dense(), rtol=rtol).rank < band.rows
    scale, bands = band.largest(), [band.of_rows(part) for part in row_parts((problem.P0 != 0) | (problem.P1 != 0))]
    return any(not one.blocks.size or FactoredBand.of(one, scale).is_singular(rtol) for one in bands)


def _certain_degree(problem: Pencil) -> int | None:
    """Return the smallest degree at which there are more coefficients than equations for them; ``None`` if never.

    Of a pencil without structure it is the smallest at which there are null vectors.
    """
    dynamic = int(np.count_nonzero(np.any(problem.P1 != 0, axis=0)))
    every = int(np.count_nonzero(np.any((problem.P0 != 0) | (problem.P1 != 0), axis=0)))
    spare = len(problem.P0) - every
    return dynamic // spare if spare > 0 else None


@cached_by_contents
def shortest_pencil_null_vectors(problem: Pencil, *, most: int, rtol: float = PENCIL_RTOL) -> PencilNullVectors | None:
    """Return the polynomial rows of the smallest degree that annihilate a pencil; ``None`` when none is up to ``most``.

    Parameters
    ----------
    problem : Pencil
    most : int
    rtol : float
    """
    if not len(problem.P0):
        return None

    def exists(degree: int) -> bool:
        return _exists(problem, degree, rtol)

    certain = _certain_degree(problem)
    if certain is not None and certain <= most and not (certain and exists(certain - 1)):
        smallest = certain
    else:
        low, high = 0, 0  # upwards first: short ones cost little to find, and there often are some
        while not exists(high):
            if high == most:
                return None
            low, high = high + 1, min(max(2 * high, 1), most)
        smallest = at_smallest_degree(lambda degree: degree if exists(degree) else None, low, high, high)
    found = pencil_null_vectors(problem, smallest, rtol=rtol)
    while not len(found.vectors) and found.degree < most:  # at the edge of the tolerance
        found = pencil_null_vectors(problem, found.degree + 1, rtol=rtol)
    return found if len(found.vectors) else None


def refined(problem: Pencil, x: NDArray[np.float64], *, rtol: float = PENCIL_RTOL) -> NDArray[np.float64]:
    """Return the null vector nearest to one that rounding, such as that of a change of basis, has moved.

    Of several of one degree, along the first axis, those nearest to each: one factorisation serves all.
    """
    if x.ndim == 2:
        return refined(problem, x[None], rtol=rtol)[0]
    band, units = _block_band(problem, x.shape[1] - 1)
    scaled = (x / units).reshape(len(x), -1)
    if _is_large(band):
        return (scaled - _moved(band, scaled, problem, rtol)).reshape(x.shape) * units
    T = band.dense()
    U, s, Vh = np.linalg.svd(T, full_matrices=False)
    keep = s > rtol * s[0] if len(s) else s > 0
    scaled = scaled - ((scaled @ T) @ Vh[keep].T / s[keep]) @ U[:, keep].T
    return scaled.reshape(x.shape) * units


def _moved(band: BlockBand, x: NDArray[np.float64], problem: Pencil, rtol: float) -> NDArray[np.float64]:
    """Return how far each of some vectors, shape (vectors, rows), is from a null vector of a large band.

    The correction is as small as what it mends, so that entries far below the largest keep their digits, which those
    of the computed null vectors do not have. The largest entries of these stay as they are.
    """
    basis = problem.basis
    key = entries(problem.P0, problem.P1, problem.rows, problem.columns, basis.real, basis.imaginary, basis.sizes)
    W = _bases.of((key, len(band.blocks), rtol), lambda: _left_null_basis(band, problem, rtol)[0])
    kept = scipy.linalg.qr(W.T, mode="r", pivoting=True)[1][: W.shape[1]]
    left = band.times(x.reshape(len(x), len(band.blocks), -1))
    moved = least_squares(band.without(kept), np.moveaxis(left, 0, -1), band.largest())
    return np.moveaxis(moved, -1, 0).reshape(x.shape)


_bases: Latest[NDArray[np.float64]] = Latest()


def _block_band(problem: Pencil, degree: int) -> tuple[BlockBand, NDArray[np.float64]]:
    """Return the matrix that the stacked coefficients of null vectors annihilate, and its balanced units.

    Units of one size for all degrees would not do: where poles lie far apart, so do the sizes of the elements.
    """
    P0 = problem.rows[:, None] * problem.P0 * problem.columns
    P1 = problem.rows[:, None] * problem.P1 * problem.columns
    used = np.any(P0 != 0, axis=0) | np.any(P1 != 0, axis=0)
    P0, P1 = P0[:, used], P1[:, used]
    basis, links = problem.basis, problem.basis.links
    S = np.zeros((degree + 1, len(P0), 3, P0.shape[1]))
    for j in range(degree + 1):
        S[j, :, 1] = P0 + basis.real[j] * P1
        S[j, :, 2] = basis.sizes[j] * P1
        if links[j]:
            S[j, :, 0] = -links[j] * P1
    band = BlockBand(S)
    left, right = band.evened()  # the blocks are in even units
    return band.scaled(left, right), left * problem.rows
