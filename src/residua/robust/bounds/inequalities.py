r"""Matrix inequalities that bound the output of every member of an uncertain system.

All use a storage function :math:`V_F(x)`, a quadratic form of ``x`` and ``p = F C x``:
:math:`V_F(x_+) \le (1-\lambda) V_F(x) + \lambda g_1 |w|^2` and :math:`|z|^2 \le V_F(x) + g_2 |w|^2` give
:math:`|z|^2 \le g_1 + g_2`, and ``V_F > 0`` stability. What holds of ``p`` because ``0 <= F <= 1`` enters by
multipliers. Quadratic: ``x' P x``. Popov and Tsypkin: ``x' P x + q' N p``. Lifted: any form of ``x`` and ``p``, which
includes the others, since ``p`` of the next sample is a variable of its own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.linear.norms import lmi
from residua.robust.bounds.star import ScaledProblem

Matrix = NDArray[np.float64]
METHODS = ("lifted", "popov-tsypkin", "quadratic")
#: Strictness of the inequalities in the scaled problem, one after the other until the result is verified.
_MARGINS = (1e-6, 1e-5, 1e-4, 1e-3)
#: What the correction may add to the bound of the solver before the next margin is tried.
_LOST = 1e-3


@dataclass(frozen=True, eq=False)
class Certificate:
    """Matrices that prove a bound, in the coordinates of a :class:`ScaledProblem`.

    Attributes
    ----------
    rate : float
    g1, g2 : float
        ``sqrt(g1 + g2)`` is the bound, in units of ``problem.unit``.
    matrices : dict of str to ndarray
    eigenvalues : dict of str to float
        The smallest eigenvalue of each matrix that must be definite, scaled to a unit diagonal.
    """

    rate: float
    g1: float
    g2: float
    matrices: dict[str, Matrix]
    eigenvalues: dict[str, float]

    @property
    def bound(self) -> float:
        """The bound, in units of ``problem.unit``."""
        return float(np.sqrt(self.g1 + self.g2))


class Inequalities:
    """The inequalities of one method, for one problem; the rate comes last, as everything is affine in it."""

    def __init__(self, problem: ScaledProblem, method: str) -> None:
        self.problem = problem
        self.method = method
        n, k, m = len(problem.A), problem.B.shape[1], problem.D.shape[1]
        groups = problem.groups
        wide = [g for g in groups if len(g) > 1]
        both = [(*g, *(k + i for i in g)) for g in groups]
        parts = [lmi.symmetric("V", n + k if method == "lifted" else n), lmi.scalar("g1"), lmi.scalar("g2")]
        multipliers = ["H2", "H3"] if method != "quadratic" else ["H2"]
        if method == "lifted":
            parts += [lmi.symmetric("D", 2 * k, both), lmi.skew("G", 2 * k, both)]
        else:
            multipliers.append("H")
        if method == "popov-tsypkin":
            parts += [lmi.symmetric("N1", k, groups), lmi.symmetric("N2", k, groups)]
        for name in multipliers:
            parts.append(lmi.symmetric(name, k, groups))
            if wide:
                parts.append(lmi.skew(name + " skew", k, wide))
        self.unknowns = lmi.Unknowns(tuple(part for part in parts if len(part.basis)))
        self._blocks: list[tuple[str, tuple[int, ...]]] = [(name, g) for name in multipliers for g in groups]
        if method == "popov-tsypkin":
            self._blocks += [(name, g) for name in ("N1", "N2") for g in groups]
        if method == "lifted":
            self._blocks += [("D", g) for g in both]
        self._sizes = n, k, m

    # ------------------------------------------------------------- inequalities

    def _get(self, v: lmi.Values, name: str) -> Matrix:
        k = self._sizes[1]
        matrix = v.get(name)
        return np.zeros((k, k)) if matrix is None else matrix

    def _sector(self, v: lmi.Values, name: str, Q: Matrix, R: Matrix) -> Matrix:
        """Return ``2 p' H (q - p)``, not negative on all members, as a quadratic form."""
        return _form(R, self._get(v, name) + self._get(v, name + " skew"), Q - R)

    def _storage(self, v: lmi.Values, X: Matrix, R: Matrix) -> Matrix:
        """Return the storage function of the state ``X`` and its ``p``."""
        if self.method == "lifted":
            both = np.vstack([X, R])
            return both.T @ v["V"] @ both
        out = X.T @ v["V"] @ X
        if self.method == "popov-tsypkin":
            out = out + _form(self.problem.C @ X, self._get(v, "N1") - self._get(v, "N2"), R) / 2
        return out

    def dynamic(self, v: lmi.Values, rate: float) -> Matrix:
        """Return ``(1 - rate) V(x) + rate g1 |w|^2 - V(x+)`` less the multipliers: at least 0 when it decreases."""
        s, (n, k, m) = self.problem, self._sizes
        lifted = self.method == "lifted"
        width = n + k * (2 if lifted else 1) + m
        X, R = _unit(0, n, width), _unit(n, k, width)
        W = _unit(width - m, m, width)
        Q = s.C @ X
        X1 = s.A @ X + s.B @ R + s.D @ W
        Q1 = s.C @ X1
        out = (1 - rate) * self._storage(v, X, R) + rate * v["g1"][0, 0] * W.T @ W
        if lifted:
            R1 = _unit(n + k, k, width)
            both_p, both_q = np.vstack([R, R1]), np.vstack([Q, Q1])
            out -= self._storage(v, X1, R1)
            if k:
                out -= _form(both_p, v["D"], both_q - both_p) + _form(both_p, v["G"], both_q)
        else:
            out -= X1.T @ v["V"] @ X1
            out -= self._sector(v, "H", Q, R)
        if self.method == "popov-tsypkin":  # q+' F N q+ is at most what is subtracted here
            N1 = self._get(v, "N1")
            N = N1 - self._get(v, "N2")
            out -= _form(R, N, Q1) - _form(Q, N, R) / 2 + (Q1 - Q).T @ N1 @ (Q1 - Q)
        scale = np.ones(width)
        scale[:n] = scale[width - m :] = 1 / np.sqrt(rate)
        return scale[:, None] * out * scale

    def output(self, v: lmi.Values) -> Matrix:
        """Return ``V(x) + g2 |w|^2 - |z|^2`` less the multipliers."""
        s, (n, k, m) = self.problem, self._sizes
        width = n + k + m
        X, R, W = _unit(0, n, width), _unit(n, k, width), _unit(n + k, m, width)
        Q, Z = s.C @ X, s.Cz @ X + s.Dzp @ R + s.Dzw @ W
        return self._storage(v, X, R) + v["g2"][0, 0] * W.T @ W - Z.T @ Z - self._sector(v, "H2", Q, R)

    def positive(self, v: lmi.Values) -> Matrix:
        """Return ``V(x)`` less the multipliers; its matrix if it does not depend on the parameters."""
        if self.method == "quadratic":
            return v["V"]
        n, k, _ = self._sizes
        X, R = _unit(0, n, n + k), _unit(n, k, n + k)
        return self._storage(v, X, R) - self._sector(v, "H3", self.problem.C @ X, R)

    # ------------------------------------------------------------------ solving

    def solve(self, rate: float) -> Certificate | None:
        """Return the best certificate for one rate, verified, or None."""
        maps = [lambda v: self.dynamic(v, rate), self.output, self.positive]
        maps += [lambda v, name=name, rows=rows: v[name][np.ix_(rows, rows)] for name, rows in self._blocks]
        inequalities = [self.unknowns.coefficients(one) for one in maps]
        levels = [np.full(len(part.basis), float(part.name in ("g1", "g2"))) for part in self.unknowns.parts]
        cost = np.concatenate(levels)
        best: Certificate | None = None
        for margin in _MARGINS:
            x = lmi.solve(self.unknowns, inequalities, cost, margin=margin)
            solution = None if x is None else self._verified(self.unknowns.values(x), rate)
            if x is None or solution is None:
                continue
            if best is None or solution.bound < best.bound:
                best = solution
            # The levels that hold are far from those of the solver where it stopped at a nearly singular matrix.
            if best.bound <= float(np.sqrt(max(cost @ x, 0.0))) * (1 + _LOST):
                break
        return best

    def _verified(self, v: dict[str, Matrix], rate: float) -> Certificate | None:
        """Compute the levels anew from all other matrices, and check that every inequality holds strictly."""
        n, k, m = self._sizes
        none = v | {"g1": np.zeros((1, 1)), "g2": np.zeros((1, 1))}
        head = self.dynamic(none, rate)
        g1, g2 = lmi.least_level(head, len(head) - m), lmi.least_level(self.output(none), n + k)
        if not np.isfinite(g1 + g2):
            return None
        v = v | {"g1": np.full((1, 1), g1), "g2": np.full((1, 1), g2)}
        eigenvalues = {
            "decrease": lmi.smallest_eigenvalue(self.dynamic(v, rate)),
            "output": lmi.smallest_eigenvalue(self.output(v)),
            "storage": lmi.smallest_eigenvalue(self.positive(v)),
            "multipliers": min(
                (lmi.smallest_eigenvalue(v[name][np.ix_(rows, rows)]) for name, rows in self._blocks), default=np.inf
            ),
        }
        sure = eigenvalues["storage"] > 1e-13 * (n + k) and eigenvalues["multipliers"] >= 0
        sound = min(eigenvalues["decrease"], eigenvalues["output"]) > -1e-14 * len(head)
        return Certificate(rate, g1, g2, v, eigenvalues) if sure and sound else None


def _unit(start: int, count: int, width: int) -> Matrix:
    return np.eye(count, width, start)


def _form(L: Matrix, M: Matrix, R: Matrix) -> Matrix:
    """Return the symmetric matrix of ``2 (L s)' M (R s)``."""
    half = L.T @ M @ R
    return half + half.T
