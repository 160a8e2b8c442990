"""The triangular factor of the joint Hankel matrix of inputs and outputs, built block by block."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import get_lapack_funcs

from residua.errors import DataError
from residua.identify.channel_facts import ChannelFacts
from residua.identify.segments import Gathered, Segment
from residua.progress import Progress
from residua.tolerances import RANK
from residua.words import counted

#: Rows of a block for each column of the Hankel matrix: with 24, the factor of before adds little to the work.
_ROWS_PER_COLUMN = 24
#: The inverse of a condition up to which products alone serve: the smallest singular value is then off by 1e-7 of
#: itself, which is less than chance moves it in any number of rows that a recording has.
_WELL_CONDITIONED = 1e-5
#: How far from orthonormal the first factorisation may leave the columns, for the second one to be exact to rounding.
_NEARLY_ORTHOGONAL = 0.1
#: A prediction error below this part of an output's standard deviation counts as none.
NOISE_FREE = 1e-7
#: Parts of the data whose factors are kept, for the spread of estimates between them.
PARTS = 16


@dataclass(frozen=True, eq=False)
class HankelFactor:
    r"""``R`` of the QR factorisation of the Hankel matrix: its columns stand for the signals at each time of a window.

    .. math:: H = Q R, \qquad H_k = \begin{bmatrix} 1 & u_k & y_k & u_{k+1} & \dots & y_{k+L-1} \end{bmatrix}

    with a row for every window of ``L`` rows that no missing value cuts. Any regression among these signals has the
    same solution, and the same residual, for the columns of ``R``.

    Attributes
    ----------
    R : ndarray, shape (columns, columns)
    parts : tuple of ndarray
        The factors of successive parts of the data, of which ``R`` is the factor.
    windows : int
        Rows of the Hankel matrix.
    length : int
        Rows of the recording in a window, ``L``.
    n_inputs, n_outputs : int
    reference, units : ndarray, shape (channels,)
        The values subtracted from each channel, and the divisors.
    """

    R: NDArray[np.float64]
    parts: tuple[NDArray[np.float64], ...]
    windows: int
    length: int
    n_inputs: int
    n_outputs: int
    reference: NDArray[np.float64]
    units: NDArray[np.float64]

    @property
    def n_channels(self) -> int:
        """Inputs and outputs."""
        return self.n_inputs + self.n_outputs

    def inputs(self, *times: int) -> list[int]:
        """Return the columns of the inputs at times of the window."""
        return [1 + time * self.n_channels + i for time in times for i in range(self.n_inputs)]

    def outputs(self, *times: int) -> list[int]:
        """Return the columns of the outputs at times of the window."""
        return [1 + time * self.n_channels + self.n_inputs + i for time in times for i in range(self.n_outputs)]

    def signals(self, times: Iterable[int]) -> list[int]:
        """Return the columns of inputs and outputs at times of the window, in the order of the times."""
        return [1 + time * self.n_channels + i for time in times for i in range(self.n_channels)]


def regress(targets: NDArray, regressors: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the least-squares fit of columns by others, in units that make the regressors equally large.

    Returns
    -------
    coefficients : ndarray, shape (targets, regressors)
        The smallest ones where the regressors determine one another.
    residual : ndarray, shape (rows of the factor, targets)
        Its products are those of the residual of the data.
    """
    size = np.linalg.norm(regressors, axis=0)
    size = np.where(size > 0, size, 1.0)
    solution = np.linalg.lstsq(regressors / size, targets, rcond=RANK)[0]
    return (solution / size[:, None]).T, targets - regressors / size @ solution


def count_windows(gathered: Gathered, length: int) -> int:
    """Return the number of windows of a length in the data."""
    return sum(max(len(one) - length + 1, 0) for one in gathered.segments)


def hankel_factor(
    gathered: Gathered, length: int, facts: ChannelFacts, *, progress: Progress | None = None
) -> HankelFactor:
    """Return the factor of the joint Hankel matrix of windows of ``length`` rows.

    Raises
    ------
    DataError
        If no segment is as long as a window, or there are fewer windows than columns.
    """
    columns = 1 + length * len(gathered.channels)
    windows = count_windows(gathered, length)
    if windows < columns:
        longest = max((len(one) for one in gathered.segments), default=0)
        raise DataError(
            f"{counted(windows, 'window')} of {length} rows in the data, for {columns} columns of the Hankel matrix: "
            f"the longest segment has {counted(longest, 'row')}; give a longer recording, or a shorter horizon"
        )
    borders = np.linspace(0, windows, min(PARTS, max(windows // columns, 1)) + 1).astype(int)
    reference, units = facts.mean, facts.units
    size = max(_ROWS_PER_COLUMN * columns, 512)
    parts, done = [], 0
    current: NDArray | None = None
    for segment, start, stop, ends in _pieces(gathered.segments, length, borders, size):
        Z = (segment.rows(start, stop + length - 1) - reference) / units
        block = _hankel_rows(Z, stop - start, length, current)
        current = triangle(block)
        done += stop - start
        if progress is not None:
            progress("Hankel matrix", done, windows)
        if ends:
            parts.append(current)
            current = None
    R = triangle(np.vstack(parts)) if len(parts) > 1 else parts[0]
    return HankelFactor(R, tuple(parts), windows, length, len(gathered.inputs), len(gathered.outputs), reference, units)


def discounted_factor(factor: HankelFactor, gathered: Gathered, forgetting: float) -> HankelFactor:
    r"""Return a factor after more windows: each takes ``forgetting`` of the weight of all before it.

    .. math:: R^T R \leftarrow \lambda R^T R + h h^T
    """
    R, length, new = factor.R, factor.length, count_windows(gathered, factor.length)
    size = max(_ROWS_PER_COLUMN * len(R), 512)
    for segment, start, stop, _ in _pieces(gathered.segments, length, np.array([0, new]), size):
        Z = (segment.rows(start, stop + length - 1) - factor.reference) / factor.units
        block = _hankel_rows(Z, stop - start, length, R)
        if forgetting < 1:
            weights = np.sqrt(forgetting) ** np.arange(stop - start, -1, -1)
            block[: len(R)] *= weights[0]
            block[len(R) :] *= weights[1:, None]
        R = triangle(block)
    return replace(factor, R=R, parts=(), windows=factor.windows + new)


def _pieces(
    segments: Sequence[Segment], length: int, borders: NDArray[np.int_], size: int
) -> Iterable[tuple[Segment, int, int, bool]]:
    """Yield (segment, first window, last window, True where a part of the data ends with it)."""
    done, part = 0, 1
    for segment in segments:
        start, stop = 0, len(segment) - length + 1
        while start < stop:
            end = min(start + size, stop, start + int(borders[part]) - done)
            done += end - start
            ends = done == borders[part]
            part += int(ends)
            yield segment, start, end, ends
            start = end


def _hankel_rows(Z: NDArray, windows: int, length: int, above: NDArray | None) -> NDArray:
    """Return windows of the signals, a row each, below a factor that is there already."""
    n = Z.shape[1]
    rows = 0 if above is None else len(above)
    block = np.empty((rows + windows, 1 + length * n), order="F")
    if above is not None:
        block[:rows] = above
    block[rows:, 0] = 1.0
    for time in range(length):
        block[rows:, 1 + time * n : 1 + (time + 1) * n] = Z[time : time + windows]
    return block


def triangle(block: NDArray) -> NDArray[np.float64]:
    """Return the triangular factor of a matrix, square even if it has fewer rows than columns.

    By the Cholesky factor of the matrix of products, where its condition is small; beyond that by the factor of what
    it leaves as well, which is as accurate as Householder's reflections up to a condition of about 1e8; and by these
    beyond.
    """
    if len(block) >= block.shape[1]:
        try:
            first = np.linalg.cholesky(block.T @ block).T
            condition, invert = get_lapack_funcs(("trcon", "trtri"), (first,))
            if condition(first)[0] > _WELL_CONDITIONED:
                return first
            even = block @ invert(first)[0]
            products = even.T @ even
            if np.abs(products - np.eye(len(products))).max() < _NEARLY_ORTHOGONAL:
                return np.linalg.cholesky(products).T @ first
        except np.linalg.LinAlgError:  # not positive definite to rounding
            pass
    R = np.zeros((block.shape[1], block.shape[1]))
    R[: min(block.shape)] = np.linalg.qr(block, mode="r")
    return R
