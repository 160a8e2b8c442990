"""Gains that the search of a robust estimator begins with: Kalman gains, and the optimum of a convex problem."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

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

    Some of them have all poles within a radius, wherever there are any such.
    """
    system = error_system(family)
    # the Kalman gain of the system divided by the radius is stable for that one, and so within the radius for this
    faster = ErrorSystem(system.A / radius, system.B, system.C / radius, system.D)
    slow = _kalman_gains(system)
    gains = [np.zeros((family.order, family.rows)), *slow, *_kalman_gains(faster)]
    if lmi.has_solver() and family.order:
        gains += least_star_gains(system, _RATES, slow)
    return [gain for gain in gains if np.isfinite(gain).all()]


def _kalman_gains(s: ErrorSystem) -> list[Matrix]:
    """Return the stationary gains for white noise instead of the disturbances, at several levels."""
    drive, seen = s.B @ s.B.T, s.D @ s.D.T
    drive = drive + 1e-6 * max(float(np.trace(drive)), 1e-12) / max(len(drive), 1) * np.eye(len(drive))
    seen = seen + 1e-6 * max(float(np.trace(seen)), float(np.trace(s.C @ drive @ s.C.T)), 1e-12) * np.eye(len(seen))
    out = []
    for level in _LEVELS:
        try:
            out.append(np.asarray(filter_riccati(s.A, s.C, level * drive, seen, dt=1.0).gain))
        except (DesignError, AccuracyError):
            continue
    return out


def least_star_gains(s: ErrorSystem, rates: Iterable[float], stable: list[Matrix] | None = None) -> list[Matrix]:
    r"""Return the gains with the least star norm from disturbances to all rows of the residual, one for each rate.

    None for rates at which there is none. The problem is scaled with one of the gains ``stable``, Kalman gains when
    omitted. With :math:`Y = P Z`, minimise :math:`g_1 + g_2` subject to

    .. math::

       \begin{bmatrix} (1-\lambda) P & 0 & (PA - YC)^T \\ 0 & \lambda g_1 I & (PB - YD)^T \\ * & * & P \end{bmatrix}
       \ge 0, \qquad
       \begin{bmatrix} P & 0 & C^T \\ 0 & g_2 I & D^T \\ C & D & I \end{bmatrix} \ge 0

    Convex: no other gain has a smaller bound at this rate. Nearly blind to faults, and so only where a search begins.
    """
    scaled = _scaled(s, _kalman_gains(s) if stable is None else stable)
    if scaled is None:
        return []
    gains = (_least_star_gain(scaled, rate) for rate in rates)
    return [scaled.T @ gain / scaled.unit for gain in gains if gain is not None]


def _least_star_gain(s: _Scaled, rate: float) -> Matrix | None:
    """Return the gain with the least star norm for one rate, in scaled coordinates."""
    A, B, C, D = s.A, s.B, s.C, s.D
    (n, m), p = B.shape, len(C)
    full = lmi.Unknown("Y", np.eye(n * p).reshape(n * p, n, p))
    unknowns = lmi.Unknowns((lmi.symmetric("P", n), full, lmi.scalar("g1"), lmi.scalar("g2")))

    def dynamics(v: lmi.Values) -> Matrix:
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

    cost = np.zeros(unknowns.count)
    cost[-2:] = 1.0
    x = lmi.solve(unknowns, [unknowns.coefficients(dynamics), unknowns.coefficients(output)], cost, margin=_MARGIN)
    if x is None:
        return None
    v = unknowns.values(x)
    if lmi.smallest_eigenvalue(v["P"]) <= 0:
        return None
    return np.asarray(np.linalg.solve(v["P"], v["Y"]), dtype=float)


@dataclass(frozen=True, eq=False)
class _Scaled(ErrorSystem):
    """An error system in coordinates ``e = T z`` in which a gain leaves errors of about one, and residuals too."""

    T: Matrix
    unit: float


def _scaled(s: ErrorSystem, gains: list[Matrix]) -> _Scaled | None:
    for gain in reversed(gains):
        closed = StateSpace(s.A - gain @ s.C, s.B - gain @ s.D, s.C, s.D, dt=1.0)
        if not closed.is_stable():
            continue
        try:
            ellipsoid = peak_norm(closed, kind="star").ellipsoid
        except AccuracyError:
            continue
        if ellipsoid is None or not np.any(ellipsoid):
            continue
        T = root(ellipsoid, 1e-6)
        size = max(float(np.linalg.norm(s.C @ T, 2)), float(np.linalg.norm(s.D, 2)), TINY)
        back = np.linalg.inv(T)
        return _Scaled(back @ s.A @ T, back @ s.B, s.C @ T / size, s.D / size, T, size)
    return None
