"""The checks of a generator in units of the plant's own: the same numbers whatever units it was designed in, once."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.design.core.decoupling import Decoupled, Leaks, Promise
from residua.design.core.evidence import Evidence
from residua.design.core.internal_form import check_known_form, check_state_map, internal_form
from residua.design.core.signatures import Signature, checked_responses, signatures_of
from residua.linear import StateSpace
from residua.linear.systems.array_cache import Latest, entries
from residua.linear.systems.balancing import power_of_two
from residua.plant import Plant
from residua.plant.comparable_units import PlantUnits, canonical_units

Factors = NDArray[np.float64]

_NONE = Leaks({}, {})


@dataclass(frozen=True, eq=False)
class Checked:
    """What the checks of a generator have measured.

    Attributes
    ----------
    leaks : Leaks
        What reaches the residual that must not, and how that was measured.
    identity : float
        How far its identities are missed.
    signatures : dict of str to Signature
        By fault.
    off : float
        The largest fraction of a response to a fault that its signature leaves out.
    residuals : ndarray, shape (residuals,)
        The factors that bring the residuals from the units of the signatures to those of the generator.
    """

    leaks: Leaks
    identity: float
    signatures: dict[str, Signature]
    off: float
    residuals: Factors


@dataclass(frozen=True, eq=False)
class _Filter:
    """A filter with the maps from the states of its plant to its own, and to its residuals."""

    system: StateSpace
    T: NDArray[np.float64]
    V: NDArray[np.float64] | None

    def for_scaled(self, units: PlantUnits) -> _Filter:
        """Return the filter for the plant in other units."""
        signals = np.concatenate([units.inputs, 1 / units.outputs])
        system = self.system.replaced(B=self.system.B * signals, D=self.system.D * signals)
        return _Filter(system, self.T / units.equations, None if self.V is None else self.V / units.equations)

    def in_units(self, states: Factors, residuals: Factors) -> _Filter:
        """Return the filter with its states divided, and its residuals multiplied, by factors."""
        F, R = states[:, None], residuals[:, None]
        s = self.system
        system = s.replaced(A=s.A / F * states, B=s.B / F, C=R * s.C * states, D=R * s.D).with_poles_of(s)
        return _Filter(system, self.T / F, None if self.V is None else R * self.V)

    def own_states(self, units: PlantUnits) -> Factors:
        """Return the units of its states: those of the plant's states, whose equations it repeats, or by its maps."""
        n = len(units.states)
        if n and len(self.T) % n == 0:
            return np.resize(units.states, len(self.T))
        return power_of_two(np.abs(self.T).max(axis=1, initial=0.0))

    def own_residuals(self, states: Factors, units: PlantUnits) -> Factors:
        """Return the factors of its residuals: those of the outputs, of which there are as many, or by their sizes."""
        if self.system.n_outputs == len(units.outputs):
            return units.outputs
        whole = np.hstack([self.system.C * states, self.system.D])
        return 1 / power_of_two(np.abs(whole).max(axis=1, initial=0.0))


_kept: Latest[Checked] = Latest()
_own: Latest[Plant] = Latest()


def _own_plant(plant: Plant, units: PlantUnits) -> Plant:
    """Return a plant in its canonical units; of one plant always the same, which keeps its systems and their poles."""
    p = plant
    matrices = entries(p.A, p.E, p.C, p.Bu, p.Du, p.Bd, p.Dd, p.Bf, p.Df, p.Bw, p.Dw)
    return _own.of((matrices, *_named(p)), lambda: _applied(units, p))


def _applied(units: PlantUnits, plant: Plant) -> Plant:
    own = units.applied(plant)
    if plant.E is None:
        own.system(()).with_poles_of(plant.system(()))
    return own


def _named(plant: Plant) -> tuple[Hashable, ...]:
    return plant.dt, plant.inputs, plant.outputs, plant.states, plant.disturbances, plant.faults


def checked(
    system: StateSpace,
    plant: Plant,
    evidence: Evidence,
    promise: Promise,
    state_map: NDArray[np.float64],
    static_map: NDArray[np.float64] | None,
) -> Checked:
    """Return what is measured of a filter with a state map, or raise when it does not pass.

    Powers of two take it to the units of the plant's own and back, so that nothing is rounded on the way; equal
    filters for the same plant in other units are checked once.
    """
    decoupled = promise if isinstance(promise, Decoupled) else None
    leaks = _NONE if decoupled else promise.leaks(system, plant, evidence)
    units = canonical_units(plant)
    one = _Filter(system, state_map, static_map).for_scaled(units)
    states = one.own_states(units)
    residuals = one.own_residuals(states, units)
    own, scaled = _own_plant(plant, units), one.in_units(states, residuals)
    s = scaled.system
    key = (
        entries(s.A, s.B, s.C, s.D, scaled.T, scaled.V),
        entries(own.A, own.E, own.C, own.Bu, own.Du, own.Bd, own.Dd, own.Bf, own.Df, own.Bw, own.Dw),
        _named(own),
        decoupled,
    )
    found = _kept.of_texts(key, lambda: _measured(scaled, own, evidence, decoupled))
    return Checked(found.leaks if decoupled else leaks, found.identity, found.signatures, found.off, 1 / residuals)


def _measured(one: _Filter, plant: Plant, evidence: Evidence, promise: Decoupled | None) -> Checked:
    """Return what is measured of a filter in its own units."""
    form = internal_form(one.system, plant, one.T, one.V)
    known = checked_responses(one.system, plant, form, one.T, one.V)
    leaks = promise.leaks(one.system, plant, evidence, known) if promise else _NONE
    identity = check_state_map(one.system, plant, one.T, one.V)
    signatures, off = signatures_of(one.system, plant, form, one.T, one.V, known)
    return Checked(leaks, identity, signatures, off, np.ones(one.system.n_outputs))


def checked_by_form(
    system: StateSpace,
    plant: Plant,
    evidence: Evidence,
    promise: Promise,
    form: StateSpace,
    state_map: NDArray[np.float64] | None = None,
    static_map: NDArray[np.float64] | None = None,
) -> Checked:
    """Return what is measured of a filter with an internal form of its own, or raise when it does not pass."""
    leaks = promise.leaks(system, plant, evidence)
    identity = check_known_form(system, plant, form)
    signatures, off = signatures_of(system, plant, form, state_map, static_map)
    return Checked(leaks, identity, signatures, off, np.ones(system.n_outputs))
