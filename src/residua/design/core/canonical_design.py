"""Designs in the plant's own units: the same filter, to the last bit, whatever units the plant was written in."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from residua.design.core.generator import ResidualGenerator
from residua.design.core.signatures import Signature
from residua.linear import StateSpace
from residua.linear.systems.array_cache import Latest, copied
from residua.plant import Plant
from residua.plant.comparable_units import PlantUnits, canonical_units, plant_contents

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
    return in_units_of(plant, units, _kept.of_texts((asked, plant_contents(own)), lambda: design(own)))


def in_units_of(
    plant: Plant, units: PlantUnits, made: ResidualGenerator, residuals: NDArray[np.float64] | None = None
) -> ResidualGenerator:
    """Return a generator for the scaled plant as one for the plant, with its residuals multiplied by factors.

    Powers of two: nothing is rounded, but what is left orthonormal where residuals have other units.
    """
    scaled = _rescaled(made, plant, units, 1.0)
    return scaled if residuals is None or np.all(residuals == 1.0) else _with_residuals_times(scaled, residuals)


def _with_residuals_times(made: ResidualGenerator, factors: NDArray[np.float64]) -> ResidualGenerator:
    R = factors[:, None]
    system, known = made.system, made.known_form
    signatures = {name: Signature(basis, np.any(basis, axis=1)) for name, basis in made.subspaces.items()}
    return replace(
        made,
        system=system.replaced(C=R * system.C, D=R * system.D),
        subspaces={name: signature.basis(factors) for name, signature in signatures.items()},
        static_map=None if made.static_map is None else R * made.static_map,
        known_form=None if known is None else known.replaced(C=R * known.C, D=R * known.D),
        steady=None if made.steady is None else {name: factors * vector for name, vector in made.steady.items()},
    )


def in_own_units(
    made: ResidualGenerator, units: PlantUnits, own: Plant, known_form: StateSpace | None = None
) -> ResidualGenerator:
    """Return a generator as one for its plant in other units, ``own``; with another known form if there is one."""
    return _rescaled(made, own, units, -1.0, known_form)


def _rescaled(
    made: ResidualGenerator, plant: Plant, units: PlantUnits, power: float, known: StateSpace | None = None
) -> ResidualGenerator:
    """Return a generator from scaled units to those of the plant, or the other way with a power of minus one."""
    signals = (1 / units.signals) ** power
    equations = units.equations**power
    known = made.known_form if known is None else known
    if known is not None:
        noises = known.n_inputs - len(units.faults) - len(units.disturbances)
        through = (1 / units.hidden(noises)) ** power
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
