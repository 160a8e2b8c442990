"""Observers of every order: identities, spectrum, and the estimate on data."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import control
import numpy as np
import pytest

import residua as rs
from generated import random_plant, simulate, singular_plant
from residua.design import Observer
from residua.errors import DesignError, ModelError


def identities(observer: Observer) -> float:
    """Return the largest miss of the identities of the family, relative to their terms."""
    p = observer.plant
    E = np.eye(p.n_states) if p.E is None else p.E
    TE = observer.T @ E
    size = max(1.0, *(float(np.abs(M).max(initial=0.0)) for M in (observer.T, observer.K, observer.M, observer.H)))
    missed = [
        observer.T @ p.A - observer.K @ p.C - observer.F @ TE,
        observer.M @ TE + observer.H @ p.C - np.eye(p.n_states) + (0 if observer.J is None else observer.J @ p.A),
    ]
    if observer.decouples:
        missed.append(observer.T @ p.Bd - observer.K @ p.Dd)
    return max(float(np.abs(M).max(initial=0.0)) for M in missed) / size**2


def poles_for(count: int, dt: float, rng: np.random.Generator) -> np.ndarray:
    """Return distinct poles of some speed, a complex pair among them where there is room."""
    rates = -rng.uniform(1.0, 4.0, count) - np.arange(count)
    poles = rates.astype(complex)
    if count >= 2:
        poles[:2] = [rates[0] + 1j, rates[0] - 1j]
    return np.exp(poles * dt) if dt else poles


def assert_poles(found: np.ndarray, wanted: np.ndarray, tolerance: float = 1e-6) -> None:
    left = list(found)
    for pole in wanted:
        nearest = min(left, key=lambda other: abs(other - pole))
        assert abs(nearest - pole) <= tolerance * max(1.0, abs(pole))
        left.remove(nearest)


DESIGNS: dict[str, Callable[..., Observer]] = {
    "luenberger": rs.design.luenberger_observer,
    "reduced": rs.design.reduced_order_observer,
    "descriptor": rs.design.descriptor_observer,
    "unknown input": rs.design.unknown_input_observer,
}


@pytest.mark.parametrize("seed", range(50))
@pytest.mark.parametrize("name", DESIGNS)
def test_identities_and_spectrum(name: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    plant = random_plant(rng, disturbances=int(seed % 2), feedthrough=bool(seed % 3))
    observer = DESIGNS[name](plant)
    assert identities(observer) < 1e-9
    count = len(observer.poles) - len(observer.evidence.fixed_poles)
    wanted = poles_for(count, plant.dt, rng)
    observer = DESIGNS[name](plant, poles=wanted)
    assert identities(observer) < 1e-9
    assert_poles(observer.poles, np.concatenate([wanted, observer.evidence.fixed_poles]))
    if name == "reduced":
        assert observer.order == plant.n_states - min(plant.n_outputs, plant.n_states)


@pytest.mark.parametrize("seed", range(40))
@pytest.mark.parametrize("name", ["descriptor", "unknown input"])
def test_singular_plants(name: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    plant = singular_plant(rng, disturbances=int(seed % 2))
    observer = DESIGNS[name](plant)
    assert identities(observer) < 1e-9
    wanted = poles_for(len(observer.poles) - len(observer.evidence.fixed_poles), plant.dt, rng)
    observer = DESIGNS[name](plant, poles=wanted)
    assert identities(observer) < 1e-9
    assert_poles(observer.poles, np.concatenate([wanted, observer.evidence.fixed_poles]))
    if name == "unknown input":
        generator = observer.residual_generator()
        points = np.exp(0.7j) if plant.dt else 0.7j
        Q = generator.system.evaluate(points)[0]
        P = plant.system(("control", "disturbance")).evaluate(points)[0]
        n_u = len(plant.inputs)
        through = Q[:, n_u:] @ P
        through[:, :n_u] += Q[:, :n_u]
        assert np.abs(through).max() < 1e-9 * max(1.0, np.abs(P).max()) * max(1.0, np.abs(Q).max())


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("name", DESIGNS)
def test_the_estimate_becomes_the_state(name: str, seed: int) -> None:
    rng = np.random.default_rng(600 + seed)
    decouples = name != "luenberger"
    plant = random_plant(rng, n=4, outputs=3, disturbances=1 if decouples else 0, dt=0.1, feedthrough=True, faults=0)
    observer = DESIGNS[name](plant, margin=5.0)
    system = plant.system(("control", "disturbance")).replaced(
        C=np.eye(4), D=np.zeros((4, len(plant.inputs) + len(plant.disturbances))), outputs=None
    )
    v = rng.standard_normal((120, system.n_inputs))
    x = system.simulate(v, rng.standard_normal(4))
    y = x @ plant.C.T + v[:, : len(plant.inputs)] @ plant.D.T
    error = np.abs(observer.estimate(v[:, : len(plant.inputs)], y) - x).max(axis=1)
    assert error[80:].max() < 1e-6 * max(1.0, np.abs(x).max())
    assert error[0] > 1e-3  # it began elsewhere


@pytest.mark.parametrize("seed", range(10))
def test_single_output_gains_are_ackermanns(seed: int) -> None:
    """With one output the gain is unique: python-control's Ackermann formula on the dual plant gives the same."""
    rng = np.random.default_rng(seed)
    plant = random_plant(rng, n=4, outputs=1, faults=0, dt=0.0)
    poles = [-2, -3, -4 + 1j, -4 - 1j]
    K = np.asarray(control.acker(plant.A.T, plant.C.T, poles)).reshape(-1, 1)
    np.testing.assert_allclose(rs.design.luenberger_observer(plant, poles=poles).K, K, rtol=1e-6)


@pytest.mark.parametrize("used", [["y2"], ["y3", "y1"]])
def test_outputs_that_are_left_out_are_not_read(used: list[str]) -> None:
    """In units far apart, so that a column of the gain in the wrong place shows."""
    plant = random_plant(np.random.default_rng(5), n=4, outputs=3, faults=0, dt=0.0)
    plant = rs.Plant(plant.A, plant.B, np.array([[1e-3], [1], [1e4]]) * plant.C)
    observer = rs.design.luenberger_observer(plant, poles=[-1, -2, -3 + 1j, -3 - 1j], outputs=used)
    assert_poles(observer.poles, np.array([-1, -2, -3 + 1j, -3 - 1j]))
    assert identities(observer) < 1e-9
    left_out = [i for i, name in enumerate(plant.outputs) if name not in used]
    np.testing.assert_array_equal(observer.K[:, left_out], 0)
    assert observer.residual_generator().residuals == tuple(f"r {name}" for name in used)


def test_unobservable_modes_are_reported_and_unstable_ones_refused() -> None:
    plant = rs.Plant([[-1, 0], [0, -2]], [[1], [1]], [[1, 0]])
    observer = rs.design.luenberger_observer(plant, poles=[-5])
    np.testing.assert_allclose(observer.evidence.fixed_poles, [-2])
    np.testing.assert_allclose(np.sort(observer.poles.real), [-5, -2])
    for design in (rs.design.luenberger_observer, rs.design.reduced_order_observer, rs.design.unknown_input_observer):
        with pytest.raises(DesignError, match=r"0\.5"):
            design(rs.Plant([[-1, 0], [0, 0.5]], [[1], [1]], [[1, 0]]))


def test_an_unstable_zero_of_the_disturbance_is_named() -> None:
    plant = rs.Plant([[0, 1], [-2, -3]], [[0], [1]], [[-4, 1]]).with_disturbances({"gust": [0, 1]})
    for design in (rs.design.unknown_input_observer, rs.design.reduced_order_observer, rs.design.descriptor_observer):
        with pytest.raises(DesignError, match="4"):
            design(plant)


def test_reduced_order_reproduces_what_it_uses() -> None:
    plant = random_plant(np.random.default_rng(3), n=5, outputs=2, dt=0.1)
    observer = rs.design.reduced_order_observer(plant)
    np.testing.assert_allclose(plant.C @ observer.H, np.eye(2), atol=1e-10)
    with pytest.raises(DesignError, match="leave some out"):
        observer.residual_generator()
    generator = rs.design.reduced_order_observer(plant, outputs=["y1"]).residual_generator()
    assert generator.residuals == ("r y2",)
    assert np.abs(generator.run(*simulate(plant, np.random.default_rng(4), 50))).max() < 1e-9
    rs.testing.check_residual_generator(generator)


def test_order_zero() -> None:
    plant = rs.Plant([[-1, 1], [0, -2]], [[0], [1]], [[1, 0], [1, 1]])
    observer = rs.design.reduced_order_observer(plant)
    assert observer.order == 0
    y = np.random.default_rng(0).standard_normal((5, 2))
    np.testing.assert_allclose(observer.estimate(np.zeros((5, 1)), y, dt=0.1) @ plant.C.T, y, atol=1e-12)


def test_a_singular_plant_is_pointed_elsewhere() -> None:
    plant = singular_plant(np.random.default_rng(0))
    with pytest.raises(DesignError, match="descriptor_observer"):
        rs.design.luenberger_observer(plant)
    with pytest.raises(DesignError, match="descriptor_observer"):
        rs.design.reduced_order_observer(plant)


def test_too_few_measurements_for_the_algebraic_part() -> None:
    plant = rs.Plant(np.eye(3), np.ones((3, 1)), [[1, 0, 0]], E=np.diag([1.0, 1, 0]))
    for design in (rs.design.unknown_input_observer, rs.design.descriptor_observer):
        with pytest.raises(DesignError, match=r"rank|not detectable"):
            design(plant)


@pytest.mark.parametrize("exponents", [(3, 0, -3), (-4, 2, 4)])
def test_units_do_not_matter(exponents: tuple[int, ...]) -> None:
    rng = np.random.default_rng(11)
    plant = random_plant(rng, n=3, outputs=2, disturbances=1, faults=0, dt=0.0)
    T = np.diag(10.0 ** np.array(exponents))
    inverse = np.diag(1 / np.diag(T))
    scaled = rs.Plant(T @ plant.A @ inverse, T @ plant.B, plant.C @ inverse).with_disturbances(
        {"d1": T @ plant.Bd[:, 0]}
    )
    for design in (rs.design.unknown_input_observer, rs.design.reduced_order_observer):
        first, second = design(plant, margin=2.0), design(scaled, margin=2.0)
        assert (second.poles.real < -2).all()
        assert (first.poles.real < -2).all()
        w = [0.3, 3.0]
        a = design(plant, poles=[-2.0, -3, -4][: first.order]).system.frequency_response(w)
        b = design(scaled, poles=[-2.0, -3, -4][: first.order]).system.frequency_response(w)
        if first.order == 1:  # one pole and one measurement left over: the observer is unique
            np.testing.assert_allclose(T @ a, b, rtol=1e-7, atol=1e-9 * np.abs(b).max())


@pytest.mark.parametrize("seed", range(60))
def test_a_singular_plant_has_an_observer_exactly_when_its_zeros_are_stable(seed: int) -> None:
    """The free part of the decoupling is placed too: what stays fixed are the finite zeros, and nothing else."""
    rng = np.random.default_rng(seed)
    n, q = int(rng.integers(3, 7)), int(seed % 2)
    rank = int(rng.integers(1, n))
    plant = singular_plant(rng, n=n, rank=rank, outputs=n - rank + q, disturbances=q, faults=0, sensors=False)
    zeros = rs.linear.invariant_zeros(plant.A, plant.Bd, plant.C, E=plant.E).zeros
    stable = np.abs(zeros) < 1 if plant.dt else zeros.real < 0
    existence = rs.analysis.unknown_input_observer_existence(plant)
    assert bool(existence) == bool(stable.all())
    for design in (rs.design.unknown_input_observer, rs.design.descriptor_observer):
        if stable.all():
            observer = design(plant)
            assert_poles(observer.evidence.fixed_poles, zeros, 1e-5)
            assert len(observer.evidence.fixed_poles) == len(zeros)
            assert identities(observer) < 1e-9
        else:
            with pytest.raises(DesignError, match="not detectable"):
                design(plant)


def test_the_algebraic_equations_are_residuals_too() -> None:
    plant = rs.library.ladder_circuit()
    generator = rs.design.unknown_input_observer(plant).residual_generator()
    assert generator.residual_rank == 2
    np.testing.assert_array_equal(generator.structure.any(axis=0), rs.diagnosability(plant).detectable)


@pytest.mark.parametrize(
    "design",
    [
        rs.design.luenberger_observer,
        rs.design.reduced_order_observer,
        rs.design.descriptor_observer,
        rs.design.perfect_observer,
        rs.design.sensor_fault_estimators,
        rs.design.parity_relations,
    ],
)
def test_an_output_that_is_chosen_twice_is_refused(design: Any) -> None:
    with pytest.raises(ModelError, match="outputs: the name 'y1' occurs twice"):
        design(rs.library.gertler(), outputs=["y1", 0])


def test_one_of_a_kind_is_said_in_the_singular() -> None:
    plant = rs.Plant([[0.5]], [[1.0]], [[1.0]], dt=1.0).with_disturbances({"inflow": [1.0]})
    with pytest.raises(DesignError, match=r"the 1 measurement is used up \(1 disturbance is decoupled\)"):
        rs.design.unknown_input_observer(plant).residual_generator()
    with pytest.raises(DesignError, match=r"got 2 poles for 1 state, of which 1 is observable"):
        rs.design.luenberger_observer(plant, poles=[0.1, 0.2])
    with pytest.raises(DesignError, match=r"got 1 pole for 3 states, of which 3 are observable"):
        rs.design.luenberger_observer(rs.library.gertler(), poles=[0.1])
    with pytest.raises(DesignError, match=r"^1 measurement is used up to decouple 1 disturbance:"):
        rs.design.robust_detection_filter(plant)
    made = rs.design.robust_detection_filter(rs.library.gertler().with_disturbances({"d": [1.0, 0.0, 0.0]}))
    assert any("the price of decoupling 1 disturbance" in note for note in made.evidence.notes)


def test_the_size_of_a_gain_depends_on_no_unit() -> None:
    """Of a chain of three states ten times slower than the margin: about the third power of that, and of two."""
    A = 1e-3 * (np.diag([1.0, 1], -1) - np.eye(3))
    T = 2.0 ** np.array([20, 0, -20])[:, None]
    plants = rs.Plant(A, np.ones((3, 1)), np.eye(3)[2:]), rs.Plant(T * A / T.T, T, 2.0**-7 * np.eye(3)[2:] / T.T)
    for design in (rs.design.luenberger_observer, rs.design.unknown_input_observer):
        sizes = [max(v for k, v in design(p, margin=1e-2).evidence.conditions.items() if "size" in k) for p in plants]
        assert 1e3 < sizes[0] < 1e5
        assert sizes[1] == pytest.approx(sizes[0], rel=1e-6)
