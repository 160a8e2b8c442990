"""Gains that the search of a robust estimator begins with: Kalman gains, and the optimum of a convex problem."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from residua.errors import AccuracyError, DesignError
from residua.linear import StateSpace
from residua.linear.norms import lmi
from residua.linear.norms.peak_norm import peak_norm
from residua.linear.norms.peak_norm_lmi import root
from residua.linear.poles.riccati import filter_riccati
from residua.robust.estimators.estimator_family import EstimatorFamily
from residua.tolerances import TINY

Matrix = NDArray[np.float64]
#: How much noise is taken to drive the states, relative to the disturbances of the loop.
_LEVELS = (1e-4, 1e-2, 1e-1, 1.0, 1e1, 1e2, 1e4)
#: Rates that the convex problem is solved for.
_RATES = (0.05, 0.3, 0.8)
#: Strictness of its inequalities, in coordinates in which states are about one.
_MARGIN = 1e-5


@dataclass(frozen=True, eq=False)
class ErrorSystem:
    """The nominal error of every estimator of a family: ``e' = (A - Z C) e + (B - Z D) w``, ``r = g' (C e + D w)``."""

    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix


def error_system(family: EstimatorFamily) -> ErrorSystem:
    """Return the error system of a family, driven by the disturbances of the loop."""
    p, q = family.plant, family
    return ErrorSystem(q.A, family.state_map @ p.Bd - family.inject @ p.Dd, q.C, family.read @ p.Dd)


def starting_gains(family: EstimatorFamily, radius: float) -> list[Matrix]:
    """Return gains to begin with: none, Kalman gains for much and little noise, and the least star norm.

    Some of them have all poles within a radius, wherever there are any such: the Kalman gain of the system divided by
    the radius is stable for that one, and so within the radius for this.
    """
    system = error_system(family)
    slow = _kalman_gains(system)
    faster = ErrorSystem(system.A / radius, system.B, system.C / radius, system.D)
    gains = [np.zeros((family.order, family.rows)), *slow, *_kalman_gains(faster)]
    if lmi.has_solver() and family.order:
        gains += least_star_gains(system, _RATES)
    return [gain for gain in gains if np.isfinite(gain).all()]


def _kalman_gains(s: ErrorSystem) -> list[Matrix]:
    """Return the stationary gains for white noise instead of the disturbances, at several levels."""
    drive, seen = s.B @ s.B.T, s.D @ s.D.T
    drive = drive + 1e-6 * max(float(np.trace(drive)), 1e-12) / max(len(drive), 1) * np.eye(len(drive))
    seen = seen + 1e-6 * max(float(np.trace(seen)), float(np.trace(s.C @ drive @ s.C.T)), 1e-12) * np.eye(len(seen))
    out = []
    for level in _LEVELS:
        with suppress(DesignError, AccuracyError):
            out.append(np.asarray(filter_riccati(s.A, s.C, level * drive, seen, dt=1.0).gain))
    return out


def least_star_gains(s: ErrorSystem, rates: Iterable[float]) -> list[Matrix]:
    r"""Return the gains with the least star norm from disturbances to all rows of the residual, one for each rate.

    None for rates at which there is none. The problem is scaled with a Kalman gain, in coordinates ``e = T z`` in which
    that leaves errors of about one, and residuals too. With :math:`Y = P Z`, minimise :math:`g_1 + g_2` subject to

    .. math::

       \begin{bmatrix} (1-\lambda) P & 0 & (PA - YC)^T \\ 0 & \lambda g_1 I & (PB - YD)^T \\ * & * & P \end{bmatrix}
       \ge 0, \qquad
       \begin{bmatrix} P & 0 & C^T \\ 0 & g_2 I & D^T \\ C & D & I \end{bmatrix} \ge 0

    Convex: no other gain has a smaller bound at this rate. Nearly blind to faults, and so only where a search begins.
    """
    for gain in reversed(_kalman_gains(s)):
        closed = StateSpace(s.A - gain @ s.C, s.B - gain @ s.D, s.C, s.D, dt=1.0)
        with suppress(AccuracyError):
            ellipsoid = peak_norm(closed, kind="star").ellipsoid if closed.is_stable() else None
            if ellipsoid is not None and np.any(ellipsoid):
                break
    else:
        return []
    T = root(ellipsoid, 1e-6)
    unit = max(float(np.linalg.norm(s.C @ T, 2)), float(np.linalg.norm(s.D, 2)), TINY)
    back = np.linalg.inv(T)
    A, B, C, D = back @ s.A @ T, back @ s.B, s.C @ T / unit, s.D / unit
    (n, m), p = B.shape, len(C)
    full = lmi.Unknown("Y", np.eye(n * p).reshape(n * p, n, p))
    unknowns = lmi.Unknowns((lmi.symmetric("P", n), full, lmi.scalar("g1"), lmi.scalar("g2")))

    def dynamics(v: lmi.Values, rate: float) -> Matrix:
        P, Y, g1 = v["P"], v["Y"], v["g1"][0, 0]
        low = np.hstack([P @ A - Y @ C, P @ B - Y @ D])
        top = np.zeros((n + m, n + m))
        top[:n, :n], top[n:, n:] = (1 - rate) * P, rate * g1 * np.eye(m)
        return np.block([[top, low.T], [low, P]])

    def output(v: lmi.Values) -> Matrix:
        top = np.zeros((n + m, n + m))
        top[:n, :n], top[n:, n:] = v["P"], v["g2"][0, 0] * np.eye(m)
        row = np.hstack([C, D])
        # the constant block belongs to the map, which stays affine
        return np.block([[top, row.T], [row, np.eye(p)]])

    cost, gains = np.zeros(unknowns.count), []
    cost[-2:] = 1.0
    for rate in rates:
        maps = [unknowns.coefficients(one) for one in (partial(dynamics, rate=rate), output)]
        x = lmi.solve(unknowns, maps, cost, margin=_MARGIN)
        v = {} if x is None else unknowns.values(x)
        if v and lmi.smallest_eigenvalue(v["P"]) > 0:
            gains.append(T @ np.linalg.solve(v["P"], v["Y"]) / unit)
    return gains
