"""Directions: every fault stays on its own line or plane, whatever its time course."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import residua as rs
from generated import random_plant, simulate
from residua.design.detection_filters.directional_gain import fault_events, obstacle
from residua.errors import DesignError, ModelError
from residua.linear.poles.zeros import invariant_zeros


@pytest.mark.parametrize("seed", range(40))
def test_the_residual_stays_on_the_line_of_the_fault(seed: int) -> None:
    rng = np.random.default_rng(seed)
    plant = random_plant(rng, n=6, outputs=3, faults=2, dt=0.1)
    generator = rs.design.detection_filter(plant)
    for name, direction in generator.directions.items():
        u, y = simulate(plant, rng, 80, fault=name)
        r = generator.run(u, y)
        off = r - np.outer(r @ direction, direction)
        assert np.abs(r).max() > 1e-6
        assert np.abs(off).max() < 1e-8 * np.abs(r).max()
    assert set(generator.directions) == set(plant.faults)


@pytest.mark.parametrize("seed", range(20))
def test_a_generic_direction_is_where_the_fault_first_shows(seed: int) -> None:
    rng = np.random.default_rng(1000 + seed)
    plant = random_plant(rng, n=5, outputs=4, faults=3)
    generator = rs.design.detection_filter(plant)
    for i, name in enumerate(plant.faults):
        expected = plant.C @ plant.Bf[:, i]
        assert generator.directions[name] @ expected / np.linalg.norm(expected) == pytest.approx(1, abs=1e-8)


def test_a_fault_two_steps_from_the_outputs_keeps_its_direction() -> None:
    A = np.array([[0, 1, 0, 0], [0, 0, 1, 0], [0, 0, -1, 1], [1, 0, 0, -2]], dtype=float)
    plant = rs.Plant(A, [[0], [0], [0], [1]], [[1, 0, 0, 0], [0, 0, 0, 1]]).with_faults({"deep": [0, 0, 1, 0]})
    generator = rs.design.detection_filter(plant, poles={"deep": [-1, -2, -3], "rest": [-4]})
    np.testing.assert_allclose(generator.directions["deep"], [1, 0], atol=1e-9)
    np.testing.assert_allclose(np.sort(generator.evidence.poles.real), [-4, -3, -2, -1], rtol=1e-6)


def test_poles_are_reached_and_invariant_zeros_of_all_faults_are_fixed() -> None:
    generator = rs.design.detection_filter(rs.library.gertler(), poles=[0.25, 0.3])
    np.testing.assert_allclose(generator.evidence.fixed_poles, [0.6], atol=1e-9)
    np.testing.assert_allclose(np.sort(generator.evidence.poles.real), [0.25, 0.3, 0.6], atol=1e-9)


def test_an_unstable_invariant_zero_of_the_faults_together_costs_a_second_filter() -> None:
    A = np.diag([0.4, 0.5, 0.9])
    C = np.array([[1.0, 1, 0], [0, 1, 1]])
    F = np.array([[1.0, 0], [1.0, 1], [0, -0.1]])
    assert abs(invariant_zeros(A, F, C).zeros[0]) > 1
    plant = rs.Plant(A, np.ones((3, 1)), C, dt=1).with_faults({"p1": F[:, 0], "p2": F[:, 1]})
    generator = rs.design.detection_filter(plant)
    assert len(generator.members) == 2, "each fault needs a filter of its own"
    assert generator.system.is_stable()


@pytest.mark.parametrize("seed", range(8))
def test_faults_are_split_over_as_few_filters_as_needed(seed: int) -> None:
    """Against brute force over all partitions."""
    rng = np.random.default_rng(seed)
    plant = random_plant(rng, n=5, outputs=2, faults=4, dt=0.1)
    generator = rs.design.detection_filter(plant)
    columns = {name: (plant.Bf[:, [i]], plant.Df[:, [i]]) for i, name in enumerate(plant.faults)}
    events, _ = fault_events(plant.A, plant.C, columns)

    def fewest(left: tuple[int, ...]) -> int:
        if not left:
            return 0
        first, rest = left[0], left[1:]
        best = len(left)
        for k in range(len(rest) + 1):
            for others in itertools.combinations(rest, k):
                if obstacle(plant.A, plant.C, [events[i] for i in (first, *others)], plant.balanced) is None:
                    best = min(best, 1 + fewest(tuple(i for i in rest if i not in others)))
        return best

    assert len(generator.members) == fewest((0, 1, 2, 3))
    assert sorted(name for member in generator.members for name in member.faults) == sorted(plant.faults)
    for member in generator.members:
        rows = list(member.residuals)
        for name in member.faults:
            assert np.linalg.matrix_rank(generator.subspaces[name][rows], tol=1e-7) == 1


def test_twins_share_a_direction_and_a_filter() -> None:
    plant = rs.library.gertler().without_faults("p2").with_faults({"twin": [2, 2, 0]})
    generator = rs.design.detection_filter(plant)
    assert len(generator.members) == 1
    np.testing.assert_allclose(generator.directions["p1"], generator.directions["twin"], atol=1e-9)


def test_sensor_faults_stay_in_a_plane() -> None:
    rng = np.random.default_rng(3)
    plant = random_plant(rng, n=4, outputs=4, faults=0, sensors=True, dt=0.1)
    generator = rs.design.detection_filter(plant, poles=[0.3] * 4)
    assert {basis.shape[1] for basis in generator.subspaces.values()} == {2}
    for name in plant.faults:
        r = generator.run(*simulate(plant, rng, 50, fault=name))
        basis = generator.subspaces[name]
        assert np.abs(r - r @ basis @ basis.T).max() < 1e-9 * np.abs(r).max()


@pytest.mark.parametrize(
    ("poles", "error", "words"),
    [
        ([0.25, 1.3, 0.6], DesignError, "stable"),
        ([0.25], DesignError, "2 are free"),
        ([0.25, 0.3 + 0.1j, 0.6], (DesignError, ModelError), "conjugate"),
        ({"p3": [0.2]}, DesignError, "unknown fault 'p3'"),
        ({"p1": [0.2, 0.1]}, DesignError, "1 belong"),
    ],
)
def test_wrong_poles_are_refused(poles: object, error: type, words: str) -> None:
    with pytest.raises(error, match=words):
        rs.design.detection_filter(rs.library.gertler(), poles=poles)  # pyright: ignore[reportArgumentType]


def test_a_plant_without_faults_is_refused() -> None:
    with pytest.raises(DesignError, match="no faults"):
        rs.design.detection_filter(rs.library.gertler().without_faults())
    with pytest.raises(ModelError, match="unknown fault"):
        rs.design.detection_filter(rs.library.gertler(), faults=["nobody"])


def test_only_faults_that_cannot_be_told_apart_are_said_to_share_a_signature() -> None:
    plant = rs.Plant([[-1.0, 0], [0, -2]], [[1.0], [1]], np.eye(2)).with_faults({"a": [1, 0], "b": [2, 0]})
    (note,) = (note for note in rs.design.detection_filter(plant, margin=3).evidence.notes if "signature" in note)
    assert note == "a, b share one signature: this filter cannot tell them apart"
    flt = rs.design.robust_detection_filter(rs.library.jet_engine().without_faults("fuel actuator"), poles=[-3, -3, -3])
    assert not any("signature" in note for note in flt.evidence.notes)
    sensors = list(flt.subspaces)
    for one, other in itertools.combinations(sensors, 2):  # each settles off the subspace of every other
        for name, stranger in ((one, other), (other, one)):
            assert rs.decide.projection_distance(flt.steady_directions[name], flt.subspaces[stranger]) > 0.1
