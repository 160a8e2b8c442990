"""Filters as a textbook writes them, in the units of the plant and without a precaution: do they work where ours do?

Each returns the matrices of the filter, from ``[u, y]`` to residuals, and its state map ``T``; or raises.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

import residua as rs

Filter = tuple[rs.StateSpace, NDArray[np.float64]]


class NoFilterError(Exception):
    """The textbook has no filter here."""


def _gain(A: NDArray, C: NDArray, Q: NDArray, R: NDArray, sampled: bool) -> NDArray[np.float64]:
    """Return the gain of the Riccati equation of SciPy."""
    if sampled:
        P = scipy.linalg.solve_discrete_are(A.T, C.T, Q, R)
        return np.linalg.solve(C @ P @ C.T + R, C @ P @ A.T).T
    return np.linalg.solve(R, C @ scipy.linalg.solve_continuous_are(A.T, C.T, Q, R)).T


def _observer(plant: rs.Plant, T: NDArray, F: NDArray, K: NDArray, H: NDArray) -> Filter:
    """Return ``z' = F z + T B u + K (y - D u)``, ``r = (y - D u) - C (z + H (y - D u))``."""
    poles = np.linalg.eigvals(F)
    if not ((np.abs(poles) < 1) if plant.is_discrete else (poles.real < 0)).all():
        raise NoFilterError("not stable")
    through = np.eye(plant.n_outputs) - plant.C @ H
    B = np.hstack([T @ plant.B - K @ plant.D, K])
    return rs.StateSpace(F, B, -plant.C, np.hstack([-through @ plant.D, through]), dt=plant.dt), T


def kalman_filter(plant: rs.Plant) -> Filter:
    """``K = P C' R^-1`` for noise of variance .01 in every state and output."""
    n, p = plant.n_states, plant.n_outputs
    K = _gain(plant.A, plant.C, 1e-2 * np.eye(n), 1e-2 * np.eye(p), plant.is_discrete)
    return _observer(plant, np.eye(n), plant.A - K @ plant.C, K, np.zeros((n, p)))


luenberger_observer = kalman_filter


def unknown_input_observer(plant: rs.Plant) -> Filter:
    """``H = E (C E)^+``, ``T = I - H C``, ``A1 = T A``, a gain for ``(C, A1)``; Chen, Patton and Zhang (1996)."""
    n, p, E = plant.n_states, plant.n_outputs, plant.Bd
    if np.any(plant.Dd) or np.linalg.matrix_rank(plant.C @ E) < np.linalg.matrix_rank(E):
        raise NoFilterError("rank(CE) < rank(E)")
    H = E @ np.linalg.pinv(plant.C @ E)
    T = np.eye(n) - H @ plant.C
    K1 = _gain(T @ plant.A, plant.C, np.eye(n), np.eye(p), plant.is_discrete)
    F = T @ plant.A - K1 @ plant.C
    return _observer(plant, T, F, K1 + F @ H, H)


def detection_filter(plant: rs.Plant) -> Filter:
    """One fault ``b`` with ``C b`` not zero: ``K C b = A b + b``, the rest by a gain through what ``C b`` leaves."""
    n, p, b = plant.n_states, plant.n_outputs, plant.Bf[:, [0]]
    h = plant.C @ b
    if np.any(plant.Df[:, 0]) or not np.linalg.norm(h) > 1e-9 * np.linalg.norm(plant.C) * np.linalg.norm(b):
        raise NoFilterError("the fault is seen later than at once")
    first = (plant.A @ b + (0.5 if plant.is_discrete else 1) * b * (-1 if plant.is_discrete else 1)) @ np.linalg.pinv(h)
    rest = np.linalg.svd(h)[0][:, 1:].T
    if not len(rest):
        return _observer(plant, np.eye(n), plant.A - first @ plant.C, first, np.zeros((n, p)))
    A, C = plant.A - first @ plant.C, rest @ plant.C
    K = first + _gain(A, C, np.eye(n), np.eye(len(C)), plant.is_discrete) @ rest
    return _observer(plant, np.eye(n), plant.A - K @ plant.C, K, np.zeros((n, p)))


FILTERS = {
    "kalman_filter": kalman_filter,
    "luenberger_observer": luenberger_observer,
    "unknown_input_observer": unknown_input_observer,
    "detection_filter": detection_filter,
}
