"""What depends on units is noticed whatever results are kept: the door, what is behind it, and the way back."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import residua as rs
from exact_campaign import examination
from exact_campaign.answers import Subject
from exact_campaign.generators import examine_generator
from residua.design.banks import decoupled_residual
from residua.design.core import canonical_design

#: A plant with states and outputs of many units in powers of two; one seed of which everything is computed again.
KIND, KEPT, AGAIN = "dense", 5009, 5020


def residual(subject: Subject) -> None:
    """Ask for one residual, and for the bank that has it as a member."""
    plant = subject.plant
    for name, call in (
        ("decoupled_residual", lambda: rs.design.decoupled_residual(plant)),
        ("structured_bank", lambda: rs.design.structured_bank(plant, ["1" * len(plant.faults)]).generator),
    ):
        record = subject.ask(name, call)
        if record.answer.made is not None:
            examine_generator(subject, record, record.answer.made, plant)


def designed(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Return the plants that the design behind the door will see."""
    seen: list[Any] = []
    right = decoupled_residual._designed

    def watched(plant: Any, *args: Any) -> Any:
        seen.append(plant)
        return right(plant, *args)

    monkeypatch.setattr(decoupled_residual, "_designed", watched)
    return seen


def topics(seed: int) -> set[str]:
    """Return what failed on a plant in base units and in powers of two."""
    return {failure.topic for failure in examination.examine(KIND, seed, (residual,))[1]}


def test_a_sound_package_computes_once_what_has_the_same_bits_and_again_for_one_plant_in_ten(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    seen = designed(monkeypatch)
    assert topics(KEPT) == set()
    once = len(seen)
    assert once
    seen.clear()
    assert topics(AGAIN) == set()
    assert len(seen) == 2 * once
    for first, second in zip(seen[:once], seen[once:], strict=True):
        assert np.array_equal(first.A, second.A)
        assert np.array_equal(first.C, second.C)


@pytest.mark.parametrize("seed", [KEPT, AGAIN])
def test_a_way_back_that_depends_on_units_is_noticed(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    right = canonical_design.in_units_of

    def wrong(plant: Any, units: Any, made: Any) -> Any:
        outputs = np.where(units.outputs > 2.0**8, 1.001 * units.outputs, units.outputs)
        return right(plant, replace(units, outputs=outputs), made)

    monkeypatch.setattr(canonical_design, "in_units_of", wrong)
    assert topics(seed) & {"leak", "structure", "units: refusal"}


@pytest.mark.parametrize("seed", [KEPT, AGAIN])
def test_a_door_that_depends_on_units_leads_to_another_computation_and_what_comes_of_it_is_noticed(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    right = canonical_design.canonical_units
    seen = designed(monkeypatch)
    watched = decoupled_residual._designed

    def door(plant: Any) -> Any:  # one output keeps its own unit
        units = right(plant)
        return replace(units, outputs=np.concatenate([units.outputs[:-1], [1.0]]))

    def absolute(plant: Any, *args: Any) -> Any:  # and a decision behind it is made by absolute size
        made = watched(plant, *args)
        silent = {name: 0.0 * basis for name, basis in made.subspaces.items()}
        return replace(made, subspaces=silent) if np.abs(plant.C[-1]).max() < 2.0**-3 else made

    monkeypatch.setattr(canonical_design, "canonical_units", door)
    monkeypatch.setattr(decoupled_residual, "_designed", absolute)
    found = topics(seed)
    assert len({float(np.abs(plant.C[-1]).max()) for plant in seen}) > 1  # it was designed again, for another plant
    assert found & {"structure", "units: structure"}
