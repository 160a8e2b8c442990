"""The plant: roles, faults, noise, sampling, and what it refuses."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

from plant_examples import A, B, C, example, random_plant
from residua.design import robust_detection_filter
from residua.errors import ModelError
from residua.library import jet_engine
from residua.plant import Fault, OperatingPoint, Plant


def test_actuator_fault_enters_as_its_input() -> None:
    plant = example().with_actuator_faults("valve")
    assert plant.fault_list == (Fault("valve actuator", "actuator", "valve"),)
    np.testing.assert_array_equal(plant.Bf[:, 0], plant.B[:, 1])
    assert not plant.Df.any()


def test_sensor_fault_adds_to_its_output() -> None:
    plant = example().with_sensor_faults()
    assert plant.faults == ("level sensor", "flow sensor")
    np.testing.assert_array_equal(plant.Df, np.eye(2))
    assert not plant.Bf.any()


def test_faults_by_vector_pair_and_name_are_the_same() -> None:
    by_vector = example().with_faults({"f": ([0, 3, 0], [0, 4])}, component="pump")
    by_name = example().with_faults({"f": ({"b": 3}, {"flow": 4})}, component="pump")
    for key in ("Bf", "Df"):
        np.testing.assert_array_equal(getattr(by_vector, key), getattr(by_name, key))
    assert by_name.fault_components == ("pump",)
    assert by_name.without_faults("f").faults == ()


def test_a_plant_does_not_change() -> None:
    plant = example()
    plant.with_sensor_faults().with_noise(process=1.0)
    assert plant.faults == ()
    assert plant.noises == ()
    with pytest.raises(ValueError, match="read-only"):
        plant.A[0, 0] = 7
    with pytest.raises(AttributeError):
        plant.dt = 1.0  # pyright: ignore[reportAttributeAccessIssue]


def test_dependent_disturbances_are_factored() -> None:
    plant = example().with_disturbances([[1, 2, 3], [2, 4, 6], [0, 0, 0]])
    assert plant.Bd.shape == (3, 1)
    assert abs(np.array([1, 2, 0]) @ plant.Bd[:, 0]) == pytest.approx(np.sqrt(5) * np.linalg.norm(plant.Bd), rel=1e-12)


def test_named_disturbances_keep_names_and_columns_though_they_depend_on_one_another() -> None:
    plant = example().with_disturbances({"gust": [1, 0, 0], "wave": [2, 0, 0]})
    assert plant.disturbances == ("gust", "wave")
    np.testing.assert_array_equal(plant.Bd, [[1, 2], [0, 0], [0, 0]])
    assert plant.with_disturbances({}).disturbances == ("gust", "wave")


def test_designs_factor_named_disturbances() -> None:
    plant = jet_engine(disturbances=False)
    both = robust_detection_filter(plant.with_disturbances({"gust": [1, 0, 0], "wave": [2, 0, 0]}))
    alone = robust_detection_filter(plant.with_disturbances({"gust": [1, 0, 0]}))
    np.testing.assert_allclose(np.sort(both.system.poles()), np.sort(alone.system.poles()), atol=1e-9)
    assert both.plant.disturbances == ("gust", "wave")
    assert max(both.evidence.decoupling.values()) < 1e-9


def test_named_disturbances_keep_their_columns() -> None:
    plant = example().with_disturbances({"wind": [1, 0, 0], "load": ({"b": 2}, {"level": 1})})
    assert plant.disturbances == ("wind", "load")
    np.testing.assert_array_equal(plant.Bd, [[1, 0], [0, 2], [0, 0]])
    np.testing.assert_array_equal(plant.Dd, [[0, 1], [0, 0]])
    assert plant.without_disturbances().Bd.shape == (3, 0)


@pytest.mark.parametrize("seed", range(5))
def test_system_stacks_the_roles(seed: int) -> None:
    plant = random_plant(seed)
    system = plant.system(("fault", "control"))
    np.testing.assert_array_equal(system.B, np.hstack([plant.Bf, plant.B]))
    np.testing.assert_array_equal(system.D, np.hstack([plant.Df, plant.D]))
    assert system.inputs == plant.faults + plant.inputs


@pytest.mark.parametrize("seed", range(5))
def test_noise_covariances_come_back(seed: int) -> None:
    rng = np.random.default_rng(seed)
    G = rng.standard_normal((3, 2))
    plant = example().with_noise(process=G @ G.T, measurement={"flow": 0.5})
    np.testing.assert_allclose(plant.process_noise, G @ G.T, atol=1e-12)
    np.testing.assert_allclose(plant.measurement_noise, np.diag([0, 0.5]), atol=1e-15)
    assert not plant.cross_noise.any()


@pytest.mark.parametrize("seed", range(5))
def test_sampling_agrees_with_the_matrix_exponential(seed: int) -> None:
    plant, h = random_plant(seed), 0.07
    sampled = plant.discretize(h)
    B = np.hstack([plant.B, plant.Bd, plant.Bf])
    X = scipy.linalg.expm(np.block([[plant.A, B], [np.zeros((B.shape[1], 4 + B.shape[1]))]]) * h)
    np.testing.assert_allclose(sampled.A, X[:4, :4], atol=1e-12)
    np.testing.assert_allclose(np.hstack([sampled.B, sampled.Bd, sampled.Bf]), X[:4, 4:], atol=1e-12)
    times = np.linspace(0, h, 401)  # Simpson's rule
    weights = np.full(401, 2.0)
    weights[1::2], weights[[0, -1]] = 4.0, 1.0
    parts = [scipy.linalg.expm(plant.A * s) for s in times]
    Q = sum(w * P @ plant.process_noise @ P.T for w, P in zip(weights, parts, strict=True)) * h / 1200
    np.testing.assert_allclose(sampled.process_noise, Q, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(sampled.measurement_noise, plant.measurement_noise / h, rtol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_an_invertible_E_is_divided_out(seed: int) -> None:
    rng = np.random.default_rng(seed)
    E = rng.standard_normal((3, 3)) + 3 * np.eye(3)
    plant = example(E=E).with_faults({"f": [1, 2, 3]}).with_noise(process=1.0)
    plain = plant.explicit()
    w = [0.1, 1.0]
    np.testing.assert_allclose(plain.system().frequency_response(w), plant.system().frequency_response(w), atol=1e-10)
    with pytest.raises(ModelError, match="singular"):
        example(E=np.diag([1.0, 1.0, 0.0])).explicit()


def test_operating_point_by_name() -> None:
    plant = example().with_operating_point(inputs={"valve": 2.0}, outputs=[3.0, 4.0])
    assert plant.operating_point == OperatingPoint((0.0, 2.0), (3.0, 4.0))


BAD_PLANTS = {
    "A is not square": (lambda: Plant([[1, 2]], [[1]], [[1]]), "A must be square"),
    "B has other rows": (lambda: Plant(A, [[1.0], [2.0]], C), "B must be 3 x any"),
    "C has other columns": (lambda: Plant(A, B, [[1.0, 2.0]]), "C must be any x 3"),
    "D does not fit": (lambda: Plant(A, B, C, [[1.0]]), "D must be 2 x 2"),
    "NaN": (lambda: Plant([[np.nan]], [[1]], [[1]]), r"A\[0, 0\] is nan"),
    "infinity": (lambda: Plant([[1]], [[np.inf]], [[1]]), r"B\[0, 0\] is inf"),
    "complex": (lambda: Plant(np.array([[1j]]), [[1]], [[1]]), "A must be real"),
    "ragged": (lambda: Plant([[1, 2], [3]], [[1]], [[1]]), "A must be a matrix of numbers"),
    "text": (lambda: Plant([["x"]], [[1]], [[1]]), "A must be a matrix of numbers"),
    "no output": (lambda: Plant(A, B, np.zeros((0, 3))), "at least one measured output"),
    "negative step": (lambda: example(dt=-1), "dt must be 0"),
    "step in words": (lambda: example(dt="1 s"), "dt must be 0"),
    "too few names": (lambda: example(inputs=["one"]), "expected 2 names, got 1"),
    "name twice": (lambda: example(outputs=["level", "level"]), "'level' occurs twice"),
    "input called like an output": (lambda: example(outputs=["pump", "flow"]), "'pump' occurs twice"),
    "empty name": (lambda: example(states=["a", "", "c"]), "non-empty string"),
    "unit of nothing": (lambda: example(units={"speed": "m/s"}), "'speed' is no input"),
    "operating point too short": (
        lambda: example(operating_point=OperatingPoint((1.0,), (1.0, 2.0))),
        "expected 2 inputs and 2 outputs",
    ),
    "operating point not finite": (
        lambda: example(operating_point=OperatingPoint((1.0, np.nan), (1.0, 2.0))),
        "must be finite",
    ),
    "operating point of another kind": (lambda: example(operating_point={"pump": 1}), "OperatingPoint"),
    "operating point of an unknown channel": (
        lambda: example().with_operating_point(inputs={"pumps": 1.0}),
        "unknown operating_point inputs: channel 'pumps'",
    ),
    "unknown sensor": (lambda: example().with_sensor_faults(["speed"]), "unknown output 'speed'; known: level, flow"),
    "unknown actuator": (lambda: example().with_actuator_faults("speed"), "unknown input 'speed'"),
    "sensor twice": (lambda: example().with_sensor_faults().with_sensor_faults(), "occurs twice"),
    "fault without effect": (lambda: example().with_faults({"f": [0, 0, 0]}), "no effect"),
    "fault of wrong length": (lambda: example().with_faults({"f": [1, 0]}), "must be 3 x 1"),
    "fault not finite": (lambda: example().with_faults({"f": [1, np.inf, 0]}), "finite"),
    "fault in words": (lambda: example().with_faults({"f": {"a": "much"}}), "expected a number, got 'much'"),
    "fault without a name": (lambda: example().with_faults({"": [1, 0, 0]}), "needs a name"),
    "unknown kind": (lambda: example().with_faults({"f": [1, 0, 0]}, kind="other"), "kind must be"),
    "faults as a list": (lambda: example().with_faults([[1, 0, 0]]), "takes a mapping"),
    "unknown fault": (lambda: example().without_faults("f"), "unknown fault 'f'; known: none"),
    "disturbance of wrong length": (lambda: example().with_disturbances([[1.0], [2.0]]), "must be 3 x any"),
    "disturbance names do not fit": (
        lambda: example().with_disturbances([[1.0], [2.0], [0.0]], names=["a", "b"]),
        "expected 1 names, got 2",
    ),
    "disturbance without effect": (lambda: example().with_disturbances({"gust": [0, 0, 0]}), "'gust' has no effect"),
    "disturbance that exists": (
        lambda: example().with_disturbances({"d": [1, 0, 0]}).with_disturbances({"d": [0, 1, 0]}),
        "occurs twice",
    ),
    "disturbance mapping with names": (
        lambda: example().with_disturbances({"d": [1, 0, 0]}, names=["e"]),
        "brings its own names",
    ),
    "noise not symmetric": (
        lambda: example().with_noise(process=np.array([[1, 1, 0], [0, 1, 0], [0, 0, 1]])),
        "symmetric",
    ),
    "noise indefinite": (lambda: example().with_noise(measurement=[1.0, -1.0]), "no negative eigenvalue"),
    "noise indefinite beside a large one": (
        lambda: example().with_noise(measurement=[1e12, -1.0]),
        "no negative eigenvalue, and the variance of 'flow' is -1",
    ),
    "noise too correlated": (
        lambda: example().with_noise(measurement=[[1e12, 2.0], [2.0, 1e-12]]),
        "'level' and 'flow' cannot have the covariance 2",
    ),
    "noise correlated with nothing": (lambda: example().with_noise(measurement=[[1.0, 0.1], [0.1, 0.0]]), "at most 0"),
    "noise of three that cannot be": (
        lambda: example().with_noise(process=[[1, 0.9, 0.9], [0.9, 1, -0.9], [0.9, -0.9, 1]]),
        "the smallest of its correlation matrix is -0.8",
    ),
    "noise of wrong size": (lambda: example().with_noise(process=np.eye(2)), "must be 3 x 3"),
    "noise of an unknown channel": (lambda: example().with_noise(process={"z": 1.0}), "'z'"),
    "noise in words": (lambda: example().with_noise(process={"a": "much"}), "expected a number, got 'much'"),
    "noise in quotes": (lambda: example().with_noise(process={"a": "0.1"}), "expected a number, got '0.1'"),
    "noise in one word": (lambda: example().with_noise(measurement="much"), "expected a number, got 'much'"),
    "noise not finite": (lambda: example().with_noise(process=np.nan), "finite"),
    "sampled twice": (lambda: example(dt=1.0).discretize(0.1), "sampled already"),
    "step zero": (lambda: example().discretize(0), "positive step"),
    "unknown role": (lambda: example().system("noises"), "unknown role 'noises'"),
}


@pytest.mark.parametrize("case", BAD_PLANTS)
def test_bad_input_gets_a_clear_error(case: str) -> None:
    make, message = BAD_PLANTS[case]
    with pytest.raises(ModelError, match=message):
        make()


def test_covariances_in_mixed_units_are_kept() -> None:
    V = np.array([[1e-10, 0.5], [0.5, 1e10]])
    plant = Plant([[-1.0]], [[1]], [[1], [1]]).with_noise(measurement=V)
    np.testing.assert_allclose(plant.measurement_noise, V, rtol=1e-9)
