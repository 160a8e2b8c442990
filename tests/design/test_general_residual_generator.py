"""The general form of a residual generator: there and back, and wrong matrices found."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import residua as rs
from generated import random_plant, simulate, singular_plant
from residua.design.observers.general_residual_generator import general_form, residual_generator_from_observer
from residua.errors import AccuracyError, DesignError, ModelError, SettingError

DESIGNS: dict[str, Callable[[rs.Plant], rs.ResidualGenerator]] = {
    "decoupled residual": lambda p: rs.design.decoupled_residual(p, insensitive_to=p.faults[0]),
    "Luenberger": lambda p: rs.design.luenberger_observer(p).residual_generator(),
    "unknown input": lambda p: rs.design.unknown_input_observer(p).residual_generator(),
    "Beard": lambda p: rs.design.detection_filter(p),
}
MATRICES = ("M", "J", "N", "Ls", "Lu", "Ly")


def matrices(generator: rs.ResidualGenerator) -> dict[str, np.ndarray]:
    form = general_form(generator)
    return {name: np.array(getattr(form, name)) for name in MATRICES}


def plant_of(seed: int, disturbances: int = 1) -> rs.Plant:
    rng = np.random.default_rng(seed)
    return random_plant(
        rng, n=int(rng.integers(2, 9)), outputs=4, disturbances=disturbances, faults=2, sensors=True, feedthrough=True
    )


@pytest.mark.parametrize("kind", DESIGNS)
@pytest.mark.parametrize("seed", range(10))
def test_there_and_back(seed: int, kind: str) -> None:
    plant = plant_of(seed)
    made = DESIGNS[kind](plant)
    form = general_form(made)
    assert form.is_residual_generator
    decouples = kind in ("decoupled residual", "unknown input")
    assert form.decouples == decouples
    assert max(list(form.conditions.values())[:4]) < 1e-10
    for T in (None, form.T):
        back = residual_generator_from_observer(plant, **matrices(made), T=T, decouples=decouples)
        np.testing.assert_allclose(back.state_map, form.T, atol=1e-5 * np.abs(form.T).max())
        np.testing.assert_array_equal(back.system.A, made.system.A)
        np.testing.assert_array_equal(back.system.B, made.system.B)
        np.testing.assert_array_equal(back.system.D, made.system.D)


@pytest.mark.parametrize("seed", range(10))
def test_the_conditions_against_data(seed: int) -> None:
    """The numbers say decoupled exactly when the filter, run on the plant with disturbances, is silent."""
    plant = plant_of(seed).discretize(0.05) if not plant_of(seed).dt else plant_of(seed)
    rng = np.random.default_rng(seed)
    u, y = simulate(plant, rng, 60)
    for kind in ("decoupled residual", "Luenberger"):
        made = DESIGNS[kind](plant)
        silent = np.abs(made.run(u, y)).max() < 1e-8 * max(1.0, np.abs(y).max())
        assert general_form(made).decouples == silent


@pytest.mark.parametrize("seed", range(16))
def test_singular_plants(seed: int) -> None:
    """The algebraic equations that the residual reads are found again, and so is the state map."""
    plant = singular_plant(np.random.default_rng(seed), disturbances=seed % 2)
    made = rs.design.decoupled_residual(plant)
    form = general_form(made)
    assert form.decouples
    back = residual_generator_from_observer(plant, **matrices(made))
    np.testing.assert_array_equal(back.structure, made.structure)
    np.testing.assert_allclose(back.state_map @ plant.E, form.T @ plant.E, atol=1e-7 * max(1.0, np.abs(form.T).max()))
    np.testing.assert_allclose(general_form(back).V, form.V, atol=1e-7 * max(1.0, np.abs(form.V).max()))


@pytest.mark.parametrize("wrong", MATRICES)
@pytest.mark.parametrize("seed", range(8))
def test_one_wrong_entry_is_found(seed: int, wrong: str) -> None:
    plant = plant_of(seed)
    made = DESIGNS["decoupled residual"](plant)
    given = matrices(made)
    at = np.unravel_index(np.argmax(np.abs(given[wrong])), given[wrong].shape)
    given[wrong][at] *= 1 + 1e-4
    for T in (None, made.state_map):
        with pytest.raises((DesignError, AccuracyError), match=r"missed by|not stable|answers to"):
            residual_generator_from_observer(plant, **given, T=T)


def test_the_condition_that_fails_is_named() -> None:
    plant = rs.library.gertler().faults_as_disturbances("p1")
    made = rs.design.decoupled_residual(plant, poles=[0.25, 0.3])
    T, given = made.state_map, matrices(made)
    assert T is not None
    for name, words in (
        ("N", r"T A - M T E - N C = 0 is missed"),
        ("J", r"T B - N D - J = 0 is missed"),
        ("Ly", r"Ls T E \+ Ly C \+ V A = 0 is missed"),
        ("Lu", r"Lu \+ Ly D \+ V B = 0 is missed"),
    ):
        with pytest.raises(DesignError, match=words) as caught:
            residual_generator_from_observer(plant, **{**given, name: given[name] + 0.1}, T=T)
        assert str(caught.value).count("is missed") == 1


def test_what_does_not_decouple_is_told_or_accepted() -> None:
    plant = rs.library.gertler().faults_as_disturbances("p1")
    made = rs.design.luenberger_observer(plant, poles=[0.1, 0.2, 0.3]).residual_generator()
    with pytest.raises(DesignError, match=r"ignores the disturbances.*T Fd - N Dd = 0 is missed by 1"):
        residual_generator_from_observer(plant, **matrices(made))
    found = residual_generator_from_observer(plant, **matrices(made), decouples=False)
    assert "disturbance" not in found.evidence.decoupling
    assert found.evidence.conditions["T Fd - N Dd = 0"] > 0.5
    assert made.observer is not None
    for source, options in ((plant, {"gain": made.observer.K}), (made.observer, {})):
        with pytest.raises(DesignError, match=r"does not ignore the disturbances p1.*by 0\.98 of the terms.*1e-06"):
            residual_generator_from_observer(source, **options, decouples=True)


@pytest.mark.parametrize("seed", range(10))
def test_a_gain_and_a_weight(seed: int) -> None:
    plant = plant_of(seed, disturbances=0)
    rng = np.random.default_rng(seed)
    observer = rs.design.luenberger_observer(plant)
    S = rng.standard_normal((2, 4))
    found = residual_generator_from_observer(plant, gain=observer.K, weight=S)
    z = np.exp(0.4j) if plant.dt else 0.4j
    expected = S @ observer.residual_generator().system.evaluate(np.array([z]))[0]
    np.testing.assert_allclose(found.system.evaluate(np.array([z]))[0], expected, atol=1e-9 * np.abs(expected).max())
    np.testing.assert_array_equal(general_form(found).T, np.eye(plant.n_states))
    whole = residual_generator_from_observer(plant, gain=observer.K)
    assert whole.n_residuals == 4
    same = residual_generator_from_observer(observer)
    np.testing.assert_array_equal(same.system.B, observer.residual_generator().system.B)


def test_J_and_Lu_follow_where_they_are_left_out() -> None:
    plant = plant_of(3)
    given = matrices(DESIGNS["decoupled residual"](plant))
    short = {name: given[name] for name in ("M", "N", "Ls", "Ly")}
    found = general_form(residual_generator_from_observer(plant, **short))
    np.testing.assert_allclose(found.J, given["J"], atol=1e-8 * np.abs(given["J"]).max())
    np.testing.assert_allclose(found.Lu, given["Lu"], atol=1e-12 * np.abs(given["Lu"]).max())


def test_a_pole_that_the_plant_has_too_leaves_the_map_to_the_other_conditions() -> None:
    """With M and A sharing both poles the Sylvester equation alone has a family of solutions."""
    plant = rs.library.gertler().faults_as_disturbances("p1")
    made = rs.design.decoupled_residual(plant, poles=[0.4, 0.9])
    back = residual_generator_from_observer(plant, **matrices(made))
    np.testing.assert_allclose(back.state_map, made.state_map, atol=1e-9)


@pytest.mark.parametrize("dt", [0.0, 0.5])
def test_what_a_residual_does_not_show_may_be_anything(dt: float) -> None:
    """A mode that no output sees is one of the observer too, and leaves a row of the map open."""
    poles = np.diag([0.3, 0.2, -0.4]) if dt else np.diag([-1.0, -2.0, -3.0])
    plant = rs.Plant(poles, np.ones((3, 1)), [[1, 0, 1], [0, 0, 1]], dt=dt).with_sensor_faults()
    made = rs.design.luenberger_observer(plant).residual_generator()
    back = residual_generator_from_observer(plant, **matrices(made), decouples=False)
    np.testing.assert_array_equal(back.structure, made.structure)
    s = np.array([0.3 + 0.4j])
    np.testing.assert_allclose(back.system.evaluate(s), made.system.evaluate(s), atol=1e-12)


def test_a_static_residual_has_a_general_form_of_order_zero() -> None:
    plant = rs.Plant([[0.5]], [[1]], [[1], [2]], dt=1).with_sensor_faults()
    none = np.zeros((0, 0))
    found = residual_generator_from_observer(
        plant, M=none, J=np.zeros((0, 1)), N=np.zeros((0, 2)), Ls=np.zeros((1, 0)), Ly=[[2, -1]]
    )
    np.testing.assert_array_equal(found.structure, [[True, True]])
    assert general_form(found).is_residual_generator


def test_rank_condition() -> None:
    """Two faults in one direction of the error cannot be told apart by any weighting of it: rank(T F) < rank(F)."""
    plant = rs.library.gertler()
    apart = general_form(rs.design.detection_filter(plant))
    assert (apart.rank_TF.rank, apart.rank_F.rank) == (2, 2)
    assert apart.keeps_faults_apart
    ignoring = general_form(rs.design.decoupled_residual(plant, insensitive_to="p1"))
    assert (ignoring.rank_TF.rank, ignoring.rank_F.rank) == (1, 2)
    assert not ignoring.keeps_faults_apart
    assert ignoring.first_response[0, 0] == pytest.approx(0, abs=1e-12)
    assert "rank(T F) = 1, rank(F) = 2" in str(ignoring)


@pytest.mark.parametrize("seed", range(6))
def test_the_first_response_is_that_of_the_internal_form(seed: int) -> None:
    made = DESIGNS["decoupled residual"](plant_of(seed))
    internal = made.internal_form()
    expected = (internal.C @ internal.B)[:, : len(made.faults)]
    np.testing.assert_allclose(general_form(made).first_response, expected, atol=1e-7 * np.abs(expected).max())


def test_a_sampled_continuous_design_has_no_general_form() -> None:
    plant = rs.Plant([[-1.0]], [[1]], [[1], [1]]).with_sensor_faults()
    with pytest.raises(DesignError, match="no linear function T x"):
        general_form(rs.design.decoupled_residual(plant).discretize(0.1))


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({}, SettingError, "needs M, N, Ls, Ly too"),
        ({"weight": [[1, 0]]}, SettingError, "weight goes with a gain"),
        ({"gain": np.zeros((3, 2)), "M": [[0]]}, SettingError, "not both: got gain and M"),
        ({"gain": np.zeros((2, 2))}, ModelError, "gain must be 3 x 2"),
        ({"gain": -np.ones((3, 2))}, DesignError, "A - K C is not stable"),
        ({"gain": np.zeros((3, 2)), "weight": [[1, 0, 0]]}, ModelError, "weight must be any x 2"),
        ({"gain": np.zeros((3, 2)), "weight": [[0, 0]]}, DesignError, "weight is zero"),
        ({"M": [[1.5]], "N": [[1, 0]], "Ls": [[1]], "Ly": [[1, 0]]}, DesignError, "M is not stable"),
        ({"M": [[0.5]], "N": [[1]], "Ls": [[1]], "Ly": [[1, 0]]}, ModelError, "N must be 1 x 2"),
        ({"M": [[0.5]], "N": [[1, 0]], "Ls": [[1]], "Ly": [[1, 0]]}, DesignError, "no residual generator"),
        ({"M": [[0.5]], "N": [[np.nan, 0]], "Ls": [[1]], "Ly": [[1, 0]]}, ModelError, "finite"),
    ],
)
def test_what_is_wrong_is_told(options: dict, error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=words):
        residual_generator_from_observer(rs.library.gertler(), **options)


def test_an_observer_brings_its_own_matrices() -> None:
    observer = rs.design.luenberger_observer(rs.library.gertler())
    with pytest.raises(SettingError, match="brings its own matrices"):
        residual_generator_from_observer(observer, weight=[[1, 0]])
