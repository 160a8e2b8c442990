"""Designs in canonical units have the same digits, to the last bit, in whatever powers of two a plant is written."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import residua as rs
from exact_campaign.cases import in_other_time, plant_of, units
from exact_campaign.kinds import case_of
from residua.design.banks import decoupled_residual
from residua.design.detection_filters import directional_gain
from residua.design.estimation import fault_estimator
from residua.design.observers import (
    kalman_filter,
    luenberger_observer,
    perfect_observer,
    reduced_order,
    unknown_input_observer,
)
from residua.design.parity import relations
from residua.errors import ResiduaError
from residua.linear.systems.array_cache import forget
from residua.plant import Plant

Systems = list[Any]


def of_perfect(observer: rs.design.PerfectObserver) -> Systems:
    """Return the filters of an observer, for the state and the residual."""
    return [observer.system, observer.residual_generator().system] if len(observer.left) else [observer.system]


def of_estimator(estimator: rs.design.FaultEstimator) -> Systems:
    """Return the filters of an estimator, for faults and states."""
    return [estimator.system, estimator.joint_system]


_DESIGNS: dict[str, Callable[[Plant], Systems]] = {
    "kalman_filter": lambda p: [rs.design.kalman_filter(p).system],
    "decoupled_residual": lambda p: [rs.design.decoupled_residual(p).system],
    "fault_estimator": lambda p: of_estimator(rs.design.fault_estimator(p, faults=p.faults[:1])),
    "luenberger_observer": lambda p: [rs.design.luenberger_observer(p).system],
    "unknown_input_observer": lambda p: [rs.design.unknown_input_observer(p).system],
    "descriptor_observer": lambda p: [rs.design.descriptor_observer(p).system],
    "detection_filter": lambda p: [rs.design.detection_filter(p).system],
    "robust_detection_filter": lambda p: [rs.design.robust_detection_filter(p).system],
    "primary_residuals": lambda p: [rs.design.primary_residuals(p).system],
    "parity_relations": lambda p: [rs.design.parity_relations(p).system],
    "structured_parity": lambda p: [rs.design.structured_parity(p, ["1" * len(p.faults)]).generator.system],
    "perfect_observer": lambda p: of_perfect(rs.design.perfect_observer(p)),
    "perfect_observer, least order": lambda p: of_perfect(rs.design.perfect_observer(p, least_order=True)),
}
#: What they compute, behind the door.
_BEHIND: dict[str, tuple[Any, str]] = {
    "kalman_filter": (kalman_filter, "filter_riccati"),
    "decoupled_residual": (decoupled_residual, "_designed"),
    "fault_estimator": (fault_estimator, "unknown_input_observer"),
    "luenberger_observer": (luenberger_observer, "place"),
    "unknown_input_observer": (unknown_input_observer, "place"),
    "descriptor_observer": (reduced_order, "_reduced"),
    "detection_filter": (directional_gain, "split_blocks"),
    "robust_detection_filter": (directional_gain, "split_blocks"),
    "primary_residuals": (relations, "realize_relation"),
    "parity_relations": (relations, "realize_relation"),
    "structured_parity": (relations, "realize_relation"),
    "perfect_observer": (perfect_observer, "full_rank_gain"),
    "perfect_observer, least order": (perfect_observer, "least_order_gain"),
}
_PLANTS = [
    ("dense", 3),
    ("sparse", 19027),
    ("companion", 8),
    ("planted zeros", 30003),
    ("delays", 2),
    ("singular E", 4),
]


def digits(systems: Systems) -> list[NDArray[np.float64]]:
    """Return the digits of all numbers of systems, without the powers of two before them."""
    return [np.frexp(getattr(system, name))[0] for system in systems for name in "ABCD"]


def written(kind: str, seed: int) -> list[Plant]:
    """Return a plant of the campaign in base units, and in two others."""
    case = case_of(kind, seed)
    others = [in_other_time(case, units(case, k, powers_of_two=True), k) for k in (1, 2)]
    return [plant_of(case, by, noise=True) for by in (None, *others)]


@pytest.mark.parametrize("design", list(_DESIGNS))
def test_a_design_has_the_same_digits_in_all_units(design: str) -> None:
    """Nothing that was computed in base units is there to be taken."""
    made = 0
    for kind, seed in _PLANTS:
        found = []
        for plant in written(kind, seed):
            forget()
            try:
                found.append(digits(_DESIGNS[design](plant)))
            except ResiduaError:
                found.append([])
        made += any(len(one) for one in found)
        for other in found[1:]:
            assert all(np.array_equal(a, b) for a, b in zip(found[0], other, strict=True)), (kind, seed)
    assert made


@pytest.mark.parametrize("design", list(_BEHIND))
def test_a_design_is_computed_once_for_all_units(design: str, monkeypatch: pytest.MonkeyPatch) -> None:
    module, name = _BEHIND[design]
    right, calls = getattr(module, name), []

    def watched(*args: Any, **options: Any) -> Any:
        calls.append(name)
        return right(*args, **options)

    monkeypatch.setattr(module, name, watched)
    most = 0
    for kind, seed in _PLANTS:
        forget()
        calls.clear()
        counts = []
        for plant in written(kind, seed):
            with suppress(ResiduaError):  # a reason that has a rate in it is found in each unit of time
                _DESIGNS[design](plant)
                counts.append(len(calls))
        if not counts:
            continue
        assert set(counts) == {counts[0]}, (kind, seed)
        most = max(most, counts[0])
    assert most
