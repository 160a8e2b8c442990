"""A plant in even units, for decisions that must not depend on those that it was written in, and the way back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.arrays import frozen
from residua.linear.systems.balancing import descriptor_units, power_of_two
from residua.linear.systems.units import output_weights
from residua.plant.plant import Plant


@dataclass(frozen=True, eq=False)
class EvenPlant:
    """A plant in units that are the same, to the last bit, for all powers of two as units of the caller.

    Attributes
    ----------
    plant : Plant
        ``R E S``, ``R A S``, ``R B U``, ``Y C S``, ``Y D U``.
    equations, states, outputs : ndarray
        The diagonals of ``R``, ``S`` and ``Y``, powers of two: ``x = S x_even``, ``y_even = Y y``.
    even : bool
        Whether the units are even, and not those of the plant.
    """

    plant: Plant
    equations: NDArray[np.float64]
    states: NDArray[np.float64]
    outputs: NDArray[np.float64]
    even: bool = True

    def output_weights(self, A: NDArray, B: NDArray, C: NDArray) -> NDArray[np.float64]:
        """Return what least squares over the outputs of a part of the plant weigh them by: ones in given units."""
        return output_weights(A, B, C, np.zeros((len(C), B.shape[1]))) if self.even else np.ones(len(C))


def given_units(plant: Plant) -> EvenPlant:
    """Return a plant in its own units, for a design that is asked for as its equations say."""
    n = plant.n_states
    return EvenPlant(plant, np.ones(n), np.ones(n), np.ones(plant.n_outputs), even=False)


def even_plant(plant: Plant, *, explicit: bool = False) -> EvenPlant:
    """Return a plant in even units; ``explicit`` divides an invertible ``E`` out, in even units too.

    Those of states and outputs follow from the plant without its faults, so that no answer depends on what is watched.
    """
    if explicit and plant.E is not None:
        first = even_plant(plant)
        second = even_plant(first.plant.explicit())
        S = first.states * second.states
        return EvenPlant(second.plant, 1 / S, S, first.outputs * second.outputs)
    m = plant.Bu.shape[1]
    B, D = np.hstack([plant.Bu, plant.Bd]), np.hstack([plant.Du, plant.Dd])
    u = descriptor_units(plant.A, plant.E, B, plant.C, D)
    R, S, Y = u.equations[:, None], u.states, u.outputs[:, None]
    Bu, Bd = np.hsplit(R * B * u.inputs, [m])
    Du, Dd = np.hsplit(Y * D * u.inputs, [m])
    size = power_of_two(np.linalg.norm(np.vstack([R * plant.Bf, Y * plant.Df]), axis=0))
    Bf, Df = R * plant.Bf / size, Y * plant.Df / size
    scaled = {
        "A": R * plant.A * S,
        "C": Y * plant.C * S,
        "Bu": Bu,
        "Bd": Bd,
        "Bf": Bf,
        "Bw": R * plant.Bw,
        "Du": Du,
        "Dd": Dd,
        "Df": Df,
        "Dw": Y * plant.Dw,
    }
    E = None if plant.E is None else frozen(R * plant.E * S)
    even = plant._with(E=E, **{name: frozen(M) for name, M in scaled.items()})
    return EvenPlant(even, u.equations, S, u.outputs)
