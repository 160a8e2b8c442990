"""How large a residual would be if its terms did not cancel: what rounding in it is measured by."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from residua.errors import AccuracyError
from residua.linear import StateSpace, peak_norm
from residua.plant import Plant

Vector = NDArray[np.float64]
#: Frequencies at which a system is looked at that is too slow for an ellipsoid, in parts of half the sample rate.
_FREQUENCIES = (0.0, 1e-3, 1e-2, 0.1, 0.5, 1.0)


def rounding_scale(plant: Plant, residual_filter: StateSpace, signals: Iterable[str]) -> float:
    """Return the size of the residual that each output of the loop would cause alone, for signals of unit size.

    The outputs are as large as the signals make them in this loop, the filter is as large as it answers to these.
    Estimators of which the signals are decoupled have a residual of 1e-15 to 1e-10 times that, for rounding.
    """
    flt = residual_filter.explicit()
    sizes = _sizes(_driven(plant, tuple(signals)))
    if not np.any(sizes) or not flt.n_outputs:
        return 0.0
    return float(np.linalg.norm(_sizes(StateSpace(flt.A, flt.B * sizes, flt.C, flt.D * sizes, dt=flt.dt))))


def _driven(plant: Plant, signals: tuple[str, ...]) -> StateSpace:
    """Return the outputs of a loop as disturbances and faults drive them."""
    known = (*plant.disturbances, *plant.faults)
    columns = [known.index(name) for name in signals]
    B, D = np.hstack([plant.Bd, plant.Bf])[:, columns], np.hstack([plant.Dd, plant.Df])[:, columns]
    return StateSpace(plant.A, B, plant.C, D, dt=plant.dt)


def _sizes(system: StateSpace) -> Vector:
    """Return about the largest value of every output."""
    direct = np.linalg.norm(system.D, axis=1)
    if not system.n_inputs or not np.any(system.B):
        return direct
    try:
        Q = peak_norm(system, kind="star").ellipsoid
    except AccuracyError:  # too slow
        points = np.pi / system.dt * np.array(_FREQUENCIES)
        return np.linalg.norm(system.frequency_response(points), axis=2).max(axis=0)
    assert Q is not None  # "star" gives one
    return direct + np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", system.C, Q, system.C), 0.0))
