"""Perfect observers: the estimate is the state, the residual a differential polynomial of the faults."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

import residua as rs
from refusals import Refused
from residua.design import perfect_observer
from residua.design.observers.perfect_gain import deadbeat, nilpotency_index
from residua.design.observers.perfect_observer import differential_filter
from residua.errors import AccuracyError, DesignError, ModelError, SettingError
from residua.library.ladder_circuit import CAPACITANCE, R_CAPACITOR, R_LINK, R_LOAD, R_SHUNT, R_SOURCE
from residua.linear import simulate_descriptor, weierstrass_form
from residua.testing import check_residual_generator


def example(dt: float = 0) -> rs.Plant:
    """A worked example of two states."""
    plant = rs.Plant([[1, 2], [3, 4]], [[1], [1]], [[1, 1]], E=[[1, 0], [0, 0]], dt=dt)
    return plant.with_actuator_faults().with_sensor_faults()


def singular_plant(
    rng: np.random.Generator, n: int, rank: int, outputs: int, *, dt: float = 0, inputs: int = 2, spread: float = 0
) -> rs.Plant:
    """Return a random plant with E of the given rank, its units spread over decades."""
    E = rng.standard_normal((n, rank)) @ rng.standard_normal((rank, n)) if rank < n else np.eye(n)
    states, ys = 10.0 ** rng.uniform(-spread, spread, n), 10.0 ** rng.uniform(-spread, spread, outputs)
    rows = 10.0 ** rng.uniform(-spread, spread, n) if rank < n else 1 / states
    plant = rs.Plant(
        rows[:, None] * rng.standard_normal((n, n)) * states,
        rows[:, None] * rng.standard_normal((n, inputs)),
        ys[:, None] * rng.standard_normal((outputs, n)) * states,
        ys[:, None] * rng.standard_normal((outputs, inputs)),
        E=rows[:, None] * E * states,
        dt=dt,
    )
    return plant.with_faults({"f": rows * rng.standard_normal(n)}).with_sensor_faults()


def lags(system: rs.StateSpace) -> int:
    """Return through how many lags, or delays, a filter passes everything: those of its fewer signals."""
    return system.n_states // min(system.n_inputs, system.n_outputs)


# ----------------------------------------------------------------------- V14


@pytest.mark.parametrize("k1", [1.0, 5.0, -3.5])
def test_v14_the_determinant_is_constant(k1: float) -> None:
    observer = perfect_observer(example(), K=[[k1], [-4]])
    E, Ab = example().E, observer.Ab
    for s in (0.3, 2.0 + 1j, -7.0):
        assert np.linalg.det(s * E - Ab) == pytest.approx(2 + k1, abs=1e-12)
    np.testing.assert_allclose(observer.K, [[k1], [-4]], atol=1e-12)


def test_v14_other_gains_are_refused() -> None:
    with pytest.raises(DesignError, match="not constant"):
        perfect_observer(example(), K=[[1], [-3]])
    with pytest.raises(DesignError, match="singular"):
        perfect_observer(example(), K=[[-2], [-4]])


def test_v14_the_designed_gain_has_the_one_that_is_forced() -> None:
    for seed in range(5):
        K = perfect_observer(example(), seed=seed).K
        assert K[1, 0] == pytest.approx(-4, abs=1e-9)
        assert abs(K[0, 0] + 2) > 1e-3


def test_v14_the_residual_is_the_printed_polynomial() -> None:
    found = perfect_observer(example(), K=[[1], [-4]]).polynomial()
    np.testing.assert_allclose(found["u1 actuator"], [[0], [1 / 3]], atol=1e-9)
    np.testing.assert_allclose(found["y1 sensor"], [[-2 / 3], [-4 / 3]], atol=1e-9)


def test_v14_the_state_is_recovered_on_a_sinusoid() -> None:
    """x' = -x1/2 + u/2 by hand; the estimate is the equally filtered state."""
    observer = perfect_observer(example(), K=[[1], [-4]], bandwidth=20.0)
    dt = 1e-3
    t = np.arange(0, 6, dt)
    u = np.sin(2 * t)[:, None]
    run = simulate_descriptor(example().system("control"), u, dt=dt, hold="linear")
    lag = rs.StateSpace(-20 * np.eye(2), 20 * np.eye(2), np.eye(2)).discretize(dt, hold="linear")
    wanted = lag.simulate(run.states)
    found = observer.system.discretize(dt, hold="linear").simulate(np.hstack([u, run.outputs]))
    late = t > 1.5  # the lags started at zero
    assert np.abs(found - wanted)[late].max() < 1e-6


# -------------------------------------------------------------- what is promised


@pytest.mark.parametrize("n", range(2, 9))
def test_random_singular_plants(n: int) -> None:
    """The determinant of the observer's pencil is constant, for every rank of E and up to four outputs."""
    rng = np.random.default_rng(n)
    for rank in range(1, n):
        for outputs in range(1, min(4, n) + 1):
            plant = singular_plant(rng, n, rank, outputs, spread=2.0 * (rank % 2))
            observer = perfect_observer(plant)
            s = rng.standard_normal(6) + 1j * rng.standard_normal(6)
            values = np.array([np.linalg.det(z * plant.E - plant.A - observer.K @ plant.C) for z in s])
            assert np.abs(values / values[0] - 1).max() < 1e-6, (n, rank, outputs)
            assert observer.index <= n
            N = np.linalg.solve(observer.Ab, plant.E)
            np.testing.assert_allclose(N, observer.N, atol=1e-8 * max(1, np.abs(observer.N).max()))


def estimate_response(observer: rs.design.PerfectObserver, points: np.ndarray) -> np.ndarray:
    """Return what controls and disturbances make of the estimate through the plant, over the state's response."""
    plant = observer.plant
    driven = plant.system(("control", "disturbance"))
    n, m = plant.n_states, len(plant.inputs)
    Q, P = observer.system.evaluate(points), driven.evaluate(points)
    found = Q[..., m:] @ P
    found[..., :m] += Q[..., :m]
    X = driven.replaced(C=np.eye(n), D=np.zeros((n, driven.n_inputs)), outputs=None).evaluate(points)
    lag = 1 / points if plant.dt else 1 / (points / observer.bandwidth + 1)
    wanted = lag[:, None, None] ** observer.derivatives * X
    return np.abs(found - wanted).max(axis=0) / np.abs(X).max(axis=0)


@pytest.mark.parametrize("dt", [0.0, 0.1])
@pytest.mark.parametrize("least_order", [False, True])
@pytest.mark.parametrize("seed", range(10))
def test_the_estimate_is_the_filtered_state_whatever_the_disturbance(seed: int, least_order: bool, dt: float) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 7))
    rank = n if seed % 3 == 0 else int(rng.integers(1, n))
    q = int(rng.integers(1, 3))
    plant = singular_plant(rng, n, rank, q + 2, dt=dt, spread=1.0)
    rows = np.abs(plant.Bf[:, 0])
    plant = plant.with_disturbances({f"d{i}": rows * rng.standard_normal(n) for i in range(q)})
    observer = perfect_observer(plant, least_order=least_order)
    points = np.exp(1j * np.array([0.1, 1.0, 2.5])) if dt else 1j * np.array([0.05, 0.7, 4.0])
    assert estimate_response(observer, points).max() < 1e-7
    generator = observer.residual_generator()
    check_residual_generator(generator)
    assert generator.evidence.decoupling["disturbance"] < 1e-9
    again = perfect_observer(plant, least_order=least_order)
    np.testing.assert_array_equal(observer.L, again.L)


@pytest.mark.parametrize("seed", range(8))
def test_sampled_estimates_and_residuals_in_the_time_domain(seed: int) -> None:
    """Finite: right from the first sample that is ``delay`` old on, from any initial state, residual zero."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(3, 7))
    plant = singular_plant(rng, n, n - 1 - seed % 2, 3, dt=0.1)
    A = plant.A / max(1.0, np.abs(weierstrass_form(plant.A, plant.E).poles).max())
    plant = rs.Plant(A, plant.B, plant.C, plant.D, E=plant.E, dt=0.1).with_disturbances({"d": rng.standard_normal(n)})
    plant = plant.with_faults({"f": rng.standard_normal(n)}).with_sensor_faults()
    observer = perfect_observer(plant)
    v = rng.standard_normal((40, 3))
    form = weierstrass_form(plant.A, plant.E)
    z = np.zeros(n)
    z[: form.n_finite] = rng.standard_normal(form.n_finite)
    system = plant.system(("control", "disturbance"))
    start = rs.linear.consistent_state(system, form.Q @ z, v[0], derivatives=v[1 : form.index]).state
    run = simulate_descriptor(system, v, x0=start)
    u, y = v[: len(run.states), :2], run.outputs
    m = observer.derivatives
    size = np.abs(run.states).max()
    np.testing.assert_allclose(observer.estimate(u, y)[m:], run.states[: len(y) - m], atol=1e-7 * size)
    assert observer.delay == pytest.approx(0.1 * m)
    d_hat = observer.estimate_disturbances(u, y)
    late = lags(observer.disturbance_system)
    np.testing.assert_allclose(d_hat[late:, 0], v[: len(y) - late, 2], atol=1e-6 * size)
    generator = observer.residual_generator()
    r = generator.run(u, y)
    settled = lags(generator.system)
    assert np.abs(r[settled:]).max() < 1e-7 * size
    faulty = simulate_descriptor(plant.system(("control", "disturbance", "fault")), np.hstack([v, np.ones((40, 4))]))
    assert np.abs(generator.run(v[: len(faulty.outputs), :2], faulty.outputs)[settled:]).max() > 1e-3


@pytest.mark.parametrize("seed", range(6))
def test_the_polynomial_is_what_faults_do(seed: int) -> None:
    """Sampled: the residual m steps late is sum_i P_i f[k - m + i], without dynamics."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 6))
    plant = singular_plant(rng, n, max(n - 2, 1), 2, dt=0.1)
    observer = perfect_observer(plant, least_order=bool(seed % 2))
    generator = observer.residual_generator()
    form = generator.internal_form()
    m = lags(generator.system)
    for i, name in enumerate(plant.faults):
        P = observer.polynomial()[name]
        f = rng.standard_normal((30, 1))
        response = form.select(inputs=[i]).simulate(f)
        wanted = sum(f[j : 30 - m + j] @ P[j][None] for j in range(len(P)))
        np.testing.assert_allclose(response[m:], wanted, atol=1e-9 * np.abs(P).max())


def test_the_perfect_observer_is_unbiased_at_once_where_others_have_a_transient() -> None:
    plant = rs.library.ladder_circuit().discretize(1e-3)
    observer = perfect_observer(plant)
    y = plant.system("control").simulate(np.ones((30, 1)), x0=[3.0, -2.0])
    x = plant.system("control").replaced(C=np.eye(2), D=np.zeros((2, 1)), outputs=None)
    states = x.simulate(np.ones((30, 1)), x0=[3.0, -2.0])
    m = observer.derivatives
    np.testing.assert_allclose(observer.estimate(np.ones((30, 1)), y)[m:], states[: 30 - m], atol=1e-10)


@pytest.mark.parametrize("least_order", [False, True])
@pytest.mark.parametrize("seed", range(12))
def test_the_observer_is_the_same_in_all_units(seed: int, least_order: bool) -> None:
    """Random gains among them: they are drawn for equations and states, whatever units and bases these have."""
    rng = np.random.default_rng(seed)
    n, dt = int(rng.integers(3, 7)), 0.1 * (seed % 2)
    plant = singular_plant(rng, n, n - 1, 3, dt=dt).without_faults()
    plant = plant.with_disturbances({"d": rng.standard_normal(n)}) if seed % 3 else plant
    equations, states, outputs = (10.0 ** rng.uniform(-3, 3, k) for k in (n, n, 3))
    rate = 1.0 if dt else 10.0 ** rng.uniform(-3, 3)
    R = rate * equations[:, None]
    assert plant.E is not None
    E = equations[:, None] * plant.E * states
    C, D = outputs[:, None] * plant.C * states, outputs[:, None] * plant.D
    other = rs.Plant(R * plant.A * states, R * plant.B, C, D, E=E, dt=dt)
    other = other.with_disturbances({"d": R[:, 0] * plant.Bd[:, 0]}) if plant.disturbances else other
    one, same = (perfect_observer(p, least_order=least_order) for p in (plant, other))
    assert (one.index, one.derivatives) == (same.index, same.derivatives)
    assert same.bandwidth == pytest.approx(rate * one.bandwidth)
    X = np.append(states, 1.0) if plant.disturbances else states
    np.testing.assert_allclose(X[:, None] * same.L * outputs, one.L, atol=1e-9 * np.abs(one.L).max())
    assert one.residual_generator().structure.shape == same.residual_generator().structure.shape


# ------------------------------------------------------------------ existence


def test_rank_of_E_and_C_is_not_necessary() -> None:
    """Condition (31a) of Twardy and Kaczorek fails, the observer exists."""
    rng = np.random.default_rng(4)
    plant = singular_plant(rng, 4, 2, 1)
    assert np.linalg.matrix_rank(np.vstack([plant.E, plant.C])) == 3
    observer = perfect_observer(plant)
    values = [np.linalg.det(s * plant.E - plant.A - observer.K @ plant.C) for s in (0.0, 1.0, -2.0 + 3j)]
    np.testing.assert_allclose(values, values[0], rtol=1e-8)


def test_a_hidden_mode_is_named() -> None:
    plant = rs.Plant(np.diag([-1.0, -2.0, 1.0]), [[1], [1], [1]], [[1, 0, 1]], E=np.diag([1.0, 1.0, 0.0]))
    with pytest.raises(DesignError, match=r"finite zero\(s\) s = -2"):
        perfect_observer(plant)


def test_a_zero_of_the_disturbance_is_named() -> None:
    plant = rs.Plant([[0, 1], [-2, -3]], [[0], [1]], [[4, 1]]).with_disturbances({"d": [0, 1]})
    with pytest.raises(DesignError, match=r"s = -4 .*unknown_input_observer"):
        perfect_observer(plant)
    two = rs.Plant(-np.eye(2), [[0], [1]], [[1, 0]]).with_disturbances({"a": [1, 0], "b": [0, 1]})
    with pytest.raises(DesignError, match="the 2 disturbances reach the 1 output with rank 1 only"):
        perfect_observer(two)
    alike = rs.Plant(-np.eye(2), [[0], [1]], np.eye(2)).with_disturbances({"a": [1, 0], "b": [2, 0]})
    with pytest.raises(DesignError, match="rank 1 only"):
        perfect_observer(alike)


def test_ordinary_plants_have_the_least_order_kind_only() -> None:
    plant = rs.Plant([[0, 1, 0], [0, 0, 1], [-1, -2, -3]], [[0], [0], [1]], [[1, 0, 0]]).with_sensor_faults()
    with pytest.raises(DesignError, match="least_order=True"):
        perfect_observer(plant)
    observer = perfect_observer(plant, least_order=True)
    assert observer.derivatives == 2  # x = (y, y', y'')
    np.testing.assert_allclose(observer.system.evaluate([0.0])[0], [[0, 1], [0, 0], [0, 0]], atol=1e-12)
    with pytest.raises(DesignError, match="K and A"):
        _ = observer.K
    # the parity relation y''' + 3 y'' + 2 y' + y = u
    P = observer.polynomial()["y1 sensor"][:, 0]
    np.testing.assert_allclose(P / P[-1], [1, 2, 3, 1], rtol=1e-9)


def test_as_many_disturbances_as_outputs_leave_no_residual() -> None:
    plant = rs.Plant([[-1, 1], [0, -2]], [[0], [1]], [[1, 0]]).with_disturbances({"d": [0, 1]}).with_sensor_faults()
    observer = perfect_observer(plant)
    assert observer.derivatives == 1
    with pytest.raises(DesignError, match="zero whatever fails"):
        observer.residual_generator()


def test_systems_that_are_not_regular_are_refused() -> None:
    with pytest.raises(ModelError, match="zero for every s"):
        perfect_observer(rs.Plant([[1, 0], [0, 0]], [[0], [1]], np.eye(2), E=[[1, 0], [0, 0]]))


def test_T_is_singular_for_every_gain_where_the_outputs_miss_the_algebraic_part() -> None:
    """det(sE - A - KC) = (s + 1 - k1)(s + 2) - k2 has degree 2 for every K, though no mode is hidden."""
    plant = rs.Plant([[-1, 1, 0], [0, -2, 0], [1, 1, -1]], [[1], [1], [0]], [[1, 0, 0]], E=np.diag([1.0, 1.0, 0.0]))
    with pytest.raises(DesignError, match=r"least_order=True"):
        perfect_observer(plant)
    observer = perfect_observer(plant, least_order=True)
    assert observer.derivatives == 1
    assert estimate_response(observer, 1j * np.array([0.1, 1.0])).max() < 1e-12


@pytest.mark.parametrize("exponent", range(3, 15))
@pytest.mark.refusals(at_most=6)
def test_nearly_hidden_states_are_estimated_or_refused_never_wrong(exponent: int, refused: Refused) -> None:
    eps = 10.0**-exponent
    plant = rs.Plant([[-1, eps, 0], [0, -2, 0], [1, 0, -1]], [[1], [1], [0]], [[1, 0, 1]], E=np.diag([1.0, 1.0, 0.0]))
    try:
        observer = perfect_observer(plant)
    except (DesignError, AccuracyError) as error:
        assert exponent > 5
        refused.skip(error)
    gain = observer.evidence.conditions["noise gain, outputs to estimate (peak)"]
    assert gain > 0.1 / eps
    # The terms that cancel in the estimate are as large as this gain, each known to 2**-52 of itself: 7e-12 for the
    # first plant of these, 7e-6 for 1e-9, where the designer's own check, at other frequencies, begins to refuse.
    assert estimate_response(observer, 1j * np.array([0.1, 1.0])).max() < 20 * 2.0**-52 * gain


# --------------------------------------------------------------------- options


def test_outputs_that_do_not_drive_it_do_not_matter() -> None:
    plant = rs.library.ladder_circuit()
    observer = perfect_observer(plant, outputs=["va", "vb"])
    generator = observer.residual_generator()
    assert generator.system.n_inputs == 1 + 3
    w = [10.0, 300.0]
    assert not np.any(generator.system.frequency_response(w)[:, :, 1])  # the column of the current
    assert not generator.structure[:, plant.faults.index("i sensor")].any()
    assert generator.structure[:, plant.faults.index("leak b")].all()
    assert observer.outputs == ("va", "vb")


def test_the_bandwidth_is_in_the_evidence_and_buys_noise() -> None:
    plant = rs.library.ladder_circuit()
    gains = []
    for bandwidth in (100.0, 1000.0, 1000000.0):
        observer = perfect_observer(plant, bandwidth=bandwidth)
        assert observer.evidence.conditions["bandwidth, rad/s"] == bandwidth
        np.testing.assert_allclose(observer.residual_generator().system.poles(), -bandwidth)
        gains.append(observer.evidence.conditions["noise gain, outputs to estimate (peak)"])
    assert gains[0] <= gains[1] < gains[2]
    poles = np.abs(plant.system().poles())
    default = perfect_observer(plant)
    assert default.bandwidth == pytest.approx(5 * np.exp(np.mean(np.log(poles))))
    assert default.delay == pytest.approx(default.derivatives / default.bandwidth)
    for bad in (0.0, -1.0, np.inf):
        with pytest.raises(SettingError, match="bandwidth"):
            perfect_observer(plant, bandwidth=bad)
    with pytest.raises(SettingError, match="finite sum"):
        perfect_observer(plant.discretize(1e-3), bandwidth=1.0)
    with pytest.raises(SettingError, match="without disturbances"):
        perfect_observer(plant, K=np.zeros((4, 3)))


def test_least_order_takes_no_more_derivatives() -> None:
    rng = np.random.default_rng(0)
    for _ in range(8):
        n = int(rng.integers(3, 7))
        plant = singular_plant(rng, n, n - 1, 2)
        least, full = perfect_observer(plant, least_order=True), perfect_observer(plant)
        assert least.index < full.index == n  # one chain of full length is forced when E lacks one rank
        assert least.derivatives == -(-(n - 1) // 2) - 1
        assert not least.complete


@pytest.mark.parametrize("seed", range(5))
def test_both_kinds_see_the_same_faults(seed: int) -> None:
    """The residual of either kind has all of the left null space: the rank of its response to y is that of W."""
    rng = np.random.default_rng(seed)
    plant = singular_plant(rng, 5, 3, 3).with_disturbances({"d": rng.standard_normal(5)})
    for least_order in (True, False):
        generator = perfect_observer(plant, least_order=least_order).residual_generator()
        response = generator.system.evaluate([0.3 + 0.2j])[0]
        assert np.linalg.matrix_rank(response[:, 2:], tol=1e-9) == generator.n_residuals == 2


def test_a_continuous_generator_is_sampled_with_its_plant() -> None:
    plant = rs.library.ladder_circuit()
    generator = perfect_observer(plant, bandwidth=400.0).residual_generator()
    sampled = generator.discretize(1e-4)
    assert sampled.plant.n_states == 2
    assert max(sampled.evidence.decoupling.values()) < 1e-2
    u = np.sin(np.arange(3000) * 1e-4 * 20)[:, None]
    fault = (np.arange(3000) > 2000) * 0.2
    f = np.zeros((3000, len(plant.faults)))
    f[:, plant.faults.index("leak b")] = fault
    y = plant.discretize(1e-4).system(("control", "fault")).simulate(np.hstack([u, f]))
    r = sampled.run(u, y)
    assert np.abs(r[500:2000]).max() < 1e-3 * np.abs(r[2500:]).max()
    steady = generator.steady_directions["leak b"] * 0.2
    np.testing.assert_allclose(r[-1], steady, atol=2e-3 * np.abs(steady).max())


# ------------------------------------------------------------------- its parts


@pytest.mark.parametrize("outputs", [["p", "q"], ["p", "q", "r", "s"]])
@pytest.mark.parametrize("dt", [0.0, 0.5])
def test_a_differential_filter_is_the_polynomial_over_its_lags(dt: float, outputs: list[str]) -> None:
    rng = np.random.default_rng(1)
    P = [rng.standard_normal((len(outputs), 3)) for _ in range(4)]
    filt = differential_filter(P, dt=dt, bandwidth=3.0, inputs=["a", "b", "c"], outputs=outputs)
    assert filt.n_states == 3 * min(len(outputs), 3)
    s = np.array([0.7 + 0.4j, 2.0 - 1j])
    plain = sum(s[:, None, None] ** i * P[i] for i in range(4))
    lag = s**3 if dt else (s / 3 + 1) ** 3
    np.testing.assert_allclose(filt.evaluate(s), plain / lag[:, None, None], rtol=1e-10)


def test_the_index_is_the_longest_chain() -> None:
    rng = np.random.default_rng(0)
    for chains in ([1], [3], [2, 2], [4, 1], [1, 1]):
        N = scipy.linalg.block_diag(*(np.eye(c, k=-1) for c in chains))
        assert nilpotency_index(N) == max(chains)
        lower = np.eye(len(N)) + np.tril(rng.standard_normal(N.shape), -1)
        other = np.tril(lower @ N @ np.linalg.inv(lower), -1)  # in other coordinates, with their rounding
        assert nilpotency_index(other) == max(chains)
        assert nilpotency_index(lower) == len(N) + 1
    assert nilpotency_index(np.diag(np.full(99, 1e-4), -1)) == 100  # though the product of its steps underflows


def test_the_ladder_circuit_obeys_kirchhoff() -> None:
    """Node voltages by hand: the resistive network between the coil's current and the capacitor's voltage."""
    plant = rs.library.ladder_circuit()
    system = plant.system("control")
    steady = system.dc_gain()[:, 0]
    load = 1 / (1 / R_SHUNT + 1 / (R_LINK + R_LOAD))  # the capacitor blocks
    np.testing.assert_allclose(steady[0], 1 / (R_SOURCE + load))
    np.testing.assert_allclose(steady[1], load / (R_SOURCE + load))
    np.testing.assert_allclose(steady[2] / steady[1], R_LOAD / (R_LINK + R_LOAD))
    fast = system.evaluate([1e9j])[0, :, 0] * 1e9j  # the capacitor is a short
    branch = R_LINK + 1 / (1 / R_LOAD + 1 / R_CAPACITOR)
    np.testing.assert_allclose(fast[1] / fast[0], 1 / (1 / R_SHUNT + 1 / branch), rtol=1e-5)
    # with the source shorted and the coil open at high frequency, v_c decays through R_CAPACITOR and the network
    network = 1 / (1 / R_LOAD + 1 / (R_LINK + R_SHUNT))
    blocked = plant.A[np.ix_([1, 2, 3], [1, 2, 3])]
    E = plant.E[np.ix_([1, 2, 3], [1, 2, 3])]
    pole = rs.StateSpace(blocked, np.zeros((3, 1)), np.eye(3), E=E).poles()
    np.testing.assert_allclose(pole, [-1 / (CAPACITANCE * (R_CAPACITOR + network))])


@pytest.mark.parametrize("seed", range(8))
def test_nested_null_spaces_leave_a_nilpotent_form_to_rounding(seed: int) -> None:
    rng = np.random.default_rng([seed, 2616])
    n, p = 12 + 5 * seed, 1 + seed % 4
    M, H = rng.standard_normal((n, n)) / np.sqrt(n), rng.standard_normal((p, n))
    H = np.vstack([H, H[:1]]) if seed % 2 else H  # a copy of an output adds nothing
    made = deadbeat(M, H)
    assert made is not None
    Z, X, levels = made
    np.testing.assert_allclose(X.T @ X, np.eye(n), atol=1e-14 * n)
    form = X.T @ (M + Z @ H) @ X
    ends = np.repeat(np.cumsum(levels), levels)
    kept = np.arange(n)[:, None] >= ends  # each group of directions goes to those after it
    assert sum(levels) == n
    assert levels[0] == p
    assert np.abs(np.where(kept, 0.0, form)).max() <= 1e-8 * np.abs(form).max()
