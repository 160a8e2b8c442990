"""The states of a filter as functions of those of the plant, for a filter that was not made from such a map."""

from __future__ import annotations

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from residua.linear import StateSpace
from residua.linear.subspaces.quotient import observable_split
from residua.linear.systems.scaling import power_near
from residua.plant import Plant
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
    """
    states, rows = _sizes(system, plant)
    A, C = system.A / states[:, None] * states, system.C * states
    split = observable_split(A / power_near(np.abs(A).max(initial=0.0)), rows * C)
    if split.hidden.shape[1]:
        O = split.seen  # noqa: E741
        system = system.replaced(A=O.T @ A @ O, B=O.T / states @ system.B, C=C @ O, states=None)
    T = state_map(system, plant)
    return system, T, static_map(system, plant, T)


def state_map(system: StateSpace, plant: Plant) -> Matrix:
    r"""Return the ``T`` of `state_map_of`; one of those that there are where the filter does not show all its states.

    A Schur form of the plant, its finite modes first, gives ``T`` column by column, whatever modes plant and filter
    share: of a mode :math:`\lambda`, :math:`[\lambda - F; L]` has full column rank where ``L`` sees all of ``F``.

    References
    ----------
    Golub, Nash and Van Loan (1979), IEEE TAC 24(6): the Sylvester equation by columns of a Schur form.
    """
    model, n_u, k = plant.balanced, len(plant.inputs), system.n_states
    (A, C, E), rate, Y = model.written, model.units.rate, model.units.outputs
    states, rows = _sizes(system, plant)
    F, L = system.A / states[:, None] * states / rate, rows * system.C * states
    n, finite = plant.n_states, len(model.dynamics)
    if plant.E is None:
        S, Z = scipy.linalg.schur(A, output="complex") if n else (A, A)
        P, Q = E, Z
    else:

        def finite_first(alpha: Columns, beta: Columns) -> NDArray[np.bool_]:
            order = np.argsort(-np.abs(beta) / np.hypot(np.abs(alpha), np.abs(beta)))
            return np.isin(np.arange(n), order[:finite])

        S, P, _, _, Q, Z = scipy.linalg.ordqz(A, E, sort=finite_first, output="complex")
    G, J = system.B[:, n_u:] / states[:, None] / Y / rate @ C @ Z, rows * system.D[:, n_u:] / Y @ C @ Z
    X = np.zeros((k, n), dtype=complex)
    for j in range(n if k else 0):
        before = X[:, :j] @ P[:j, j]
        pencil, right = S[j, j] * np.eye(k) - P[j, j] * F, G[:, j] + F @ before - X[:, :j] @ S[:j, j]
        if j < finite:  # where V reads nothing
            pencil, right = np.vstack([pencil, P[j, j] * L]), np.concatenate([right, -J[:, j] - L @ before])
        X[:, j] = scipy.linalg.lstsq(pencil, right, lapack_driver="gelsy")[0]
    T = np.asarray((X @ Q.conj().T).real, dtype=np.float64)
    T[np.abs(T).max(axis=1, initial=0.0) < BALANCED_RANK] = 0.0  # states that signals move but the plant does not
    return states[:, None] * T * model.units.equations


def static_map(system: StateSpace, plant: Plant, T: Matrix) -> Matrix | None:
    """Return the ``V`` of `state_map_of`: how a filter reads the algebraic equations of its plant, if it has any."""
    model, n_u = plant.balanced, len(plant.inputs)
    if not len(model.algebra):
        return None
    (A, C, E), units, rows = model.written, model.units, _sizes(system, plant)[1]
    missing = rows * system.C @ (T / units.equations) @ E + rows * system.D[:, n_u:] / units.outputs @ C
    read = np.linalg.lstsq((model.algebra @ A).T, missing.T, rcond=BALANCED_RANK)[0].T
    read[np.abs(read).max(axis=1, initial=0.0) < BALANCED_RANK] = 0.0  # a residual that reads none
    return -read @ model.algebra * units.equations / rows / units.rate


def _sizes(system: StateSpace, plant: Plant) -> tuple[Matrix, Matrix]:
    """Return how large balanced signals make the states of a filter, and factors that make its outputs near one.

    Powers of two; one for states that no signal reaches.
    """
    units, k = plant.balanced.units, system.n_states
    signals = np.concatenate([units.inputs[: len(plant.inputs)], 1 / units.outputs])
    points = np.exp(1j * _ANGLES) if system.is_discrete else 1j * units.rate * _ANGLES
    responses = np.linalg.solve(points[:, None, None] * np.eye(k) - system.A, (system.B * signals).astype(complex))
    states = power_near(np.abs(responses).max(axis=(0, 2), initial=0.0))
    whole = np.abs(np.hstack([system.C * states, system.D * signals]))
    return states, 1 / power_near(whole.max(axis=1, initial=0.0))[:, None]
