"""The jet engine of the robust l1 fault detection paper, section 4."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

import residua as rs
from residua.errors import DesignError, ModelError, SettingError
from residua.library import (
    degrading_jet_engine,
    degrading_jet_engine_controller,
    degrading_jet_engine_corner,
    drift,
    simulate_degrading_jet_engine,
    simulate_jet_engine,
    simulate_three_tank,
)
from residua.linear import peak_input, peak_norm

# Eqs. (52)-(56), typed again.
AP = np.array([[0.8938, 0.0034, 0.0020], [-0.0001, 0.8940, 0.0014], [0, -0.0001, 0.8996]])
BP = np.array([[0.0059, 0.1119, -0.0160], [0.0042, 0.0720, 0.0083], [0.0001, -0.0003, 0]])
CP = np.array([[1, 0.0077, 0.0044], [-0.0003, 1, 0.0031], [0.0299, -0.0208, 0.0010]])
DP1, DP2 = np.diag([0.1, 0.1, 0.01]), 0.1 * np.eye(3)
H_A = -np.array([[1.0, 1, 1, 0, 0, 0], [0, 0, 0, 1, 1, 1], [0, 0, 0, 0, 0, 0]])
H_B = H_C = -np.array([[1.0, 1, 1], [0, 0, 0], [0, 0, 0]])
G_A, G_B, G_C = np.vstack([np.eye(3), np.eye(3)]), np.eye(3), np.eye(3)
BOUNDS = {
    "dA1": (0, 0.0011), "dA2": (-0.0008, 0), "dA3": (0, 0.0002),
    "dA4": (-0.0001, 0), "dA5": (0, 0.0005), "dA6": (0, 0.0001),
    "dB1": (0, 0.0008), "dB2": (0, 0.0115), "dB3": (-0.0005, 0),
    "dC1": (-0.0001, 0), "dC2": (-0.0015, 0), "dC3": (0, 0.0004),
}  # fmt: skip
READINGS = [(a33, c33) for a33 in (0.8996, 0.8960, 0.9960) for c33 in (0.0010, 1.0010)]
SENSORS = ("XNH sensor", "XNL sensor", "TMPC sensor")


def of(letter: str, values: dict[str, float]) -> np.ndarray:
    """Return the parameters of one matrix as ``F``."""
    return np.diag([values[name] for name in sorted(values) if name[1] == letter])


def drawn(seed: int) -> dict[str, float]:
    rng = np.random.default_rng(seed)
    return {name: float(rng.uniform(*bounds)) for name, bounds in BOUNDS.items()}


def by_turns(values: dict[str, float], w: np.ndarray, f: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Run engine and controller one after the other, with matrices written out here."""
    c = degrading_jet_engine_controller()
    A, B, C = (
        M - H @ of(letter, values) @ G
        for M, H, letter, G in ((AP, H_A, "A", G_A), (BP, H_B, "B", G_B), (CP, H_C, "C", G_C))
    )
    x, xc, out = np.zeros(3), np.zeros(3), []
    for k in range(len(w)):
        u = c.C @ xc
        y = C @ x + DP2 @ w[k] + f[k]
        out.append((y, u, x))
        x, xc = A @ x + B @ u + DP1 @ w[k], c.A @ xc + c.B @ y
    y, u, x = (np.array(part) for part in zip(*out, strict=True))
    return y, u, x


def test_matrices_and_bounds_are_the_papers():
    engine = degrading_jet_engine()
    plant = engine.nominal
    for found, known in (
        (plant.A, AP), (plant.B, BP), (plant.C, CP), (plant.Bd, DP1), (plant.Dd, DP2), (plant.Df, np.eye(3)),
    ):  # fmt: skip
        np.testing.assert_array_equal(found, known)
    assert not plant.Bf.any()
    assert plant.dt == 0.01
    assert plant.inputs == ("WF36", "A8", "A16")
    assert plant.outputs == plant.states == ("XNH", "XNL", "TMPC")
    assert plant.disturbances == ("w1", "w2", "w3")
    assert plant.faults == SENSORS
    assert {p.name: (p.low, p.high) for p in engine.parameters} == BOUNDS
    assert plant.units["TMPC"] == "degC"
    # The first row of dB widens A8 by a tenth: the sign of the perturbation is plus.
    assert engine.member({"dB2": 0.0115}).B[0, 1] == pytest.approx(0.1119 + 0.0115, abs=1e-16)
    assert engine.member({"dA4": -0.0001}).A[1, 0] == pytest.approx(-0.0002, abs=1e-16)
    assert engine.member({"dC3": 0.0004}).C[0, 2] == pytest.approx(0.0048, abs=1e-16)


@pytest.mark.parametrize(("a33", "c33"), READINGS)
def test_every_reading_of_the_digits_is_stable_at_all_corners(a33, c33):
    engine = degrading_jet_engine(a33=a33, c33=c33)
    assert (engine.nominal.A[2, 2], engine.nominal.C[2, 2]) == (a33, c33)
    loop = engine.in_closed_loop(degrading_jet_engine_controller(engine))
    corners = np.stack([member.A for member in loop.vertices()])
    assert corners.shape == (4096, 6, 6)
    radius = np.abs(np.linalg.eigvals(corners)).max()
    # What wear moves is not what decides: the slowest mode is the temperature's own.
    assert radius == pytest.approx(a33, abs=1e-5)


def test_the_third_sensor_hardly_sees_its_state_as_printed():
    smallest = [np.linalg.svd(degrading_jet_engine(c33=c33).nominal.C)[1][-1] for c33 in (0.0010, 1.0010)]
    assert smallest == pytest.approx([0.00093, 0.98], rel=5e-3)


def test_the_controller_is_the_regulator_on_the_kalman_filter():
    X = scipy.linalg.solve_discrete_are(AP, BP, 4 * np.eye(3), 0.5 * np.eye(3))
    Y = scipy.linalg.solve_discrete_are(AP.T, CP.T, DP1 @ DP1.T, DP2 @ DP2.T)
    K = np.linalg.solve(0.5 * np.eye(3) + BP.T @ X @ BP, BP.T @ X @ AP)
    L = AP @ Y @ CP.T @ np.linalg.inv(CP @ Y @ CP.T + DP2 @ DP2.T)
    found = degrading_jet_engine_controller(state_weight=4, input_weight=0.5)
    np.testing.assert_allclose(found.A, AP - BP @ K - L @ CP, atol=1e-13, rtol=0)
    np.testing.assert_allclose(found.B, L, atol=1e-13, rtol=0)
    np.testing.assert_allclose(found.C, -K, atol=1e-13, rtol=0)
    assert (found.inputs, found.outputs) == (("XNH", "XNL", "TMPC"), ("WF36", "A8", "A16"))


@pytest.mark.parametrize("seed", range(5))
def test_structure_of_the_loop_with_two_copies_of_the_output_perturbation(seed):
    """Eqs. (13)-(19) and (30)-(36): the paper has dC once in dA and once in the measurement, we have it once."""
    rng, values = np.random.default_rng(seed), drawn(seed)
    engine, controller = degrading_jet_engine(), degrading_jet_engine_controller()
    loop = engine.in_closed_loop(controller)
    Ac, Bc, Cc = controller.A, controller.B, controller.C
    zero = np.zeros((3, 3))
    F_A = scipy.linalg.block_diag(of("A", values), of("C", values), of("B", values))
    F_C = of("C", values)
    HA = np.block([[H_A, zero, H_B], [np.zeros((3, 6)), Bc @ H_C, zero]])
    GA = np.block([[G_A, np.zeros((6, 3))], [G_C, zero], [zero, G_B @ Cc]])
    GC = np.hstack([G_C, zero])
    A, C = np.block([[AP, BP @ Cc], [Bc @ CP, Ac]]), np.hstack([CP, zero])
    dA, dC = -HA @ F_A @ GA, -H_C @ F_C @ GC
    member = loop.member(values)
    assert np.abs(member.A - A - dA).max() < 1e-14
    assert np.abs(member.C - C - dC).max() < 1e-14
    assert np.abs(member.Bd - np.vstack([DP1, Bc @ DP2])).max() < 1e-14
    assert np.abs(member.Bf - np.vstack([zero, Bc])).max() < 1e-14
    # The estimator of one sensor: states x and e.
    W, Ae = 0.1 * rng.standard_normal((6, 3)), loop.nominal.A + 0.01 * rng.standard_normal((6, 6))
    P = rng.standard_normal((1, 3))
    H0 = np.block([[HA, np.zeros((6, 3))], [HA, W @ H_C]])
    G0 = np.block([[GA, np.zeros((12, 6))], [-GC, np.zeros((3, 6))]])
    whole = np.block([[A, np.zeros((6, 6))], [A - Ae, Ae - W @ C]]) - H0 @ scipy.linalg.block_diag(F_A, F_C) @ G0
    residual = loop.estimator_residual(W, P, model=Ae).member(values)
    assert np.abs(residual.A - whole).max() < 1e-14
    assert np.abs(residual.C - P @ np.hstack([dC, C])).max() < 1e-14


def test_the_corner_is_the_bound_that_is_not_zero():
    corner = degrading_jet_engine_corner()
    assert corner == {name: low or high for name, (low, high) in BOUNDS.items()}
    assert all(corner.values())


@pytest.mark.parametrize("values", [None, {}, {"dA5": 0.0003, "dB2": 0.01, "dC2": -0.001}])
def test_simulation_is_engine_and_controller_by_turns(values):
    rng = np.random.default_rng(4)
    w, f = rng.uniform(-0.5, 0.5, (300, 3)), rng.standard_normal((300, 3))
    faults = dict(zip(SENSORS, f.T, strict=True))
    run = simulate_degrading_jet_engine(3.0, faults=faults, values=values, disturbance=w)
    member = dict.fromkeys(BOUNDS, 0.0) | (degrading_jet_engine_corner() if values is None else values)
    for found, known in zip((run.y, run.u, run.x), by_turns(member, w, f), strict=True):
        assert np.abs(found - known).max() < 1e-12
    assert np.array_equal(run.time, np.arange(300) * 0.01)
    assert run.dt == 0.01
    # And the library's own closed loop is the same.
    engine, controller = degrading_jet_engine(), degrading_jet_engine_controller()
    loop = engine.in_closed_loop(controller).member(member).system(("disturbance", "fault"))
    assert np.abs(loop.simulate(np.hstack([w, f])) - run.y).max() < 1e-12


def test_disturbances_lie_on_the_sphere_and_are_repeatable():
    at_rest = {"engine": degrading_jet_engine(), "values": {}}
    runs = [simulate_degrading_jet_engine(40.0, seed=seed, **at_rest) for seed in (1, 1, 2)]
    assert np.array_equal(runs[0].y, runs[1].y)
    assert np.all(runs[0].y[:, 0] != runs[2].y[:, 0])
    w = (runs[0].y - runs[0].x @ CP.T) / 0.1
    np.testing.assert_allclose(np.linalg.norm(w, axis=1), 1.0, atol=1e-12)
    # Directions drawn evenly: no mean, one third of the square each.
    assert np.abs(w.mean(axis=0)).max() < 0.03
    np.testing.assert_allclose(w.T @ w / len(w), np.eye(3) / 3, atol=0.02)
    quiet = simulate_degrading_jet_engine(1.0, disturbance=0.0)
    assert not quiet.y.any()


def test_a_fault_of_one_sensor_moves_all_of_the_engine():
    bias = {"XNH sensor": 1.0}
    run = simulate_degrading_jet_engine(10.0, faults=bias, values={}, disturbance=0.0)
    plant, c = degrading_jet_engine().nominal, degrading_jet_engine_controller()
    # At rest: x = A x + B u, u = Cc xc, xc = Ac xc + Bc (C x + f).
    gain = plant.B @ c.C @ np.linalg.solve(np.eye(3) - c.A, c.B)
    x = np.linalg.solve(np.eye(3) - plant.A - gain @ plant.C, gain[:, 0])
    np.testing.assert_allclose(run.x[-1], x, atol=1e-10)
    np.testing.assert_allclose(run.y[-1], plant.C @ x + [1, 0, 0], atol=1e-10)
    # The controller pulls both speeds down by what it believes: the sensor shows 22 % less than its fault.
    assert run.y[-1] == pytest.approx([0.781, -0.130, -0.004], abs=1e-3)


def test_drifts():
    course = drift(0.5, 0.4)
    assert course(np.array([0.0, 0.5, 1.0])).tolist() == [0.0, 0.0, 0.2]
    time = np.arange(200) * 0.01
    found = simulate_degrading_jet_engine(2.0, faults={"TMPC sensor": course})
    same = simulate_degrading_jet_engine(2.0, faults={"TMPC sensor": 0.4 * np.maximum(time - 0.5, 0)})
    assert np.array_equal(found.y, same.y)
    # Other simulations take functions of time too, in their own step.
    slow = simulate_three_tank(30, dt=2.0, noise=0, faults={"h1 sensor": drift(10.0, 0.1)})
    assert slow.y[-1, 0] - slow.x[-1, 0] == pytest.approx(0.1 * 48)
    run = simulate_jet_engine(np.zeros(300), dt=0.02, faults={"p2 sensor": drift(1.0, 0.1)})
    assert run.y[-1, 3] == pytest.approx(0.1 * (299 * 0.02 - 1))


@pytest.mark.parametrize("c33", [0.0010, 1.0010])
def test_the_worst_input_reaches_the_peak_norm_and_no_random_one_does(c33):
    engine = degrading_jet_engine(c33=c33)
    member = engine.in_closed_loop(degrading_jet_engine_controller(engine)).member(degrading_jet_engine_corner())
    loop = member.system("disturbance").select(outputs=["XNL"])
    peak = peak_norm(loop)
    w = peak_input(loop, peak, 500)
    worst = simulate_degrading_jet_engine(5.0, engine=engine, disturbance=w)
    assert worst.y[-1, 1] == pytest.approx(peak.attained, rel=1e-9)
    drawn_at_random = simulate_degrading_jet_engine(5.0, engine=engine)
    assert np.abs(drawn_at_random.y[:, 1]).max() < 0.8 * peak.attained


def test_a_controller_with_names_in_another_order():
    c = degrading_jet_engine_controller()
    other = c.select(inputs=["TMPC", "XNH", "XNL"], outputs=["A16", "WF36", "A8"])
    runs = [simulate_degrading_jet_engine(1.0, controller=controller) for controller in (c, other)]
    assert np.array_equal(runs[0].u, runs[1].u)
    assert np.array_equal(runs[0].y, runs[1].y)


def test_bad_requests():
    with pytest.raises(
        SettingError, match=r"a33 must be one of the readings of the scan, 0.8996, 0.896, 0.996, got 0.9"
    ):
        degrading_jet_engine(a33=0.9)
    with pytest.raises(SettingError, match=r"c33 must be one of .*, 0.001, 1.001, got 1.0"):
        degrading_jet_engine(c33=1.0)
    with pytest.raises(SettingError, match="input_weight must be a positive number"):
        degrading_jet_engine_controller(input_weight=0.0)
    with pytest.raises(ModelError, match="engine must be a sampled UncertainPlant"):
        degrading_jet_engine_controller(degrading_jet_engine().nominal)  # type: ignore[arg-type]
    with pytest.raises(ModelError, match="unknown fault 'XNL'; known: XNH sensor, XNL sensor, TMPC sensor"):
        simulate_degrading_jet_engine(1.0, faults={"XNL": 1.0})
    with pytest.raises(ModelError, match=r"fault .XNL sensor.: expected shape \(100,\), got \(99,\)"):
        simulate_degrading_jet_engine(1.0, faults={"XNL sensor": np.ones(99)})
    with pytest.raises(ModelError, match=r"'dA1' = 0.01 lies outside of its bounds \[0, 0.0011\]"):
        simulate_degrading_jet_engine(1.0, values={"dA1": 0.01})
    with pytest.raises(ModelError, match=r"disturbance: expected shape \(100, 3\), got \(100, 2\)"):
        simulate_degrading_jet_engine(1.0, disturbance=np.zeros((100, 2)))
    with pytest.raises(SettingError, match="disturbance must be 'sphere' or numbers"):
        simulate_degrading_jet_engine(1.0, disturbance="gauss")
    for seconds in (0.0, -1.0, np.inf, np.nan):
        with pytest.raises(SettingError, match=r"at least one step of 0\.01 s"):
            simulate_degrading_jet_engine(seconds)
    with pytest.raises(SettingError, match="finite"):
        drift(0.0, np.nan)


def test_a_member_that_its_controller_does_not_hold_is_refused():
    engine = degrading_jet_engine()
    wide = rs.UncertainPlant(
        engine.nominal, [rs.plant.Perturbation("A", -np.eye(3)[:, :1], np.eye(3)[:1], 0, 1.0, ["dA1"])]
    )
    simulate_degrading_jet_engine(0.1, engine=wide, values={"dA1": 0.1})
    with pytest.raises(DesignError, match="not stable for this member"):
        simulate_degrading_jet_engine(0.1, engine=wide, values={"dA1": 1.0})
