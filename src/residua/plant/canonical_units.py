"""A plant in units of its own, the same whatever units it was written in, and the way back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.linear.systems.units import PencilUnits, pencil_units, system_units
from residua.plant.plant import Plant

Factors = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PlantUnits:
    """Factors, powers of two: ``R (sE - A) S``, ``R B U``, ``Y C S``, ``Y D U``; without ``E``, ``R`` is ``1 / S``.

    Attributes
    ----------
    equations, states, outputs, inputs, disturbances, faults : ndarray
        The diagonals of ``R``, ``S``, ``Y``, and those of ``U`` by role.
    """

    equations: Factors
    states: Factors
    outputs: Factors
    inputs: Factors
    disturbances: Factors
    faults: Factors

    def applied(self, plant: Plant) -> Plant:
        """Return the plant in these units. Those of noise, of variance one, are what they are."""
        R, S, Y = self.equations[:, None], self.states, self.outputs[:, None]
        return plant._with(
            A=R * plant.A * S,
            E=None if plant.E is None else R * plant.E * S,
            C=Y * plant.C * S,
            Bu=R * plant.Bu * self.inputs,
            Du=Y * plant.Du * self.inputs,
            Bd=R * plant.Bd * self.disturbances,
            Dd=Y * plant.Dd * self.disturbances,
            Bf=R * plant.Bf * self.faults,
            Df=Y * plant.Df * self.faults,
            Bw=R * plant.Bw,
            Dw=Y * plant.Dw,
        )


def canonical_units(plant: Plant, *, controls: bool = True) -> PlantUnits:
    """Return the units in which the entries of a plant are nearest to one level.

    Scaled by them, plants in units that differ by powers of two are the same to the last bit. Without ``controls``
    these take no part, and stay as they are.
    """
    roles = [(plant.Bd, plant.Dd), (plant.Bf, plant.Df), *([(plant.Bu, plant.Du)] if controls else [])]
    B, D = (np.hstack([role[k] for role in roles]) for k in (0, 1))
    bordered = np.block([[plant.A, B], [plant.C, D]])
    found = _fitted(bordered, plant)
    d, f = plant.Bd.shape[1], plant.Bf.shape[1]
    n = plant.n_states
    rows, (states, signals) = found.rows, (found.columns[:n], found.columns[n:])
    inputs = signals[d + f :] if controls else np.ones(plant.Bu.shape[1])
    return PlantUnits(rows[:n], states, rows[n:], inputs, signals[:d], signals[d : d + f])


def _fitted(bordered: NDArray[np.float64], plant: Plant) -> PencilUnits:
    """Return the factors of rows and columns of ``[A B; C D]`` that suit its entries, and those of ``E``."""
    n = plant.n_states
    if plant.E is not None:
        return pencil_units(bordered, _padded(plant.E, bordered.shape))
    found = system_units(bordered[:n, :n], bordered[:n, n:], bordered[n:, :n], bordered[n:, n:])
    rows = np.concatenate([1 / found.states, found.outputs])
    return PencilUnits(rows, np.concatenate([found.states, found.inputs]), 1.0)


def _padded(E: NDArray[np.float64], shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return ``E`` as large as the bordered pencil."""
    out = np.zeros(shape)
    out[: len(E), : len(E)] = E
    return out
