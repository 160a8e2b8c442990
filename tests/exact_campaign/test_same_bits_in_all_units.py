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
from residua.design.observers import kalman_filter
from residua.errors import DesignError
from residua.linear.systems.array_cache import forget
from residua.plant import Plant

Systems = list[Any]

_DESIGNS: dict[str, Callable[[Plant], Systems]] = {
    "kalman_filter": lambda p: [rs.design.kalman_filter(p).system],
    "decoupled_residual": lambda p: [rs.design.decoupled_residual(p).system],
}
#: What they compute, behind the door.
_BEHIND: dict[str, tuple[Any, str]] = {
    "kalman_filter": (kalman_filter, "filter_riccati"),
    "decoupled_residual": (decoupled_residual, "_designed"),
}
_PLANTS = [("dense", 3), ("sparse", 19027), ("companion", 8), ("planted zeros", 30003), ("delays", 2)]


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
            except DesignError:
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
    for kind, seed in _PLANTS:
        forget()
        calls.clear()
        counts = []
        for plant in written(kind, seed):
            with suppress(DesignError):
                _DESIGNS[design](plant)
            counts.append(len(calls))
        assert counts[0]
        assert set(counts) == {counts[0]}, (kind, seed)
