r"""The star norm of an uncertain system: one ellipsoid for all members, without a solver of matrix inequalities.

The next state is a sum, ``A x`` in the middle of the set, one term for each parameter, and ``D w``. For weights with
:math:`\sum 1/a_i \le 1`, :math:`(\sum u_i)(\sum u_i)^T \le \sum a_i u_i u_i^T`, so that

.. math:: Q = a_0 A Q A^T + \sum_i a_i B_i C_i Q C_i^T B_i^T + a_w D D^T

is an ellipsoid that no member leaves: a linear equation. The bound is log-convex in the logarithms of the weights (its
terms are products of their powers), so that a point at which no weight wants to change is the best one.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from residua.linear.poles.spectrum import spectral_radius
from residua.linear.subspaces.rank import spectral_norm
from residua.robust.bounds.scaled_problem import ScaledProblem

Matrix = NDArray[np.float64]
#: Shares of the decay of the middle of the set that weights begin with.
_SHARES = (0.1, 0.3, 0.03, 0.01, 0.001)


@dataclass(frozen=True, eq=False)
class CommonEllipsoid:
    """All states of all members lie in ``x' Q^-1 x <= 1``, in scaled coordinates.

    Attributes
    ----------
    Q : ndarray, shape (n, n)
    shares : ndarray, shape (1 + parameters + 1,)
        ``1 / a``: of the middle of the set, of each parameter, of the inputs.
    spare : ndarray, shape (n, n)
        What can be added to ``Q`` in any multiple, to leave room for rounding: the equation with a source of one.
    """

    Q: Matrix
    shares: NDArray[np.float64]
    spare: Matrix


class _Sums:
    """The equation of ``Q`` for some weights, in a vector of the entries of a symmetric matrix."""

    def __init__(self, s: ScaledProblem) -> None:
        half = [0.5 * s.B[:, list(g)] @ s.C[list(g)] for g in s.groups]
        middle = s.A + 0.5 * s.B @ s.C
        self.n = len(s.A)
        self.outputs = [s.Cz + 0.5 * s.Dzp @ s.C, *(0.5 * s.Dzp[:, list(g)] @ s.C[list(g)] for g in s.groups)]
        self.direct = spectral_norm(s.Dzw)
        rows, columns = np.triu_indices(self.n)
        self._rows, self._columns = rows, columns
        self._weight = np.where(rows == columns, 1.0, np.sqrt(2.0))
        self.terms = [self._matrix(M) for M in (middle, *half)]
        self.room = 1 - min(float(spectral_radius(middle)), 1 - 1e-9) ** 2
        self.source = self.vector(s.D @ s.D.T)

    def vector(self, Q: Matrix) -> NDArray[np.float64]:
        return Q[self._rows, self._columns] * self._weight

    def square(self, v: NDArray[np.float64]) -> Matrix:
        Q = np.zeros((self.n, self.n))
        Q[self._rows, self._columns] = v / self._weight
        return Q + Q.T - np.diag(np.diagonal(Q))

    def _matrix(self, M: Matrix) -> Matrix:
        """Return ``Q -> M Q M'`` as a matrix; its transpose is the adjoint map."""
        r, c = self._rows, self._columns
        full = M[r][:, r] * M[c][:, c] + M[r][:, c] * M[c][:, r]
        return full * (self._weight[:, None] * self._weight / 2)

    def solve(self, a: NDArray[np.float64]) -> tuple[Matrix, object, Matrix] | None:
        """Return ``Q``, the factors of the equation, and its answer to a source of one; None if it grows without
        end with these weights.
        """
        M = np.eye(len(self.source)) - sum(w * K for w, K in zip(a[:-1], self.terms, strict=True))
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore", scipy.linalg.LinAlgWarning)  # a singular equation has no positive answer
            factors = scipy.linalg.lu_factor(M, check_finite=False)
            # The map is positive: a positive answer to a positive source is a proof that its powers die out.
            trial = self.square(scipy.linalg.lu_solve(factors, self.vector(np.eye(self.n))))
        if not np.isfinite(trial).all() or not np.linalg.eigvalsh(trial)[0] >= 1 - 1e-6:
            return None
        Q = self.square(scipy.linalg.lu_solve(factors, a[-1] * self.source))
        return Q + 1e-9 * np.trace(Q) / self.n * trial, factors, trial


def common_ellipsoid(s: ScaledProblem) -> CommonEllipsoid | None:
    """Return the best ellipsoid, or None if there is none of this form."""
    sums = _Sums(s)
    a = _start(sums)
    best = None if a is None else _evaluate(sums, a)
    if a is None or best is None:
        return None
    bound, Q, wanted = best
    step = 1.0
    for _ in range(200):
        trial = a ** (1 - step) * wanted**step
        trial = trial * np.sum(1 / trial)
        solution = _evaluate(sums, trial)
        if solution is None or solution[0] > bound * (1 + 1e-12):
            step /= 2
            if step < 1e-3:
                break
            continue
        moved = bound - solution[0]
        a, (bound, Q, wanted) = trial, solution
        step = min(1.0, 1.5 * step)
        if moved <= 1e-9 * bound:
            break
    solved = sums.solve(a)
    return None if solved is None else CommonEllipsoid(Q, 1 / a, solved[2])


def _evaluate(sums: _Sums, a: NDArray[np.float64]) -> tuple[float, Matrix, NDArray[np.float64]] | None:
    """Return the bound, the ellipsoid, and the weights that its slope asks for."""
    solved = sums.solve(a)
    if solved is None:
        return None
    Q, factors, _ = solved
    bound, pull = sums.direct, np.zeros_like(Q)
    for C in sums.outputs:
        values, vectors = np.linalg.eigh(C @ Q @ C.T)
        size = float(np.sqrt(max(values[-1], 0.0))) if len(values) else 0.0
        if size:
            row = C.T @ vectors[:, -1]
            pull += np.outer(row, row) / (2 * size)
            bound += size
    Y = scipy.linalg.lu_solve(factors, sums.vector(pull), trans=1)
    q = sums.vector(Q)
    slopes = np.array([*(Y @ (K @ q) for K in sums.terms), Y @ sums.source])
    return bound, Q, _weights(slopes)


def _weights(slopes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Minimise ``sum a_i slopes_i`` subject to ``sum 1 / a_i = 1``."""
    largest = slopes.max()
    if not largest > np.finfo(float).tiny:  # no input reaches the outputs: any weights do
        return np.full(len(slopes), float(len(slopes)))
    roots = np.sqrt(np.maximum(slopes, 1e-16 * largest))
    return roots.sum() / roots


def _start(sums: _Sums) -> NDArray[np.float64] | None:
    """Return weights with which the states die out: a guess from sizes, or those with the least spectral radius."""
    sizes = np.sqrt([max(float(np.linalg.norm(K)), np.finfo(float).tiny) for K in sums.terms])
    k = len(sizes)
    # a slow system leaves little room: what its own decay needs must be kept
    for uncertain in sums.room * np.array(_SHARES) if k > 1 else (0.0,):
        parts = np.concatenate([[1 - uncertain], uncertain * sizes[1:] / max(sizes[1:].sum(), np.finfo(float).tiny)])
        a = _feasible(sums, parts)
        if a is not None:
            return a
    shares = np.full(k, 0.1 * sums.room / k)
    shares[0] = 1 - shares[1:].sum()
    for _ in range(40):
        K = np.tensordot(1 / shares, np.stack(sums.terms), axes=1)
        q, rho = _perron(K, sums)
        y, _ = _perron(K.T, sums)
        a = _feasible(sums, shares) if rho < 1.1 else None
        if a is not None:
            return a
        wanted = 1 / _weights(np.array([y @ (M @ q) for M in sums.terms]))
        shares = np.sqrt(shares * wanted)
        shares /= shares.sum()
    return None


def _feasible(sums: _Sums, shares: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Return weights with these shares of what the inputs leave, or None if the states do not die out."""
    for own in sums.room * np.array(_SHARES):
        a = 1 / np.append(np.maximum(shares, 1e-12) * (1 - own), own)
        a *= np.sum(1 / a)
        if sums.solve(a) is not None:
            return a
    return None


def _perron(K: Matrix, sums: _Sums) -> tuple[NDArray[np.float64], float]:
    # A little of everything keeps the two vectors from having nothing in common where the system falls into parts.
    start = sums.vector(np.eye(sums.n)) / np.sqrt(sums.n)
    v, rho, tiny = start, 0.0, float(np.finfo(float).tiny)
    for _ in range(200):
        new = K @ v
        new = new + 1e-6 * math.sqrt(new.dot(new)) * start
        length = math.sqrt(new.dot(new))
        size = length / max(math.sqrt(v.dot(v)), tiny)
        done = abs(size - rho) <= 1e-6 * size
        v, rho = new / max(length, tiny), size
        if done:
            break
    return v, rho
