"""Designs in the plant's own units: the same filter, to the last bit, whatever units the plant was written in."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import replace

import numpy as np

from residua.design.core.generator import ResidualGenerator
from residua.linear import StateSpace
from residua.linear.systems.array_cache import Latest, copied, entries
from residua.plant import Plant
from residua.plant.comparable_units import PlantUnits, canonical_units

_kept: Latest[ResidualGenerator] = Latest()


def designed_in_own_units(
    plant: Plant,
    design: Callable[[Plant], ResidualGenerator],
    asked: Hashable = None,
    units: PlantUnits | None = None,
) -> ResidualGenerator:
    """Return what a design makes of the plant in canonical units, as a generator for the plant as it was written.

    ``asked`` holds all that the design is asked for; the latest results are kept by it and by the plant, unless it is
    ``None``: banks, and methods that are tried in turn, want the same residual many times. Another choice of canonical
    units is in ``units``.
    """
    units = canonical_units(plant) if units is None else units
    own = units.applied(plant)
    if asked is None:
        return in_units_of(plant, units, design(own))
    matrices = entries(own.A, own.E, own.C, own.Bu, own.Du, own.Bd, own.Dd, own.Bf, own.Df, own.Bw, own.Dw)
    names = (own.inputs, own.outputs, own.states, own.disturbances, own.faults)
    return in_units_of(plant, units, _kept.of_texts((asked, matrices, own.dt, *names), lambda: design(own)))


def in_units_of(plant: Plant, units: PlantUnits, made: ResidualGenerator) -> ResidualGenerator:
    """Return a generator for the scaled plant as one for the plant. Powers of two: nothing is rounded."""
    return _rescaled(made, plant, units, 1.0)


def in_own_units(
    made: ResidualGenerator, units: PlantUnits, own: Plant, known_form: StateSpace | None = None
) -> ResidualGenerator:
    """Return a generator as one for its plant in other units, ``own``; with another known form if there is one."""
    return _rescaled(made, own, units, -1.0, known_form)


def _rescaled(
    made: ResidualGenerator, plant: Plant, units: PlantUnits, power: float, known: StateSpace | None = None
) -> ResidualGenerator:
    """Return a generator from scaled units to those of the plant, or the other way with a power of minus one."""
    signals = np.concatenate([1 / units.inputs, units.outputs]) ** power
    equations = units.equations**power
    known = made.known_form if known is None else known
    if known is not None:
        noises = np.full(known.n_inputs - len(units.faults) - len(units.disturbances), 1 / units.noise)
        through = np.concatenate([1 / units.faults, 1 / units.disturbances, noises]) ** power
        known = known.replaced(B=known.B * through, D=known.D * through)
    return replace(
        made,
        system=made.system.replaced(B=made.system.B * signals, D=made.system.D * signals),
        plant=plant,
        state_map=None if made.state_map is None else made.state_map * equations,
        static_map=None if made.static_map is None else made.static_map * equations,
        known_form=known,
        # what is kept is not handed out to be changed
        evidence=copied(made.evidence),
        subspaces=copied(made.subspaces),
        codes=copied(made.codes),
        steady=copied(made.steady),
    )
