"""A user's own equations, linearised: against derivatives by hand, the library's matrices, and kinks."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import scipy.integrate

import residua as rs
from guards import trips
from residua.errors import AccuracyError, ModelError
from residua.library.three_tank import CLOGS, FLOWS, LEAKS, LEVELS, three_tank, three_tank_rate

#: Extrapolated differences of a smooth function leave some thirteen digits; what sampling a plant does to them is less.
DIGITS = 1e-10


def smooth(seed: int, n: int = 3, m: int = 2, p: int = 2) -> tuple[Callable, Callable, Callable]:
    """Return a rate and an output of random smooth functions, and their derivatives by hand."""
    rng = np.random.default_rng(seed)
    W, V = rng.standard_normal((n, n + m)), rng.standard_normal((p, n + m))
    shift = rng.standard_normal(n)

    def rate(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        return np.sin(W @ np.concatenate([x, u]) + shift) - 2 * x

    def output(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        return np.exp(0.3 * V @ np.concatenate([x, u]))

    def derivatives(x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        z = np.concatenate([x, u])
        upper = np.cos(W @ z + shift)[:, None] * W - 2 * np.eye(n, n + m)
        return upper, 0.3 * output(x, u)[:, None] * V

    return rate, output, derivatives


def real_only(function: Callable) -> Callable:
    return lambda x, u: np.asarray(function(np.asarray(x, dtype=float), u), dtype=float)


# ----------------------------------------------------------- what is exact


def test_the_three_tanks_own_equations_give_the_librarys_matrices() -> None:
    made = rs.identify.linearise(
        lambda x, u, f: three_tank_rate(x, u, leaks=f[:3], clogs=f[3:]),
        at=(LEVELS, FLOWS),
        hold="point",
        faults=[*LEAKS, *CLOGS],
        inputs=["Q1", "Q2"],
        states=["h1", "h2", "h3"],
        outputs=["h1", "h2", "h3"],
    )
    wanted = three_tank(dt=0)
    assert made.faults == wanted.faults[5:]
    for name, columns in {"A": slice(None), "B": slice(None), "C": slice(None), "Bf": slice(5, None)}.items():
        reference = getattr(wanted, name)[:, columns]
        np.testing.assert_allclose(getattr(made, name), reference, rtol=DIGITS, atol=DIGITS * abs(reference).max())
    assert made.operating_point == wanted.operating_point
    assert "differences" in made.description


def test_the_levels_of_the_three_tanks_tell_their_flows() -> None:
    model = rs.identify.tangent_model(
        three_tank_rate,
        at=((45.0, 30.0, 36.0), (30.0, 50.0)),
        hold={"h1": 41.0, "h2": 32.0},
        inputs=["Q1", "Q2"],
        states=["h1", "h2", "h3"],
        outputs=["h1", "h2", "h3"],
    )
    assert abs(three_tank_rate(list(model.states.values()), list(model.inputs.values()))).max() < 1e-12
    assert model.outputs["h1"] == pytest.approx(41.0, rel=1e-9)
    np.testing.assert_allclose(list(model.inputs.values()), FLOWS, atol=0.05)  # the nominal flows are rounded
    one = rs.identify.tangent_model(
        three_tank_rate,
        at=((45.0, 30.0, 36.0), (30.0, 50.0)),
        hold={"h1": 41.0, "Q2": FLOWS[1]},
        inputs=["Q1", "Q2"],
        outputs=["h1", "h2", "h3"],
    )
    assert one.inputs["Q2"] == FLOWS[1]
    assert one.inputs["Q1"] == pytest.approx(FLOWS[0], abs=0.05)


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("dt", [0, 0.5])
@pytest.mark.parametrize("complex_too", [True, False])
def test_slopes_are_those_by_hand_at_the_steady_state(seed: int, dt: float, complex_too: bool) -> None:
    rate, output, derivatives = smooth(seed)
    n = 3
    ahead = (lambda x, u: x + 0.3 * rate(x, u)) if dt else rate
    functions = (ahead, output) if complex_too else (real_only(ahead), real_only(output))
    u = np.array([0.7, -0.4])
    model = rs.identify.tangent_model(*functions, at=(np.full(n, 0.2), u), dt=dt)
    x = np.array(list(model.states.values()))
    assert abs(rate(x, u)).max() < 1e-12
    upper, lower = derivatives(x, u)
    if dt:
        upper = 0.3 * upper + np.eye(n, n + 2)
    made = np.block([[model.plant.A, model.plant.B], [model.plant.C, model.plant.D]])
    wanted = np.vstack([upper, lower])
    off = abs(made - wanted)
    assert off.max() < (1e-13 if complex_too else DIGITS)
    assert model.complex_step is complex_too
    assert model.jacobian_error < DIGITS
    assert model.plant.dt == dt
    np.testing.assert_allclose(model.plant.operating_point.outputs, output(x, u))


@pytest.mark.parametrize("seed", range(4))
def test_the_estimated_error_is_not_below_the_error(seed: int) -> None:
    """By differences of a function that bends sharply beside the point."""
    rng = np.random.default_rng(seed)
    sharp = rng.uniform(50.0, 500.0)

    def rate(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        return np.asarray(u - x - 0.01 * np.tanh(sharp * (x - 1.1)), dtype=float)

    model = rs.identify.tangent_model(real_only(rate), at=([1.0], [1.1]))
    x = model.states["x1"]
    slope = -1 - 0.01 * sharp / np.cosh(sharp * (x - 1.1)) ** 2
    assert abs(model.plant.A[0, 0] - slope) <= max(model.jacobian_error * abs(slope) * 2, 1e-13)
    assert model.jacobian_error < 1e-6


@pytest.mark.parametrize("complex_too", [True, False])
@pytest.mark.parametrize("seed", range(4))
def test_units_change_nothing_but_units(seed: int, complex_too: bool) -> None:
    rng = np.random.default_rng(100 + seed)
    rate, output, _ = smooth(seed)
    X, U, Y = (2.0 ** rng.integers(-20, 21, count) for count in (3, 2, 2))

    def scaled_rate(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        return X * rate(x / X, u / U)

    def scaled_output(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        return Y * output(x / X, u / U)

    ways = (lambda f: f) if complex_too else real_only
    u = np.array([0.7, -0.4])
    plain = rs.identify.tangent_model(ways(rate), ways(output), at=(np.full(3, 0.2), u))
    other = rs.identify.tangent_model(ways(scaled_rate), ways(scaled_output), at=(0.2 * X, u * U))
    back = other.plant
    for made, wanted in (
        (back.A / X[:, None] * X, plain.plant.A),
        (back.B / X[:, None] * U, plain.plant.B),
        (back.C / Y[:, None] * X, plain.plant.C),
        (back.D / Y[:, None] * U, plain.plant.D),
    ):
        np.testing.assert_allclose(made, wanted, rtol=DIGITS, atol=DIGITS)
    assert other.jacobian_error == pytest.approx(plain.jacobian_error, rel=10, abs=1e-12)


def test_a_value_of_zero_is_stepped_by_what_has_an_effect() -> None:
    """A leak in m2 of a tank: 1 m2 would empty it at once."""

    def rate(x: np.ndarray, u: np.ndarray, f: np.ndarray) -> list[float]:
        return [float(u[0] - 1e-4 * np.sqrt(2 * 9.81 * x[0]) - (f[0] + 1e3 * f[0] ** 2) * np.sqrt(2 * 9.81 * x[0]))]

    model = rs.identify.tangent_model(
        rate, at=([0.5], [4e-4]), faults=["leak"], inputs="q", states="h", outputs="level"
    )
    assert not model.complex_step
    assert model.sizes["leak"] < 1e-2
    level = model.states["h"]
    assert model.plant.Bf[0, 0] == pytest.approx(-np.sqrt(2 * 9.81 * level), rel=DIGITS)


def test_a_function_may_change_its_arguments() -> None:
    def changing(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        x -= 1
        u *= 2
        return u - x

    model = rs.identify.tangent_model(changing, lambda x, u: 3 * x + u, at=([1.0], [2.0]))
    assert (model.states["x1"], model.outputs["y1"]) == pytest.approx((5.0, 17.0))
    plain = rs.identify.tangent_model(changing, at=([1.0], [2.0]))
    assert plain.outputs["x1"] == plain.states["x1"] == pytest.approx(5.0)


def test_a_step_by_a_solver_has_slopes() -> None:
    """The next state by adaptive integration, whose tolerance is a noise of the function."""

    def after(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        out = scipy.integrate.solve_ivp(lambda _, z: u - np.sqrt(z), (0, 0.5), x, rtol=1e-9, atol=1e-12)
        return np.asarray(out.y[:, -1], dtype=float)

    plant = rs.identify.linearise(after, at=([4.0], [2.1]), dt=0.5)
    assert plant.operating_point.outputs[0] == pytest.approx(4.41)
    assert plant.A[0, 0] == pytest.approx(np.exp(-0.5 / 2 / 2.1), rel=1e-6)


def test_an_integrator_rests_where_it_is() -> None:
    model = rs.identify.tangent_model(lambda x, u: [u[0] - u[1], x[0] - x[1]], at=([3.0, 1.0], [2.0, 2.0]))
    # the shortest step, in units of the states' sizes
    assert abs(model.states["x1"] - model.states["x2"]) < 1e-12
    assert 1.0 <= model.states["x1"] <= 3.0


# ------------------------------------------------------------ what is said


def test_a_point_that_does_not_rest_is_said() -> None:
    model = rs.identify.tangent_model(lambda x, u: [u[0] - x[0]], at=([1.0], [1.5]), hold="point", states="level")
    assert model.drift == {"level": 0.5}
    assert model.residual > 0.1
    assert any("do not rest" in note and "level by 0.5" in note for note in model.notes)
    assert "at rest to 0.2" in model.plant.description


def test_states_of_very_different_sizes_are_said() -> None:
    model = rs.identify.tangent_model(lambda x, u: [u[0] - 1e-9 * x[0], u[0] - x[1]], at=([1e9, 1.0], [1.0]))
    assert any("very different sizes" in note for note in model.notes)
    assert "note: states are" in str(model)


def test_a_function_without_a_size_anywhere_is_said() -> None:
    model = rs.identify.tangent_model(lambda x, u: [u[0] - x[0]], at=([0.0], [0.0]))
    assert any("no size is known" in note for note in model.notes)
    known = rs.identify.tangent_model(lambda x, u: [u[0] - x[0]], at=([0.0], [0.0]), sizes={"x1": 1.0, "u1": 2.0})
    assert known.notes == ()


def test_why_it_is_by_differences_is_said() -> None:
    by_abs = rs.identify.tangent_model(lambda x, u: [u[0] - np.abs(x[0])], at=([2.0], [2.0]))
    assert not by_abs.complex_step
    assert any("complex derivative is another" in note for note in by_abs.notes)
    assert by_abs.plant.A[0, 0] == pytest.approx(-1.0, rel=DIGITS)


# --------------------------------------------------------- what is refused

KINKS = {
    "abs": (lambda x, u: [u[0] - np.abs(x[0]) - x[0]], [0.0], [0.0]),
    "sign": (lambda x, u: [u[0] - x[0] - np.sign(x[0])], [0.0], [0.0]),
    "limit": (lambda x, u: [np.minimum(u[0], 2.0) - x[0]], [2.0], [2.0]),
    "root": (lambda x, u: [u[0] - np.sign(x[0]) * np.sqrt(np.abs(x[0]))], [0.0], [0.0]),
    "root of zero": (lambda x, u: [u[0] - np.sqrt(x[0])], [0.0], [0.0]),
}


@pytest.mark.parametrize("kind", KINKS)
@pytest.mark.parametrize("unit", [2.0**-20, 1.0, 2.0**20])
def test_a_place_without_a_slope_is_refused_by_name(kind: str, unit: float) -> None:
    function, x, u = KINKS[kind]

    def rate(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        return unit * np.array([*function(x / unit, u / unit), (x[1] - u[1]) / unit])

    at = (unit * np.array([*x, 3.0]), unit * np.array([*u, 3.0]))
    named = "flow" if kind == "limit" else "speed"
    with pytest.raises(ModelError, match=rf"no linear model exists .*{named}"):
        rs.identify.linearise(rate, at=at, hold="point", states=["speed", "other"], inputs=["flow", "more"])


def test_beside_a_kink_there_is_a_slope() -> None:
    plant = rs.identify.linearise(lambda x, u: [u[0] - np.abs(x[0]) - x[0]], at=([1.0], [1e-4]))
    assert plant.A[0, 0] == pytest.approx(-2.0, rel=DIGITS)


def sliver(x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """A wave as short as the smallest steps, in a range of four of them."""
    return np.where(abs(x - 1) < 1e-6, u - x - 1e-3 * np.sin(4e6 * (x - 1)), np.nan)


@trips("identify.jacobian:jacobian")
def test_a_slope_that_is_not_known_well_is_refused() -> None:
    with pytest.raises(AccuracyError, match=r"the slope of the rate of 'x1' over x1 .* estimated error"):
        rs.identify.linearise(sliver, at=([1.0], [1.0]))


@pytest.mark.parametrize(
    ("rate", "said"),
    [
        (lambda x, u: [u[0] + 1 + x[0] ** 2], "x1 is still 2"),
        (lambda x, u: [u[0] + 0 * x[0]], "can be moved in 0 directions only"),
        (lambda x, u: [u[0] * np.exp(-x[0])], "after 100 steps"),
        (lambda x, u: [np.sqrt(x[0]) + u[0]], "no steady state"),
    ],
)
@trips("identify.linearise:steady_state")
def test_a_steady_state_that_is_not_there_is_refused(rate: Callable, said: str) -> None:
    with pytest.raises(AccuracyError, match=said):
        rs.identify.linearise(rate, at=([0.3], [1.0]))


def good(x: np.ndarray, u: np.ndarray) -> np.ndarray:
    return u - x


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"at": [1.0]}, "at must be a pair"),
        ({"at": ([1.0], [np.nan])}, "must be finite"),
        ({"at": ({"x": 1.0}, [1.0]), "states": ["y"]}, "states are y, values were given for x"),
        ({"rate": 3}, "must be functions"),
        ({"rate": lambda x, u: [1.0, 2.0]}, "rate must give 1 numbers"),
        ({"rate": lambda x, u: [np.nan]}, "no finite numbers"),
        ({"rate": lambda x, u: ["a"]}, "must give numbers"),
        ({"rate": lambda x, u: [1j * x[0]]}, "complex numbers for real"),
        ({"output": lambda x, u: [[1.0]]}, "one number for each output"),
        ({"output": lambda x, u: x, "outputs": ["a", "b"]}, "expected 1 names"),
        ({"hold": "nothing"}, "hold must be"),
        ({"hold": {"wrong": 1.0}}, "'wrong' is no output or input; known: x1 and u1"),
        ({"hold": {"x1": 1.0, "u1": 1.0}}, "1 outputs are held and 0 inputs may move"),
        ({"hold": {"x1": "a"}}, "finite number"),
        ({"sizes": {"wrong": 1.0}}, "is no variable"),
        ({"sizes": {"x1": -1.0}}, "positive number"),
        ({"states": ["u1"]}, "same names"),
        ({"dt": -1.0}, "dt must be"),
        ({"units": {"wrong": "m"}}, "is no input, output or state"),
    ],
)
def test_bad_input_is_refused(options: dict, said: str) -> None:
    given = {"rate": good, "at": ([1.0], [1.0])} | options
    with pytest.raises(ModelError, match=said):
        rs.identify.linearise(given.pop("rate"), **given)


def test_names_units_and_faults_arrive() -> None:
    plant = rs.identify.linearise(
        lambda x, u, f: [u[0] - x[0] - f[0]],
        lambda x, u, f: [2 * x[0] + f[1]],
        at=({"level": 1.0}, {"flow": 1.0}),
        faults=["leak", "gauge"],
        outputs="reading",
        units={"level": "m", "flow": "m3/s"},
        name="tank",
        description="A tank.",
    )
    assert (plant.states, plant.inputs, plant.outputs) == (("level",), ("flow",), ("reading",))
    assert plant.faults == ("leak", "gauge")
    np.testing.assert_allclose([plant.Bf[0], plant.Df[0]], [[-1, 0], [0, 1]], atol=1e-15)
    assert plant.units == {"level": "m", "flow": "m3/s"}
    assert plant.name == "tank"
    assert plant.description.startswith("A tank. Linearised at level = 1")


@pytest.mark.parametrize("which", ["rate", "output"])
@pytest.mark.parametrize("bad", [0.0, 5e-4])
def test_what_a_users_function_raises_is_said_with_the_point(which: str, bad: float) -> None:
    """At the point itself, or only near it, where differences look."""

    def fails(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        if abs(x[0] - 4.0) >= bad:
            raise ZeroDivisionError("the pump is dry")
        return u - x

    def good(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        return u - x

    functions = {"rate": fails} if which == "rate" else {"rate": good, "output": fails}
    with pytest.raises(
        ModelError, match=rf"^{which} raised ZeroDivisionError at level = 4.* and pump = 4: the pump is dry"
    ):
        rs.identify.linearise(**functions, at=([4.0], [4.0]), states="level", inputs="pump")


def test_a_function_that_takes_no_complex_numbers_is_told_by_its_own_error() -> None:
    def rate(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        if np.iscomplexobj(x):
            raise KeyError("complex")
        return u - x**2

    made = rs.identify.tangent_model(rate, at=([2.0], [4.0]))
    assert any("it takes no complex numbers (KeyError)" in note for note in made.notes)
