"""Plants from other packages' systems."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import scipy.signal

from residua.errors import ModelError
from residua.linear import StateSpace
from residua.plant import Plant, plant_from_state_space

control = pytest.importorskip("control")

RNG = np.random.default_rng(3)
MATRICES = (
    RNG.standard_normal((3, 3)),
    RNG.standard_normal((3, 2)),
    RNG.standard_normal((2, 3)),
    RNG.standard_normal((2, 2)),
)


def assert_same(plant: Plant, dt: float) -> None:
    for mine, given in zip((plant.A, plant.B, plant.C, plant.D), MATRICES, strict=True):
        np.testing.assert_array_equal(mine, given)
    assert plant.dt == dt


@pytest.mark.parametrize("dt", [0, 0.25])
def test_python_control_with_its_names(dt: float) -> None:
    names = {"inputs": ["p", "q"], "outputs": ["y", "z"], "states": ["a", "b", "c"], "name": "mine"}
    plant = Plant.from_state_space(control.ss(*MATRICES, dt, **names))
    assert_same(plant, dt)
    assert (plant.inputs, plant.outputs, plant.states) == (("p", "q"), ("y", "z"), ("a", "b", "c"))
    assert plant.name == "mine"
    assert plant_from_state_space(control.ss(*MATRICES, dt), inputs=["r", "s"]).inputs == ("r", "s")


def test_python_control_with_an_open_time_base() -> None:
    with pytest.raises(ModelError, match="dt=None"):
        plant_from_state_space(control.ss(*MATRICES, None))
    with pytest.raises(ModelError, match="dt=True"):
        plant_from_state_space(control.ss(*MATRICES, True))
    with pytest.raises(ModelError, match="positive"):
        plant_from_state_space(control.ss(*MATRICES, True), dt=0)
    assert_same(plant_from_state_space(control.ss(*MATRICES, True), dt=0.5), 0.5)
    assert_same(plant_from_state_space(control.ss(*MATRICES, None), dt=0), 0)


def test_scipy() -> None:
    assert_same(plant_from_state_space(scipy.signal.StateSpace(*MATRICES)), 0)
    assert_same(plant_from_state_space(scipy.signal.StateSpace(*MATRICES, dt=0.1)), 0.1)
    assert_same(plant_from_state_space(scipy.signal.dlti(*MATRICES, dt=0.1)), 0.1)
    with pytest.raises(ModelError, match="dt=True"):
        plant_from_state_space(scipy.signal.dlti(*MATRICES))


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_scipy_transfer_function(dt: float) -> None:
    system = scipy.signal.dlti([1, 2], [1, 0.5, 0.1], dt=dt) if dt else scipy.signal.lti([1, 2], [1, 0.5, 0.1])
    plant = plant_from_state_space(system)
    assert plant.dt == dt
    w, expected = system.freqresp([0.3])
    point = np.exp(1j * w) if dt else 1j * w
    np.testing.assert_allclose(plant.system("control").evaluate(point).ravel(), expected, rtol=1e-10)


def test_residua_keeps_E_and_names() -> None:
    E = np.diag([1.0, 2.0, 0.0])
    system = StateSpace(*MATRICES, E=E, dt=2, inputs=["p", "q"], outputs=["y", "z"])
    plant = plant_from_state_space(system, name="descriptor", units={"p": "V"})
    assert_same(plant, 2)
    np.testing.assert_array_equal(plant.E, E)
    assert (plant.inputs, plant.outputs, plant.name) == (("p", "q"), ("y", "z"), "descriptor")


def test_anything_with_the_right_attributes() -> None:
    system = SimpleNamespace(**dict(zip("ABCD", MATRICES, strict=True)), dt=0.5)
    assert_same(plant_from_state_space(system), 0.5)


@pytest.mark.parametrize("thing", [3.0, "system", None, SimpleNamespace(A=np.eye(2)), np.eye(2)])
def test_what_is_no_system(thing: object) -> None:
    with pytest.raises(ModelError, match="state-space system"):
        plant_from_state_space(thing)


def test_contradictions_are_refused() -> None:
    with pytest.raises(ModelError, match="contradicts"):
        plant_from_state_space(scipy.signal.StateSpace(*MATRICES, dt=0.1), dt=0.2)
    with pytest.raises(ModelError, match="Plant already"):
        plant_from_state_space(plant_from_state_space(scipy.signal.StateSpace(*MATRICES)))
    with pytest.raises(TypeError):
        plant_from_state_space(scipy.signal.StateSpace(*MATRICES), colour="red")
