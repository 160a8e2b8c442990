r"""The star norm of an uncertain system: one ellipsoid for all members, without a solver of matrix inequalities.

The next state is a sum, ``A x`` in the middle of the set, one term for each parameter, and ``D w``. For weights with
:math:`\sum 1/a_i \le 1`, :math:`(\sum u_i)(\sum u_i)^T \le \sum a_i u_i u_i^T`, so that

.. math:: Q = a_0 A Q A^T + \sum_i a_i B_i C_i Q C_i^T B_i^T + a_w D D^T

is an ellipsoid that no member leaves: a linear equation. The bound is log-convex in the logarithms of the weights (its
terms are products of their powers), so that a point at which no weight wants to change is the best one.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from residua.linear.norms.peak_norm_lmi import root
from residua.linear.poles.spectrum import spectral_radius
from residua.linear.subspaces.rank import spectral_norm
from residua.robust.bounds.centred import reached_middle
from residua.robust.sets.uncertain_system import UncertainSystem

Matrix = NDArray[np.float64]
#: Channels below this fraction of the largest of their parameter are rounding of its factors.
_INDEPENDENT = 1e-12
#: The least extent, squared, of the ellipsoid that gives the coordinates, relative to the extents of its states.
_FLOOR = 1e-5
#: Shares of the decay of the middle of the set that weights begin with.
_SHARES = (0.1, 0.3, 0.03, 0.01, 0.001)
#: The share of a parameter that was left out as rounding.
_LEFT_OUT = 1e-9
#: Rounding of one product of matrices, relative to that of their absolute values, per row.
_ROUNDING = 4 * np.finfo(float).eps
#: What is added to the ellipsoid, relative to its size, until rounding cannot matter.
_ADDED = (0.0, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4)


@dataclass(frozen=True, eq=False)
class ScaledProblem:
    """``x+ = A x + B p + D w``, ``q = C x``, ``p = F q`` with ``0 <= F <= 1``, ``z = Cz x + Dzp p + Dzw w``.

    In coordinates in which an ellipsoid about what inputs reach in the middle of the set, by way of parameters as well,
    is the unit ball, and ``z`` in units of what it gets to there.

    Attributes
    ----------
    A, B, D, C, Cz, Dzp, Dzw : ndarray
    groups : tuple of tuple of int
        The channels of each parameter that is left.
    owners : tuple of int
        Its position among the parameters of the system.
    unit : float
        What ``z`` was divided by.
    T : ndarray, shape (n, n)
        ``x = T x_scaled``.
    """

    A: Matrix
    B: Matrix
    D: Matrix
    C: Matrix
    Cz: Matrix
    Dzp: Matrix
    Dzw: Matrix
    groups: tuple[tuple[int, ...], ...]
    owners: tuple[int, ...]
    unit: float
    T: Matrix

    def widest(self) -> float:
        """Return the parameter that moves the system most, as a position among those of the system; NaN without any."""
        if not self.groups:
            return np.nan
        sizes = [np.linalg.norm(self.B[:, list(g)] @ self.C[list(g)]) for g in self.groups]
        return self.owners[int(np.argmax(sizes))]


def scaled_problem(system: UncertainSystem) -> ScaledProblem:
    """Shift, scale and thin out the channels of an uncertain system.

    Parameters of zero width and channels without effect are dropped; several channels of one parameter are reduced to
    the rank of what they do together.
    """
    low, width = system.low, system.high - system.low
    channels = np.array(system.channels, dtype=int)
    shift = low[channels][:, None] * system.Cq
    A, Cz = system.A + system.Bp @ shift, system.Cz + system.Dzp @ shift
    reached = reached_middle(system)
    T, unit, rate = reached.middle.units[:, None] * root(reached.Q, _FLOOR), reached.unit, reached.rate
    back = np.linalg.inv(T)
    n = len(A)
    scale = np.concatenate([np.ones(n), np.full(len(Cz), np.sqrt(rate) / unit)])
    left, right, groups, owners = [np.zeros((len(scale), 0))], [np.zeros((0, n))], [], []
    for i in range(system.n_parameters):
        mine = np.flatnonzero(channels == i)
        effect = np.vstack([back @ system.Bp[:, mine], system.Dzp[:, mine]]) * scale[:, None]
        U, s, Vh = np.linalg.svd(width[i] * effect @ (system.Cq[mine] @ T), full_matrices=False)
        keep = s > max(_INDEPENDENT * s.max(initial=0.0), 1e-15)
        if not keep.any():
            continue
        count = sum(len(g) for g in groups)
        groups.append(tuple(range(count, count + int(keep.sum()))))
        owners.append(i)
        half = np.sqrt(s[keep])
        left.append(U[:, keep] * half / scale[:, None])
        right.append(half[:, None] * Vh[keep])
    both = np.hstack(left)
    return ScaledProblem(
        back @ A @ T,
        both[:n],
        back @ system.Bw,
        np.vstack(right),
        Cz @ T / unit,
        both[n:] / unit,
        system.Dzw / unit,
        tuple(groups),
        tuple(owners),
        unit,
        T,
    )


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
    sizes = np.sqrt([max(float(np.linalg.norm(K)), np.finfo(float).tiny) for K in sums.terms])
    uncertain, own = np.array(_SHARES)[:, None], np.array(_SHARES)[None]
    # a slow system leaves little room: what its own decay needs must be kept
    for of_parameters, of_inputs in np.broadcast(sums.room * uncertain * (len(sizes) > 1), sums.room * own):
        parts = np.append(1 - of_parameters, of_parameters * sizes[1:] / max(sizes[1:].sum(), np.finfo(float).tiny))
        a = 1 / np.append(np.maximum(parts, 1e-12) * (1 - of_inputs), of_inputs)
        a *= np.sum(1 / a)
        best = _evaluate(sums, a)
        if best is not None:
            break
    else:
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
    # these minimise sum a_i slopes_i subject to sum 1 / a_i = 1
    largest = slopes.max()
    if not largest > np.finfo(float).tiny:  # no input reaches the outputs: any weights do
        return bound, Q, np.full(len(slopes), float(len(slopes)))
    roots = np.sqrt(np.maximum(slopes, 1e-16 * largest))
    return bound, Q, roots.sum() / roots


@dataclass(frozen=True, eq=False)
class VerifiedEllipsoid:
    """An ellipsoid that no member leaves, in the units of the system, and the bound that follows.

    ``shares`` are those of the middle of the set, of every parameter of the system, and of the inputs.
    """

    bound: float
    Q: Matrix
    shares: NDArray[np.float64]
    least: float


def verified_star(system: UncertainSystem, problem: ScaledProblem, star: CommonEllipsoid) -> VerifiedEllipsoid | None:
    r"""Return the smallest ellipsoid about ``star`` that is shown to hold; None without one.

    No member leaves :math:`x^T Q^{-1} x \le 1` if, with shares :math:`s` of sum one at most,

    .. math:: Q - A Q A^T / s_0 - \sum_i B_i C_i Q C_i^T B_i^T / s_i - B_w B_w^T / s_w \ge 0

    The smallest eigenvalue of it, ``least``, must exceed what rounding may have done to its terms.
    """
    shares = np.full(2 + system.n_parameters, _LEFT_OUT)
    shares[[0, *(1 + i for i in problem.owners), -1]] = star.shares
    shares /= max(float(shares.sum()), 1.0)
    middle = system.member((system.low + system.high) / 2)
    channels, half = np.array(system.channels, dtype=int), (system.high - system.low) / 2
    # what the next state and the output are sums of: the middle of the set, and half widths of parameters
    readings = [half[i] * system.Cq[channels == i] for i in range(system.n_parameters)]
    terms = [middle.A, *(system.Bp[:, channels == i] @ C for i, C in enumerate(readings))]
    outputs = [middle.C, *(system.Dzp[:, channels == i] @ C for i, C in enumerate(readings))]
    size = float(np.trace(star.Q)) / max(len(star.Q), 1)
    for added in _ADDED:
        Q = problem.T @ (star.Q + added * size * star.spare) @ problem.T.T
        Q = (Q + Q.T) / 2
        least = _least(Q, terms, middle.B, shares)
        if least > 0:
            bound = spectral_norm(middle.D)
            for C in outputs:  # what they reach on the ellipsoid, with what rounding may hide
                rounded = _ROUNDING * len(Q) * float(np.trace(np.abs(C) @ np.abs(Q) @ np.abs(C).T))
                values = np.linalg.eigvalsh(C @ Q @ C.T)
                bound += float(np.sqrt(max(values[-1], 0.0) + rounded)) if len(values) and np.any(C) else 0.0
            return VerifiedEllipsoid(bound, Q, shares, least)
    return None


def _least(Q: Matrix, terms: list[Matrix], B: Matrix, shares: NDArray[np.float64]) -> float:
    """Return the smallest eigenvalue of the inequality, in units of the extents of ``Q``, less their rounding."""
    n = len(Q)
    extent = np.sqrt(np.maximum(np.diagonal(Q), 0.0))
    if not n:
        return np.inf
    if not (np.isfinite(extent).all() and (extent > 0).all()):
        return -np.inf
    Q, B = Q / extent[:, None] / extent, B / extent[:, None]
    left, size = Q - B @ B.T / shares[-1], np.abs(Q) + np.abs(B) @ np.abs(B).T / shares[-1]
    for M, share in zip(terms, shares[:-1], strict=True):
        M = M / extent[:, None] * extent
        left = left - M @ Q @ M.T / share
        size = size + np.abs(M) @ np.abs(Q) @ np.abs(M).T / share
    # where the inequality holds and Q is an ellipsoid at all, Q is no smaller than what is left
    least = min(np.linalg.eigvalsh((left + left.T) / 2)[0], np.linalg.eigvalsh(Q)[0])
    return float(least - _ROUNDING * n * np.linalg.norm(size))
