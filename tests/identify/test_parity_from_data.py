"""Parity relations from data: those of the model as the noise goes, exact responses, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from numpy.typing import NDArray

import residua as rs
from recorded_examples import Recorded, recorded
from residua.errors import DataError, SettingError


def of_the_model(one: Recorded, order: int, spread: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the parity space of the plant, by its observability matrix: columns, newest sample first, u before y."""
    A, B, C, D = one.plant.A, one.plant.B, one.plant.C, one.plant.D
    p, m = D.shape
    markov = [D, *(C @ np.linalg.matrix_power(A, i) @ B for i in range(order))]
    seen = np.vstack([C @ np.linalg.matrix_power(A, i) for i in range(order + 1)])
    H = np.zeros((p * (order + 1), m * (order + 1)))
    for i in range(order + 1):
        for j in range(i + 1):
            H[i * p : (i + 1) * p, j * m : (j + 1) * m] = markov[i - j]
    G = scipy.linalg.null_space(seen.T).T
    out = np.zeros((len(G), order + 1, m + p))
    for i in range(order + 1):
        out[:, order - i, m:] = G[:, i * p : (i + 1) * p]
        out[:, order - i, :m] = -(G @ H)[:, i * m : (i + 1) * m]
    return np.linalg.qr((out * spread).reshape(len(G), -1).T)[0]


def sine(inside: NDArray[np.float64], space: NDArray[np.float64]) -> float:
    """Return the sine of the largest angle between vectors of a space and another."""
    return float(np.linalg.norm(inside - space @ (space.T @ inside), 2))


@pytest.mark.parametrize("seed", range(60))
def test_without_noise_the_relations_are_those_of_the_model(seed: int) -> None:
    one = recorded(seed, 0.0)
    order = one.plant.n_states + 1
    made = rs.identify.parity_from_data(one.u, one.y, order=order)
    model = of_the_model(one, order, made.spread)
    ours = made.vectors.reshape(made.relations, -1).T
    assert made.relations == made.supported == model.shape[1]
    assert sine(model, ours) < 1e-9
    assert sine(ours, model) < 1e-9


@pytest.mark.parametrize("seed", range(60, 72))
def test_the_angle_to_the_model_shrinks_with_the_noise(seed: int) -> None:
    angles = []
    for noise in (1e-2, 1e-4, 1e-6):
        one = recorded(seed, noise, 8000)
        order = one.plant.n_states
        count = one.plant.n_outputs * (order + 1) - one.plant.n_states
        made = rs.identify.parity_from_data(one.u, one.y, order=order, relations=count)
        angles.append(sine(of_the_model(one, order, made.spread), made.vectors.reshape(count, -1).T))
    assert angles[2] < 3e-2 * angles[0]  # a hundred times less for each hundred, but for one factor of luck
    assert angles[2] < 1e-3


def test_the_residual_is_what_the_relations_say() -> None:
    one = recorded(1, 0.1, outputs=3)
    made = rs.identify.parity_from_data(one.u, one.y, order=4)
    z = (one.rows - made.mean) / made.spread
    by_hand = sum(z[4 - i : len(z) - i] @ made.vectors[:, i].T for i in range(5))
    run = made.generator.run(None, one.rows - one.rows.mean(axis=0))
    assert np.allclose(run[4:], by_hand, atol=1e-12)


def test_poles_divide_the_same_relations() -> None:
    one = recorded(1, 0.1, outputs=3)
    plain = rs.identify.parity_from_data(one.u, one.y, order=3)
    poles = [0.5, 0.3 + 0.4j, 0.3 - 0.4j]
    made = rs.identify.parity_from_data(one.u, one.y, order=3, poles=poles)
    assert np.array_equal(made.vectors, plain.vectors)
    d = np.poly(poles).real
    rows = one.rows - one.rows.mean(axis=0)
    moving, filtered = plain.generator.run(None, rows), made.generator.run(None, rows)
    again = sum(d[i] * np.vstack([np.zeros((i, filtered.shape[1])), filtered[: len(filtered) - i]]) for i in range(4))
    assert np.allclose(again, moving, atol=1e-10)
    reached = np.unique(np.round(made.generator.system.poles(), 4))
    assert np.allclose(np.sort_complex(reached), np.sort_complex(poles), atol=1e-4)


@pytest.mark.parametrize("seed", range(8))
def test_an_actuator_fault_moves_the_residual_by_its_column_whatever_the_plant_does(seed: int) -> None:
    """What acts is more than what is recorded: the simulated plant says the same as the plant of channels."""
    one = recorded(seed, 0.0, 2000)
    made = rs.identify.parity_from_data(
        one.u, one.y, order=one.plant.n_states + 1, inputs=one.plant.inputs, outputs=one.plant.outputs
    )
    fault = np.zeros_like(one.u)
    fault[500:, 0] = 0.7
    recorded_rows = np.hstack([one.u, one.plant.system().simulate(one.u + fault)])
    moved = made.generator.run(None, recorded_rows) - made.generator.run(None, one.rows)
    column = made.generator.faults.index(f"{one.plant.inputs[0]} actuator")
    alone = made.generator.internal_form().select(inputs=[column]).simulate(fault[:, :1])
    assert np.allclose(moved[20:], alone[20:], atol=1e-8)


def test_the_first_relations_are_those_that_hold_best() -> None:
    one = recorded(1, 0.05, outputs=3)
    every = rs.identify.parity_from_data(one.u, one.y, order=4)
    few = rs.identify.parity_from_data(one.u, one.y, order=4, relations=2)
    assert np.allclose(few.vectors, every.vectors[:2], atol=1e-12)
    assert np.all(np.diff(every.correlations) <= 0)


def test_more_relations_than_hold_are_said() -> None:
    one = recorded(5, 0.0)
    order = one.plant.n_states + 1
    held = rs.identify.parity_from_data(one.u, one.y, order=order).relations
    made = rs.identify.parity_from_data(one.u, one.y, order=order, relations=held + 1)
    assert any(
        f"{held + 1} relations were asked for, and {held} hold" in note for note in made.generator.evidence.notes
    )


def test_a_recording_without_excitation_is_refused() -> None:
    one = recorded(2, 0.0)
    u = np.sin(0.3 * np.arange(2000))[:, None]
    y = one.plant.system().simulate(np.repeat(u, len(one.plant.inputs), axis=1))
    with pytest.raises(DataError, match="does not excite the plant enough"):
        rs.identify.parity_from_data(u, y, order=5)


def test_data_without_any_relation_are_refused() -> None:
    """The output of a plant of ten states has no relation of order two."""
    rng = np.random.default_rng(0)
    A = 0.95 * np.linalg.qr(rng.standard_normal((10, 10)))[0]
    plant = rs.Plant(A, rng.standard_normal((10, 1)), rng.standard_normal((1, 10)), dt=1.0)
    u = rng.standard_normal((5000, 1))
    with pytest.raises(DataError, match="no relation of order 2 holds"):
        rs.identify.parity_from_data(u, plant.system().simulate(u), order=2)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"order": 0}, "order must be a whole number, at least 1"),
        ({"order": 2.5}, "order must be a whole number"),
        ({"relations": 0}, "relations must be a whole number"),
        ({"order": 1, "relations": 50}, "relations of order 1 are 2 at most, got 50"),
        ({"order": 2, "poles": [0.5]}, "take 2 poles"),
        ({"order": 2, "poles": [0.5, 1.0]}, "inside the unit circle"),
        ({"order": 2, "poles": [0.5j, 0.5]}, "conjugates"),
        ({"order": 2, "poles": ["a", "b"]}, "must be numbers"),
    ],
)
def test_bad_settings_are_refused(options: dict[str, object], said: str) -> None:
    one = recorded(2, 0.1, 500, outputs=1)
    with pytest.raises(SettingError, match=said):
        rs.identify.parity_from_data(one.u[:, :1], one.y, **options)  # pyright: ignore


def test_progress_is_told() -> None:
    told: list[str] = []
    rows = np.random.default_rng(0).standard_normal((400, 3)).cumsum(axis=0)
    rs.identify.parity_from_data(rows[:, :1], rows[:, 1:], order=2, progress=lambda stage, *_: told.append(stage))
    assert told[0] == "Hankel matrix"
    assert told[-2:] == ["relations", "relations, and the checks of their generator"]
