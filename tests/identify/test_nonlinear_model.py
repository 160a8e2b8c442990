"""Equations that are predicted as they are: equal to the linear plant where they are linear, right where it is not."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.integrate

import residua as rs
from residua.errors import DataError, ModelError
from residua.identify import NonlinearModel, grey_box
from residua.identify.prediction_errors import model_errors
from residua.library.three_tank import FLOWS, GRAVITY, LEVELS, PIPE

TRUE = {"a1": 0.46, "a2": 0.60, "a3": 0.45}
#: Runge-Kutta over a step that is a fiftieth of the time constant.
INTEGRATION = 1e-8


def tanks(a1: float, a2: float, a3: float) -> NonlinearModel:
    """Return the three tanks' own equations, and their linear plant at the nominal levels."""

    def flow(a: float, drop: float) -> float:
        return a * PIPE * np.sign(drop) * np.sqrt(2 * GRAVITY * abs(drop))

    def rate(h: np.ndarray, q: np.ndarray) -> np.ndarray:
        q13, q20, q32 = flow(a1, h[0] - h[2]), flow(a2, h[1]), flow(a3, h[2] - h[1])
        return np.array([q[0] - q13, q[1] + q32 - q20, q13 - q32]) / 154.0

    levels = ["h1", "h2", "h3"]
    near = rs.identify.tangent_model(
        rate, at=(LEVELS, FLOWS), hold={"h1": 41.0, "h2": 32.0}, inputs=["Q1", "Q2"], states=levels, outputs=levels
    )
    plant = near.plant.discretize(1.0).with_noise(process=1e-4, measurement=0.02)
    return NonlinearModel(rate, plant=plant, state=near.states)


def linear(decay: float, *, sampled: bool = False) -> NonlinearModel:
    """Return a linear model as if it were not."""
    plant = rs.Plant([[-decay, 0.1], [0.0, -0.3]], [[1.0], [0.5]], [[1.0, 1.0]], inputs="push", outputs="pull")
    plant = plant.with_noise(process=0.02, measurement=0.1).with_operating_point(inputs=[2.0], outputs=[3.0])
    discrete = plant.discretize(0.2)
    A, B = (discrete.A, discrete.B) if sampled else (plant.A, plant.B)
    x0 = np.array([1.0, 2.0])

    def rate(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        return A @ (x - x0) + B @ (u - 2.0) + (x0 if sampled else 0.0)

    return NonlinearModel(rate, lambda x, u: [x.sum()], plant=discrete, state=x0, dt=0.2 if sampled else 0, substeps=4)


@pytest.mark.parametrize("sampled", [False, True])
@pytest.mark.parametrize("simulation", [False, True])
def test_linear_equations_are_predicted_as_their_plant_is(sampled: bool, simulation: bool) -> None:
    rng = np.random.default_rng(0)
    data = [rng.standard_normal((60, 2)) + [2.0, 3.0], rng.standard_normal((40, 2)) + [2.5, 3.0]]
    model = linear(0.8, sampled=sampled)
    made = model_errors(model, data, 0.2, [1], simulation=simulation).projected(np.eye(1))
    wanted = model_errors(model.plant, data, 0.2, [1], simulation=simulation).projected(np.eye(1))
    for one, other in zip(made, wanted, strict=True):
        np.testing.assert_allclose(one, other, atol=100 * INTEGRATION)


def test_the_step_is_that_of_an_integrator() -> None:
    model = tanks(**TRUE)
    h, q = np.array([50.0, 20.0, 30.0]), np.array([60.0, 10.0])
    exact = scipy.integrate.solve_ivp(lambda _, x: model.rate(x, q), (0, 1), h, rtol=1e-12, atol=1e-12).y[:, -1]
    np.testing.assert_allclose(model.after(h, q, 1.0), exact, rtol=INTEGRATION)


def wide(seed: int, samples: int = 600) -> tuple[np.ndarray, np.ndarray]:
    """Return a recording in open loop whose levels move by 6 to 20 cm, with the benchmark's noise."""
    rng = np.random.default_rng(seed)
    q = np.repeat(np.array(FLOWS) * rng.uniform(0.2, 1.4, (samples // 100, 2)), 100, axis=0)
    run = rs.library.simulate_three_tank(samples, u=q, seed=seed)
    assert np.ptp(run.x, axis=0).min() > 6
    return run.u, run.y


def test_the_tanks_coefficients_come_from_wide_movements() -> None:
    """Where the linear plant at one operating point is off by many standard errors, and says so."""
    data = wide(seed=1)
    box = dict.fromkeys(TRUE, (0.3, 0.5, 0.8))
    model = grey_box(tanks, data, box)
    for name, value in TRUE.items():
        assert abs(model.parameters[name] - value) < 3.5 * model.standard_errors[name]
        assert model.standard_errors[name] < 0.01
    assert min(model.fit.values()) > 0.8
    assert min(model.whiteness.values()) > 0.001
    assert model.plant.inputs == ("Q1", "Q2")
    flat = grey_box(lambda **p: tanks(**p).plant, data, box)
    off = max(abs(flat.parameters[name] - value) / flat.standard_errors[name] for name, value in TRUE.items())
    assert off > 5
    assert any("correlated over time" in note for note in flat.notes)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"rate": 3}, "must be functions"),
        ({"output": 3}, "must be functions"),
        ({"plant": 3}, "must be a Plant"),
        ({"substeps": 0}, "substeps must be"),
        ({"state": [1.0]}, "must be 2 x 1"),
        ({"state": {"x1": 1.0}}, "must give every state of the plant: x1, x2"),
        ({"state": [1.0, 3.0]}, r"the output 'pull' is 4, at the plant's operating point 3"),
        ({"rate": lambda x, u: [1.0]}, "expected one number a state"),
        ({"output": lambda x, u: [1.0, 2.0]}, "expected one an output"),
        ({"dt": -1.0}, "dt must be"),
    ],
)
def test_bad_input_is_refused(changes: dict[str, Any], said: str) -> None:
    good = linear(0.8)
    given = {"rate": good.rate, "output": good.output, "plant": good.plant, "state": good.state} | changes
    with pytest.raises(ModelError, match=said):
        NonlinearModel(given.pop("rate"), given.pop("output"), **given)


def test_a_recording_of_another_step_is_refused() -> None:
    sampled = linear(0.8, sampled=True)
    model = NonlinearModel(sampled.rate, sampled.output, plant=sampled.plant, state=sampled.state, dt=0.3)
    with pytest.raises(DataError, match=r"the model has dt=0.3 s, the recording 0.2 s"):
        model_errors(model, [np.ones((20, 2))], 0.2, [])


def test_equations_that_break_down_are_refused_with_the_parameters() -> None:
    def breaking(decay: float) -> NonlinearModel:
        good = linear(decay)

        def rate(x: np.ndarray, u: np.ndarray) -> np.ndarray:
            return np.where(abs(x - [1.0, 2.0]).max() > 1e-3, np.nan, np.asarray(good.rate(x, u)))

        return NonlinearModel(rate, good.output, plant=good.plant, state=good.state)

    rng = np.random.default_rng(0)
    data = rng.standard_normal((80, 1)) + 2.0, rng.standard_normal((80, 1)) + 3.0
    with pytest.raises(ModelError, match=r"plant_at\(decay=0.8\): its predictions are no finite numbers"):
        grey_box(breaking, data, {"decay": (0.5, 0.8, 1.0)})
