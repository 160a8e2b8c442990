"""The states of a filter as functions of those of the plant, for a filter that was not made from such a map."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from residua.linear import StateSpace
from residua.linear.subspaces.quotient import observable_split, quotient
from residua.plant import Plant
from residua.plant.balanced import BalancedPlant
from residua.tolerances import BALANCED_RANK

Matrix = NDArray[np.float64]
Columns = NDArray[np.complex128]
#: Where the states of a filter are compared: per sample, or in units of the rate of the plant.
_ANGLES = np.array([0.1, 0.7, 2.5])


def state_map_of(system: StateSpace, plant: Plant) -> tuple[StateSpace, Matrix, Matrix | None]:
    r"""Return a filter without the states that it does not show, and its states as a function of those of the plant.

    Of a filter :math:`\dot\xi = F \xi + G_u u + G_y y, \; r = L \xi + J_u u + J_y y`, ``L`` seeing all of ``F``, whose
    residual is zero whatever a controllable plant does, :math:`\xi = T E x` with the one ``T`` that solves

    .. math:: F T E + G_y C = T A, \qquad L T E + J_y C + V A = 0, \qquad V E = 0

    and then :math:`T B = G_u + G_y D` and :math:`J_u + J_y D + V B = 0`. Of another filter these are missed.

    Parameters
    ----------
    system : StateSpace
        From controls and outputs of the plant to residuals.
    plant : Plant

    Returns
    -------
    StateSpace
        The filter itself where it shows all of its states.
    ndarray, shape (states of that filter, n)
        ``T``, by least squares where nothing solves the equations.
    ndarray, shape (residuals, n), or None
        ``V``; none where ``E`` is invertible.

    Notes
    -----
    A Schur form of the plant, its finite modes first, gives ``T`` column by column, whatever modes plant and filter
    share: of a mode :math:`\lambda`, :math:`[\lambda - F; L]` has full column rank, as ``L`` sees all of ``F``.

    References
    ----------
    Golub, Nash and Van Loan (1979), IEEE TAC 24(6): the Sylvester equation by columns of a Schur form.
    """
    model, n_u = plant.balanced, len(plant.inputs)
    units = model.units
    signals = np.concatenate([units.inputs[:n_u], 1 / units.outputs])
    states = _sizes(system, system.B * signals, units.rate)
    A, L = system.A / states[:, None] * states / units.rate, system.C * states
    rows = 1 / _power(np.abs(np.hstack([L, system.D * signals])).max(axis=1, initial=0.0))[:, None]
    split = observable_split(A / _power(np.abs(A).max(initial=0.0)), rows * L)
    if split.hidden.shape[1]:
        O = split.seen  # noqa: E741
        A, L = O.T @ A @ O, L @ O
        system = system.replaced(A=units.rate * A, B=O.T / states @ system.B, C=L, states=None)
        states = np.ones(len(A))
    G, J = (M[:, n_u:] / units.outputs for M in (system.B / states[:, None] / units.rate, rows * system.D))
    T, V = _solved(A, G, rows * L, J, model)
    T = states[:, None] * T * units.equations
    return system, T, None if V is None else V * units.equations / rows / units.rate


def _sizes(system: StateSpace, B: Matrix, rate: float) -> Matrix:
    """Return how large inputs of unit size make the states of a filter; 1 for those that they do not reach."""
    points = np.exp(1j * _ANGLES) if system.is_discrete else 1j * rate * _ANGLES
    responses = np.linalg.solve(points[:, None, None] * np.eye(len(B)) - system.A, B.astype(complex))
    return _power(np.abs(responses).max(axis=(0, 2), initial=0.0))


def _power(size: Matrix | float) -> Matrix:
    """Return powers of two near sizes; 1 for zero."""
    return np.exp2(np.round(np.log2(np.where(np.asarray(size) > 0, size, 1.0))))


def _solved(F: Matrix, G: Matrix, L: Matrix, J: Matrix, model: BalancedPlant) -> tuple[Matrix, Matrix | None]:
    """Return ``T`` and ``V`` of a balanced filter."""
    p, n, k = model.plant, model.plant.n_states, len(F)
    R, X = model.units.equations[:, None], model.units.states
    A, C = R * p.A * X / model.units.rate, model.units.outputs[:, None] * p.C * X
    if p.E is None:
        E, finite = np.eye(n), n
        S, Z = scipy.linalg.schur(A, output="complex") if n else (A, A)
        P, Q = E, Z
    else:
        E, outputs = R * p.E * X, p.n_outputs
        # what is left of the equations when the variables without one of their own are divided out has the finite modes
        finite = len(quotient(model.A, model.free[0], model.C[outputs:], model.free[1][outputs:]).A)
        S, P, _, _, Q, Z = scipy.linalg.ordqz(A, E, sort=_most_finite(finite), output="complex")
    GC, JC, T = G @ C @ Z, J @ C @ Z, np.zeros((k, n), dtype=complex)
    for j in range(n):
        before = T[:, :j] @ P[:j, j]
        pencil, right = S[j, j] * np.eye(k) - P[j, j] * F, GC[:, j] + F @ before - T[:, :j] @ S[:j, j]
        if j < finite:  # where V reads nothing
            pencil, right = np.vstack([pencil, P[j, j] * L]), np.concatenate([right, -JC[:, j] - L @ before])
        T[:, j] = scipy.linalg.lstsq(pencil, right, lapack_driver="gelsy")[0] if k else 0.0
    T = np.asarray((T @ Q.conj().T).real, dtype=np.float64)
    if not len(model.algebra):
        return T, None
    missing = L @ T @ E + J @ C
    return T, -np.linalg.lstsq((model.algebra @ A).T, missing.T, rcond=BALANCED_RANK)[0].T @ model.algebra


def _most_finite(count: int) -> Callable[[Columns, Columns], NDArray[np.bool_]]:
    """Return what orders the eigenvalues ``alpha / beta`` of a pencil: some number of them first."""

    def first(alpha: Columns, beta: Columns) -> NDArray[np.bool_]:
        chosen = np.zeros(len(alpha), dtype=bool)
        chosen[np.argsort(-np.abs(beta) / np.hypot(np.abs(alpha), np.abs(beta)))[:count]] = True
        return chosen

    return first
