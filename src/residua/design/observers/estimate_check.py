"""Whether the estimate of a finished observer is the state, whatever the inputs do."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from residua.design.core.internal_form import leak_frequencies, leakage_of_inputs
from residua.errors import AccuracyError, ModelError
from residua.plant import Plant

if TYPE_CHECKING:
    from residua.design.observers.observer import Observer


#: Frequencies over the dynamics, besides those far below of a plant that integrates.
_POINTS = 24


def check_estimate(observer: Observer, *, limit: float = 3e-7) -> float:
    r"""Return how far the response of the estimate to the inputs is from that of the state, or raise.

    The identities of an observer are local: in coordinates in which ``F`` is far from normal, rounding of its entries
    moves the estimate by much more than the identities are missed. So the response to controls, and to the
    disturbances that are decoupled, is compared with that of the state over the frequencies of leaks, which go down
    to where a plant that integrates is the power of 1/s alone, relative to the terms that make up the difference.

    Parameters
    ----------
    observer : Observer
    limit : float

    Returns
    -------
    float
        Zero where the pencil of the plant is not regular: then there is no response to compare with.

    Raises
    ------
    AccuracyError
        If the difference is larger than the limit.
    """
    plant = observer.plant if observer.decouples else observer.plant.without_disturbances()
    n, estimate = plant.n_states, observer.system
    if not n or not (plant.inputs or plant.disturbances):
        return 0.0
    # the error as a residual of a plant whose states are outputs too: the estimate minus these
    seen = Plant(plant.A, plant.B, np.vstack([plant.C, np.eye(n)]), _above(plant.D, n), E=plant.E, dt=plant.dt)
    moving = np.flatnonzero(np.any(plant.Bd, axis=0) | np.any(plant.Dd, axis=0))
    seen = seen.with_disturbances({f"d{i + 1}": (plant.Bd[:, i], _above(plant.Dd[:, i], n)) for i in moving})
    B = np.hstack([estimate.B, np.zeros((estimate.n_states, n))])
    error = estimate.replaced(B=B, D=np.hstack([estimate.D, -np.eye(n)]), inputs=None)
    try:
        w = leak_frequencies(estimate, plant, points=_POINTS)
        worst = float(leakage_of_inputs(error, seen, w).max(initial=0.0))
    except ModelError:
        return 0.0
    if not worst <= limit:
        raise AccuracyError(
            f"the estimate is off the state by {worst:.2g} (relative, limit {limit:.0e}): the measurements see "
            "part of the plant too weakly for the gain that this takes; ask for slower poles, a smaller margin, or "
            "add a sensor"
        )
    return worst


def _above(D: NDArray, rows: int) -> NDArray[np.float64]:
    """Return a matrix above rows of zeros."""
    return np.concatenate([D, np.zeros((rows, *D.shape[1:]))])
