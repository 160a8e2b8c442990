"""Needs of methods, and the calls that are worth trying for a plant."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from residua.design.core.method import Need
from residua.plant import Plant
from residua.plant.balanced import is_singular

if TYPE_CHECKING:
    from residua.analysis.diagnosability import Diagnosability


def _no_noise(plant: Plant, known: Diagnosability | None) -> str:
    return "" if plant.noises else "the plant has no noise: give it with plant.with_noise(...)"


def _not_sampled(plant: Plant, known: Diagnosability | None) -> str:
    return "" if plant.is_discrete else "it counts samples: plant.discretize(dt) first"


def _no_faults(plant: Plant, known: Diagnosability | None) -> str:
    return "" if plant.faults else "the plant has no faults"


def _no_sensor_faults(plant: Plant, known: Diagnosability | None) -> str:
    return "" if "sensor" in plant.fault_kinds else "the plant has no sensor faults"


def _no_actuator_faults(plant: Plant, known: Diagnosability | None) -> str:
    return "" if "actuator" in plant.fault_kinds else "the plant has no actuator faults"


def _not_two_groups(plant: Plant, known: Diagnosability | None) -> str:
    if not plant.faults:
        return "the plant has no faults"
    if known is None:
        return "which of its faults can be told apart was not examined"
    return "" if len(known.groups) > 1 else "no two of its faults can be told apart"


NOISE = Need("noise", _no_noise)
SAMPLED = Need("sampled", _not_sampled)
FAULTS = Need("faults", _no_faults)
SENSOR_FAULTS = Need("sensor faults", _no_sensor_faults)
ACTUATOR_FAULTS = Need("actuator faults", _no_actuator_faults)
FAULTS_APART = Need("faults", _not_two_groups)


def disturbances(text: str, instead: str) -> Need:
    """Return the need of disturbances: its name, and what serves a plant without."""

    def missing(plant: Plant, known: Diagnosability | None) -> str:
        return "" if plant.disturbances else f"the plant has no disturbances: {instead}"

    return Need(text, missing)


def each_scheme(plant: Plant, known: Diagnosability | None) -> Iterable[Mapping[str, Any]]:
    """Return both schemes of a bank."""
    return {"scheme": "generalized"}, {"scheme": "dedicated"}


def least_order_unless_singular(plant: Plant, known: Diagnosability | None) -> Iterable[Mapping[str, Any]]:
    """Return the option for the least order, where a plant has neither a singular ``E`` nor disturbances."""
    return ({} if is_singular(plant) or plant.disturbances else {"least_order": True},)


def groups_of_faults(plant: Plant, known: Diagnosability | None) -> Iterator[Mapping[str, Any]]:
    """Yield all faults, all of one kind, and each fault that is seen."""
    seen = plant.faults if known is None else tuple(np.asarray(plant.faults)[known.detectable].tolist())
    groups: list[tuple[str, ...]] = [plant.faults]
    for kind in ("actuator", "sensor", "component"):
        groups.append(tuple(fault.name for fault in plant.fault_list if fault.kind == kind))
    groups += [(name,) for name in seen]
    for group in dict.fromkeys(groups):
        if group:
            yield {} if group == plant.faults else {"faults": group}
