"""The checks of a generator in units of the plant's own: the same numbers whatever units it was designed in, once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.design.core.decoupling import Decoupled, Leaks, Promise
from residua.design.core.evidence import Evidence
from residua.design.core.internal_form import check_known_form, internal_form
from residua.design.core.signatures import Signature, signatures_of
from residua.linear import StateSpace
from residua.linear.systems.array_cache import Latest, entries
from residua.linear.systems.balancing import power_of_two
from residua.plant import Plant
from residua.plant.comparable_units import PlantUnits, canonical_units, plant_contents

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
    """A filter with the maps from the states of its plant to its own, and to its residuals, or its internal form."""

    system: StateSpace
    T: NDArray[np.float64] | None
    V: NDArray[np.float64] | None
    form: StateSpace | None

    def for_scaled(self, units: PlantUnits) -> _Filter:
        """Return the filter for the plant in other units."""
        system = self.system.replaced(B=self.system.B * units.signals, D=self.system.D * units.signals)
        form = self.form
        if form is not None:
            hidden = units.hidden(form.n_inputs - len(units.faults) - len(units.disturbances))
            form = form.replaced(B=form.B * hidden, D=form.D * hidden)
        T, V = (None if M is None else M / units.equations for M in (self.T, self.V))
        return _Filter(system, T, V, form)

    def in_units(self, states: Factors, residuals: Factors) -> _Filter:
        """Return the filter with its states divided, and its residuals multiplied, by factors."""
        F, R = states[:, None], residuals[:, None]
        s, form = self.system, self.form
        system = s.replaced(A=s.A / F * states, B=s.B / F, C=R * s.C * states, D=R * s.D).with_poles_of(s)
        if form is not None:
            form = form.replaced(C=R * form.C, D=R * form.D)
        return _Filter(system, None if self.T is None else self.T / F, None if self.V is None else R * self.V, form)

    def own_states(self, units: PlantUnits) -> Factors:
        """Return the units of its states: those of the plant's states, whose equations it repeats, or by its maps."""
        if self.T is None:
            return np.ones(self.system.n_states)
        n = len(units.states)
        if n and len(self.T) % n == 0:
            return np.resize(units.states, len(self.T))
        return power_of_two(np.abs(self.T).max(axis=1, initial=0.0))

    def own_residuals(self, states: Factors) -> Factors:
        """Return the factors that bring its residuals to sizes near one."""
        whole = np.hstack([self.system.C * states, self.system.D])
        return 1 / power_of_two(np.abs(whole).max(axis=1, initial=0.0))


_kept: Latest[Checked] = Latest()
_own: Latest[Plant] = Latest()


def _own_plant(plant: Plant, units: PlantUnits) -> Plant:
    """Return a plant in its canonical units; of one plant always the same, which keeps its systems and their poles."""
    return _own.of(plant_contents(plant), lambda: _applied(units, plant))


def _applied(units: PlantUnits, plant: Plant) -> Plant:
    own = units.applied(plant)
    if plant.E is None:
        own.system(()).with_poles_of(plant.system(()))
    return own


def checked(
    system: StateSpace,
    plant: Plant,
    evidence: Evidence,
    promise: Promise,
    state_map: NDArray[np.float64] | None = None,
    static_map: NDArray[np.float64] | None = None,
    form: StateSpace | None = None,
    state_units: Factors | None = None,
) -> Checked:
    """Return what is measured of a filter with a state map or an internal form of its own, or raise when it fails.

    Powers of two take it to the units of the plant's own and back, so that nothing is rounded on the way; equal
    filters for the same plant in other units are checked once. Of a filter without a state map the units of its states
    are those given, or else they stay what they are.
    """
    decoupled, identity = promise if isinstance(promise, Decoupled) else None, None
    if decoupled and form is None and state_map is not None:
        leaks, identity = decoupled.measured(system, plant, state_map, static_map)
        decoupled = None
    else:
        leaks = _NONE if decoupled else promise.leaks(system, plant, evidence)
    units = canonical_units(plant)
    one = _Filter(system, state_map, static_map, form).for_scaled(units)
    states = one.own_states(units) if state_units is None else state_units
    residuals = one.own_residuals(states)
    own, scaled = _own_plant(plant, units), one.in_units(states, residuals)
    s, known = scaled.system, scaled.form
    key = (
        entries(s.A, s.B, s.C, s.D, scaled.T, scaled.V),
        None if known is None else entries(known.A, known.B, known.C, known.D),
        plant_contents(own),
        decoupled,
    )
    found = _kept.of_texts(key, lambda: _measured(scaled, own, evidence, decoupled))
    leaks, identity = found.leaks if decoupled else leaks, found.identity if identity is None else identity
    return Checked(leaks, identity, found.signatures, found.off, 1 / residuals)


def _measured(one: _Filter, plant: Plant, evidence: Evidence, promise: Decoupled | None) -> Checked:
    """Return what is measured of a filter in its own units."""
    residuals = np.ones(one.system.n_outputs)
    if one.form is not None or one.T is None:
        # as known form of an approximate design the driven filter would say that control inputs do nothing
        form = internal_form(one.system, plant) if one.form is None else one.form
        leaks = promise.leaks(one.system, plant, evidence) if promise else _NONE
        identity = check_known_form(one.system, plant, form)
        return Checked(leaks, identity, *signatures_of(one.system, plant, form, one.T, one.V), residuals)
    form = internal_form(one.system, plant, one.T, one.V)
    return Checked(_NONE, 0.0, *signatures_of(one.system, plant, form, one.T, one.V), residuals)
