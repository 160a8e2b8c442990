"""Matched filters: the responses are those of the filter run on the faulty plant; groups and refusals are right."""

from __future__ import annotations

import re
from collections.abc import Callable
from importlib import import_module

import numpy as np
import pytest

import residua as rs
from generated import random_plant
from residua.design.banks.matched_filters import MatchedFilters, matched_filters
from residua.errors import AccuracyError, DesignError


def noisy(seed: int, **options: object) -> rs.Plant:
    rng = np.random.default_rng(seed)
    plant = random_plant(rng, sensors=True, dt=0.1, **options)  # pyright: ignore[reportArgumentType]
    return plant.with_noise(process=float(rng.uniform(0.01, 0.1)), measurement=float(rng.uniform(0.02, 0.2)))


def gertler() -> rs.Plant:
    return rs.library.gertler(sensor_faults=True).with_noise(process=0.01, measurement=0.1)


@pytest.mark.parametrize("seed", range(20))
def test_the_responses_are_what_the_filter_gives_on_the_faulty_plant(seed: int) -> None:
    """By linearity: simulate the plant with a step in one fault, without noise, and run the filter over its outputs."""
    plant = noisy(seed, feedthrough=seed % 2 == 0)
    matched = matched_filters(plant, window=25)
    for j, name in enumerate(plant.faults):
        f = np.zeros((26, len(plant.faults)))
        f[:, j] = 1.0
        y = plant.system("fault").simulate(f)
        r = matched.generator.run(np.zeros((26, len(plant.inputs))), y)
        scale = np.abs(y).max() + 1.0
        np.testing.assert_allclose(matched.responses[:, :, j], r, atol=1e-9 * scale, err_msg=name)
        np.testing.assert_allclose(matched.settled[:, j], matched.generator.steady_directions[name])


def test_equations_of_gertler_for_the_two_kinds_of_fault() -> None:
    """(5-20) and (5-21), written out, with the filter's own gain."""
    plant = gertler()
    matched = matched_filters(plant, window=6)
    observer = matched.generator.observer
    assert observer is not None
    A, C, K = plant.A - observer.K @ plant.C, plant.C, observer.K
    process, sensor = np.zeros(3), np.zeros(3)
    for k in range(7):
        np.testing.assert_allclose(matched.responses[k, :, 0], C @ process, atol=1e-12)
        np.testing.assert_allclose(matched.responses[k, :, 3], C @ sensor + [0, 1], atol=1e-12)
        process, sensor = A @ process + plant.Bf[:, 0], A @ sensor - K[:, 1]


def test_the_units_of_the_plant_do_not_matter() -> None:
    plant = gertler()
    scaled = rs.Plant(plant.A, plant.B, np.diag([1e6, 1e-5]) @ plant.C, dt=1.0, outputs=["y1", "y2"])
    scaled = scaled.with_faults({"p1": [1e-3, 1e-3, 0], "p2": [0, 1e4, 1e4]}).with_sensor_faults()
    scaled = scaled.with_noise(process=0.01 * np.eye(3), measurement=0.1 * np.diag([1e12, 1e-10]))
    reference = rs.library.gertler(sensor_faults=True).with_noise(process=0.01 * np.eye(3), measurement=0.1 * np.eye(2))
    one, other = matched_filters(reference), matched_filters(scaled)
    assert one.groups == other.groups
    np.testing.assert_allclose(one.similarity(), other.similarity(), atol=1e-8)
    units = np.array([1e-3, 1e4, 1e-6, 1e5])
    np.testing.assert_allclose(
        list(one.deviation().values()), np.array(list(other.deviation().values())) * units, rtol=1e-6
    )


def test_faults_that_look_the_same_are_grouped_and_told() -> None:
    """An actuator and a leak that act alike; and one that does the same a few samples later."""
    chain = np.diag([0.7, 0.0, 0.0]) + np.diag([0.0, 0.0], 1)
    chain[0, 1] = chain[1, 2] = 1.0  # a fault of the third state reaches the first two samples later
    plant = rs.Plant(chain, [[1.0], [0], [0]], [[1.0, 0, 0], [2.0, 0, 0]], dt=1.0)
    plant = plant.with_faults({"valve": [1, 0, 0], "leak": [-3, 0, 0], "upstream": [0, 0, 1]}).with_sensor_faults()
    plant = plant.with_noise(process=0.1, measurement=0.1)
    matched = matched_filters(plant, window=30)
    assert matched.groups[0] == ("valve", "leak", "upstream")
    assert len(matched.groups) == 3
    assert any("not told apart within the window: valve, leak, upstream" in x for x in matched.generator.evidence.notes)
    assert "alike: valve, leak, upstream" in str(matched)
    assert matched_filters(plant, window=30, alike=1.0).similarity()[0, 1] == pytest.approx(1.0)


def test_a_response_that_vanishes_is_told() -> None:
    """An integrator's own sensor: a Kalman filter that knows of drift takes a constant offset for the level."""
    plant = rs.Plant([[1.0]], [[0.1]], [[1.0]], dt=1.0).with_sensor_faults().with_actuator_faults()
    matched = matched_filters(plant.with_noise(process=0.1, measurement=0.1))
    assert matched.vanishing == ("y1 sensor",)
    assert matched.unseen == ()
    assert any("not once constant: y1 sensor" in note for note in matched.generator.evidence.notes)
    steady = matched_filters(plant.with_noise(process=0.1, measurement=0.1), steady=True)
    assert steady.unseen == ("y1 sensor",)
    assert steady.groups == (("u1 actuator",),)
    assert steady.deviation()["y1 sensor"] == np.inf


def test_an_invisible_fault_is_in_no_group() -> None:
    plant = rs.Plant(np.diag([0.5, 0.6]), [[1.0], [1]], [[1.0, 0]], dt=1.0)
    plant = plant.with_faults({"seen": [1, 0], "hidden": [0, 1]}).with_noise(process=0.1, measurement=0.1)
    matched = matched_filters(plant)
    assert matched.unseen == ("hidden",)
    assert matched.groups == (("seen",),)
    assert rs.Monitor(matched).groups == (("seen",),)


def test_deviation_is_that_of_least_squares() -> None:
    """The inverse root of the information in the samples since the arrival, with the covariance of the innovations."""
    matched = matched_filters(gertler(), window=12)
    covariance = matched.generator.covariance
    assert covariance is not None
    weight = np.linalg.inv(covariance)
    for j, name in enumerate(matched.faults):
        for age in (1, 5, 12):
            rho = matched.responses[: age + 1, :, j]
            information = np.einsum("ka,ab,kb->", rho, weight, rho)
            assert matched.deviation(age)[name] == pytest.approx(information**-0.5)
    assert matched.deviation(0)["p1"] == np.inf
    assert np.isnan(matched.similarity(0)[0]).all()


def test_what_cannot_be_matched_is_refused() -> None:
    plant = gertler()
    bare = rs.library.gertler(sensor_faults=True)
    slow = rs.library.three_tank(dt=0)
    for make, words in (
        (lambda: matched_filters(slow), r"plant\.discretize\(dt\)"),
        (lambda: matched_filters(bare), "with_noise"),
        (lambda: matched_filters(plant.without_faults(list(plant.faults))), "no faults"),
        (lambda: matched_filters(plant, window=0), "window"),
        (lambda: matched_filters(plant, window=2.5), "window"),  # pyright: ignore[reportArgumentType]
        (lambda: matched_filters(plant, alike=1.5), "alike"),
        (lambda: matched_filters(plant, window=10**7), "shorten the window"),
        (lambda: matched_filters(plant).deviation(41), "0 to 40"),
        (lambda: matched_filters(plant).deviation(1.5), "whole number"),  # pyright: ignore[reportArgumentType]
        (lambda: matched_filters(plant).similarity(1.5), "whole number"),  # pyright: ignore[reportArgumentType]
        (lambda: matched_filters(plant).deviation(True), "whole number"),
    ):
        with pytest.raises(DesignError, match=words):
            make()
    blind = rs.Plant([[1.0]], [[0.1]], [[1.0]], dt=1.0).with_sensor_faults().with_noise(process=0.1, measurement=0.1)
    with pytest.raises(DesignError, match="none of the faults once they are constant"):
        matched_filters(blind, steady=True)
    assert isinstance(matched_filters(slow.discretize(1.0), window=5), MatchedFilters)


def test_a_window_that_is_too_short_to_settle_is_told() -> None:
    short = matched_filters(rs.library.three_tank(), window=5)
    assert any("still under way at the end of the window" in note for note in short.generator.evidence.notes)
    assert "still under way at the end of the window" in str(short)
    enough = matched_filters(gertler())
    assert enough.under_way == ()
    assert not any("still under way" in note for note in enough.generator.evidence.notes)
    assert "still under way" not in str(enough)


def test_a_window_as_long_as_is_said_sees_the_responses_settle() -> None:
    """A slow filter of one state: (0.9859...)^k is a tenth after 163 samples."""
    plant = rs.Plant([[0.99]], [[0.01]], [[1.0]], dt=1.0, outputs=["h"]).with_sensor_faults()
    plant = plant.with_noise(process=1e-6, measurement=1e-2)
    short = matched_filters(plant, window=40)
    assert short.under_way == ("h sensor",)
    found = re.search(r"of about (\d+) samples", str(short))
    assert found is not None
    assert abs(short.generator.system.poles()[0]) ** int(found[1]) == pytest.approx(0.1, rel=0.02)
    assert matched_filters(plant, window=int(found[1])).under_way == ()


@pytest.mark.parametrize("make", [rs.design.kalman_filter, matched_filters])
def test_missing_process_noise_is_named(make: Callable[[rs.Plant], object], monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the Riccati equation cannot be solved without any; with process noise that stays what is said."""

    def fails(*_: object, **__: object) -> None:
        raise AccuracyError("the Riccati equation was not solved")

    monkeypatch.setattr(import_module("residua.design.observers.kalman_filter"), "filter_riccati", fails)
    plant = rs.library.gertler(sensor_faults=True)
    with pytest.raises(DesignError, match=r"no process noise.*with_noise\(process=\.\.\., measurement=\.\.\.\)"):
        make(plant.with_noise(measurement=1e-2))
    with pytest.raises(AccuracyError, match="Riccati"):
        make(plant.with_noise(process=1e-2, measurement=1e-2))


def test_a_gain_of_zero_is_told() -> None:
    plant = rs.library.gertler(sensor_faults=True)
    told = matched_filters(plant.with_noise(measurement=0.1)).generator.evidence.notes
    assert any("no process noise, so that the gain is zero" in note for note in told)
    assert not any("gain is zero" in note for note in matched_filters(gertler()).generator.evidence.notes)
