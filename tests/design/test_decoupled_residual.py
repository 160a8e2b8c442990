"""The residual that ignores chosen faults: exists whenever any method has one, and sees what any method sees."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

import residua as rs
from generated import random_plant, simulate, singular_plant
from residua.errors import DesignError


def responses(generator: rs.design.ResidualGenerator) -> np.ndarray:
    """Return the largest response to each fault, relative to the largest of all."""
    w = np.array([0.37, 2.1]) / (generator.dt or 1.0) * (0.5 if generator.dt else 1.0)
    form = generator.internal_form().frequency_response(w)[:, :, : len(generator.faults)]
    size = np.abs(form).max(axis=(0, 1), initial=0.0)
    return size / size.max(initial=1e-300)


@pytest.mark.parametrize("seed", range(60))
def test_it_sees_exactly_what_the_pencils_say(seed: int) -> None:
    """Diagnosability is decided from ranks of transfer matrices, the design from subspaces: they must agree."""
    rng = np.random.default_rng(1000 + seed)
    plant = random_plant(
        rng,
        n=int(rng.integers(2, 7)),
        outputs=int(rng.integers(1, 5)),
        disturbances=int(rng.integers(0, 2)),
        faults=2,
        sensors=bool(seed % 2),
        feedthrough=bool(seed % 3),
    )
    possible = rs.diagnosability(plant)
    for j, name in enumerate(plant.faults):
        try:
            generator = rs.design.decoupled_residual(plant, insensitive_to=name)
        except DesignError:
            assert not possible.isolable[:, j].any()
            continue
        seen = responses(generator) > 1e-7
        assert not seen[j]
        others = [i for i in range(len(plant.faults)) if i != j]
        np.testing.assert_array_equal(seen[others], possible.isolable[others, j])


@pytest.mark.parametrize("seed", range(30))
def test_nothing_else_reaches_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    plant = random_plant(rng, outputs=4, disturbances=1, faults=2, sensors=True, feedthrough=True, dt=0.1)
    ignored = [plant.faults[int(rng.integers(len(plant.faults)))]]
    generator = rs.design.decoupled_residual(plant, insensitive_to=ignored, margin=3.0)
    u, y = simulate(plant, rng, 80, fault=ignored[0])
    size = max(np.abs(u).max(), np.abs(y).max()) * (1 + np.abs(generator.system.D).max())
    assert np.abs(generator.run(u, y)).max() < 1e-9 * size
    assert (np.abs(generator.evidence.poles) < np.exp(-0.3) + 1e-9).all()
    rs.testing.check_residual_generator(generator)


@pytest.mark.parametrize("seed", range(30))
def test_singular_plants(seed: int) -> None:
    """Against the plant itself: with any x that obeys the equations, the residual is zero."""
    rng = np.random.default_rng(seed)
    plant = singular_plant(rng, disturbances=int(rng.integers(0, 2)))
    generator = rs.design.decoupled_residual(plant, insensitive_to="y1 sensor")
    seen = responses(generator) > 1e-7
    assert not seen[plant.faults.index("y1 sensor")]
    assert seen[plant.faults.index("f0")]
    points = np.exp(1j * np.array([0.4, 1.7])) if plant.dt else 1j * np.array([0.4, 1.7])
    n_u = len(plant.inputs)
    Q = generator.system.evaluate(points)
    P = plant.system(("control", "disturbance", "fault")).evaluate(points)
    through = Q[:, :, n_u:] @ P
    through[:, :, :n_u] += Q[:, :, :n_u]
    silent = n_u + len(plant.disturbances)
    assert np.abs(through[:, :, :silent]).max() < 1e-9 * np.abs(Q).max() * max(1.0, np.abs(P).max())
    form = generator.internal_form().evaluate(points)[:, :, : len(plant.faults)]
    np.testing.assert_allclose(through[:, :, silent:], form, atol=1e-8 * np.abs(form).max())


def attainable(plant: rs.Plant) -> set[str]:
    """Return every row that a structured bank reaches."""
    found = set()
    for digits in product("01", repeat=len(plant.faults)):
        row = "".join(digits)
        if "1" in row:
            try:
                rs.design.structured_bank(plant, [row])
            except DesignError:
                continue
            found.add(row)
    return found


def test_v9_attainable_rows_of_gertlers_example() -> None:
    assert attainable(rs.library.gertler(sensor_faults=True)) == {"0111", "1011", "1101", "1110", "1111"}


def test_v9_attainable_rows_of_yuans_example() -> None:
    A = np.diag([-1.0, -2, -2, -2]) + np.diag(np.ones(3), 1) + np.diag(np.ones(3), -1)
    leaks, blocks = np.eye(4), np.zeros((4, 4))
    for column, (high, low) in enumerate(((0, 1), (1, 2), (2, 3))):
        blocks[high, column], blocks[low, column] = 1, -1
    blocks[3, 3] = 1
    Bf = np.hstack([leaks, blocks])
    plant = rs.Plant(A, np.eye(4)[:, :1], np.eye(4)[[0, 2, 3]]).with_faults({f"f{i + 1}": Bf[:, i] for i in range(8)})
    assert len(attainable(plant)) == 18


def test_poles_are_placed_and_counted() -> None:
    plant = rs.library.gertler()
    generator = rs.design.decoupled_residual(plant, insensitive_to="p1", poles=[0.25, 0.3])
    np.testing.assert_allclose(np.sort(generator.evidence.poles.real), [0.25, 0.3], atol=1e-9)
    with pytest.raises(DesignError, match="2"):
        rs.design.decoupled_residual(plant, insensitive_to="p1", poles=[0.1, 0.2, 0.3, 0.4])


def test_all_measurements_used_up() -> None:
    with pytest.raises(DesignError, match="used up"):
        rs.design.decoupled_residual(rs.library.gertler(), insensitive_to=["p1", "p2"])


@pytest.mark.parametrize("seed", range(10))
def test_with_noise_and_nothing_to_ignore_it_is_the_kalman_filter(seed: int) -> None:
    rng = np.random.default_rng(seed)
    plant = random_plant(rng, outputs=3, faults=1, dt=0.1).with_noise(process=1.0, measurement=0.1)
    kalman, found = rs.design.kalman_filter(plant), rs.design.decoupled_residual(plant)
    z = np.exp(1j * np.array([0.2, 1.5]))
    a, b = kalman.system.evaluate(z), found.system.evaluate(z)
    Q = b[0] @ np.linalg.pinv(a[0])  # a constant change of residual coordinates
    np.testing.assert_allclose(Q @ a, b, atol=1e-8 * np.abs(b).max())
    np.testing.assert_allclose(Q @ Q.conj().T, Q.real @ Q.real.T, atol=1e-8)


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("singular", [False, True])
def test_with_noise_the_residual_is_white(seed: int, singular: bool) -> None:
    rng = np.random.default_rng(seed)
    plant = (
        singular_plant(rng, disturbances=1, dt=0.1)
        if singular
        else random_plant(rng, outputs=4, disturbances=1, faults=2, sensors=True, dt=0.1)
    ).with_noise(process=0.5, measurement=0.2)
    found = rs.design.decoupled_residual(plant, insensitive_to="y1 sensor")
    assert "gain of the Kalman filter" in found.evidence.notes
    one, many = found.covariance_of_sums(1), found.covariance_of_sums(30)
    assert one is not None
    assert many is not None
    np.testing.assert_allclose(many, one, atol=1e-8 * np.abs(one).max())
    placed = rs.design.decoupled_residual(plant, insensitive_to="y1 sensor", gain="placement")
    other = placed.covariance
    assert other is not None
    # the smallest covariance there is: in no direction of the residual is the other's smaller
    assert np.linalg.eigvalsh(other - one).min() >= -1e-9 * np.abs(other).max()


def test_the_gain_is_checked() -> None:
    plant = rs.library.gertler()
    with pytest.raises(DesignError, match="'kalman' or 'placement'"):
        rs.design.decoupled_residual(plant, gain="best")
    with pytest.raises(DesignError, match="with_noise"):
        rs.design.decoupled_residual(plant, gain="kalman")
    noisy = plant.with_noise(process=1.0, measurement=1.0)
    with pytest.raises(DesignError, match="leave them out"):
        rs.design.decoupled_residual(noisy, gain="kalman", margin=1.0)
    silent = plant.with_noise(process=1.0)  # no measurement noise: no Kalman filter, and that is said
    found = rs.design.decoupled_residual(silent)
    assert any("no gain of a Kalman filter" in note for note in found.evidence.notes)
    with pytest.raises(DesignError):
        rs.design.decoupled_residual(silent, gain="kalman")
