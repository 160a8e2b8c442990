"""What a design says must not depend on the units that the states are written in."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

import residua as rs
from generated import random_plant
from residua.design.core.decoupling import Decoupled
from residua.design.core.generator import make_generator
from residua.errors import AccuracyError, DesignError, SettingError


def in_units(plant: rs.Plant, T: np.ndarray) -> rs.Plant:
    """Return the plant with the states measured in other units, ``x = x' / T``."""
    return plant._with(
        A=plant.A * T[:, None] / T,
        C=plant.C / T,
        B=plant.B * T[:, None],
        Bd=plant.Bd * T[:, None],
        Bf=plant.Bf * T[:, None],
        Bw=plant.Bw * T[:, None],
    )


@pytest.mark.parametrize("seed", range(15))
def test_covariance_and_structure_of_a_kalman_filter(seed: int) -> None:
    rng = np.random.default_rng(seed)
    plant = random_plant(rng, n=3, outputs=2, faults=1, sensors=True, dt=0.1).with_noise(process=0.1, measurement=0.2)
    first = rs.design.kalman_filter(plant)
    second = rs.design.kalman_filter(in_units(plant, 10.0 ** rng.uniform(-4, 4, 3)))
    assert first.covariance is not None
    assert second.covariance is not None
    np.testing.assert_allclose(second.covariance, first.covariance, rtol=1e-6)
    assert np.array_equal(first.structure, second.structure)
    assert first.internal_form().n_states == second.internal_form().n_states == 3


@pytest.mark.parametrize("T", [(1, 1e6, 1e-6), (1, 1e8, 1), (1e-5, 1, 1e5)])
def test_the_jet_engine_in_other_units(T: tuple[float, float, float]) -> None:
    engine = rs.library.jet_engine()
    first = rs.design.robust_detection_filter(engine, poles=[-3, -3, -3])
    second = rs.design.robust_detection_filter(in_units(engine, np.array(T)), poles=[-3, -3, -3])
    assert np.array_equal(first.structure, second.structure)
    for name in engine.faults:
        P1, P2 = (g.subspaces[name] @ g.subspaces[name].T for g in (first, second))
        np.testing.assert_allclose(P1, P2, atol=1e-6)
    assert second.internal_form().n_states == 3


@pytest.mark.parametrize("seed", range(10))
def test_the_innovation_covariance_is_that_of_the_riccati_equation(seed: int) -> None:
    rng = np.random.default_rng(50 + seed)
    plant = random_plant(rng, n=4, outputs=3, faults=1, dt=0.1).with_noise(process=0.3, measurement=0.1)
    generator = rs.design.kalman_filter(plant)
    solution = rs.linear.filter_riccati(plant.A, plant.C, plant.process_noise, plant.measurement_noise, dt=0.1)
    np.testing.assert_allclose(generator.covariance, solution.innovation_covariance, rtol=1e-7)
    for window in (5, 40):  # innovations are white
        np.testing.assert_allclose(generator.covariance_of_sums(window), solution.innovation_covariance, rtol=1e-6)


def test_sums_of_coloured_residuals_have_the_covariance_that_is_said() -> None:
    plant = rs.library.gertler().with_noise(process=0.01, measurement=0.02)
    generator = rs.design.detection_filter(plant, poles=[0.9, 0.95])
    rng = np.random.default_rng(0)
    w = rng.standard_normal((400_000, len(plant.noises)))
    r = generator.run(np.zeros((len(w), 1)), plant.system("noise").simulate(w))[1000:]
    for window in (1, 25):
        sums = r[: len(r) // window * window].reshape(-1, window, 2).sum(axis=1) / np.sqrt(window)
        np.testing.assert_allclose(np.cov(sums.T), generator.covariance_of_sums(window), rtol=0.08)


def test_a_window_over_coloured_residuals_keeps_the_rate() -> None:
    plant = rs.library.gertler().with_noise(process=0.01, measurement=0.02)
    generator = rs.design.detection_filter(plant, poles=[0.9, 0.95])
    test = rs.decide.NormThreshold(window=25, persistence=1, false_alarm_rate=0.01)
    monitor = rs.Monitor(generator, test=test)
    rng = np.random.default_rng(1)
    w = rng.standard_normal((100_000, len(plant.noises)))
    found = monitor.run(np.zeros((len(w), 1)), plant.system("noise").simulate(w))
    assert isinstance(found, rs.Diagnosis)
    assert 0.005 < found.false_alarm_fraction < 0.02


@pytest.mark.parametrize("margin", [-1, 0, np.nan, np.inf, "1", True])
@pytest.mark.parametrize("design", [rs.design.detection_filter, rs.design.robust_detection_filter])
def test_margins_that_make_no_sense_are_refused(design: object, margin: object) -> None:
    with pytest.raises(DesignError, match="margin"):
        design(rs.library.jet_engine(), margin=margin)  # pyright: ignore[reportCallIssue]
    with pytest.raises(DesignError, match="not both"):
        design(rs.library.jet_engine(), poles=[-3, -3, -3], margin=1.0)  # pyright: ignore[reportCallIssue]
    with pytest.raises(DesignError, match="numbers"):
        design(rs.library.jet_engine(), poles="abc")  # pyright: ignore[reportCallIssue]


def test_an_unstable_filter_cannot_be_made() -> None:
    flt = rs.design.detection_filter(rs.library.gertler())
    assert flt.observer is not None
    with pytest.raises(AccuracyError, match="stable"):
        make_generator(
            flt.system.replaced(A=flt.system.A * 4),
            flt.plant,
            "x",
            flt.evidence,
            decouples=Decoupled(),
            state_map=np.eye(3),
        )


def test_poles_are_said_to_be_asked_for_only_when_they_were() -> None:
    engine = rs.library.jet_engine()
    assert len(rs.design.robust_detection_filter(engine).evidence.requested_poles) == 0
    asked = rs.design.robust_detection_filter(engine, poles=[-3, -3, -3])
    np.testing.assert_allclose(asked.discretize(0.01).evidence.requested_poles, np.exp(-0.03))


@pytest.mark.parametrize("value", [np.nan, "a", None, 2.5, True, 0])
def test_settings_that_make_no_sense_are_refused(value: object) -> None:
    if value is not None:  # the clear mean
        with pytest.raises(SettingError, match="window"):
            rs.decide.Directional(window=value)  # pyright: ignore[reportArgumentType]
    with pytest.raises(SettingError, match="persistence"):
        rs.decide.NormThreshold(persistence=value)  # pyright: ignore[reportArgumentType]
    if value != 0:
        with pytest.raises(SettingError, match="max_hold"):
            rs.Monitor(rs.design.detection_filter(rs.library.gertler()), max_hold=value)  # pyright: ignore


def test_disturbances_in_the_outputs_with_very_different_units_are_all_decoupled() -> None:
    rng = np.random.default_rng(0)
    plant = rs.Plant(rng.standard_normal((3, 3)) - 3 * np.eye(3), np.ones((3, 1)), rng.standard_normal((4, 3)))
    plant = plant.with_disturbances(
        {
            "gust": (1e5 * rng.standard_normal(3), [1e5, 0, 0, 0]),
            "drift": (1e-6 * rng.standard_normal(3), [0, 1e-6, 0, 0]),
        }
    )
    generator = rs.design.unknown_input_observer(plant).residual_generator()
    assert generator.n_residuals == 2
    form = generator.internal_form()
    response = np.abs(form.frequency_response(np.logspace(-2, 2, 20)))
    assert response[:, :, 0].max() < 1e-9 * 1e5
    assert response[:, :, 1].max() < 1e-9 * 1e-6


@pytest.mark.parametrize("seed", range(10))
def test_sampling_keeps_the_steady_directions_also_with_integrators(seed: int) -> None:
    rng = np.random.default_rng(seed)
    A = np.array([[0, 1, 0], [0, 0, 1], [0, 0, -1.0]])
    plant = rs.Plant(A, rng.standard_normal((3, 1)), np.eye(3)[[0, 2]]).with_faults({"f": rng.standard_normal(3)})
    plant = plant.with_sensor_faults().with_noise(process=1.0, measurement=0.1)
    for design in (rs.design.kalman_filter, lambda p: rs.design.unknown_input_observer(p).residual_generator()):
        generator = design(plant)
        sampled = generator.discretize(0.05)
        for name in plant.faults:
            np.testing.assert_allclose(sampled.steady_directions[name], generator.steady_directions[name])
        assert rs.Monitor(generator, dt=0.05, test=rs.decide.NormThreshold(threshold=1.0)).groups


@pytest.mark.parametrize("seed", range(20))
def test_sensor_faults_stay_narrow_with_more_outputs_than_states_and_disturbances_in_them(seed: int) -> None:
    rng = np.random.default_rng(100 + seed)
    plant = random_plant(rng, n=3, outputs=6, faults=1, sensors=True, dt=0.1)
    plant = plant.with_disturbances({"d": (rng.standard_normal(3), rng.standard_normal(6))})
    generator = rs.design.robust_detection_filter(plant, faults=plant.faults[1:])
    rows = {name: list(m.residuals) for m in generator.members for name in m.faults}
    for name in plant.faults[1:]:
        assert np.linalg.matrix_rank(generator.subspaces[name][rows[name]], tol=1e-6) <= 3


def test_a_fault_in_small_units_keeps_its_steady_direction() -> None:
    """The units of one fault must not make the response to another look like rounding."""
    plant = rs.library.gertler(sensor_faults=True)
    plain = rs.design.luenberger_observer(plant).residual_generator().steady_directions
    Y = np.array([1e6, 1e-5])
    scaled = plant._with(C=Y[:, None] * plant.C, Df=Y[:, None] * plant.Df, Bf=plant.Bf * np.array([1, 1e4, 1, 1]))
    found = rs.design.luenberger_observer(scaled).residual_generator().steady_directions
    for name in plant.faults:
        assert ((plain[name] != 0) == (found[name] != 0)).all()


@pytest.mark.parametrize("seed", range(8))
def test_evidence_is_the_same_in_units_of_powers_of_two(seed: int) -> None:
    rng = np.random.default_rng(900 + seed)
    plant = random_plant(rng, n=4, outputs=4, faults=3, dt=0.1 * (seed % 2))
    T, Y = (2.0 ** np.round(rng.uniform(-20, 20, 4)) for _ in range(2))
    other = in_units(plant, T)._with(
        C=Y[:, None] * plant.C / T, D=Y[:, None] * plant.D, Dd=Y[:, None] * plant.Dd, Df=Y[:, None] * plant.Df
    )
    for design in (rs.design.luenberger_observer, partial(rs.design.unknown_input_observer, scaling="even")):
        first, second = (design(p).residual_generator() for p in (plant, other))
        assert first.n_residuals > 1
        for name in ("identities", "response off the signatures"):
            assert max(one.evidence.conditions[name] for one in (first, second)) < 1e-12
        assert max([*first.evidence.decoupling.values(), *second.evidence.decoupling.values()]) < 1e-12
        np.testing.assert_allclose(second.evidence.poles, first.evidence.poles, rtol=1e-6)
        for fault in plant.faults:  # what spans them, in other units of the residuals
            one, two = first.subspaces[fault], second.subspaces[fault]
            assert one.shape == two.shape
