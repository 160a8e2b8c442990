"""Every guard of plants and uncertain plants notices a wrong intermediate result, and does not hand it on."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import residua as rs
from guards import changed, trips
from residua.errors import AccuracyError
from residua.linear import UncertainSystem, robust_peak_norm
from residua.plant import InputOutputModel, UncertainPlant, dumps_plant, without_algebraic_equations
from residua.robust.parity.expected_signals import stationary_factor

#: By how much wrong results are off: small enough to look right, and far above every tolerance of the evidence.
OFF = 1e-3


def off(M: Any) -> Any:
    """A matrix with its largest entry off by a thousandth."""
    out = np.array(M)
    out.flat[int(np.argmax(np.abs(out)))] *= 1 + OFF
    return out


@trips("plant.plant_writer:dumps_plant")
def test_a_file_that_does_not_give_the_plant_back_is_not_written(monkeypatch: pytest.MonkeyPatch) -> None:
    dumps_plant(rs.library.gertler())
    changed(monkeypatch, "plant.plant_writer:loads_plant", lambda plant: plant.with_sensor_faults())
    with pytest.raises(AccuracyError, match="does not give the same plant back"):
        dumps_plant(rs.library.gertler())


@trips("plant.observer_form:check_response")
def test_an_elimination_that_misses_the_equations_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    plant = rs.Plant([[-1, 1], [1, -2]], [[0], [1]], [[0, 1]], E=[[1, 0], [0, 0]], states=["level", "flow"])
    without_algebraic_equations(plant)
    changed(monkeypatch, "plant.algebraic_equations:np.linalg.inv", off)
    with pytest.raises(AccuracyError, match="without its algebraic equations"):
        without_algebraic_equations(plant)


def two_poles() -> InputOutputModel:
    return InputOutputModel.from_transfer_functions([[([1.0], [1.0, 1.0]), ([1.0], [1.0, 2.0])]])


@trips("plant.transfer_functions:_least_common_row:1")
def test_an_unclear_denominator_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    two_poles()
    changed(monkeypatch, "plant.transfer_functions:shortest_left_null_vectors", lambda found: None)
    with pytest.raises(AccuracyError, match="is not clear"):
        two_poles()


@trips("plant.transfer_functions:_least_common_row:2")
def test_a_denominator_of_zero_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    zero = lambda found: replace(found, vectors=0.0 * np.asarray(found.vectors))  # noqa: E731
    changed(monkeypatch, "plant.transfer_functions:shortest_left_null_vectors", zero)
    with pytest.raises(AccuracyError, match="came out zero"):
        two_poles()


# ------------------------------------------------------------------ uncertain plants


@trips("robust.sets.linearisation:uncertain_plant_from_plants")
def test_a_box_that_misses_its_plants_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    slow, fast = (rs.Plant([[-a]], [[a]], [[1.0]]) for a in (1.0, 2.0))
    UncertainPlant.from_plants([slow, fast])
    changed(monkeypatch, "robust.sets.linearisation:_channels_of", lambda parts: (parts[0], off(parts[1]), parts[2]))
    with pytest.raises(AccuracyError, match="misses the plants"):
        UncertainPlant.from_plants([slow, fast])


@trips("robust.bounds.robust_peak_norm:robust_peak_norm")
def test_a_bound_below_what_a_member_attains_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    lag = UncertainSystem([[0.5]], [[1.0]], [[1.0]], [[1.0]], [[1.0]], low=[0.0], high=[0.3], dt=1.0)
    robust_peak_norm(lag, method="star")
    changed(
        monkeypatch,
        "robust.bounds.robust_peak_norm:_cut",
        lambda parts: [replace(part, bound=(1 - OFF) * part.bound) for part in parts],
    )
    with pytest.raises(AccuracyError, match="the certificate is wrong"):
        robust_peak_norm(lag, method="star")


@trips("robust.parity.expected_signals:stationary_factor")
def test_states_without_a_stationary_covariance_are_refused() -> None:
    np.testing.assert_allclose(stationary_factor(np.array([[0.5]]), np.eye(1), "x") ** 2, [[4 / 3]], rtol=1e-12)
    with pytest.raises(AccuracyError, match="does not converge"):
        stationary_factor(np.eye(1), np.eye(1), "x")
