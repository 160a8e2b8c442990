"""Rational matrices: made of floats as the fractions that they are, with ranks, null spaces and stacks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from flint import fmpq, fmpq_mat, nmod_mat

#: Generic ranks are taken modulo this prime: right unless it divides a minor, by chance in one of 1e17 cases.
PRIME = 2**61 - 1


def rational(x: Any) -> fmpq:
    """Return a number as the fraction that it is."""
    return fmpq(*x.as_integer_ratio()) if isinstance(x, float) else fmpq(x.numerator, x.denominator)


def exact(M: Any) -> fmpq_mat:
    """Return an array of floats, or nested lists of fractions, as a rational matrix."""
    if isinstance(M, np.ndarray):
        rows, columns = M.shape
        return fmpq_mat(rows, columns, [rational(float(x)) for x in M.ravel()])
    rows, columns = len(M), len(M[0]) if len(M) else 0
    return fmpq_mat(rows, columns, [rational(x) for row in M for x in row])


def zeros(rows: int, columns: int) -> fmpq_mat:
    """Return a matrix of zeros."""
    return fmpq_mat(rows, columns, [0] * (rows * columns))


def identity(n: int) -> fmpq_mat:
    """Return the identity."""
    return fmpq_mat(n, n, [int(i == j) for i in range(n) for j in range(n)])


def block(rows: Sequence[Sequence[fmpq_mat]]) -> fmpq_mat:
    """Return a matrix of blocks; heights and widths must fit."""
    entries: list[fmpq] = []
    for blocks in rows:
        for lines in zip(*(M.tolist() if M.ncols() else [[]] * M.nrows() for M in blocks), strict=True):
            for line in lines:
                entries += line
    return fmpq_mat(sum(blocks[0].nrows() for blocks in rows), sum(M.ncols() for M in rows[0]), entries)


def part(M: fmpq_mat, rows: Sequence[int] | None = None, columns: Sequence[int] | None = None) -> fmpq_mat:
    """Return the chosen rows and columns of a matrix; all where ``None``."""
    rows = range(M.nrows()) if rows is None else rows
    columns = range(M.ncols()) if columns is None else columns
    return fmpq_mat(len(rows), len(columns), [M[i, j] for i in rows for j in columns])


def rank(M: fmpq_mat) -> int:
    """Return the rank of a matrix."""
    return M.rank() if M.nrows() and M.ncols() else 0


def null_space(M: fmpq_mat) -> fmpq_mat:
    """Return a basis of ``{x : M x = 0}`` in its columns."""
    columns = M.ncols()
    if not M.nrows() or not columns:
        return identity(columns)
    R, r = M.rref()
    pivots, at = [], 0
    for i in range(r):
        while R[i, at] == 0:
            at += 1
        pivots.append(at)
    free = [j for j in range(columns) if j not in pivots]
    out = [[fmpq(0)] * len(free) for _ in range(columns)]
    for k, j in enumerate(free):
        out[j][k] = fmpq(1)
        for i, pivot in enumerate(pivots):
            out[pivot][k] = -R[i, j]
    return fmpq_mat(columns, len(free), [x for row in out for x in row])


def left_null_space(M: fmpq_mat) -> fmpq_mat:
    """Return a basis of ``{w : w M = 0}`` in its rows."""
    return null_space(M.transpose()).transpose()


def row_basis(M: fmpq_mat) -> fmpq_mat:
    """Return a basis of the row space in its rows."""
    if not M.nrows() or not M.ncols():
        return zeros(0, M.ncols())
    R, r = M.rref()
    return part(R, rows=range(r))


def is_zero(M: fmpq_mat) -> bool:
    """Tell whether all entries are zero."""
    return all(x == 0 for x in M.entries())


def residues(M: fmpq_mat) -> list[list[int]]:
    """Return a matrix modulo the prime."""
    return [[_residue(x) for x in row] for row in M.tolist()]


def _residue(x: fmpq) -> int:
    return int(x.p) * (1 if x.q == 1 else pow(int(x.q), -1, PRIME)) % PRIME if x.p else 0


def rank_modulo(M: Sequence[Sequence[int]]) -> int:
    """Return the rank of a matrix of whole numbers modulo the prime."""
    rows, columns = len(M), len(M[0]) if len(M) else 0
    return nmod_mat(rows, columns, [x for row in M for x in row], PRIME).rank() if rows and columns else 0
