"""Designs in a unit of time of their own: however options are written, they are in the unit of the caller."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

import residua as rs

POLES = np.array([-100.0, -120.0, -150.0])


def plant(factor: float = 1.0) -> rs.Plant:
    """Return a plant of rates about a thousand."""
    A = 1000.0 * factor * np.array([[-1, 0.5, 0], [0.3, -2, 0.4], [0, 0.2, -3]])
    return rs.Plant(A, [[1000.0], [0], [500.0]], np.eye(3)[:2]).with_actuator_faults().with_sensor_faults()


WRITTEN: dict[str, Callable[[], Any]] = {
    "list": lambda: list(POLES),
    "tuple": lambda: tuple(POLES),
    "iterator": lambda: iter(POLES),
    "objects": lambda: POLES.astype(object),
    "words": lambda: [str(pole) for pole in POLES],
    "array of words": lambda: POLES.astype(str),
    "fractions": lambda: [Fraction(pole) for pole in POLES],
    "complex": lambda: POLES + 0j,
}


@pytest.mark.parametrize("how", WRITTEN)
def test_poles_are_in_the_unit_of_the_caller_however_they_are_written(how: str) -> None:
    made = rs.design.luenberger_observer(plant(), poles=WRITTEN[how]())
    assert np.allclose(np.sort(made.evidence.poles.real), np.sort(POLES), rtol=1e-9)
    assert np.allclose(np.sort(made.evidence.requested_poles.real), np.sort(POLES), rtol=1e-12)


def test_poles_of_a_plant_without_rates_are_as_they_are_asked_for() -> None:
    chain = rs.Plant(np.eye(3, k=1), [[0], [0], [1]], [[1, 0, 0]]).with_sensor_faults()
    for poles in ([-1000.0, -1500.0, -2000.0], ["-1000", "-1500", "-2000"]):
        made = rs.design.luenberger_observer(chain, poles=poles)  # pyright: ignore[reportArgumentType]
        assert np.allclose(np.sort(made.evidence.poles.real), [-2000, -1500, -1000], rtol=1e-6)


def test_variants_are_taken_from_whatever_holds_them() -> None:
    variants = [plant(), plant(1.1), plant(1.2)]
    sizes: dict[str, Any] = {"order": 2, "states": np.eye(3), "inputs": np.eye(1)}
    expected = rs.design.optimal_parity(plant(), variants=variants, **sizes).indices
    for held in (tuple(variants), iter(variants), dict(enumerate(variants)).values()):
        assert np.array_equal(rs.design.optimal_parity(plant(), variants=held, **sizes).indices, expected)


def test_an_observer_of_a_users_own_class_has_the_residual_of_what_it_is_made_of() -> None:
    class Own(rs.design.Observer):
        pass

    made = rs.design.luenberger_observer(plant())
    own = Own(**{one.name: getattr(made, one.name) for one in fields(made)})
    assert np.array_equal(own.residual_generator().evidence.poles, made.residual_generator().evidence.poles)


def test_a_plant_by_its_name_is_designed_for_as_one_by_its_place() -> None:
    assert np.array_equal(
        rs.design.reduced_order_observer(plant=plant()).K, rs.design.reduced_order_observer(plant()).K
    )


def test_an_argument_given_twice_is_refused() -> None:
    with pytest.raises(TypeError, match="multiple values for argument 'structure'"):
        rs.design.structured_bank(plant(), ["111"], structure=["011"])  # pyright: ignore[reportCallIssue]
