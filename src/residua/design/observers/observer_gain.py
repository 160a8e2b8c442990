"""What every observer asks of pole placement: the poles that the user lists, or all beyond a margin."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.design.detection_filters.directional_gain import checked_options
from residua.errors import AccuracyError, DesignError, ModelError
from residua.linear.poles.matrix_poles import explicit_poles
from residua.linear.poles.placement import Placement, default_margin, kept_observer_margin, place_observer_poles
from residua.linear.poles.pole_assignment import real_block_diagonal
from residua.linear.subspaces.rank import without_rounded_gains
from residua.linear.systems.balancing import state_units
from residua.plant import Plant
from residua.tolerances import above_rounding

#: Largest error of a pole of an observer, relative (sampled: absolute).
POLE_ERROR = 1e-6


def place(
    A: NDArray,
    C: NDArray,
    poles: Sequence[complex] | ArrayLike | None,
    margin: float | None,
    dt: float,
    rtol: float,
) -> Placement:
    """Place the poles that were asked for, or all of them beyond a margin."""
    poles, margin = checked_options(poles, margin)
    if isinstance(poles, Mapping):
        raise DesignError("an observer takes a list of poles; poles per fault are for the detection filters")
    if poles is None:
        return kept_observer_margin(A, C, default_margin(A, dt) if margin is None else margin, dt=dt, rtol=rtol)
    placed = place_observer_poles(A, C, poles, dt=dt, rtol=rtol)
    if placed.error > POLE_ERROR:  # within what rounding does to it, which the placement itself allows
        raise AccuracyError(
            f"a pole is off by {placed.error:.2g} > {POLE_ERROR:.0e} of the requested pole: so ill-conditioned that "
            "rounding moves it; ask for poles nearer to those of the plant or further apart, for a margin, or add a "
            "sensor"
        )
    return placed


def margin_from(A1: NDArray, plant: Plant) -> float:
    """Return the margin that suits an error system, or the plant, where decoupling left no dynamics of its own."""
    if _has_dynamics(A1, 1e-8 * float(np.linalg.norm(plant.A))):
        return default_margin(A1, plant.dt)
    try:
        return own_rate(plant)
    except ModelError:  # the pencil of a singular plant need not be regular
        return default_margin(A1, plant.dt)


def _has_dynamics(A: NDArray, least: float) -> bool:
    """Tell whether an eigenvalue of a matrix is larger than ``least``."""
    if not np.any(A):
        return False
    # one of them is as large as their mean, which is known without them
    return abs(float(np.trace(A))) > 2 * len(A) * least or bool(np.abs(np.linalg.eigvals(A)).max() > least)


def own_rate(plant: Plant) -> float:
    """Return the geometric mean of the sizes of the plant's poles, in 1/s."""
    A = plant.A if plant.E is None else real_block_diagonal(plant.system(()).poles())
    return default_margin(A, plant.dt)


def gain_size(F: NDArray, K: NDArray, C: NDArray) -> float:
    r"""Return the norm of the gain of an observer in the units that its own error equation has: one over time.

    States as in ``F``, which the gain has closed, and outputs as large as these make them. In units of the plant alone
    a gain is large wherever the poles asked for are faster than the plant: by a power of their ratio that grows along
    every chain of states.
    """
    if not K.size:
        return 0.0
    K, n = without_rounded_gains(K), len(F)
    fed = np.abs(K) @ np.abs(C)
    # what cancels in F couples states no less than what is left; rounding of it couples nothing
    states = state_units(np.abs(above_rounding(F, n * fed)) + fed, np.zeros((n, 0)), np.zeros((0, n)))
    outputs = (np.abs(C) * states).max(axis=1, initial=0.0)
    return float(np.linalg.norm(K * outputs / states[:, None]))  # a gain on an output that reads no state is none


def pole_evidence(placed: Placement, F: NDArray) -> dict[str, Any]:
    """Return the poles of an observer with state matrix ``F`` as fields of its evidence."""
    return {
        "poles": explicit_poles(F),
        "requested_poles": np.asarray(placed.requested, dtype=complex),
        "fixed_poles": np.asarray(placed.fixed, dtype=complex),
    }
