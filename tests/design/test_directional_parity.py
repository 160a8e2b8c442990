"""Directions from parity equations: they exist as counted, hold in transients and in any units, and name faults."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

import residua as rs
from generated import random_plant, singular_plant
from residua.design.parity.directional_parity import directional_parity
from residua.errors import AccuracyError, DesignError, ModelError, SettingError


@dataclass(frozen=True)
class Case:
    """A plant with directions in general position, and whether the count allows them."""

    plant: rs.Plant
    directions: dict[str, np.ndarray]
    residuals: int
    exists: bool


def generated(seed: int) -> Case:
    rng = np.random.default_rng([77, seed])
    q, m, r = int(rng.integers(0, 2)), int(rng.integers(2, 5)), int(rng.integers(1, 4))
    plant = random_plant(
        rng,
        n=int(rng.integers(3, 7)),
        outputs=m,
        inputs=1,
        disturbances=q,
        faults=2,
        sensors=True,
        dt=[0.0, 0.1][seed % 2],
        feedthrough=seed % 5 == 0,
    )
    most = (r * (m - q) - 1) // (r - 1) if r > 1 else len(plant.faults)
    s = min(len(plant.faults), int(rng.integers(1, most + 2)))
    names = [plant.faults[i] for i in rng.permutation(len(plant.faults))[:s]]
    return Case(plant, {name: rng.standard_normal(r) for name in names}, r, s * (r - 1) <= r * (m - q) - 1)


def in_other_units(case: Case, rng: np.random.Generator) -> Case:
    """Return the same problem with states, signals, faults, time and residuals in other units."""
    p = case.plant
    T, Y = 10 ** rng.uniform(-3, 3, p.n_states), 10 ** rng.uniform(-3, 3, p.n_outputs)
    U, time = 10 ** rng.uniform(-3, 3), 1.0 if p.dt else 10 ** rng.uniform(-3, 3)
    A, B, C = time * p.A / T[:, None] * T, p.B / T[:, None] * U, p.C * T * Y[:, None]
    plant = rs.Plant(A, B, C, p.D * Y[:, None] * U, dt=p.dt)
    if p.disturbances:
        plant = plant.with_disturbances(p.Bd / T[:, None])
    plant = plant.with_faults({f"f{i}": p.Bf[:, i] / T * 10 ** rng.uniform(-3, 3) for i in range(2)})
    e = 10 ** rng.uniform(-3, 3, case.residuals)
    return Case(plant.with_sensor_faults(), {k: e * d for k, d in case.directions.items()}, case.residuals, case.exists)


def check(case: Case) -> None:
    """The design exists as counted, and points where it was asked to, at every frequency."""
    if not case.exists:
        with pytest.raises(DesignError, match=r"conditions; .* ask for"):
            directional_parity(case.plant, directions=case.directions)
        return
    made = directional_parity(case.plant, directions=case.directions)
    assert made.n_residuals == case.residuals
    assert made.relations is not None
    assert len({*made.relations.orders}) == 1
    for name, wanted in case.directions.items():
        ratio = made.directions[name] * np.linalg.norm(wanted) / wanted  # of each entry, in its own units
        np.testing.assert_allclose(ratio, np.sign(ratio[0]), atol=1e-6)
    assert not made.evidence.decoupling or max(made.evidence.decoupling.values()) < 1e-7


@pytest.mark.parametrize("seed", range(120))
def test_exists_as_counted(seed: int) -> None:
    check(generated(seed))


def test_both_answers_are_tried() -> None:
    exists = [generated(seed).exists for seed in range(120)]
    assert 20 < sum(exists) < 110


@pytest.mark.parametrize("seed", range(60))
def test_in_other_units(seed: int) -> None:
    check(in_other_units(generated(seed), np.random.default_rng(seed)))


@pytest.mark.parametrize("seed", range(10))
def test_the_filter_and_the_plant_agree(seed: int) -> None:
    """The response through the plant itself: Q (P_f; 0) is a direction times a scalar, at points of the plane."""
    rng = np.random.default_rng(seed)
    plant = random_plant(rng, n=4, outputs=3, disturbances=seed % 2, faults=3, dt=[0.0, 0.1][seed % 4 // 2])
    D = rng.standard_normal((2, 3))
    made = directional_parity(plant, directions={f"f{i}": D[:, i] for i in range(3)})
    rate = 1.0 if plant.dt else np.abs(plant.system(()).poles()).mean()
    points = rate * (rng.uniform(-1.5, 1.5, 20) + 1j * rng.uniform(0.3, 1.5, 20))
    Q = made.system.evaluate(points)[:, :, len(plant.inputs) :]
    response = Q @ plant.system("fault").evaluate(points)
    for i in range(3):
        across = np.array([-D[1, i], D[0, i]]) @ response[:, :, i].T
        along = D[:, i] @ response[:, :, i].T
        assert np.abs(across).max() < 1e-8 * np.abs(along).max()
    # the rows are independent: not one residual twice
    rank = np.linalg.svd(Q[0], compute_uv=False)
    assert rank[1] > 1e-4 * rank[0]


@pytest.mark.parametrize("seed", range(6))
def test_independent_residuals_for_one_direction(seed: int) -> None:
    """A single direction must not make all residuals the same relation."""
    plant = random_plant(np.random.default_rng(seed), n=4, outputs=3, faults=2, sensors=True)
    made = directional_parity(plant, directions={"f0": [1, 2, -1]})
    assert made.residual_rank == 3
    assert "f1, y1 sensor, y2 sensor, y3 sensor: no direction was asked for" in made.evidence.notes


@pytest.mark.parametrize("seed", range(10))
def test_singular_plants(seed: int) -> None:
    rng = np.random.default_rng(seed)
    plant = singular_plant(rng, n=5, rank=int(rng.integers(1, 5)), outputs=3, disturbances=seed % 2)
    names = ("f0", "y1 sensor")
    wanted = {name: rng.standard_normal(2) for name in names}
    made = directional_parity(plant, directions=wanted)
    for name in names:
        assert abs(made.directions[name] @ wanted[name]) == pytest.approx(np.linalg.norm(wanted[name]), rel=1e-9)


def test_ignored_faults_and_zero_entries() -> None:
    plant = random_plant(np.random.default_rng(3), n=5, outputs=4, faults=3, sensors=True, dt=0.1)
    made = directional_parity(plant, directions={"f0": [1, 0], "f1": [0, 1]}, insensitive_to=["f2", "y1 sensor"])
    columns = [made.faults.index(name) for name in ("f0", "f1", "f2", "y1 sensor")]
    assert made.structure[:, columns].tolist() == [[True, False, False, False], [False, True, False, False]]
    assert made.evidence.notes[0] == "ignores f2, y1 sensor"


def test_order_asked_for() -> None:
    plant = rs.library.gertler()
    wanted = {"p1": [2, 1], "p2": [1, 2]}
    with pytest.raises(DesignError, match="no relations of order 1 have these directions: the smallest order is 2"):
        directional_parity(plant, directions=wanted, order=1)
    made = directional_parity(plant, directions=wanted, order=3)
    assert made.relations is not None
    assert set(made.directions) == {"p1", "p2"}
    # what all signals share is divided out
    short = directional_parity(rs.library.gertler(sensor_faults=True), directions={**wanted, "y1 sensor": [1, -1]})
    long = directional_parity(
        rs.library.gertler(sensor_faults=True), directions={**wanted, "y1 sensor": [1, -1]}, order=4
    )
    assert short.relations is not None
    assert long.relations is not None
    assert short.relations.orders == long.relations.orders == (3, 3)
    assert short.equivalent_to(long).kind in ("identical", "scale")
    assert len(long.relations.divided[0]) == 1
    assert "a factor common to all signals was divided out" in long.evidence.notes[0]
    with pytest.raises(DesignError, match="whole number"):
        directional_parity(plant, directions=wanted, order=1.5)  # pyright: ignore[reportArgumentType]


def test_poles_are_the_same_for_all_residuals() -> None:
    plant = rs.library.gertler()
    made = directional_parity(plant, directions={"p1": [2, 1], "p2": [1, 2]}, poles=[0.25, 0.3])
    np.testing.assert_allclose(np.sort(made.system.poles().real), [0.25, 0.25, 0.3, 0.3], atol=1e-12)
    again = made.with_poles({"r1": [0.5, -0.2], "r2": [-0.2, 0.5]})
    np.testing.assert_allclose(again.directions["p1"], made.directions["p1"], atol=1e-10)
    with pytest.raises(SettingError, match=r"'r1' and 'r2' keep the directions of p1, p2 together.*same poles"):
        made.with_poles({"r1": [0.25, 0.3], "r2": [0.25, 0.4]})


def sampled_fast(h: float) -> rs.Plant:
    rng = np.random.default_rng(5)
    A = rng.standard_normal((4, 4))
    A -= (0.5 + np.linalg.eigvals(A).real.max()) * np.eye(4)
    plant = rs.Plant(A, rng.standard_normal((4, 1)), rng.standard_normal((3, 4))).discretize(h)
    return plant.with_faults({"a": rng.standard_normal(4), "b": rng.standard_normal(4)}).with_sensor_faults()


FOUR = {"a": [1, 0, 2], "b": [1, 1, 0], "y1 sensor": [0, 1, 1], "y2 sensor": [1, -1, 2]}


@pytest.mark.parametrize(("h", "most"), [(0.1, 1e-10), (0.01, 1e-10), (0.001, 1e-10)])
def test_poles_crowd_near_one(h: float, most: float) -> None:
    made = directional_parity(sampled_fast(h), directions=FOUR, poles=[np.exp(-2 * h)] * 8)
    for name, direction in FOUR.items():
        assert abs(made.directions[name] @ direction) == pytest.approx(np.linalg.norm(direction), rel=1e-10)
    assert made.evidence.conditions["response off the directions"] < most


def test_moving_averages_that_lose_their_digits_are_refused() -> None:
    """Of order 8 at 0.1 s ten digits cancel, at 0.01 s all of them; never is a direction bent without a word."""
    made = directional_parity(sampled_fast(0.1), directions=FOUR)
    assert 8 < made.evidence.conditions["digits lost to cancellation"] < 11
    with pytest.raises(AccuracyError, match=r"of order 8.* give 8 poles near those of the plant"):
        directional_parity(sampled_fast(0.01), directions=FOUR)


def test_directions_that_do_not_go_with_the_plant() -> None:
    """Two faults that enter alike cannot point apart, whatever the count."""
    plant = random_plant(np.random.default_rng(1), n=4, outputs=3, faults=1, dt=0.1)
    twin = plant.with_faults({"twin": 2 * plant.Bf[:, 0]})
    with pytest.raises(DesignError, match=r"f0 \(.*\), twin \(.*\) vanishes: .* depends on those of other faults"):
        directional_parity(twin, directions={"f0": [1, 0], "twin": [0, 1]})
    alike = directional_parity(twin, directions={"f0": [1, 3], "twin": [1, 3]})
    np.testing.assert_allclose(np.abs(alike.directions["f0"]), np.abs(alike.directions["twin"]), atol=1e-12)
    hidden = rs.Plant(np.diag([0.5, 0.2]), [[1.0], [1]], [[1.0, 0], [2, 0]], dt=1).with_faults({"f": [0, 1]})
    with pytest.raises(DesignError, match="the response to f"):
        directional_parity(hidden, directions={"f": [1, 1]})


def test_bad_requests() -> None:
    plant = rs.library.gertler()
    for directions, message in [
        ({}, "one fault at least"),
        ({"p1": [0, 0]}, "'p1' is zero: name the fault in insensitive_to"),
        ({"p1": [1, 2], "p2": [1]}, r"same number: got \[1, 2\]"),
        ({"p1": [1, np.nan]}, "finite"),
        ({"p1": "up"}, "numbers"),
        ({"p1": [[1, 2]]}, "one per residual"),
        ({"p1": [1, 2], 0: [1, 2]}, "twice"),
    ]:
        with pytest.raises(DesignError, match=message):
            directional_parity(plant, directions=directions)  # pyright: ignore[reportArgumentType]
    with pytest.raises(ModelError, match="unknown fault 'p7'"):
        directional_parity(plant, directions={"p7": [1, 2]})
    with pytest.raises(DesignError, match="not both"):
        directional_parity(plant, directions={"p1": [1, 2]}, insensitive_to="p1")


@pytest.mark.parametrize("poles", [None, 0.6])
def test_a_monitor_names_the_fault(poles: float | None) -> None:
    plant = rs.library.gertler(sensor_faults=True).with_noise(process=1e-8, measurement=1e-6)
    wanted = {"p1": [2, 1], "p2": [1, 2], "y1 sensor": [1, -1]}
    given = None if poles is None else [poles] * 3
    made = directional_parity(plant, directions=wanted, poles=given)
    monitor = rs.Monitor(made, isolate=rs.decide.Directional(window=30))
    rng = np.random.default_rng(7)
    system = plant.system(("control", "fault", "noise"))
    for name in wanted:
        u = rng.standard_normal((800, 1))
        f = np.zeros((800, len(plant.faults)))
        f[400:, plant.faults.index(name)] = 2 + np.sin(0.3 * np.arange(400))
        w = rng.standard_normal((800, system.n_inputs - 1 - len(plant.faults)))
        found = monitor.run(u, system.simulate(np.hstack([u, f, w])))
        assert isinstance(found, rs.Diagnosis)
        assert found.onset is not None
        assert abs(found.onset - 400) < 20
        assert found.candidates[0].faults == (name,)


def test_a_plant_without_states() -> None:
    plant = rs.Plant(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((3, 0)), np.ones((3, 1)), dt=1).with_sensor_faults()
    made = directional_parity(plant, directions={"y1 sensor": [1, 0], "y2 sensor": [1, 1]})
    assert made.relations is not None
    assert made.relations.orders == (0, 0)
    np.testing.assert_allclose(np.abs(made.directions["y2 sensor"]), [np.sqrt(0.5)] * 2, atol=1e-12)
