"""Sensor faults as actuator faults: a filter on the measurement, included in the plant."""

from __future__ import annotations

from collections.abc import Iterable
from typing import cast

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from residua import arrays
from residua.arrays import frozen
from residua.errors import ModelError
from residua.linear import StateSpace
from residua.plant.channels import ROLES
from residua.plant.plant import Plant


def augment_sensor_filter(plant: Plant, outputs: Iterable[str | int] | str, rate: ArrayLike) -> Plant:
    r"""Return the plant with a first-order filter on chosen outputs, so that their faults enter a state.

    .. math:: \dot x_s = a (y_j - x_s)

    and :math:`x_s` is the output in place of :math:`y_j`. A fault, disturbance or noise of that sensor then enters
    the state equation and no output: methods for actuator faults apply to sensor faults. In sampled time the
    pole is at :math:`e^{-a\,dt}`. The recorded measurements have to pass through the same filter first, see
    :func:`sensor_filter`. (:func:`residua.design.fault_estimator` takes sensor faults as they are.)

    Parameters
    ----------
    plant : Plant
    outputs : sequence of str or int
        The outputs to filter.
    rate : float or array_like, shape (number of outputs,)
        ``a`` in 1/s, positive.

    Returns
    -------
    Plant
        With one more state, ``"<output> filtered"``, per filtered output; its outputs keep their names.

    Raises
    ------
    ModelError
        If an output does not exist, is named twice, or a rate is not positive.

    References
    ----------
    Sueur, Observer-based actuator and sensor fault estimation, eqs. (13) and (14).

    Examples
    --------
    >>> import residua as rs
    >>> aircraft = rs.plant.augment_sensor_filter(rs.library.vtol(), ["v_horizontal"], 25)
    >>> aircraft.A[4], aircraft.Bf[4, 2]
    (array([ 25.,   0.,   0.,   0., -25.]), np.float64(25.0))
    """
    rows, pole, gain = _lags(plant, outputs, rate)
    k, n = len(rows), plant.n_states
    C = np.hstack([plant.C, np.zeros((plant.n_outputs, k))])
    C[rows] = np.hstack([np.zeros((k, n)), np.eye(k)])
    changes: dict[str, object] = {
        "A": frozen(np.block([[plant.A, np.zeros((n, k))], [gain[:, None] * plant.C[rows], np.diag(pole)]])),
        "C": frozen(C),
        "E": None if plant.E is None else frozen(scipy.linalg.block_diag(plant.E, np.eye(k))),
    }
    for letter in ROLES.values():
        B, D = getattr(plant, "B" + letter), np.array(getattr(plant, "D" + letter))
        changes["B" + letter] = frozen(np.vstack([B, gain[:, None] * D[rows]]))
        D[rows] = 0.0
        changes["D" + letter] = frozen(D)
    labels = [plant.outputs[i] for i in rows]
    states = (*plant.states, *(f"{name} filtered" for name in labels))
    arrays.unique(states, "states")
    units = {f"{name} filtered": plant.units[name] for name in labels if name in plant.units}
    return plant._with(**changes, states=states, units={**plant.units, **units})


def sensor_filter(plant: Plant, outputs: Iterable[str | int] | str, rate: ArrayLike) -> StateSpace:
    """Return the filter of the measurements for a design with :func:`augment_sensor_filter`.

    Parameters
    ----------
    plant : Plant
        The plant before it was augmented.
    outputs, rate
        As given to :func:`augment_sensor_filter`.

    Returns
    -------
    StateSpace
        From all outputs to all outputs; those that are not filtered pass through.

    Raises
    ------
    ModelError
        If an output does not exist, is named twice, or a rate is not positive.

    Examples
    --------
    >>> import residua as rs
    >>> rs.plant.sensor_filter(rs.library.vtol(), ["v_horizontal"], 25).dc_gain()
    array([[1., 0., 0.],
           [0., 1., 0.],
           [0., 0., 1.]])
    """
    rows, pole, gain = _lags(plant, outputs, rate)
    whole = np.eye(plant.n_outputs)
    through = whole.copy()
    through[rows] = 0.0
    return StateSpace(
        np.diag(pole),
        gain[:, None] * whole[rows],
        whole[:, rows],
        through,
        dt=plant.dt,
        inputs=plant.outputs,
        outputs=plant.outputs,
    )


def _lags(plant: Plant, outputs: Iterable[str | int] | str, rate: ArrayLike) -> tuple[list[int], NDArray, NDArray]:
    """Return the numbers of the outputs, and pole and input gain of the lag of each."""
    rows = arrays.positions(outputs, plant.outputs, "output")
    arrays.unique(tuple(plant.outputs[i] for i in rows), "outputs to filter")
    if not rows:
        raise ModelError("name at least one output to filter")
    try:
        rates = np.broadcast_to(np.asarray(rate, dtype=float), (len(rows),))
    except (TypeError, ValueError) as error:
        raise ModelError(f"rate must be one number, or one for each of {len(rows)} outputs, got {rate!r}") from error
    if not (np.isfinite(rates).all() and (rates > 0).all()):
        raise ModelError(f"rate must be positive, in 1/s, got {rate!r}")
    rates = cast(NDArray, rates)
    return (rows, np.exp(-rates * plant.dt), 1 - np.exp(-rates * plant.dt)) if plant.dt else (rows, -rates, rates)
