"""Infinite zeros and null structure of a system taken out by orthogonal steps, until ``D`` has full row rank.

References
----------
Emami-Naeini and Van Dooren, Computation of zeros of linear multivariable systems, Automatica 18 (1982) 415-430.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from residua.linear.subspaces.weak_couplings import UnclearRankError, WeakCouplings, copies_of

Matrix = NDArray[np.float64]
Matrices = tuple[Matrix, Matrix, Matrix, Matrix]


class _Run:
    """A system on its way through the steps."""

    def __init__(self, M: Matrices) -> None:
        self.M = M

    def transpose(self) -> None:
        """Go on with the dual system."""
        A, B, C, D = self.M
        self.M = A.T, C.T, B.T, D.T

    def compress(self, U: Matrix) -> None:
        """Turn the outputs, those that inputs enter first."""
        A, B, C, D = self.M
        self.M = A, B, U.T @ C, U.T @ D

    def drop(self, rank: int) -> None:
        """Leave out the outputs beyond the first ones, which are zero."""
        A, B, C, D = self.M
        self.M = A, B, C[:rank], D[:rank]

    def force(self, rank: int, V: Matrix, mu: int) -> None:
        """Take out the last states, which silent outputs force to zero: their equations become outputs in turn."""
        A, B, C, D = self.M
        A, B, C = V.T @ A @ V, V.T @ B, C[:rank] @ V
        k = len(A) - mu
        self.M = A[:k, :k], B[:k], np.vstack([C[:, :k], A[k:, :k]]), np.vstack([D[:rank], B[k:]])


class _ComparedRun(_Run):
    """The same with its bases in the coordinates that it began in, in which it is compared with copies.

    Of the states, of the rows of ``[C D]``, outputs and equations of states, and of the columns of ``[B; D]``.
    """

    def __init__(self, M: Matrices) -> None:
        super().__init__(M)
        n, (p, q) = len(M[0]), M[3].shape
        self._states, self._rows, self._columns = np.eye(n), np.eye(p + n, p), np.eye(q + n, q)

    def through(self) -> Matrix:
        """Return ``D`` in the coordinates of the beginning."""
        return self._rows @ self.M[3] @ self._columns.T

    def silent(self, rank: int) -> Matrix:
        """Return what outputs without inputs see, in the coordinates of the beginning."""
        return self._rows[:, rank:] @ self.M[2][rank:] @ self._states.T

    def transpose(self) -> None:
        super().transpose()
        self._rows, self._columns = self._columns, self._rows

    def compress(self, U: Matrix) -> None:
        super().compress(U)
        self._rows = self._rows @ U

    def drop(self, rank: int) -> None:
        super().drop(rank)
        self._rows = self._rows[:, :rank]

    def force(self, rank: int, V: Matrix, mu: int) -> None:
        super().force(rank, V, mu)
        turned = self._states @ V
        n, k = turned.shape[0], turned.shape[1] - mu
        equations = np.vstack([np.zeros((len(self._rows) - n, mu)), turned[:, k:]])
        self._rows, self._states = np.hstack([self._rows[:, :rank], equations]), turned[:, :k]


class _Steps:
    """The steps of a system, or of it and its copies with the ranks of the first."""

    def __init__(self, one: _Run, compared: list[_ComparedRun], rtol: float, scale: float) -> None:
        self.one, self.compared = one, compared
        self.runs: list[_Run] = [*compared] or [one]
        self.decided, self._scale = WeakCouplings(rtol), scale

    def take(self) -> None:
        """Take the steps of the rows, and then of the columns."""
        self._deflate()
        for run in self.runs:
            run.transpose()
        self._deflate()

    def _decide(self, values: Matrix, couplings: Callable[[_ComparedRun], Matrix]) -> int:
        """Return how many singular values are no rounding."""
        scale = self._scale
        return self.decided.rank(
            values, scale, of=scale, turning=scale, couplings=lambda: [couplings(run) for run in self.compared]
        )

    def _deflate(self) -> None:
        """Take steps until ``D`` has full row rank."""
        one = self.one
        while len(one.M[3]):
            through = [_singular_vectors(run.M[3]) for run in self.runs]
            rank = self._decide(through[0][1], _ComparedRun.through) if one.M[3].size else 0
            if rank == len(one.M[3]):
                return
            for run, (U, _, _) in zip(self.runs, through, strict=True):
                run.compress(U)
            silent = [_singular_vectors(run.M[2][rank:]) for run in self.runs]
            mu = self._decide(silent[0][1], lambda run, rank=rank: run.silent(rank)) if len(one.M[0]) else 0
            if mu == 0:
                for run in self.runs:
                    run.drop(rank)
                return
            for run, (_, _, Vh) in zip(self.runs, silent, strict=True):
                run.force(rank, np.roll(Vh, -mu, axis=0).T, mu)


def deflated(M: Matrices, rtol: float, scale: float) -> tuple[Matrices, WeakCouplings]:
    """Return the dual of the part of a system with its finite zeros, and what was decided on the way.

    Parameters
    ----------
    M : tuple of ndarray
        ``A, B, C, D`` in comparable units.
    rtol, scale : float
        Singular values up to ``rtol * scale`` are zero, and those that may be rounding.

    Returns
    -------
    M : tuple of ndarray
        ``D`` is square and invertible, if all decisions were clear.
    decided : WeakCouplings
        The decisions about ranks.
    """
    steps = _Steps(_Run(M), [], rtol, scale)
    try:
        steps.take()
    except UnclearRankError:
        runs = [_ComparedRun(one) for one in (M, *copies_of(M))]
        steps = _Steps(runs[0], runs, rtol, scale)
        steps.take()
    return steps.one.M, steps.decided


def _singular_vectors(X: Matrix) -> tuple[Matrix, Matrix, Matrix]:
    if not X.size:
        return np.eye(X.shape[0]), np.zeros(0), np.eye(X.shape[1])
    return np.linalg.svd(X)
