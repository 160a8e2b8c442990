"""The peak norm's bound by a linear matrix inequality that weighs states and direct term together."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from residua.errors import AccuracyError
from residua.linear.norms import lmi
from residua.linear.norms.impulse_terms import StableSystem
from residua.linear.norms.star_norm import Ellipsoid

Matrix = NDArray[np.float64]
#: Strictness of the inequalities, in coordinates in which the ellipsoid of the star norm is the unit ball.
_MARGINS = (1e-6, 1e-4, 1e-3)


def lmi_peak(system: StableSystem, star: Ellipsoid) -> tuple[float, float, Matrix] | None:
    """Return the bound of the inequality, its rate and ellipsoid; ``None`` if the star norm is no larger."""
    lmi.require_solver()
    if not star.bound or not np.any(star.Q) or not np.any(system.C):
        return None
    # coordinates x = T z in which Q is the identity, and the star bound is the unit
    T = root(star.Q, 1e-6)
    inverse = np.linalg.inv(T)
    A, B, C, D = inverse @ system.A @ T, inverse @ system.B, system.C @ T / star.bound, system.D / star.bound
    room = 1 - system.radius**2
    best: list[tuple[float, float, Matrix]] = []

    def bound(t: float) -> float:
        rate = room / (1 + np.exp(-t))
        solved = _solve(A, B, C, D, rate)
        if solved is None:
            return 2.0
        best.append((solved[0], rate, solved[1]))
        return solved[0]

    centre = -float(np.log(room / star.rate - 1)) if star.rate < room else 20.0
    from scipy.optimize import minimize_scalar  # slow to import, and not needed to run a monitor

    minimize_scalar(bound, bounds=(centre - 1.5, centre + 1.5), method="bounded", options={"xatol": 1e-2})
    if not best:
        raise AccuracyError("no matrix inequality of the peak norm was solved and verified: use kind='star'")
    value, rate, P = min(best, key=lambda item: item[0])
    value *= star.bound
    if value >= star.bound:
        return None
    # x' P x <= g1 in scaled coordinates, g1 the first part of the bound's square.
    back = system.units[:, None] * T
    g1 = lmi.least_level(_dynamic(A, B, P, rate, 0.0), len(A))
    return value, rate, g1 * back @ np.linalg.solve(P, back.T)


def root(Q: Matrix, floor: float = 1e-8) -> Matrix:
    """Return ``T`` with ``T T' = Q``, invertible: directions that are not reached get a small extent of their own."""
    scale = np.sqrt(np.maximum(np.diagonal(Q), 0.0))
    scale = np.where(scale > 0, scale, 1.0)
    values, vectors = np.linalg.eigh(Q / scale[:, None] / scale)
    return scale[:, None] * vectors * np.sqrt(np.maximum(values, floor))


def _dynamic(A: Matrix, B: Matrix, P: Matrix, rate: float, g1: float) -> Matrix:
    both = np.hstack([A, B])
    n, m = B.shape
    out = -both.T @ P @ both
    out[:n, :n] += (1 - rate) * P
    out[n:, n:] += rate * g1 * np.eye(m)
    return out / rate


def _output(C: Matrix, D: Matrix, P: Matrix, g2: float) -> Matrix:
    both = np.hstack([C, D])
    n, m = C.shape[1], D.shape[1]
    out = -both.T @ both
    out[:n, :n] += P
    out[n:, n:] += g2 * np.eye(m)
    return out


def _solve(A: Matrix, B: Matrix, C: Matrix, D: Matrix, rate: float) -> tuple[float, Matrix] | None:
    """Return a bound that was verified, and its ``P``."""
    n = len(A)
    unknowns = lmi.Unknowns((lmi.symmetric("P", n), lmi.scalar("g1"), lmi.scalar("g2")))
    inequalities = [
        unknowns.coefficients(lambda v: _dynamic(A, B, v["P"], rate, float(v["g1"][0, 0]))),
        unknowns.coefficients(lambda v: _output(C, D, v["P"], float(v["g2"][0, 0]))),
    ]
    cost = np.zeros(unknowns.count)
    cost[-2:] = 1.0
    for margin in _MARGINS:
        x = lmi.solve(unknowns, inequalities, cost, margin=margin)
        if x is None:
            continue
        P = unknowns.values(x)["P"]
        g1 = lmi.least_level(_dynamic(A, B, P, rate, 0.0), n)
        g2 = lmi.least_level(_output(C, D, P, 0.0), n)
        if np.isfinite(g1 + g2):
            return float(np.sqrt(g1 + g2)), P
    return None
