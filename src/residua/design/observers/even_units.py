"""Observers that are designed for a plant in even units, as ones for the plant itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from residua.design.observers.observer import Observer
from residua.linear.poles.placement import default_margin
from residua.linear.poles.pole_assignment import real_block_diagonal
from residua.linear.subspaces.rank import without_rounded_gains
from residua.linear.systems.balancing import power_of_two, state_units
from residua.plant import Plant
from residua.plant.comparable_units import EvenPlant, PlantUnits
from residua.tolerances import above_rounding

#: Largest error of a pole of an observer, relative (sampled: absolute).
POLE_ERROR = 1e-6


def in_units_of_the_plant(observer: Observer, plant: Plant, even: EvenPlant) -> Observer:
    """Return an observer that was designed for a plant in even units, for the plant itself."""
    return observer_in_units_of(observer, plant, even.units)


def observer_in_units_of(observer: Observer, plant: Plant, units: PlantUnits) -> Observer:
    """Return an observer for a scaled plant as one for the plant.

    The states of a full-order observer take the units of the plant's; a residual that is the error of one output that
    of this output, and any other stays as large as it is.
    """
    S, Y = units.states, units.outputs
    R = 1 / S if observer.plant.E is None else units.equations  # an E may have been divided out
    own = S if observer.order == plant.n_states else np.ones(observer.order)
    rows = 1 / power_of_two(np.abs(observer.W * Y).max(axis=1, initial=0.0))
    return replace(
        observer,
        plant=plant,
        F=own[:, None] * observer.F / own,
        T=own[:, None] * observer.T * R,
        K=own[:, None] * observer.K * Y,
        M=S[:, None] * observer.M / own,
        H=S[:, None] * observer.H * Y,
        W=rows[:, None] * observer.W * Y,
        J=None if observer.J is None else S[:, None] * observer.J * R,
        V=None if observer.V is None else rows[:, None] * observer.V * R,
    )


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
