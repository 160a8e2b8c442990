"""What is true of a plant of whole numbers, from ranks modulo a prime: an oracle that shares nothing with the package.

Ranks are those over the rational numbers unless the prime divides one of the minors, by chance about one in 1e8 times.
Numbers that are fractions of powers of two are taken exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from itertools import combinations

import numpy as np
from flint import nmod_mat
from numpy.typing import NDArray

import residua as rs

#: Products of two remainders fit into 64 bits.
PRIME = 2**31 - 1
_POINT = 1234567891


def remainders(M: NDArray) -> NDArray[np.int64]:
    """Return the entries of a matrix of binary fractions modulo the prime."""
    out = np.zeros(M.shape, dtype=np.int64)
    for at in np.argwhere(M):
        x = Fraction(float(M[tuple(at)]))
        out[tuple(at)] = x.numerator * pow(x.denominator, -1, PRIME) % PRIME
    return out


def _modular(M: NDArray[np.int64]) -> nmod_mat:
    rows, columns = M.shape
    return nmod_mat(rows, columns, M.ravel().tolist(), PRIME)


def rank(M: NDArray[np.int64]) -> int:
    """Return the rank of a matrix modulo the prime."""
    return _modular(M).rank() if M.size else 0


def left_null(M: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return rows that span the left null space modulo the prime."""
    if not M.size:
        return np.eye(len(M), dtype=np.int64)
    X, count = _modular(M.T).nullspace()
    return np.array([[int(x) for x in row] for row in X.tolist()], dtype=np.int64)[:, :count].T


def product(X: NDArray[np.int64], Y: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return a product modulo the prime."""
    out = np.zeros((X.shape[0], Y.shape[1]), dtype=np.int64)
    for k in range(X.shape[1]):
        out = (out + X[:, k : k + 1] * Y[k] % PRIME) % PRIME
    return out


class Exact:
    """The pencil ``[A - s E; C]`` of a plant with the columns of its disturbances and faults, modulo the prime."""

    def __init__(self, plant: rs.Plant) -> None:
        n, p = plant.n_states, plant.n_outputs
        E = np.eye(n) if plant.E is None else plant.E
        self.faults = plant.faults
        self.states = n
        self.limit = 1 if plant.is_discrete else 0
        self.P0 = remainders(np.vstack([plant.A, plant.C]))
        self.P1 = -remainders(np.vstack([E, np.zeros((p, n))])) % PRIME
        self.Fd = remainders(np.vstack([plant.Bd, plant.Dd]))
        self.F = remainders(np.vstack([plant.Bf, plant.Df]))

    def _columns(self, ignored: Sequence[int]) -> NDArray[np.int64]:
        return np.hstack([self.Fd, self.F[:, list(ignored)]])

    def visible(self, ignored: Sequence[int] = ()) -> NDArray[np.bool_]:
        """Return which faults some residual sees that ignores the disturbances and some faults."""
        at = np.hstack([(self.P0 + _POINT * self.P1) % PRIME, self._columns(ignored)])
        return np.asarray(product(left_null(at), self.F).any(axis=0))

    def exists(self, ignored: Sequence[int] = ()) -> bool:
        """Tell whether there is a residual at all that ignores the disturbances and some faults."""
        at = np.hstack([(self.P0 + _POINT * self.P1) % PRIME, self._columns(ignored)])
        return rank(at) < len(at)

    def traces(self, ignored: Sequence[int] = ()) -> NDArray[np.int64]:
        """Return what constant faults leave in the end, in every residual that ignores some, shape (residuals, faults).

        The values at the limit of all rows that annihilate the pencil around it: of the rows that do so up to a power
        of ``s`` beyond the order of every zero there.
        """
        Q0 = np.hstack([(self.P0 + self.limit * self.P1) % PRIME, self._columns(ignored)])
        Q1 = np.hstack([self.P1, np.zeros((len(self.P1), Q0.shape[1] - self.states), dtype=np.int64)])
        return product(left_null(_toeplitz(Q0, Q1, self.states + 2, cut=True))[:, : len(Q0)], self.F)

    def lasting(self, ignored: Sequence[int] = ()) -> NDArray[np.bool_]:
        """Return which constant faults some residual sees for good that ignores some faults, whatever these do."""
        return np.asarray(self.traces(ignored).any(axis=0))

    def responses(self, order: int, ignored: Sequence[int], unread: Sequence[int] = ()) -> NDArray[np.int64]:
        """Return the responses of all relations of at most an order, shape (relations, (order + 1) faults)."""
        extra = np.eye(len(self.P0), dtype=np.int64)[:, [self.states + i for i in unread]]
        Q0 = np.hstack([self.P0, self._columns(ignored), extra])
        Q1 = np.hstack([self.P1, np.zeros((len(self.P1), Q0.shape[1] - self.states), dtype=np.int64)])
        x = left_null(_toeplitz(Q0, Q1, order + 1, cut=False))
        return np.hstack([product(x[:, k * len(Q0) : (k + 1) * len(Q0)], self.F) for k in range(order + 1)])

    def order(self, ignored: Sequence[int], seen: Sequence[int], unread: Sequence[int] = ()) -> int | None:
        """Return the order of the shortest relation that ignores some faults and sees others; ``None`` without any."""
        for order in range(self.states + 1):
            found = self.responses(order, ignored, unread)
            answers = np.asarray(found.reshape(-1, len(self.faults)).any(axis=0))
            if len(found) and answers[list(seen)].all():
                return order
        return None


def _toeplitz(Q0: NDArray[np.int64], Q1: NDArray[np.int64], count: int, *, cut: bool) -> NDArray[np.int64]:
    """Return the matrix of ``x(s) (Q0 + s Q1)`` for ``count`` coefficients; ``cut`` drops the highest power."""
    rows, columns = Q0.shape
    T = np.zeros((count * rows, (count + 1) * columns), dtype=np.int64)
    for k in range(count):
        T[k * rows : (k + 1) * rows, k * columns : (k + 1) * columns] = Q0
        T[k * rows : (k + 1) * rows, (k + 1) * columns : (k + 2) * columns] = Q1
    return T[:, : count * columns] if cut else T


def pairs_apart(columns: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return for every two columns whether the first is no multiple of the second, shape (columns, columns)."""
    n = columns.shape[1]
    out = np.zeros((n, n), dtype=bool)
    for i, j in combinations(range(n), 2):
        both = rank(columns[:, [i, j]])
        out[i, j] = both > int(columns[:, j].any())
        out[j, i] = both > int(columns[:, i].any())
    return out
