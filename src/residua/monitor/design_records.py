"""Plants and designs as records for JSON, complete to the last bit."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np

from residua.arrays import frozen
from residua.design import Evidence, Observer, ParityRelations, ResidualGenerator
from residua.design.core.decoupling import IGNORED, reached
from residua.errors import FileFormatError
from residua.linear import RankDecision, StateSpace
from residua.number_kinds import ANY, NOT_NEGATIVE, STEP
from residua.plant import Fault, Plant
from residua.records import RecordOf, joined, record, values_in, values_out
from residua.tolerances import LEAK

#: Fields of a generator that sampling changes, and those that are in no file.
_SAMPLED = ("system", "plant", "evidence", "subspaces", "state_map", "static_map", "known_form", "steady")
_LEFT_OUT = ("relations",)
#: Fields of a plant that its constructor does not take.
_ADDED = ("Bd", "Dd", "Bf", "Df", "Bw", "Dw")


def generator_out(generator: ResidualGenerator) -> dict[str, Any]:
    """Return a generator as a record."""
    return values_out(generator, but=_LEFT_OUT)


def generator_in(value: Any, where: str) -> ResidualGenerator:
    """Return the generator that a record describes."""
    return values_in(value, where, ResidualGenerator, dict.fromkeys(_LEFT_OUT), others=_OTHERS)


def sampled_out(generator: ResidualGenerator) -> dict[str, Any]:
    """Return the parts of a generator that depend on sampling, as a record."""
    return values_out(generator, but=[one.name for one in fields(generator) if one.name not in _SAMPLED])


def sampled_in(design: ResidualGenerator, value: Any, where: str) -> ResidualGenerator:
    """Return the sampled generator of a continuous design."""
    same = {one.name: getattr(design, one.name) for one in fields(design) if one.name not in _SAMPLED}
    return values_in(value, where, ResidualGenerator, same, others=_OTHERS)


def _plant(disturbances: tuple[str, ...], fault_list: tuple[Fault, ...], **entries: Any) -> Plant:
    added = {name: frozen(entries.pop(name)) for name in _ADDED}
    return Plant(**entries)._with(**added, disturbances=disturbances, fault_list=fault_list)


def _check_plant(plant: Plant, where: str) -> None:
    """Raise unless the directions of disturbances, faults and noise fit the plant."""
    for letter, count in (("d", len(plant.disturbances)), ("f", len(plant.fault_list)), ("w", plant.Bw.shape[-1])):
        shapes = [getattr(plant, name + letter).shape for name in "BD"]
        if shapes != [(plant.n_states, count), (plant.n_outputs, count)]:
            raise FileFormatError(f"{where}: B{letter} and D{letter} must have {count} columns and fit the plant")


def _check_rank(one: RankDecision, where: str) -> None:
    if one.singular_values.ndim != 1 or not 0 <= one.rank <= len(one.singular_values):
        raise FileFormatError(f"{where}: a rank of {one.rank} does not fit {one.singular_values.size} singular values")


def _check_dimensions(one: Any, where: str) -> None:
    """Raise unless the arrays of an observer are matrices, and those of the evidence have one dimension."""
    dimensions = 1 if isinstance(one, Evidence) else 2
    for name, array in vars(one).items():
        if isinstance(array, np.ndarray) and array.ndim != dimensions:
            raise FileFormatError(
                f"{joined(where, name)}: expected an array of {dimensions} dimensions, got shape {array.shape}"
            )


def _check(generator: ResidualGenerator, where: str) -> None:
    """Raise unless the parts of a generator fit together."""
    system, plant, k = generator.system, generator.plant, generator.n_residuals
    if system.E is not None or (generator.known_form is not None and generator.known_form.E is not None):
        raise FileFormatError(f"{where}: a filter has no matrix E")
    if system.n_inputs != len(plant.inputs) + plant.n_outputs:
        raise FileFormatError(f"{where}: the filter and the plant have different channels")
    if tuple(generator.subspaces) != plant.faults:
        raise FileFormatError(f"{where}: subspaces must be those of the faults of the plant")
    if any(basis.ndim != 2 or len(basis) != k for basis in generator.subspaces.values()):
        raise FileFormatError(f"{where}: every subspace needs {k} rows, one per residual")
    if any(row >= k for member in generator.members for row in member.residuals):
        raise FileFormatError(f"{where}: a member has residuals that are not there")
    if generator.steady is not None and any(
        vector.shape != (k,) or not np.isfinite(vector).all() for vector in generator.steady.values()
    ):
        raise FileFormatError(f"{where}: every steady response needs {k} finite entries")
    if generator.steady is not None:
        record(generator.steady, joined(where, "steady"), plant.faults)
    if not system.is_stable():
        raise FileFormatError(f"{where}: the filter is not stable")
    _check_leaks(generator, where)
    for name, rows in (("state_map", system.n_states), ("static_map", k)):
        M = getattr(generator, name)
        if M is not None and M.shape != (rows, plant.n_states):
            raise FileFormatError(f"{where}: {name} must be {rows} x {plant.n_states}")
    if generator.codes is not None and generator.codes.shape != (len(generator.members), len(plant.faults)):
        raise FileFormatError(f"{where}: codes must have a row per member and a column per fault")
    if generator.estimated and len(generator.estimated) != k:
        raise FileFormatError(f"{where}: an estimator names one fault per residual")
    if set(generator.estimated) - {"", *plant.faults}:
        raise FileFormatError(f"{where}: a fault is estimated that the plant does not have")
    form = generator.known_form
    if form is not None and (form.n_outputs != k or form.n_inputs < len(plant.faults)):
        raise FileFormatError(f"{where}: known_form does not fit the filter")


def _check_leaks(generator: ResidualGenerator, where: str) -> None:
    """Recompute the leakage of decoupled signals into the residual, since alarms rest on it.

    Of what :func:`make_generator` checks, this and the stability are checked again. The subspaces tell what faults do;
    they are as good as the checksum of the file.
    """
    promised = dict(generator.evidence.decoupling)
    promised.setdefault("disturbance", promised.get(IGNORED, np.inf))
    cost = generator.evidence.cost_of_sampling
    system, plant = generator.system, generator.plant
    gains = reached(system, plant, generator.state_map, generator.static_map)
    for name, gain in gains.items():
        known = max(promised.get(name, np.inf), cost.get(name, 0.0))
        if not gain <= max(2 * LEAK, 1.01 * known):  # twice, for other rounding than where it was made
            raise FileFormatError(
                f"{where}: the {name} inputs reach the residual, by {gain:.2g} of the terms that should cancel"
            )


_OTHERS = (
    RecordOf(ResidualGenerator, check=_check),
    RecordOf(StateSpace, {"dt": STEP}),
    RecordOf(Plant, {"dt": STEP}, _plant, _check_plant),
    RecordOf(Observer, check=_check_dimensions),
    RecordOf(Evidence, {"decoupling": ANY, "conditions": ANY}, check=_check_dimensions),
    RecordOf(RankDecision, {"singular_values": NOT_NEGATIVE, "tolerance": NOT_NEGATIVE}, check=_check_rank),
    RecordOf(ParityRelations),
)
