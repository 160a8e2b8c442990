"""The check of an ellipsoid with the original system: it shows what scaling and solving have rounded."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.linear.subspaces.rank import spectral_norm
from residua.robust.bounds.scaled_problem import ScaledProblem
from residua.robust.bounds.weighted_star import CommonEllipsoid
from residua.robust.sets.uncertain_system import UncertainSystem

Matrix = NDArray[np.float64]
#: The share of a parameter that was left out as rounding.
_LEFT_OUT = 1e-9
#: Rounding of one product of matrices, relative to that of their absolute values, per row.
_ROUNDING = 4 * np.finfo(float).eps


#: What is added to the ellipsoid, relative to its size, until rounding cannot matter.
_ADDED = (0.0, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4)


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
    terms, outputs, B, direct = _parts(system)
    size = float(np.trace(star.Q)) / max(len(star.Q), 1)
    for added in _ADDED:
        Q = problem.T @ (star.Q + added * size * star.spare) @ problem.T.T
        Q = (Q + Q.T) / 2
        least = _least(Q, terms, B, shares)
        if least > 0:
            return VerifiedEllipsoid(_largest_output(Q, outputs) + direct, Q, shares, least)
    return None


def _parts(system: UncertainSystem) -> tuple[list[Matrix], list[Matrix], Matrix, float]:
    """Return what the next state and the output are sums of: the middle of the set, and half widths of parameters."""
    middle = system.member((system.low + system.high) / 2)
    own, half = np.array(system.channels, dtype=int), (system.high - system.low) / 2
    terms, outputs = [middle.A], [middle.C]
    for i in range(system.n_parameters):
        C = half[i] * system.Cq[own == i]
        terms.append(system.Bp[:, own == i] @ C)
        outputs.append(system.Dzp[:, own == i] @ C)
    return terms, outputs, middle.B, spectral_norm(middle.D)


def _least(Q: Matrix, terms: list[Matrix], B: Matrix, shares: NDArray[np.float64]) -> float:
    """Return the smallest eigenvalue of the inequality, in units of the extents of ``Q``, less what is rounding."""
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


def _largest_output(Q: Matrix, outputs: list[Matrix]) -> float:
    """Return what the outputs reach on the ellipsoid, one part after the other, with what rounding may hide."""
    bound = 0.0
    for C in outputs:
        rounded = _ROUNDING * len(Q) * float(np.trace(np.abs(C) @ np.abs(Q) @ np.abs(C).T))
        values = np.linalg.eigvalsh(C @ Q @ C.T)
        bound += float(np.sqrt(max(values[-1], 0.0) + rounded)) if len(values) and np.any(C) else 0.0
    return bound
