"""Polynomial rows that annihilate the states and the unknown inputs of a balanced system: its parity relations."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from residua.linear.polynomials.polynomial_basis import PolynomialBasis, basis_on_poles
from residua.linear.subspaces.parts import part_numbers
from residua.linear.subspaces.quotient import NEGLIGIBLE, Quotient, quotient, without_rounding
from residua.linear.subspaces.rank import RankDecision
from residua.progress import check_time
from residua.tolerances import BALANCED_RANK, DESIGN_ROUNDING, RESIDUE, TINY, above_rounding

Matrix = NDArray[np.float64]
#: Eigenvalues that are this near together, beside the distance of ``F`` from them, are one.
_MEET = 1e-3
#: Of a row that has less than this in common with those of another basis nothing is left there.
_GONE = 1e-9


@dataclass(frozen=True, eq=False)
class PairRelations:
    r"""All polynomial rows ``[p, q]`` of a balanced system with :math:`p (zI - A) = q C, \; p B + q D = 0`.

    Divided by its unknown inputs the system is a pair ``(F, G)``, all of whose states are seen, and the rows are

    .. math:: w (zI - F) = v G, \qquad p = w N, \; q = v H - w J

    How many there are of each order, the ranks of the staircase say.

    Attributes
    ----------
    quotient : Quotient
        What is left of the system.
    parts : ndarray
        For each output the number of the part of the system that it belongs to, which nothing connects with others.
    """

    quotient: Quotient
    parts: NDArray[np.int_]
    _found: dict[tuple, tuple[Matrix, Matrix, Matrix]] = field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, A: Matrix, B: Matrix, C: Matrix, D: Matrix, *, tolerance: float = BALANCED_RANK) -> PairRelations:
        """Return the rows of a balanced system with unknown inputs."""
        n = len(A)
        coupled = np.block([[np.eye(n) + np.abs(A), B], [C, D]]) != 0
        return cls(quotient(A, B, C, D, tolerance=tolerance), part_numbers(coupled)[0][n:])

    @cached_property
    def seen(self) -> Matrix:
        """A basis of the states that are seen: that of the quotient where it is all of them."""
        split = self.quotient.split
        return split.seen if split.hidden.shape[1] else np.eye(len(split.seen))

    @cached_property
    def pair(self) -> tuple[Matrix, Matrix]:
        """Matrices ``(F, G)`` of the states that are seen."""
        F, G = self.quotient.pair
        return without_rounding(self.seen.T @ F @ self.seen), without_rounding(G @ self.seen)

    @property
    def center(self) -> float:
        """The mean of the eigenvalues of ``F``."""
        F = self.pair[0]
        return float(np.trace(F)) / max(len(F), 1)

    @cached_property
    def injection(self) -> Matrix:
        """Gain ``K`` that leaves least of ``F - K G`` around its center: outputs carry the fast couplings."""
        F, G = self.pair
        return (F - self.center * np.eye(len(F))) @ np.linalg.pinv(G, rcond=BALANCED_RANK)

    @cached_property
    def injected(self) -> tuple[Matrix, Matrix]:
        """Matrices ``(F - K G, G)``, of which the rows are ``w`` and ``v + w K``."""
        F, G = self.pair
        return without_rounding(F - self.injection @ G), G

    @cached_property
    def new(self) -> list[int]:
        """Number of rows of each order that are no sums of multiples of shorter ones, up to the longest."""
        m, ranks = len(self.pair[1]), [one.rank for one in self.quotient.split.decisions]
        missing = [m - rank for rank in ranks if rank] + [m]
        return [missing[0], *np.diff(missing).tolist()]

    @property
    def orders(self) -> tuple[int, int] | None:
        """The smallest and the largest order of rows that are no sums of multiples of shorter ones, if any."""
        there = np.flatnonzero(self.new)
        return (int(there[0]), int(there[-1])) if len(there) else None

    def count(self, order: int) -> int:
        """Return how many independent rows of at most an order there are."""
        return sum((order + 1 - k) * new for k, new in enumerate(self.new[: order + 1]))

    @property
    def near(self) -> tuple[RankDecision, ...]:
        """The rank decisions that double precision hardly allows."""
        q = self.quotient
        return tuple(one for one in (*q.decisions, *q.split.decisions) if not one.is_clear)

    def basis(self, order: int) -> PolynomialBasis:
        """Return Newton's polynomials on the eigenvalues of ``F``, for rows of an order."""
        F, center = self.pair[0], self.center
        n = len(F)
        nodes = np.linalg.eigvals(F)
        reach = float(np.abs(F - center * np.eye(n)).max(initial=0.0))
        if not np.abs(nodes - center).max(initial=0.0) > _MEET * reach:  # rounding scatters one
            size = float(np.abs(self.injected[0] - center * np.eye(n)).max(initial=0.0))
            powers = PolynomialBasis.powers(order + 1, size if size > BALANCED_RANK else 1.0)
            return replace(powers, real=np.full(order + 1, center))
        return basis_on_poles(nodes, order + 1, 1.0, outward=order >= n)

    def rows(self, order: int, basis: PolynomialBasis) -> tuple[Matrix, Matrix, RankDecision]:
        """Return ``p`` and ``q`` of all rows of at most an order, shapes (count, order + 1, ...), in a basis.

        Together, and as ``w`` and ``v``, they are orthonormal. The decision is on the conditions that are left when
        ``w`` has been eliminated.
        """
        w, v, s = self._null(order, basis)
        kept = (order + 1) * v.shape[2] - len(v)
        p, q = self._rows(w, v)
        if (self.parts != self.parts[:1]).any():
            U = _by_parts(q, self.parts)
            p, q = (np.tensordot(U, one, 1) for one in (p, q))
            size = np.abs(np.concatenate([p, q], axis=2)).max(axis=(1, 2), keepdims=True, initial=0.0)
            p, q = (above_rounding(one, size, RESIDUE) for one in (p, q))
        return p, q, RankDecision(kept, s, BALANCED_RANK * float(s.max(initial=0.0)))

    def moved(self, p: Matrix, q: Matrix, basis: PolynomialBasis, other: PolynomialBasis) -> tuple[Matrix, Matrix]:
        """Return ``p`` and ``q`` of one row in another basis, or of the row nearest to it where that costs digits."""
        w = p @ self.quotient.N.T @ self.seen
        both = w, q @ self.quotient.H.T + w @ self.injection
        moved = (basis.changed_to(other, both[0]), basis.changed_to(other, both[1]))
        w, v, _ = self._null(len(q) - 1, other)
        weights = np.tensordot(w, moved[0], 2) + np.tensordot(v, moved[1], 2)
        nearest = (np.tensordot(weights, w, 1), np.tensordot(weights, v, 1))
        if np.linalg.norm(weights) > _GONE * np.linalg.norm(np.hstack(moved)):
            moved = min(moved, nearest, key=lambda row: _missed(*row, *self.injected, other))
        largest = max(float(np.abs(x).max(initial=0.0)) for x in moved)
        w, v = (above_rounding(x, largest, NEGLIGIBLE)[None] for x in moved)
        p, q = self._rows(w, v)
        return p[0], q[0]

    def completed(self, q: Matrix, basis: PolynomialBasis) -> tuple[Matrix, float]:
        """Return ``p`` of a row given by its ``q``, and how far it is from annihilating the states, of its terms."""
        w, v, missed = self._divided(q @ self.quotient.H.T, basis)
        p, found = self._rows(w[None], (v + w @ self.injection)[None])
        return p[0], max(missed, float(np.abs(found[0] - q).max() / max(float(np.abs(q).max()), TINY)))

    def characteristic(self) -> tuple[Matrix, Matrix]:
        """Return ``p`` and ``q`` of the only shortest row of a pair with one output, by the eigenvalues of ``F``."""
        k = len(self.seen.T)
        basis = self.basis(k)
        w, v, _ = self._divided(np.eye(k + 1)[:, [k]], basis)
        p, q = self._rows(w[None], (v + w @ self.injection)[None])
        return p[0], q[0]

    def _divided(self, v: Matrix, basis: PolynomialBasis) -> tuple[Matrix, Matrix, float]:
        """Return ``w`` with ``w (zI - F) = v G``, ``v``, and what is left over, relative to the terms."""
        (F, G), k = self.pair, len(v) - 1
        w, left = np.zeros((k + 1, len(F))), np.zeros(len(F))
        for j in range(k, -1, -1):
            left = _next(w[[j]], w[[j + 1]] if j < k else w[:0], v[[j]] @ G, F, basis, j)[0]
            if j:
                w[j - 1] = left / basis.sizes[j - 1]
        terms = np.abs(v).max() * np.abs(G).max(initial=0.0) + np.abs(w).max(initial=0.0) * np.abs(F).max(initial=0.0)
        return w, v, float(np.abs(left).max(initial=0.0)) / max(float(terms), TINY)

    def _null(self, order: int, basis: PolynomialBasis) -> tuple[Matrix, Matrix, Matrix]:
        key = order, *(x[: order + 1].tobytes() for x in (basis.real, basis.imaginary, basis.sizes))
        if key not in self._found:
            self._found[key] = _null_rows(*self.injected, basis, order, self.count(order))
        return self._found[key]

    def _rows(self, w: Matrix, v: Matrix) -> tuple[Matrix, Matrix]:
        """Return ``p`` and ``q``, without what rounding leaves of nothing."""
        N, H = self.quotient.N, self.quotient.H
        w, J = w @ self.seen.T, self.quotient.J + self.seen @ self.injection @ H
        terms = np.abs(w) @ np.abs(N), np.abs(v) @ np.abs(H) + np.abs(w) @ np.abs(J)
        sizes = (one.max(axis=2, keepdims=True, initial=0.0) for one in terms)
        p, q = (above_rounding(one, size, RESIDUE) for one, size in zip((w @ N, v @ H - w @ J), sizes, strict=True))
        return p, q


def _by_parts(q: Matrix, parts: NDArray[np.int_]) -> Matrix:
    """Return combinations of rows that read the outputs of one part each."""
    flat = q.reshape(len(q), math.prod(q.shape[1:]))
    out, reads = [], np.tile(parts, q.shape[1])
    for part in np.unique(parts):
        # what reads nothing else, of the rows that are left
        U, s, _ = (
            np.linalg.svd(flat[:, reads != part]) if (reads != part).any() else (np.eye(len(q)), np.zeros(0), None)
        )
        out.append(U[:, int(np.count_nonzero(s > DESIGN_ROUNDING * s.max(initial=0.0))) :].T)
    return np.vstack(out) if sum(map(len, out)) == len(q) else np.eye(len(q))


def _null_rows(F: Matrix, G: Matrix, basis: PolynomialBasis, order: int, count: int) -> tuple[Matrix, Matrix, Matrix]:
    r"""Return orthonormal rows ``w`` and ``v`` with :math:`w (zI - F) = v G`, and what decides how many there are.

    The coefficients follow from each other from the highest on, :math:`\rho_{j-1} w_{j-1} = v_j G + w_j (F - a_j I) +
    \beta_{j+1} w_{j+1}`, with every ``v_j`` free; the last equation leaves conditions on all that was free. After each
    step the free parameters are made orthonormal in all coefficients so far, so that what grows hides nothing. The
    ``count`` rows are those that miss their equations least; where more miss them by rounding alone, those of which the
    newest coefficient is largest.
    """
    m, k = len(G), order
    before, now = np.zeros((2, 0, len(F)))
    steps = []
    for j in range(k, -1, -1):
        check_time()
        before, now, entering = (np.vstack([part, new]) for part, new in ((before, 0 * G), (now, 0 * G), (0 * now, G)))
        left = _next(now, before, entering, F, basis, j)
        if not j:
            break
        left = left / basis.sizes[j - 1]
        R = scipy.linalg.qr(np.vstack([np.eye(len(left)), left.T]), mode="r")[0][: len(left)]
        before, now = (scipy.linalg.solve_triangular(R, part, trans="T") for part in (now, left))
        steps.append((R, now))
    U, s, _ = np.linalg.svd(left) if left.size else (np.eye(len(left)), np.zeros(0), None)
    null = len(left) - int(np.count_nonzero(s > NEGLIGIBLE * s.max(initial=0.0)))
    chosen = U[:, len(U) - max(count, null) :]
    w, v = np.zeros((chosen.shape[1], k + 1, len(F))), np.zeros((chosen.shape[1], k + 1, m))
    for j in range(k + 1):
        v[:, j], chosen = chosen[len(chosen) - m :].T, chosen[: len(chosen) - m]
        if steps:
            R, now = steps.pop()
            w[:, j] = chosen.T @ now
            chosen = scipy.linalg.solve_triangular(R, chosen)
    if len(v) > count:
        newest = np.linalg.svd(v[:, k])[0][:, :count].T
        w, v = np.tensordot(newest, w, 1), np.tensordot(newest, v, 1)
    return w, v, s


def _next(w: Matrix, before: Matrix, entering: Matrix, F: Matrix, basis: PolynomialBasis, j: int) -> Matrix:
    """Return ``v_j G + w_j (F - a_j I) + beta_(j+1) w_(j+1)``, with the first and the last given."""
    total = entering + w @ F - basis.real[j] * w
    return total + basis.links[j + 1] * before if len(before) and j + 1 < basis.count else total


def _missed(w: Matrix, v: Matrix, F: Matrix, G: Matrix, basis: PolynomialBasis) -> float:
    """Return how far a row is from ``w (zI - F) = v G``, relative to its largest coefficient, in extended precision."""
    k, size = len(v) - 1, max(float(np.abs(w).max(initial=0.0)), float(np.abs(v).max(initial=0.0)), TINY)
    W, V, M, C = (x.astype(np.longdouble) for x in (w, v, F, G))
    left = basis.real[: k + 1, None] * W - W @ M - V @ C
    left[:-1] -= basis.links[1 : k + 1, None] * W[1:]
    left[1:] += basis.sizes[:k, None] * W[:-1]
    return float(np.abs(left).max(initial=0.0)) / size
