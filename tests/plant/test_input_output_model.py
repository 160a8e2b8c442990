"""Input-output models: what is read, what the equations say, and the way from and to state space."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.signal

import residua as rs
from effort import rounds
from generated import random_plant, singular_plant
from guards import trips
from refusals import Refused
from residua.errors import AccuracyError, ModelError
from residua.linear import StateSpace
from residua.linear.polynomials.polynomial_matrix import PolynomialMatrix
from residua.plant.input_output_conversion import input_output_from_plant
from residua.plant.input_output_model import InputOutputModel
from scaled_plants import with_rates_times

ROLES = ("control", "disturbance", "fault")
H2 = [[1, -0.9, 0.2], [1, -1.4, 0.45]]
G2 = [[[1.5, -0.65]], [[1.1, -0.95]]]


def example_2(**options: object) -> InputOutputModel:
    return InputOutputModel(H2, G2, inputs="u", **options)  # pyright: ignore[reportArgumentType]


def entry(P: PolynomialMatrix, i: int, j: int) -> list[float]:
    """Return one polynomial, highest power first."""
    return np.trim_zeros(P.coefficients[::-1, i, j], "f").tolist()


def off_boundary(plant: rs.Plant, rng: np.random.Generator, count: int = 40) -> np.ndarray:
    """Return points around the stability boundary that the conversions do not check themselves at."""
    angle = rng.uniform(0, np.pi, count)
    if plant.dt:
        return rng.choice([0.8, 1.15, 1.4], count) * np.exp(1j * angle)
    size = np.abs(plant.system(()).poles()).max()
    return size * (rng.uniform(-1.5, 1.5, count) + 1.1j * rng.uniform(0.05, 2, count))


def difference(found: np.ndarray, wanted: np.ndarray) -> float:
    """Return the largest difference of an entry, relative to its own peak or a millionth of the largest of all."""
    peak = np.abs(wanted).max(axis=0)
    return float(np.max(np.abs(found - wanted).max(axis=0) / np.maximum(peak, 1e-6 * peak.max()), initial=0.0))


def equation_error(io: InputOutputModel, y: np.ndarray, v: np.ndarray) -> float:
    """Return how far samples are from ``H y = N v``, relative to the terms."""

    def filtered(P: PolynomialMatrix, x: np.ndarray) -> np.ndarray:
        C, length = P.coefficients, len(x) - degree
        return sum((x[k : k + length] @ C[k].T for k in range(len(C))), np.zeros((length, P.shape[0])))

    degree = max(io.H.degree, io.right_side().degree)
    left, right = filtered(io.H, y), filtered(io.right_side(), v)
    return float(np.abs(left - right).max() / max(np.abs(y).max(), np.abs(v).max()))


# ------------------------------------------------------------------------ paper


def test_example_2_of_gertler() -> None:
    io = InputOutputModel.from_plant(rs.library.gertler())
    for i, (h, gu, gp) in enumerate(
        [
            (np.poly([0.4, 0.5]), [1.5, -0.65], ([2, -0.9], [1, -0.4])),
            (np.poly([0.5, 0.9]), [1.1, -0.95], ([1, -0.9], [2, -1.4])),
        ]
    ):
        np.testing.assert_allclose(entry(io.H, i, i), h, atol=1e-13)
        np.testing.assert_allclose(entry(io.G, i, 0), gu, atol=1e-13)
        for j in range(2):
            np.testing.assert_allclose(entry(io.Gf, i, j), gp[j], atol=1e-13)
    assert io.faults == ("p1", "p2")
    # the printed zeros, .4333 and .8636
    assert np.roots(entry(io.G, 0, 0)) == pytest.approx(13 / 30, abs=1e-12)
    assert np.roots(entry(io.G, 1, 0)) == pytest.approx(19 / 22, abs=1e-12)
    assert str(io).splitlines()[0] == "(z^2 - 0.9 z + 0.2) y1 = (1.5 z - 0.65) u1 + (2 z - 0.9) p1 + (z - 0.4) p2"


def test_example_2_back_to_three_states() -> None:
    found = InputOutputModel.from_plant(rs.library.gertler(sensor_faults=True)).realization()
    assert sorted(found.plant.system().poles().real) == pytest.approx([0.4, 0.5, 0.9], abs=1e-10)
    assert found.removed_modes == pytest.approx([0.5], abs=1e-10)  # both equations have it, the plant once
    assert found.plant.fault_kinds == ("component", "component", "sensor", "sensor")
    assert found.plant.faults == ("p1", "p2", "y1 sensor", "y2 sensor")


@pytest.mark.parametrize("k", range(6))
def test_common_denominator_is_corrected_2_6(k: int) -> None:
    rng = np.random.default_rng(k)
    plant = random_plant(rng, n=int(rng.integers(2, 7)), feedthrough=True, dt=0.1, disturbances=1)
    io = InputOutputModel.from_plant(plant, common_denominator=True)
    n, s = plant.n_states, plant.system(ROLES)
    assert io.H.row_degrees == (n,) * plant.n_outputs
    for z in (0.7 + 0.9j, -1.3 + 0.2j):
        M = np.eye(n) - plant.A / z
        adjugate = np.linalg.det(M) * np.linalg.inv(M)
        G = s.C @ adjugate @ s.B / z + s.D * np.linalg.det(M)
        np.testing.assert_allclose(io.right_side().evaluate(z)[0] / z**n, G, rtol=1e-8, atol=1e-10)
        np.testing.assert_allclose(io.H.evaluate(z)[0] / z**n, np.linalg.det(M) * np.eye(plant.n_outputs), atol=1e-10)


# -------------------------------------------------------------------- reading


def test_written_in_three_ways() -> None:
    nested = InputOutputModel([[H2[0], 0], [[0], H2[1]]], G2, inputs="u")
    values = InputOutputModel(
        PolynomialMatrix.from_entries([[H2[0], 0], [0, H2[1]]]), PolynomialMatrix.from_entries(G2), inputs="u"
    )
    assert str(nested) == str(values) == str(example_2())


def test_powers_of_one_over_z() -> None:
    # y1 - .9 y1(t-1) + .2 y1(t-2) = 1.5 u(t-1) - .65 u(t-2), and likewise
    io = InputOutputModel(H2, [[[0, 1.5, -0.65]], [[0, 1.1, -0.95]]], variable="1/z", inputs="u")
    assert str(io) == str(example_2())
    # a longer one multiplies its own equation only
    late = io.with_disturbances({"d": [[0, 0, 0, 2], [0, 0, 1]]})
    assert str(late).splitlines() == [
        "(z^3 - 0.9 z^2 + 0.2 z) y1 = (1.5 z^2 - 0.65 z) u + 2 d",
        "(z^2 - 1.4 z + 0.45) y2 = (1.1 z - 0.95) u + d",
    ]
    P = PolynomialMatrix(np.array([[[0.0]], [[1.5]], [[-0.65]]]))
    assert entry(InputOutputModel([H2[0]], P, variable="1/z").G, 0, 0) == [1.5, -0.65]


def test_delays_are_states_at_zero() -> None:
    plant = InputOutputModel([[1]], [[[0, 0, 0, 2]]], variable="1/z").to_plant()
    y = plant.system().simulate(np.eye(6)[:, :1])
    np.testing.assert_allclose(y.ravel(), [0, 0, 0, 2, 0, 0], atol=1e-13)
    assert plant.n_states == 3


@pytest.mark.parametrize(
    ("H", "G", "options", "message"),
    [
        ([1, -0.9], [[1]], {}, "single output"),
        (H2, [[1.5, -0.65], [1.1, -0.95]], {}, "may mean constants"),
        (H2, [[[1]]], {}, "one row per output"),
        ([[[1, 0.5], [1]]], [[[1]]], {}, "square"),
        ([[[1, 0], [1, 0]], [[1], [1]]], [[[1]], [[1]]], {}, "det H is zero"),
        ([[1, 0.5], [0]], G2, {}, "det H is zero"),
        (H2, [[[1]], [[1, 0, 0, 0]]], {}, "'y2' is not a proper function"),
        ([[1, 2]], [[[1, 0, 0]]], {"dt": 0}, "derivatives"),
        (H2, G2, {"variable": "s"}, "sampled model"),
        (H2, G2, {"dt": 0, "variable": "1/z"}, "continuous model"),
        (H2, G2, {"outputs": ["u1", "y"]}, "occurs twice"),
        (H2, G2, {"measured_inputs": "q"}, "unknown measured input"),
        (H2, [[[1j]], [[1]]], {}, r"G\[0, 0\]: .* real ones"),
        (H2, [[[1]], [[]]], {}, r"G\[1, 0\] is an empty list"),
        (H2, [[[1]], [[]]], {"variable": "1/z"}, r"G\[1, 0\] is an empty list"),
        (H2, [[[1]], [[1, np.inf]]], {}, r"G\[1, 0\] has the coefficient inf"),
        ([[[1, 0.5], [np.nan]], [[0], [1]]], [[[1]], [[1]]], {}, r"H\[0, 1\] has the coefficient nan"),
        (H2, [[[1]], [[1], [1]]], {}, "rows of G must have one length, got 1, 2 entries"),
        ("H", G2, {}, "nested lists"),
    ],
)
def test_refused(H: object, G: object, options: dict, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        InputOutputModel(H, G, **options)


def test_properness_does_not_depend_on_how_equations_are_combined() -> None:
    # The second equation is z times the first on the left: H is not row reduced, and the degrees tell nothing.
    H = [[[1, 0, 0.1], [1, 0.3]], [[1, 0], [1]]]
    good = InputOutputModel(H, [[[1, 2]], [[1]]])
    z = np.array([0.3 + 0.4j, 2.0])
    np.testing.assert_allclose(
        good.to_plant().system().evaluate(z)[..., 0],
        [np.linalg.solve([[p * p + 0.1, p + 0.3], [p, 1]], [p + 2, 1]) for p in z],
        rtol=1e-10,
    )
    assert good.to_plant().n_states == 1
    with pytest.raises(ModelError, match="not a proper function"):
        InputOutputModel(H, [[[1, 2]], [[1, 0]]])
    assert InputOutputModel([[[1, 0], [1]], [[1, 0, 1], [1, 0]]], [[[1]], [[1, 0]]]).to_plant().n_states == 0


# --------------------------------------------------------------------- faults


def test_faults_of_measured_and_commanded_inputs() -> None:
    io = InputOutputModel(
        H2, [[[1.5, -0.65], [1]], [[1.1, -0.95], [2]]], inputs=["flow", "valve"], measured_inputs=["flow"]
    )
    faulty = (
        io.with_sensor_faults("y2").with_actuator_faults().with_input_sensor_faults().with_disturbances({"d": [1, 0]})
    )
    assert faulty.faults == ("y2 sensor", "valve actuator", "flow sensor")
    assert faulty.fault_kinds == ("sensor", "actuator", "sensor")
    assert faulty.fault_components == ("y2", "valve", "flow")
    # eqs. (2-8) to (2-11), sample by sample: what the plant gets and what is read
    rng = np.random.default_rng(4)
    u, f, d = rng.standard_normal((60, 2)), rng.standard_normal((60, 3)), rng.standard_normal((60, 1))
    true_u = u + np.column_stack([-f[:, 2], f[:, 1]])
    plant = io.with_disturbances({"d": [1, 0]}).to_plant()
    y = plant.system(("control", "disturbance")).simulate(np.hstack([true_u, d]))
    y = y + np.column_stack([np.zeros(60), f[:, 0]])
    assert equation_error(faulty, y, np.hstack([u, d, f])) < 1e-12
    assert equation_error(faulty, y, np.hstack([u, d, -f])) > 1e-2


def test_wrong_kind_of_input() -> None:
    io = example_2(measured_inputs=["u"])
    with pytest.raises(ModelError, match=r"is measured: .* with_input_sensor_faults"):
        io.with_actuator_faults("u")
    with pytest.raises(ModelError, match=r"is commanded: .* with_actuator_faults"):
        example_2().with_input_sensor_faults(["u"])
    with pytest.raises(ModelError, match=r"all inputs are measured: .* with_input_sensor_faults"):
        io.with_actuator_faults()
    with pytest.raises(ModelError, match=r"all inputs are commanded: .* with_actuator_faults"):
        example_2().with_input_sensor_faults()


def test_faults_come_and_go() -> None:
    io = example_2().with_faults({"p1": [[2, -0.9], [1, -0.9]], "p2": {"y1": [1, -0.4]}}, component="pump")
    assert io.fault_components == ("pump", "pump")
    assert entry(io.Gf, 1, 1) == []
    other = io.with_disturbances({"d": [1, 1]}).faults_as_disturbances("p1")
    assert (other.faults, other.disturbances) == (("p2",), ("d", "p1"))
    np.testing.assert_array_equal(other.Gd.coefficients[:, :, 1], io.Gf.coefficients[:, :, 0])
    assert other.without_faults().without_disturbances().right_side().shape == (2, 1)
    for wrong, message in [
        ({"p1": [[1], [1]]}, "occurs twice"),
        ({"q": [[1]]}, "one per output"),
        ({"q": [0, 0]}, "no effect"),
        ({"q": [[1, 0, 0, 0], 0]}, "'y1' is not a proper"),
        ({"q": {"y7": 1}}, "fault 'q': unknown output 'y7'; known: y1, y2"),
        ({"q": [[], 0]}, "fault 'q', output 'y1' is an empty list"),
        ({"q": {"y2": [1, [2]]}}, r"fault 'q', output 'y2': a polynomial must be .* got \[1, \[2\]\]$"),
    ]:
        with pytest.raises(ModelError, match=message):
            io.with_faults(wrong)
    with pytest.raises(ModelError, match="kind"):
        io.with_faults({"q": [1, 1]}, kind="leak")
    with pytest.raises(ModelError, match="noise"):
        io.right_side("noise")


# ----------------------------------------------------------------- from plants


@pytest.mark.parametrize("k", range(10))
def test_equations_hold_from_any_initial_state(k: int) -> None:
    rng = np.random.default_rng(k)
    plant = random_plant(rng, n=int(rng.integers(2, 7)), dt=0.1, disturbances=1, sensors=True)
    # and with a mode that no input reaches, which its equation must keep
    A = np.block([[plant.A, np.zeros((plant.n_states, 1))], [np.zeros((1, plant.n_states)), 0.6]])
    rest = np.zeros((1, 9))
    whole = rs.Plant(
        A,
        np.vstack([plant.B, rest[:, : plant.B.shape[1]]]),
        np.hstack([plant.C, np.ones((plant.n_outputs, 1))]),
        dt=0.1,
    ).with_disturbances({"d": np.append(plant.Bd, 0.0)})
    io = InputOutputModel.from_plant(whole)
    assert io.H.row_degrees == (whole.n_states,) * whole.n_outputs
    v = rng.standard_normal((80, len(whole.inputs) + 1))
    system = whole.system(("control", "disturbance"))
    x0 = rng.standard_normal(whole.n_states)
    y = system.simulate(v, x0)
    assert equation_error(io, y, v) < 1e-10
    removed = io.realization().removed_modes
    assert np.abs(removed - 0.6).min() < 1e-6


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_each_equation_has_the_order_that_its_output_sees(dt: float) -> None:
    rng = np.random.default_rng(8)
    poles = [-0.5, -0.3, -0.8, -0.2]
    T = rng.standard_normal((4, 4))
    modal = np.array([[1.0, 2, 0, 0], [0, 0, 0, 3], [1, 1, 1, 1], [0, 0, 0, 0]])
    plant = rs.Plant(
        np.linalg.solve(T, np.diag(poles) @ T), rng.standard_normal((4, 1)), modal @ T, [[0], [0], [0], [2]], dt=dt
    )
    io = InputOutputModel.from_plant(plant)
    assert io.H.row_degrees == (2, 1, 4, 0)
    for i, seen in enumerate([poles[:2], poles[3:], poles]):
        np.testing.assert_allclose(entry(io.H, i, i), np.poly(seen), rtol=1e-8)
    assert entry(io.G, 3, 0) == [2.0]


def test_relative_degree_is_exact() -> None:
    chain = rs.Plant(np.eye(5, k=1) - np.diag([1.0, 2, 3, 4, 5]), np.eye(5)[:, 4:], np.eye(5)[:1])
    io = InputOutputModel.from_plant(chain)
    np.testing.assert_allclose(entry(io.H, 0, 0), np.poly([-1, -2, -3, -4, -5]), rtol=1e-10)
    np.testing.assert_allclose(entry(io.G, 0, 0), [1.0], rtol=1e-10)


@pytest.mark.parametrize("k", range(20))
def test_singular_plants(k: int) -> None:
    rng = np.random.default_rng(k)
    plant = singular_plant(rng, disturbances=k % 2)
    points = off_boundary(plant, rng)
    wanted = plant.system(ROLES).evaluate(points)
    io = InputOutputModel.from_plant(plant)
    assert difference(io.transfer(points), wanted) < 1e-8
    back = io.to_plant()
    assert plant.E is not None
    assert back.n_states == np.linalg.matrix_rank(plant.E)
    assert difference(back.system(ROLES).evaluate(points), wanted) < 1e-8
    common = InputOutputModel.from_plant(plant, common_denominator=True)
    assert difference(common.transfer(points), wanted) < 1e-8


@pytest.mark.parametrize("k", range(10))
def test_fast_and_slow_modes_are_all_in_the_equations(k: int) -> None:
    rng = np.random.default_rng([3, k])
    poles = -np.concatenate([rng.uniform(0.5, 3, 3), 1e3 * rng.uniform(0.5, 3, 3)])
    T = np.linalg.qr(rng.standard_normal((6, 6)))[0] @ np.diag(rng.uniform(0.5, 2, 6))
    A = np.linalg.solve(T, np.diag(poles) @ T)
    io = InputOutputModel.from_plant(rs.Plant(A, rng.standard_normal((6, 2)), rng.standard_normal((2, 6))))
    assert io.H.row_degrees == (6, 6)
    for i in range(2):
        np.testing.assert_allclose(entry(io.H, i, i), np.poly(poles), rtol=1e-8)


@pytest.mark.parametrize(("n", "h"), [(4, 0.01), (6, 0.03)])
def test_degrees_of_plants_that_are_sampled_fast(n: int, h: float) -> None:
    """The degree is that of the plant also where coefficients of powers hold few digits of the response.

    Four poles within a hundredth of one another leave their coefficients half of the digits.
    """
    for k in range(5):
        rng = np.random.default_rng([n, k])
        A = rng.standard_normal((n, n))
        A = A / np.abs(np.linalg.eigvals(A)).max()
        A -= (0.3 + np.linalg.eigvals(A).real.max()) * np.eye(n)
        plant = rs.Plant(A, rng.standard_normal((n, 2)), rng.standard_normal((2, n))).discretize(h)
        io = input_output_from_plant(plant, tolerance=np.inf)
        assert io.H.row_degrees == (n, n)
        np.testing.assert_allclose(entry(io.H, 0, 0), np.poly(np.linalg.eigvals(plant.A)), rtol=1e-7)


def test_plant_that_differentiates_is_refused() -> None:
    plant = rs.Plant(np.eye(2), [[0.0], [1.0]], [[1.0, 0.0], [0, 1]], E=[[0.0, 1.0], [0, 0]], outputs=["rate", "value"])
    with pytest.raises(ModelError, match="'rate' is not a proper function"):
        InputOutputModel.from_plant(plant)


@trips("plant.observer_form:check_response")
def test_too_much_for_coefficients_is_refused() -> None:
    rng = np.random.default_rng(0)
    A = rng.standard_normal((8, 8))
    plant = rs.Plant(A - 4 * np.eye(8), rng.standard_normal((8, 1)), rng.standard_normal((2, 8)))
    InputOutputModel.from_plant(plant)
    with pytest.raises(AccuracyError, match="frequency response of the equations"):
        InputOutputModel.from_plant(plant.discretize(1e-3))
    with pytest.raises(AccuracyError, match="frequency response of the equations"):
        InputOutputModel.from_plant(plant, tolerance=1e-17)


def test_an_output_that_no_input_reaches() -> None:
    # the second output sees only modes that nothing reaches; in these coordinates that shows in no zero of a matrix
    T = np.random.default_rng(2).standard_normal((4, 4))
    A, B, C = np.diag([0.5, -0.4, 0.7, 0.2]), [[1.0], [1], [0], [0]], np.array([[1.0, 1, 1, 0], [0, 0, 1, 1]])
    plant = rs.Plant(np.linalg.solve(T, A @ T), np.linalg.solve(T, B), C @ T, dt=1)
    io = InputOutputModel.from_plant(plant)
    np.testing.assert_allclose(entry(io.H, 1, 1), np.poly([0.7, 0.2]), atol=1e-12)
    assert np.abs(io.G.coefficients[:, 1]).max() < 1e-12
    found = io.realization()
    assert found.plant.n_states == 2
    assert sorted(found.removed_modes.real) == pytest.approx([0.2, 0.7, 0.7])


# ------------------------------------------------------------------ round trip


@pytest.mark.parametrize("count", rounds(4, 19))
@pytest.mark.parametrize("n", range(2, 13))
def test_round_trip(n: int, count: int) -> None:
    for k in range(count):
        rng = np.random.default_rng([n, k])
        plant = random_plant(
            rng,
            n=n,
            inputs=int(rng.integers(1, 5)),
            outputs=int(rng.integers(2, 6)),
            disturbances=k % 2,
            sensors=k % 3 == 0,
            feedthrough=k % 5 == 0,
            dt=[0.0, 0.1][k // 2 % 2],
        )
        found = InputOutputModel.from_plant(plant).realization()
        back = found.plant
        assert (back.inputs, back.outputs, back.disturbances) == (plant.inputs, plant.outputs, plant.disturbances)
        assert (back.fault_list, back.dt, back.name) == (plant.fault_list, plant.dt, plant.name)
        assert back.n_states == n
        assert len(found.removed_modes) == n * (plant.n_outputs - 1)
        points = off_boundary(plant, rng)
        wanted = plant.system(ROLES).evaluate(points)
        assert difference(back.system(ROLES).evaluate(points), wanted) < 1e-6, (n, k)


@pytest.mark.parametrize("k", range(12))
def test_round_trip_in_other_units(k: int) -> None:
    rng = np.random.default_rng(k)
    plain = random_plant(rng, n=int(rng.integers(2, 8)), dt=[0.0, 0.1][k % 2])
    T, U = 10 ** rng.uniform(-5, 5, plain.n_states), 10 ** rng.uniform(-5, 5, len(plain.inputs))
    Y, time = 10 ** rng.uniform(-5, 5, plain.n_outputs), 1.0 if k % 2 else 10 ** rng.uniform(-6, 6)
    plant = rs.Plant(
        time * plain.A / T[:, None] * T, plain.B / T[:, None] * U, plain.C * T * Y[:, None], dt=plain.dt
    ).with_sensor_faults()
    back = InputOutputModel.from_plant(plant).to_plant()
    assert back.n_states == plant.n_states
    points = off_boundary(plant, rng)
    wanted = plant.system("control").evaluate(points)
    found = back.system("control").evaluate(points)
    peak = np.abs(wanted).max(axis=0)
    assert np.max(np.abs(found - wanted).max(axis=0) / peak) < 1e-7
    # the sensors of one output reach no other
    faults = back.system("fault").evaluate(points)
    np.testing.assert_allclose(faults, np.broadcast_to(np.eye(plant.n_outputs), faults.shape), atol=1e-9)


def test_hidden_unstable_mode_is_refused() -> None:
    with pytest.raises(ModelError, match=r"mode 1\.1 is in the equations .* not stable"):
        InputOutputModel([np.poly([0.5, 1.1])], [[np.poly([1.1])]]).to_plant()
    with pytest.raises(ModelError, match="mode 1 "):  # an integrator does not die out either
        InputOutputModel([np.poly([0.5, 1])], [[np.poly([1])]]).to_plant()
    assert InputOutputModel([np.poly([0.5, 0.9])], [[np.poly([0.9])]]).realization().removed_modes == pytest.approx(
        [0.9]
    )
    # a disturbance reaches it
    io = InputOutputModel([np.poly([0.5, 1.1])], [[np.poly([1.1])]]).with_disturbances({"d": [1]})
    assert io.to_plant().n_states == 2


def test_copies_of_an_unstable_pole_are_one() -> None:
    io = InputOutputModel([np.poly([1.2]), np.poly([1.2])], [[[1]], [[2]]])
    found = io.realization()
    assert found.plant.n_states == 1
    assert found.removed_modes == pytest.approx([1.2])
    apart = InputOutputModel([np.poly([1.2]), np.poly([1.2])], [[[1], [0]], [[0], [1]]])
    assert apart.to_plant().n_states == 2


@pytest.mark.parametrize("k", range(8))
def test_sensor_faults_reach_no_state(k: int) -> None:
    # Equations mixed so that H is not diagonal, and only rounding is left of the path from the sensors to the states.
    rng = np.random.default_rng(k)
    mixed, poles = PolynomialMatrix.constant(rng.standard_normal((3, 3))), [-5e6, -3e6, -7e6]
    H = PolynomialMatrix.from_entries([[np.poly([poles[i]]) if i == j else 0.0 for j in range(3)] for i in range(3)])
    io = InputOutputModel(mixed @ H, mixed @ PolynomialMatrix.constant([[1.0], [1], [0]]), dt=0)
    io = io.with_sensor_faults()
    found = io.realization()
    assert found.plant.n_states == 2
    np.testing.assert_allclose(found.removed_modes, [-7e6], rtol=1e-10)


def test_copies_that_rounding_sets_apart_are_one() -> None:
    rng = np.random.default_rng(11)
    for _ in range(5):
        A = rng.standard_normal((8, 8))
        A -= (1 + np.linalg.eigvals(A).real.max()) * np.eye(8)
        plant = rs.Plant(A, rng.standard_normal((8, 2)), rng.standard_normal((3, 8))).discretize(0.15)
        assert InputOutputModel.from_plant(plant).to_plant().n_states == 8


def of_slow_and_fast_modes(seed: int, count: int, ratio: float) -> rs.Plant:
    """Return a plant of as many slow modes as ones ``ratio`` times as fast, in turned coordinates."""
    rng = np.random.default_rng(seed)
    poles = -np.concatenate([rng.uniform(0.5, 3, count), ratio * rng.uniform(0.5, 3, count)])
    T = np.linalg.qr(rng.standard_normal((2 * count, 2 * count)))[0] * rng.uniform(0.5, 2, 2 * count)
    A = np.diag(poles) if ratio > 1e3 else np.linalg.solve(T, np.diag(poles) @ T)
    return rs.Plant(A, rng.standard_normal((2 * count, 2)), rng.standard_normal((3, 2 * count)))


@pytest.mark.parametrize(("count", "ratio"), [(5, 30.0), (5, 100.0), (5, 300.0), (5, 1e3), (6, 210.0), (3, 1e6)])
def test_slow_and_fast_modes_come_back_once_in_any_unit_of_time(count: int, ratio: float) -> None:
    """Rounding of the coefficients sets the copies of modes apart, which ten powers of ``A`` make the more of."""
    for seed in range(3):
        plant = of_slow_and_fast_modes(seed, count, ratio)
        try:
            io = InputOutputModel.from_plant(plant)
        except AccuracyError:
            assert (count, ratio) == (5, 1e3)  # coefficients of such a degree do not hold it
            continue
        found = io.realization()
        assert found.plant.n_states == 2 * count
        assert len(found.removed_modes) == 4 * count
        assert found.error < 1e-7
        poles = np.sort(np.linalg.eigvals(plant.A).real)
        np.testing.assert_allclose(np.sort(np.linalg.eigvals(found.plant.A).real), poles, rtol=1e-6)
        np.testing.assert_allclose(np.sort(found.removed_modes.real), np.repeat(poles, 2), rtol=1e-3)
        for t in (2.0**-20, 2.0**20):
            other = InputOutputModel.from_plant(with_rates_times(plant, t)).realization()
            assert other.plant.n_states == found.plant.n_states
            np.testing.assert_allclose(np.sort(np.linalg.eigvals(other.plant.A).real), t * poles, rtol=1e-6)


def test_what_the_inputs_do_not_reach_stays_zero_beside_copies_of_modes() -> None:
    io = InputOutputModel.from_plant(of_slow_and_fast_modes(0, 5, 300.0)).with_sensor_faults()
    found = io.to_plant()
    assert found.n_states == 10
    assert not np.any(found.Bf)
    assert np.array_equal(found.Df, np.eye(3))


@trips("plant.input_output_realization:_smallest_part")
@pytest.mark.parametrize("seed", [3, 5, 7])
def test_unclear_order_is_refused(seed: int) -> None:
    """Twelve modes sampled so fast that powers of ``z`` hardly tell them apart: few digits of the response are left."""
    rng = np.random.default_rng([12, seed])
    A = rng.standard_normal((12, 12))
    A = A / np.abs(np.linalg.eigvals(A)).max()
    A -= (0.3 + np.linalg.eigvals(A).real.max()) * np.eye(12)
    plant = rs.Plant(A, rng.standard_normal((12, 2)), rng.standard_normal((3, 12))).discretize(0.3)
    io = input_output_from_plant(plant, tolerance=np.inf)
    with pytest.raises(AccuracyError, match="the order of the plant is not clear"):
        io.to_plant()


def test_names_units_and_operating_point_stay() -> None:
    plant = rs.library.three_tank()
    plant = plant.with_operating_point(inputs=np.ones(len(plant.inputs)))
    io = InputOutputModel.from_plant(plant)
    back = io.to_plant()
    assert back.operating_point == io.operating_point == plant.operating_point
    assert back.units == io.units
    assert set(io.units) <= {*plant.inputs, *plant.outputs}
    assert (back.faults, back.description) == (plant.faults, plant.description)
    assert repr(io).startswith(f"InputOutputModel({plant.name!r}: degrees ")


# ------------------------------------------------------ from transfer functions


def test_least_common_denominators() -> None:
    S = [
        [([1], [1, -0.5]), ([1, 2], np.poly([0.5, 0.9])), 3],
        [([1, -0.3], np.poly([0.3, 0.7])), ([0.0], [1, 0.2]), ([2], [2, 0.4])],
    ]
    io = InputOutputModel.from_transfer_functions(S, outputs=["a", "b"])
    np.testing.assert_allclose(entry(io.H, 0, 0), np.poly([0.5, 0.9]), atol=1e-12)
    np.testing.assert_allclose(entry(io.H, 1, 1), np.poly([0.7, -0.2]), atol=1e-12)  # (z - 0.3) divided out
    np.testing.assert_allclose(entry(io.G, 0, 2), 3 * np.poly([0.5, 0.9]), atol=1e-12)
    assert entry(io.G, 1, 1) == []
    assert (io.outputs, io.dt) == (("a", "b"), 1.0)
    with pytest.raises(ModelError, match="zero"):
        InputOutputModel.from_transfer_functions([[([1], [0])]])
    with pytest.raises(ModelError, match="proper"):
        InputOutputModel.from_transfer_functions([[([1, 0, 0], [1, 2])]])
    with pytest.raises(ModelError, match="equal length"):
        InputOutputModel.from_transfer_functions([[1, 2], [1]])
    with pytest.raises(ModelError, match="number or"):
        InputOutputModel.from_transfer_functions([[([1], [2], [3])]])


@pytest.mark.parametrize("k", range(10))
def test_transfer_functions_of_generated_systems(k: int) -> None:
    rng = np.random.default_rng(k)
    dt = [0.0, 0.1][k % 2]
    scale = 1.0 if dt else 10 ** rng.uniform(-4, 4)
    pool = [-scale * p for p in rng.uniform(0.1, 0.95, 4)]
    S, points = [], scale * (rng.uniform(-1, 1, 30) + 1j * rng.uniform(0.1, 1, 30))
    for _ in range(2):
        chosen = [rng.choice(pool, 2, replace=False) for _ in range(3)]
        S.append([(rng.standard_normal(2) * [1, scale], np.poly(poles)) for poles in chosen])
    io = InputOutputModel.from_transfer_functions(S, dt=dt)
    wanted = np.array([[np.polyval(n, points) / np.polyval(d, points) for n, d in row] for row in S]).transpose(2, 0, 1)
    assert difference(io.transfer(points), wanted) < 1e-8
    assert io.H.row_degrees == tuple(len({*np.concatenate([np.roots(d).round(8) for _, d in row])}) for row in S)


@pytest.mark.parametrize(
    ("entries", "dt", "mode"),
    [
        ([[([1, -2], [1, -2.5, 1])]], 1.0, "2"),
        ([[([1, 1], [1, 0, -1]), ([1], [1, -0.5])]], 1.0, "-1"),
        ([[([1, -1], [1, 0, -1])]], 0.0, "1"),
        ([[([1, 0], [1, 1, 0])]], 0.0, "0"),
    ],
)
def test_a_mode_that_is_not_stable_does_not_cancel(entries: list, dt: float, mode: str) -> None:
    """As in equations: refused, unless the same mode is in another denominator and stays."""
    with pytest.raises(ModelError, match=rf"mode {mode} is in a denominator but cancels.*not stable"):
        InputOutputModel.from_transfer_functions(entries, dt=dt)
    kept = entries[0][0][1]
    once = InputOutputModel.from_transfer_functions([[entries[0][0], ([1], kept)]], dt=dt)
    assert once.H.row_degrees == (2,)
    twice = InputOutputModel.from_transfer_functions([[entries[0][0]], [([1], kept)]], dt=dt)
    assert twice.H.row_degrees == (1, 2)


def test_stable_modes_cancel() -> None:
    made = InputOutputModel.from_transfer_functions([[([1, -0.2], [1, -0.7, 0.1])]])
    assert str(made) == "(z - 0.5) y1 = u1"
    slow = InputOutputModel.from_transfer_functions([[([1, 1e-3], [1, 2 + 1e-3, 2e-3])]], dt=0)
    assert slow.H.row_degrees == (1,)


def test_the_entry_that_is_wrong_is_named() -> None:
    for entry, words in (
        (([1, [2]], [1]), r"the numerator of entry \[0, 1\]: a polynomial must be"),
        (([1], [1, np.nan]), r"the denominator of entry \[0, 1\] has the coefficient nan"),
        (([1], [0, 0]), r"the denominator of entry \[0, 1\] is zero"),
        (([1], [1], [1]), r"entry \[0, 1\] must be a number or"),
    ):
        with pytest.raises(ModelError, match=words):
            InputOutputModel.from_transfer_functions([[1.0, entry]])


def test_other_packages() -> None:
    control = pytest.importorskip("control")
    tf = control.tf([[[1], [1, 2]]], [[[1, 3], [1, 3, 2]]], inputs=["p", "q"], outputs=["w"], name="mine")
    io = InputOutputModel.from_transfer_functions(tf)
    assert (io.inputs, io.outputs, io.name, io.dt) == (("p", "q"), ("w",), "mine", 0.0)
    points = np.array([0.3 + 1j, 2.0])
    np.testing.assert_allclose(io.transfer(points), np.moveaxis(tf(points), -1, 0), rtol=1e-10)
    with pytest.raises(ModelError, match="dt=True"):
        InputOutputModel.from_transfer_functions(control.tf([1], [1, 0.5], True))
    sampled = InputOutputModel.from_transfer_functions(scipy.signal.TransferFunction([2, 3], [1, 0.5], dt=0.1))
    assert (str(sampled), sampled.dt) == ("(z + 0.5) y1 = (2 z + 3) u1", 0.1)
    with pytest.raises(ModelError, match="from_state_space"):
        InputOutputModel.from_transfer_functions(control.ss([[0.5]], [[1]], [[1]], [[0]], 0.1))
    two = scipy.signal.TransferFunction([[1, 2], [0, 3]], [1, 0.5])
    assert str(InputOutputModel.from_transfer_functions(two)).splitlines()[1] == "(s + 0.5) y2 = 3 u1"


def test_a_plant_without_inputs() -> None:
    plant = rs.Plant([[-1.0]], np.zeros((1, 0)), [[1.0]]).with_faults({"f": [1.0]})
    io = InputOutputModel.from_plant(plant)
    assert str(io) == "(s + 1) y1 = f"
    assert io.to_plant().faults == ("f",)
    assert isinstance(io.to_plant().system(), StateSpace)


@pytest.mark.refusals(at_most=1)
def test_the_response_of_a_very_slow_plant_is_checked_where_it_is(refused: Refused) -> None:
    A = np.diag([1 - 1e-6, 1 - 2e-6]) + np.array([[0, 1e-7], [0, 0]])
    plant = rs.Plant(A, [[0.0], [1e-6]], [[1.0, 0.0]], dt=1.0)
    z = np.exp(1j * np.array([1e-8, 1e-7, 1e-6, 1e-5]))
    wanted = plant.system("control").evaluate(z)
    try:
        found = InputOutputModel.from_plant(plant).transfer(z)
    except AccuracyError as error:
        refused.skip(error)
    assert np.abs(found - wanted).max() < 1e-5 * np.abs(wanted).max()
