"""A plant in comparable units, the same to the last bit whatever units (powers of two) it was written in; the way back.

The door of every design and of every answer about a plant. Two choices of units are made here, and nowhere else:
:func:`canonical_units` bring all entries nearest to one level, faults and controls included, for what is decided entry
by entry (polynomials, pencils, structure); :func:`even_plant` balances rows against columns after that, by what states,
outputs and disturbances do alone, for what is decided by norms (gains, subspaces, poles).
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from residua.arrays import frozen
from residua.linear.subspaces.parts import part_numbers
from residua.linear.systems.array_cache import Latest, copied, entries
from residua.linear.systems.balancing import DescriptorUnits, descriptor_units
from residua.linear.systems.units import (
    PencilUnits,
    bordered,
    output_weights,
    pencil_units,
    powers_of_two,
    row_levels,
    system_rate,
    system_units,
    without_residue,
)
from residua.plant.plant import Plant

Factors = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PlantUnits:
    """Factors, powers of two: ``R (sE - A) S``, ``R B U``, ``Y C S``, ``Y D U``; without ``E``, ``R`` is ``1 / S``.

    Attributes
    ----------
    equations, states, outputs, inputs, disturbances, faults : ndarray
        The diagonals of ``R``, ``S``, ``Y``, and those of ``U`` by role.
    noise : float
        The same for all noise: what a design takes of it is how large one is beside another.
    """

    equations: Factors
    states: Factors
    outputs: Factors
    inputs: Factors
    disturbances: Factors
    faults: Factors
    noise: float = 1.0

    @property
    def signals(self) -> Factors:
        """What the columns of a filter of inputs and outputs are multiplied by, for the scaled plant."""
        return np.concatenate([self.inputs, 1 / self.outputs])

    def hidden(self, noises: int) -> Factors:
        """Return the same for columns of faults, disturbances and so many noises."""
        return np.concatenate([self.faults, self.disturbances, np.full(noises, self.noise)])

    def applied(self, plant: Plant) -> Plant:
        """Return the plant in these units."""
        R, S, Y = self.equations[:, None], self.states, self.outputs[:, None]
        scaled = {
            "A": R * plant.A * S,
            "C": Y * plant.C * S,
            "B": R * plant.B * self.inputs,
            "D": Y * plant.D * self.inputs,
            "Bd": R * plant.Bd * self.disturbances,
            "Dd": Y * plant.Dd * self.disturbances,
            "Bf": R * plant.Bf * self.faults,
            "Df": Y * plant.Df * self.faults,
            "Bw": R * plant.Bw * self.noise,
            "Dw": Y * plant.Dw * self.noise,
        }
        E = None if plant.E is None else frozen(R * plant.E * S)
        return plant._with(E=E, **{name: frozen(M) for name, M in scaled.items()})

    def then(self, further: PlantUnits, *, explicit: bool = False) -> PlantUnits:
        """Return these units and further ones as one; ``explicit``: an ``E`` was divided out between them."""
        states = self.states * further.states
        return PlantUnits(
            1 / states if explicit else self.equations * further.equations,
            states,
            self.outputs * further.outputs,
            self.inputs * further.inputs,
            self.disturbances * further.disturbances,
            self.faults * further.faults,
            self.noise * further.noise,
        )


@dataclass(frozen=True, eq=False)
class EvenPlant:
    """A plant in even units, and what these are.

    Attributes
    ----------
    plant : Plant
        ``R E S``, ``R A S``, ``R B U``, ``Y C S``, ``Y D U``.
    units : PlantUnits
        ``x = S x_even``, ``y_even = Y y``.
    even : bool
        Whether the units are even, and not those of the plant.
    """

    plant: Plant
    units: PlantUnits
    even: bool = True

    @property
    def equations(self) -> Factors:
        """The diagonal of ``R``."""
        return self.units.equations

    @property
    def states(self) -> Factors:
        """The diagonal of ``S``."""
        return self.units.states

    @property
    def outputs(self) -> Factors:
        """The diagonal of ``Y``."""
        return self.units.outputs

    def output_weights(self, A: NDArray, B: NDArray, C: NDArray) -> NDArray[np.float64]:
        """Return what least squares over the outputs of a part of the plant weigh them by."""
        return output_weights(A, B, C, np.zeros((len(C), B.shape[1]))) if self.even else np.ones(len(C))


def unit_of_rates_of(plant: Plant) -> float:
    """Return the unit, a power of two in 1/s, in which the rates of a continuous plant are near one.

    In other units of time by powers of two it is that many times larger, whatever the other units are. Zero if the
    plant has no rate, as a chain of integrators; what faults tell of one counts where nothing else does. One if it is
    sampled.
    """
    if plant.is_discrete:
        return 1.0
    roles = [(plant.B, plant.D), (plant.Bd, plant.Dd), (plant.Bf, plant.Df)]
    for some in (roles[:2], roles):
        B, D = (np.hstack([role[k] for role in some]) for k in (0, 1))
        if plant.E is None:
            unit = system_rate(plant.A, B, plant.C, D)
        else:
            whole = bordered(plant.A, B, plant.C, D)
            found = pencil_units(whole, _padded(plant.E, whole.shape))
            unit = found.unit if found.has_rate else 0.0
        if unit:
            return unit
    return 0.0


def with_rates_times(plant: Plant, factor: float) -> Plant:
    """Return a continuous plant in another unit of time, in which its rates are so many times as large.

    The noise is as large beside other signals as it was, at all frequencies.
    """
    return plant._with(**{name: frozen(factor * getattr(plant, name)) for name in ("A", "B", "Bd", "Bf", "Bw")})


def in_unit_of_rates(plant: Plant) -> tuple[Plant, float]:
    """Return a plant in the unit of time in which its rates are near one, and that unit; itself where it has none."""
    unit = unit_of_rates_of(plant) or 1.0
    return (plant if unit == 1.0 else with_rates_times(plant, 1 / unit)), unit


def own_units(plant: Plant) -> EvenPlant:
    """Return a plant in its own units, for a design that is asked for as its equations say."""
    states, outputs = np.ones(plant.n_states), np.ones(plant.n_outputs)
    inputs, disturbances, faults = (np.ones(M.shape[1]) for M in (plant.B, plant.Bd, plant.Bf))
    return EvenPlant(plant, PlantUnits(states, states, outputs, inputs, disturbances, faults), even=False)


def even_plant(plant: Plant, *, explicit: bool = False) -> EvenPlant:
    """Return a plant in even units; ``explicit`` divides an invertible ``E`` out, in even units too.

    Those of states and outputs follow from the plant without its faults, so that no answer depends on what is watched;
    but parts that nothing else connects have a unit in common by the faults that move several of them.
    """
    if explicit and plant.E is not None:
        first = even_plant(plant)
        second = even_plant(first.plant.explicit())
        return EvenPlant(second.plant, first.units.then(second.units, explicit=True))
    units = copied(_even.of(_matrices(plant), lambda: _even_units(plant)))  # which answers about a plant hold
    return EvenPlant(units.applied(plant), units)


def plant_contents(plant: Plant) -> Hashable:
    """Return by what a plant is known, where something about it is kept: all that a design reads of it."""
    p = plant
    matrices = entries(p.A, p.E, p.C, p.B, p.D, p.Bd, p.Dd, p.Bf, p.Df, p.Bw, p.Dw)
    return matrices, p.dt, p.inputs, p.outputs, p.states, p.disturbances, p.faults


def _matrices(plant: Plant) -> Hashable:
    """Return what the units of a plant depend on."""
    p = plant
    return entries(p.A, p.E, p.C, p.B, p.D, p.Bd, p.Dd, p.Bf, p.Df)


_even: Latest[PlantUnits] = Latest()
_canonical: Latest[PlantUnits] = Latest()


def _even_units(plant: Plant) -> PlantUnits:
    m = plant.B.shape[1]
    B, D = np.hstack([plant.B, plant.Bd]), np.hstack([plant.D, plant.Dd])
    u = descriptor_units(plant.A, plant.E, B, plant.C, D)
    u = _levelled(u, plant, B, D)
    faults = np.vstack([u.equations[:, None] * plant.Bf, u.outputs[:, None] * plant.Df])
    sizes = np.linalg.norm(faults, axis=0)
    sizes = powers_of_two(np.log2(np.where(sizes > 0, sizes, 1.0)))
    return PlantUnits(u.equations, u.states, u.outputs, u.inputs[:m], u.inputs[m:], 1 / sizes)


def _levelled(u: DescriptorUnits, plant: Plant, B: NDArray[np.float64], D: NDArray[np.float64]) -> DescriptorUnits:
    """Return units with one factor more for each part of a plant that nothing connects: its level beside the others.

    Nothing but a fault says what that is; without, it is that of the units that the plant was written in, and what is
    decided of all parts together would change with these. The factors bring what faults do nearest to one size.
    """
    n = plant.n_states
    rows, columns = np.concatenate([u.equations, u.outputs]), np.concatenate([u.states, u.inputs])
    coupled = without_residue(rows[:, None] * bordered(plant.A, B, plant.C, D) * columns) > 0
    coupled[:n, :n] |= np.eye(n, dtype=bool) if plant.E is None else plant.E != 0
    of_rows, of_columns = part_numbers(coupled)
    faults = rows[:, None] * np.vstack([plant.Bf, plant.Df])
    if not np.any(of_rows) or not faults.size:
        return u
    levels = row_levels(faults, of_rows, int(max(of_rows.max(), of_columns.max(initial=0))) + 1)
    left, right = rows / levels[of_rows], columns * levels[of_columns]
    return DescriptorUnits(left[:n], right[:n], right[n:], left[n:], u.unit)


def canonical_units(plant: Plant, *, controls: bool = True) -> PlantUnits:
    """Return the units in which the entries of a plant are nearest to one level.

    Scaled by them, plants in units that differ by powers of two are the same to the last bit. Without ``controls``
    these take no part, and stay as they are.
    """
    units = _canonical.of((_matrices(plant), controls), lambda: _canonical_units(plant, controls))
    if not plant.Bw.shape[1]:
        return units
    # all states and outputs may be as much larger or smaller together, and signals the other way
    largest = max(float(np.abs(M).max(initial=0.0)) for M in _noise_in(units, plant))
    return replace(units, noise=1.0 / np.ldexp(1.0, np.frexp(largest)[1])) if largest else units


def _noise_in(units: PlantUnits, plant: Plant) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the noise in the equations and the outputs of a plant in other units."""
    return units.equations[:, None] * plant.Bw, units.outputs[:, None] * plant.Dw


def _canonical_units(plant: Plant, controls: bool) -> PlantUnits:
    roles = [(plant.Bd, plant.Dd), (plant.Bf, plant.Df), *([(plant.B, plant.D)] if controls else [])]
    B, D = (np.hstack([role[k] for role in roles]) for k in (0, 1))
    bordered = np.block([[plant.A, B], [plant.C, D]])
    found = _fitted(bordered, plant)
    d, f = plant.Bd.shape[1], plant.Bf.shape[1]
    n = plant.n_states
    rows, (states, signals) = found.rows, (found.columns[:n], found.columns[n:])
    inputs = signals[d + f :] if controls else np.ones(plant.B.shape[1])
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
