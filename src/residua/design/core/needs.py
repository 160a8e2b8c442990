"""Needs of methods, and the calls that are worth trying for a plant."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from residua.design.core.method import Need
from residua.plant import Plant
from residua.plant.balanced import is_singular

if TYPE_CHECKING:
    from residua.analysis.diagnosability import Diagnosability


def _not_two_groups(plant: Plant, known: Diagnosability | None) -> str:
    if not plant.faults:
        return "the plant has no faults"
    if known is None:
        return "which of its faults can be told apart was not examined"
    return "" if len(known.groups) > 1 else "no two of its faults can be told apart"


def _has(text: str, has: Callable[[Plant], object], missing: str) -> Need:
    return Need(text, lambda plant, known: "" if has(plant) else missing)


NOISE = _has("noise", lambda plant: plant.noises, "the plant has no noise: give it with plant.with_noise(...)")
SAMPLED = _has("sampled", lambda plant: plant.is_discrete, "it counts samples: plant.discretize(dt) first")
FAULTS = _has("faults", lambda plant: plant.faults, "the plant has no faults")
SENSOR_FAULTS = _has("sensor faults", lambda plant: "sensor" in plant.fault_kinds, "the plant has no sensor faults")
ACTUATOR_FAULTS = _has(
    "actuator faults", lambda plant: "actuator" in plant.fault_kinds, "the plant has no actuator faults"
)
FAULTS_APART = Need("faults", _not_two_groups)


def disturbances(text: str, instead: str) -> Need:
    """Return the need of disturbances: its name, and what serves a plant without."""
    return _has(text, lambda plant: plant.disturbances, f"the plant has no disturbances: {instead}")


def each_scheme(plant: Plant, known: Diagnosability | None) -> Iterable[Mapping[str, Any]]:
    """Return both schemes of a bank."""
    return {"scheme": "generalized"}, {"scheme": "dedicated"}


def least_order_unless_singular(plant: Plant, known: Diagnosability | None) -> Iterable[Mapping[str, Any]]:
    """Return the option for the least order, where a plant has neither a singular ``E`` nor disturbances."""
    return ({} if is_singular(plant) or plant.disturbances else {"least_order": True},)


def groups_of_faults(plant: Plant, known: Diagnosability | None) -> Iterator[Mapping[str, Any]]:
    """Yield all faults, all of one kind, and each fault that is seen."""
    seen = plant.faults if known is None else tuple(np.asarray(plant.faults)[known.detectable].tolist())
    kinds = ("actuator", "sensor", "component")
    groups = [tuple(fault.name for fault in plant.fault_list if fault.kind == kind) for kind in kinds]
    for group in dict.fromkeys([plant.faults, *groups, *((name,) for name in seen)]):
        if group:
            yield {} if group == plant.faults else {"faults": group}
