"""The smallest singular values of a large block matrix with three block diagonals, without a dense decomposition."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from residua.linear.subspaces.rank import check_rtol, without_noise
from residua.linear.systems.balancing import power_of_two
from residua.progress import check_time
from residua.tolerances import RESIDUE

#: What keeps the triangular factor from being singular, beside the largest singular value: a few roundings.
_SHIFT = 4 * float(np.finfo(float).eps)
#: Vectors that are iterated at first, beyond those that are annihilated, ...
_MORE = 6
#: ... and steps: each takes what is far above the tolerance down by the square of its distance.
_STEPS = 12
#: A singular value is known well enough when a step moves it by less than this fraction.
_NEARLY = 0.01
#: Cubes of its rows for which a dense decomposition takes a second, at least.
_CUBES = 2e9


@dataclass(frozen=True, eq=False)
class BlockBand:
    """A matrix of ``count`` by ``count + 1`` blocks, in rows of three: before, on and after the diagonal.

    Attributes
    ----------
    blocks : ndarray, shape (count, rows, 3, columns)
        ``blocks[j, :, i]`` stands in block row ``j`` and block column ``j + i - 1``.
    """

    blocks: NDArray[np.float64]

    @property
    def rows(self) -> int:
        """The number of rows of the whole matrix."""
        return self.blocks.shape[0] * self.blocks.shape[1]

    def scaled(self, left: NDArray[np.float64], right: NDArray[np.float64]) -> BlockBand:
        """Return the matrix with its rows and columns multiplied, shapes (count, rows) and (count + 1, columns)."""
        return BlockBand(left[:, :, None, None] * self.blocks * self._at_blocks(right)[:, None])

    def _at_blocks(self, of_columns: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return what belongs to block columns where their blocks are, shape (count, 3, columns)."""
        count = len(self.blocks)
        out = np.zeros((count, 3, *of_columns.shape[1:]))
        out[1:, 0], out[:, 1], out[:, 2] = of_columns[: count - 1], of_columns[:count], of_columns[1:]
        return out

    def _over_columns(self, of_blocks: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the sums over block columns of what belongs to their blocks, shape (count, 3, ...)."""
        count = len(self.blocks)
        out = np.zeros((count + 1, *of_blocks.shape[2:]))
        out[1:] += of_blocks[:, 2]
        out[:count] += of_blocks[:, 1]
        out[: count - 1] += of_blocks[1:, 0]
        return out

    def evened(self, *, sweeps: int = 4) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return powers of two that even out the norms of rows and columns, as for a dense matrix in even units."""
        W = np.abs(self.blocks)
        of_rows, count = W.max(axis=(2, 3), initial=0.0), len(W)
        of_columns = np.zeros((count + 1, W.shape[3]))
        for i, where in ((2, slice(1, None)), (1, slice(count)), (0, slice(count - 1))):
            part = W[1:, :, 0] if i == 0 else W[:, :, i]
            of_columns[where] = np.maximum(of_columns[where], part.max(axis=1, initial=0.0))
        floor = RESIDUE * np.minimum(of_rows[:, :, None, None], self._at_blocks(of_columns)[:, None])
        squares = BlockBand(np.where(floor < W, W, 0.0) ** 2)
        left, right = np.ones(of_rows.shape), np.ones(of_columns.shape)
        for _ in range(sweeps):
            row_sizes = power_of_two(np.sqrt(squares.scaled(left**2, right**2).blocks.sum(axis=(2, 3))))
            left = left / row_sizes
            scaled = squares.scaled(left**2, right**2)
            column_sizes = power_of_two(np.sqrt(scaled._over_columns(scaled.blocks.sum(axis=1))))
            right = right / column_sizes
            if (row_sizes == 1.0).all() and (column_sizes == 1.0).all():
                break  # nor does another sweep change anything
        return left, right

    def dense(self) -> NDArray[np.float64]:
        """Return the whole matrix."""
        count, rows, _, columns = self.blocks.shape
        T = np.zeros((count, rows, count + 1, columns))
        for j in range(count):
            for i in range(0 if j else 1, 3):
                T[j, :, j + i - 1] = self.blocks[j, :, i]
        return T.reshape(count * rows, (count + 1) * columns)

    def without(self, rows: NDArray[np.int_]) -> BlockBand:
        """Return the matrix with some of its rows, counted from the first to the last, set to zero."""
        blocks = self.blocks.copy()
        blocks[tuple(np.divmod(rows, blocks.shape[1]))] = 0.0
        return BlockBand(blocks)

    def of_rows(self, chosen: NDArray[np.int_]) -> BlockBand:
        """Return the same rows of each block row, without the columns that have no entry there."""
        part = self.blocks[:, chosen]
        return BlockBand(part[:, :, :, np.any(part != 0, axis=(0, 1, 2))])

    def times(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the products of the transpose with vectors, shape (vectors, count, rows)."""
        count, rows, _, columns = self.blocks.shape
        parts = x.transpose(1, 0, 2) @ self.blocks.reshape(count, rows, -1)  # (count, vectors, 3 columns)
        return np.moveaxis(self._over_columns(np.moveaxis(parts.reshape(count, len(x), 3, columns), 2, 1)), 1, 0)

    def largest(self) -> float:
        """Return the largest singular value, to some percent, by iteration with the square."""
        count, rows = self.blocks.shape[:2]
        x = np.random.default_rng(4).standard_normal((2, count, rows))
        size = 0.0
        for _ in range(40):
            x = np.linalg.qr(x.reshape(len(x), -1).T)[0].T.reshape(-1, count, rows)
            y = self.times(x)
            before, size = size, float(np.linalg.norm(y.reshape(len(y), -1), 2))
            at = self._at_blocks(np.moveaxis(y, 0, -1)).reshape(count, -1, len(y))  # (count, 3 columns, vectors)
            x = np.moveaxis(self.blocks.reshape(count, rows, -1) @ at, 2, 0)
            if abs(size - before) <= _NEARLY * size:
                break
        return size


@dataclass(frozen=True, eq=False)
class FactoredBand:
    """A band with the triangular factor of its transpose.

    Attributes
    ----------
    band : BlockBand
    scale : float
        What tolerances are relative to.
    """

    band: BlockBand
    scale: float
    _factor: _Factor

    @classmethod
    def of(cls, band: BlockBand, scale: float) -> FactoredBand:
        """Return a band with its factor."""
        return cls(band, scale, _Factor.of(band, _SHIFT * scale))

    def is_singular(self, rtol: float) -> bool:
        """Tell whether a singular value counts as zero."""
        return bool(self._iterated(min(2, self.band.rows), rtol * self.scale)[1][-1] <= rtol * self.scale)

    def left_null_basis(self, rtol: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the vectors that the band annihilates from the left, as columns, and the smallest singular values.

        By inverse iteration. These hold all that count as zero, and one at least that does not, if there is one.

        Parameters
        ----------
        rtol : float
            Singular values at or below ``rtol * scale`` count as zero.
        """
        check_rtol(rtol)
        total, tolerance = self.band.rows, rtol * self.scale
        wanted = min(_MORE, total)
        while True:
            X, s = self._iterated(wanted, tolerance)
            dropped = int(np.count_nonzero(s <= tolerance))
            if dropped < wanted or wanted == total:
                break
            wanted = min(2 * wanted + _MORE, total)
        return without_noise(X[wanted - dropped :].reshape(dropped, total).T), s

    def _iterated(self, wanted: int, tolerance: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return orthonormal approximations of the last left singular vectors, and their values, largest first."""
        count, rows = self.band.blocks.shape[:2]
        X = np.random.default_rng(7).standard_normal((count, rows, wanted))
        s = np.full(wanted, np.inf)
        for step in range(_STEPS):
            X = self._factor.inverse_of_square(X)
            Q = np.linalg.qr(X.reshape(count * rows, wanted))[0]
            product = self.band.times(Q.T.reshape(wanted, count, rows)).reshape(wanted, -1)
            U, now, _ = np.linalg.svd(product, full_matrices=wanted > product.shape[1])
            now = np.concatenate([now, np.zeros(wanted - len(now))])  # fewer columns than vectors
            X = (Q @ U).reshape(count, rows, wanted)
            settled = np.abs(now - s) <= _NEARLY * now + tolerance / 100
            s = now
            if step and settled.all():
                return np.moveaxis(X, 2, 0), s
        check_time((count * rows) ** 3 / _CUBES)
        U, s, _ = np.linalg.svd(self.band.dense())  # takes its time, and ends
        s = np.concatenate([s, np.zeros(len(U) - len(s))])
        return U.T[len(U) - wanted :].reshape(wanted, count, rows), s[len(s) - wanted :]


def least_squares(band: BlockBand, right: NDArray[np.float64], scale: float) -> NDArray[np.float64]:
    """Return ``x`` of the smallest ``|x T - right|``, zero where a row of ``T`` is; the other rows are independent.

    Parameters
    ----------
    band : BlockBand
    right : ndarray, shape (count + 1, columns, vectors)
    scale : float
        The largest singular value.
    """
    factor = _Factor.of(band, _SHIFT * scale, right)
    return factor.solved(factor.right)


@dataclass(frozen=True, eq=False)
class _Factor:
    """The triangular factor of the transpose of a band above a small multiple of the identity, in block rows.

    Attributes
    ----------
    blocks : list of list of ndarray, shape (rows, rows)
        Of each block row the block on the diagonal, which is upper triangular, and those after it.
    right : ndarray, shape (count, rows, vectors)
        What the orthogonal factor makes of right-hand sides.
    """

    blocks: list[list[NDArray[np.float64]]]
    right: NDArray[np.float64]

    @classmethod
    def of(cls, band: BlockBand, shift: float, right: NDArray[np.float64] | None = None) -> _Factor:
        """Return the factor, from one block row of the transpose after the other."""
        S = band.blocks
        count, rows, _, columns = S.shape
        right = np.zeros((count + 1, columns, 0)) if right is None else right
        width = (3 if S[:, :, 0].any() else 2) * rows
        ahead = np.zeros((count + 2, rows, 3, columns))
        ahead[:count] = S
        active = np.zeros((0, width + right.shape[2]))
        factors, turned = [], np.zeros((count, rows, right.shape[2]))
        for j in range(count):
            incoming = [active]
            for i in (0, 1) if j == 0 else (j + 1,):
                row = np.zeros((columns, active.shape[1]))
                for at in range(max(i - 1, j), min(i + 2, j + width // rows)):
                    row[:, (at - j) * rows : (at - j + 1) * rows] = ahead[at, :, i - at + 1].T
                row[:, width:] = right[i]
                incoming.append(row)
            incoming.append(shift * np.eye(rows, active.shape[1]))
            R = np.asarray(scipy.linalg.qr(np.vstack(incoming), mode="r", overwrite_a=True, check_finite=False)[0])
            factors.append([R[:rows, i : i + rows].copy() for i in range(0, width, rows)])
            turned[j] = R[:rows, width:]
            left = R[rows:width]
            active = np.zeros((len(left), active.shape[1]))
            active[:, : width - rows], active[:, width:] = left[:, rows:width], left[:, width:]
        return cls(factors, turned)

    def inverse_of_square(self, X: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return ``(R' R)^-1 X`` for vectors of shape (count, rows, vectors), up to a factor."""
        count = len(X)
        Y = X.copy()
        for j in range(count):  # R' Y = X
            diagonal, *after = self.blocks[j]
            Y[j] = scipy.linalg.solve_triangular(diagonal, Y[j], trans=1, check_finite=False)
            for i, R in enumerate(after[: count - 1 - j], j + 1):
                Y[i] -= R.T @ Y[j]
        Y = self.solved(Y / np.abs(Y).max())
        return Y / np.abs(Y).max()

    def solved(self, Y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return ``R^-1 Y``."""
        X, count = Y.copy(), len(Y)
        for j in reversed(range(count)):
            diagonal, *after = self.blocks[j]
            for i, R in enumerate(after[: count - 1 - j], j + 1):
                X[j] -= R @ X[i]
            X[j] = scipy.linalg.solve_triangular(diagonal, X[j], check_finite=False)
        return X
