"""Filters as a textbook writes them, in the units of the plant and without a precaution: do they work where ours do?

Each takes a plant and returns its filters, from ``[u, y]`` to residuals, each with the plant that it is of, its state
map ``T`` and its estimate of the state, ``M z + H (y - D u)``; or it raises :class:`NoFilterError` where the textbook
has none. :func:`verdict` says whether all of them are stable, keep known inputs below 1e-6 of the terms that cancel,
and answer to a fault, or estimate the state to 1e-6.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

import residua as rs
from residua.errors import ResiduaError

Matrix = NDArray[np.float64]
Filter = tuple[rs.StateSpace, rs.Plant, Matrix, rs.StateSpace | None]
#: The longest window of parity relations.
_LONGEST = 20
#: Poles of a stable filter are farther inside than this, relative to the fastest.
_STABLE = 1e-12
#: A fault that a residual answers to changes it by more, relative to the terms.
_ANSWERS = 1e-6


class NoFilterError(Exception):
    """The textbook has no filter here."""


def verdict(name: str, plant: rs.Plant) -> str:
    """Return whether the filters of a design work on a plant: works, leaks, none; empty where there is no textbook."""
    from residua.design.core.decoupling import leak  # an older source, whose speed is compared, has none
    from residua.tolerances import LEAK

    if name not in FILTERS:
        return ""
    try:
        made = FILTERS[name](plant.explicit())
        for system, of, *_ in made:
            poles = np.linalg.eigvals(system.A)
            inside = 1 - np.abs(poles) if of.is_discrete else -poles.real / (np.abs(poles).max(initial=0.0) or 1.0)
            if not (inside > _STABLE).all():
                raise NoFilterError("not stable")
        if name in _RESIDUALS and not any(_answers(system, of) for system, of, *_ in made):
            raise NoFilterError("blind")
        gains = [leak(system, of, T).gains.max(initial=0.0) for system, of, T, _ in made]
        for _, of, T, estimate in made if name in _ESTIMATES else ():
            assert estimate is not None
            gains.append(leak(estimate, of, T, estimate=np.eye(of.n_states)).gains.max(initial=0.0))
    except (NoFilterError, np.linalg.LinAlgError, ValueError, ResiduaError):
        return "none"
    return "works" if max(gains, default=0.0) <= LEAK else "leaks"


def _answers(system: rs.StateSpace, plant: rs.Plant) -> bool:
    """Tell whether a residual answers to a fault at some frequency."""
    rates = np.abs(np.linalg.eigvals(plant.A))
    w = np.geomspace(1e-2, 3, 5) / plant.dt if plant.is_discrete else np.geomspace(0.1, 10, 5) * (rates.mean() or 1.0)
    Q = system.frequency_response(w)[:, :, len(plant.inputs) :]
    P = plant.system(("fault",)).frequency_response(w)
    return bool((np.abs(Q @ P) > _ANSWERS * (np.abs(Q) @ np.abs(P)).max(initial=0.0)).any())


def _gain(A: Matrix, C: Matrix, plant: rs.Plant, weight: float = 1.0) -> Matrix:
    """Return the gain of the Riccati equation of SciPy for noise of equal variance in all states and outputs."""
    Q, R = weight * np.eye(len(A)), weight * np.eye(len(C))
    if plant.is_discrete:
        P = scipy.linalg.solve_discrete_are(A.T, C.T, Q, R)
        return np.linalg.solve(C @ P @ C.T + R, C @ P @ A.T).T
    return np.linalg.solve(R, C @ scipy.linalg.solve_continuous_are(A.T, C.T, Q, R)).T


def _observer(plant: rs.Plant, T: Matrix, F: Matrix, K: Matrix, M: Matrix, H: Matrix) -> Filter:
    """Return ``z' = F z + T B u + K (y - D u)``, ``x = M z + H (y - D u)``, ``r = (y - D u) - C x``."""
    through = np.eye(plant.n_outputs) - plant.C @ H
    B, D = np.hstack([T @ plant.B - K @ plant.D, K]), np.hstack([-through @ plant.D, through])
    residual = rs.StateSpace(F, B, -plant.C @ M, D, dt=plant.dt)
    return residual, plant, T, rs.StateSpace(F, B, M, np.hstack([-H @ plant.D, H]), dt=plant.dt)


def kalman_filter(plant: rs.Plant) -> list[Filter]:
    """``K = P C' R^-1`` for noise of variance .01 in every state and output."""
    n, p = plant.n_states, plant.n_outputs
    K = _gain(plant.A, plant.C, plant, 1e-2)
    return [_observer(plant, np.eye(n), plant.A - K @ plant.C, K, np.eye(n), np.zeros((n, p)))]


def reduced_order_observer(plant: rs.Plant) -> list[Filter]:
    """The first output unfiltered, ``z = w - L y1``, ``w' = A22 w + A21 y1 + B2 u``; Luenberger (1971)."""
    n, p, C1 = plant.n_states, plant.n_outputs, plant.C[[0]]
    if np.any(plant.D) or not np.any(C1) or n < 2:
        raise NoFilterError("D is not zero, or nothing is left")
    V: Matrix = np.hstack([np.linalg.pinv(C1), scipy.linalg.null_space(C1)], dtype=np.float64)
    A: Matrix = np.asarray(np.linalg.solve(V, plant.A @ V), dtype=np.float64)
    L = _gain(A[1:, 1:], A[:1, 1:], plant)
    F, T = A[1:, 1:] - L @ A[:1, 1:], np.hstack([-L, np.eye(n - 1)]) @ np.linalg.inv(V)
    first = np.eye(1, p)
    K = (F @ L + A[1:, :1] - L @ A[:1, :1]) @ first
    return [_observer(plant, T, F, K, V[:, 1:], V @ np.vstack([np.eye(1), L]) @ first)]


def unknown_input_observer(plant: rs.Plant) -> list[Filter]:
    """``H = E (C E)^+``, ``T = I - H C``, a gain for ``(C, T A)``; Chen, Patton and Zhang (1996)."""
    H, T = _decoupling(plant)
    K1 = _gain(T @ plant.A, plant.C, plant)
    F = T @ plant.A - K1 @ plant.C
    return [_observer(plant, T, F, K1 + F @ H, np.eye(len(F)), H)]


def _decoupling(plant: rs.Plant) -> tuple[Matrix, Matrix]:
    E = plant.Bd
    if np.any(plant.Dd) or np.linalg.matrix_rank(plant.C @ E) < np.linalg.matrix_rank(E):
        raise NoFilterError("rank(CE) < rank(E)")
    H = E @ np.linalg.pinv(plant.C @ E)
    return H, np.eye(plant.n_states) - H @ plant.C


def parity_relations(plant: rs.Plant) -> list[Filter]:
    """The shortest window of Chow and Willsky, by powers of ``A``, as a filter of that order; Ding (2008), chapter 7.

    ``w_0..w_s`` annihilate ``C, C A, ...`` and the disturbances; the rows of ``T`` are ``sum_j>i w_j C A^(j-i-1)``.
    """
    rate = 1.0 if plant.is_discrete else float(np.abs(np.linalg.eigvals(plant.A)).max()) or 1.0
    A, E, none = plant.A / rate, plant.Bd / rate, np.zeros_like(plant.Dd)
    powers, markov = [plant.C], [plant.Dd]
    for s in range(1, min(plant.n_states, _LONGEST) + 1):
        markov.append(powers[-1] @ E)
        powers.append(powers[-1] @ A)
        H = np.block([[markov[i - j] if i >= j else none for j in range(s + 1)] for i in range(s + 1)])
        U, size, _ = np.linalg.svd(np.hstack([np.vstack(powers), H]))
        if int((size > 1e-10 * size[0]).sum()) == len(U):
            continue
        w = U[:, -1].reshape(s + 1, plant.n_outputs)
        T = np.array([sum(w[j] @ powers[j - i - 1] for j in range(i + 1, s + 1)) for i in range(s)])
        k = np.zeros(s) if plant.is_discrete else np.poly(np.full(s, -0.5))[:0:-1]
        F = np.eye(s, k=-1) - np.outer(k, np.eye(1, s, s - 1))
        K = -w[:s] + np.outer(k, w[s])
        B = np.hstack([T @ plant.B - rate * K @ plant.D, rate * K])
        system = rs.StateSpace(rate * F, B, -np.eye(1, s, s - 1), [[*-w[s] @ plant.D, *w[s]]], dt=plant.dt)
        return [(system, plant, T, None)]
    raise NoFilterError("no window")


def detection_filter(plant: rs.Plant) -> list[Filter]:
    """One fault ``b`` with ``C b`` not zero: ``K C b = A b + b``, the rest by a gain through what ``C b`` leaves."""
    n, p = plant.n_states, plant.n_outputs
    K = _directional(plant, np.eye(n))
    return [_observer(plant, np.eye(n), plant.A - K @ plant.C, K, np.eye(n), np.zeros((n, p)))]


def robust_detection_filter(plant: rs.Plant) -> list[Filter]:
    """The same behind the decoupling of an unknown input observer; Chen and Patton (1999), section 4.4."""
    H, T = _decoupling(plant)
    K1 = _directional(plant, T)
    F = T @ plant.A - K1 @ plant.C
    return [_observer(plant, T, F, K1 + F @ H, np.eye(len(F)), H)]


def _directional(plant: rs.Plant, T: Matrix) -> Matrix:
    A, b = T @ plant.A, T @ plant.Bf[:, [0]]
    h = plant.C @ b
    if np.any(plant.Df[:, 0]) or not np.linalg.norm(h) > 1e-9 * np.linalg.norm(plant.C) * np.linalg.norm(b):
        raise NoFilterError("the fault is seen later than at once")
    first = (A @ b - (0.5 if plant.is_discrete else -1.0) * b) @ np.linalg.pinv(h)
    rest = np.linalg.svd(h)[0][:, 1:].T
    return first + _gain(A - first @ plant.C, rest @ plant.C, plant) @ rest if len(rest) else first


def fault_estimator(plant: rs.Plant) -> list[Filter]:
    """An unknown input observer with the faults among the disturbances, if these are independent."""
    both = _ignoring(plant, list(range(len(plant.faults))))
    if np.linalg.matrix_rank(both.Bd) < len(both.disturbances):
        raise NoFilterError("the faults are not independent of the disturbances")
    return unknown_input_observer(both)


def sensor_fault_bank(plant: rs.Plant) -> list[Filter]:
    """An observer without each faulty sensor in turn."""
    return [one for j in range(len(plant.faults)) for one in unknown_input_observer(_ignoring(plant, [j]))]


def structured_bank(plant: rs.Plant) -> list[Filter]:
    """An unknown input observer for each row of the code, which ignores its faults."""
    rows = rs.coding.attainable(plant).digits[:4]
    ignored = [[j for j, digit in enumerate(row) if digit == "0"] for row in rows]
    return [one for faults in ignored for one in unknown_input_observer(_ignoring(plant, faults))]


def _ignoring(plant: rs.Plant, faults: list[int]) -> rs.Plant:
    """Return a plant without the outputs of faulty sensors, and with other faults among the disturbances."""
    sensors = [j for j in faults if not np.any(plant.Bf[:, j])]
    rows = ~np.any(plant.Df[:, sensors], axis=1)
    others = [j for j in faults if j not in sensors]
    B, D = (np.hstack([d, f[:, others]]) for d, f in ((plant.Bd, plant.Bf), (plant.Dd, plant.Df)))
    made = rs.Plant(plant.A, plant.B, plant.C[rows], plant.D[rows], dt=plant.dt)
    return made.with_disturbances(B, output=D[rows]) if B.shape[1] else made


FILTERS: dict[str, Callable[[rs.Plant], list[Filter]]] = {
    "kalman_filter": kalman_filter,
    "luenberger_observer": kalman_filter,
    "reduced_order_observer": reduced_order_observer,
    "unknown_input_observer": unknown_input_observer,
    "decoupled_residual": unknown_input_observer,
    "parity_relations": parity_relations,
    "detection_filter": detection_filter,
    "robust_detection_filter": robust_detection_filter,
    "fault_estimator": fault_estimator,
    "sensor_fault_bank": sensor_fault_bank,
    "structured_bank": structured_bank,
}
#: Designs that estimate the state.
_ESTIMATES = ("luenberger_observer", "reduced_order_observer", "unknown_input_observer")
#: Designs that are residuals, which have to answer to a fault.
_RESIDUALS = ("decoupled_residual", "parity_relations", "detection_filter", "robust_detection_filter")
