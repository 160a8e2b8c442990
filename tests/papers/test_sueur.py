"""Paper 004: the aircraft's poles and zeros, the printed gain and its misprint, and both experiments."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

import residua as rs
from residua.errors import DesignError
from residua.linear import invariant_zeros, pencil_rank_at
from residua.linear.poles.spectrum import match_poles
from residua.plant import augment_sensor_filter

ACTUATORS = ("collective actuator", "cyclic actuator")
POLES = [-20, -25, -100 / 3, -50]
SENSOR_POLES = [-30, -40, -40, -50, -50]
K_PRINTED = np.array(
    [
        [0, -0.0267, -0.4457],
        [0, -0.6815, 3.1666],
        [0, 0.0008, 0.9954],
        [0, -0.0605, -0.3685],
        [0.0250, 0, 0],
    ]
)
BOTH = pytest.mark.parametrize("corrected", [True, False], ids=["-5.52", "+5.52"])


def sensor_model(j: int = 0) -> rs.Plant:
    """Return the extended model of section 3.2: the filter rate is 25 on every faulty sensor."""
    aircraft = rs.library.vtol().without_faults(ACTUATORS)
    return augment_sensor_filter(aircraft, [aircraft.outputs[j]], 25)


def same_poles(found: np.ndarray, wanted: np.ndarray, tolerance: float) -> bool:
    found, wanted = np.asarray(found, dtype=complex), np.asarray(wanted, dtype=complex)
    return bool(np.all(np.abs(found[match_poles(wanted, found)] - wanted) <= tolerance * np.abs(wanted)))


def test_poles_of_the_aircraft() -> None:
    printed = [-6.8271, -2.5506, -1.0112 - 1.5146j, -1.0112 + 1.5146j]
    found = rs.library.vtol().system(()).poles()
    assert np.abs(found[match_poles(np.array(printed), found)] - printed).max() < 1e-4


@BOTH
def test_there_is_no_zero_from_the_actuators_and_both_matrices_are_as_printed(corrected: bool) -> None:
    aircraft = rs.library.vtol(corrected=corrected)
    np.testing.assert_array_equal(aircraft.B[2], [-5.52 if corrected else 5.52, 4.49])
    assert invariant_zeros(aircraft.A, aircraft.B, aircraft.C).zeros.size == 0
    # an independent statement: the pencil has full column rank at every generalised eigenvalue of a square part
    for rows in ([0, 1], [0, 2], [1, 2]):
        M = np.block([[aircraft.A, aircraft.B], [aircraft.C[rows], np.zeros((2, 2))]])
        for s in scipy.linalg.eigvals(M, scipy.linalg.block_diag(np.eye(4), np.zeros((2, 2)))):
            if np.isfinite(s) and abs(s) < 1e6:
                assert pencil_rank_at(aircraft.A, aircraft.B, aircraft.C, s=complex(s)).rank == 6


@pytest.mark.parametrize(("corrected", "stable"), [(True, False), (False, True)], ids=["-5.52", "+5.52"])
def test_with_two_outputs_only_the_sign_decides(corrected: bool, stable: bool) -> None:
    aircraft = rs.library.vtol(corrected=corrected)
    zeros = invariant_zeros(aircraft.A, aircraft.B, aircraft.C[:2]).zeros
    assert len(zeros) == 2
    assert np.isclose(zeros[0], np.conj(zeros[1]))
    assert bool((zeros.real < 0).all()) is stable
    two = rs.Plant(aircraft.A, aircraft.B, aircraft.C[:2], inputs=aircraft.inputs).with_actuator_faults()
    if stable:
        found = rs.design.fault_estimator(two)
        assert same_poles(found.observer.evidence.fixed_poles, zeros, 1e-8)
    else:
        with pytest.raises(DesignError, match=r"invariant zero|not detectable"):
            rs.design.fault_estimator(two)


@pytest.mark.parametrize("j", range(3))
def test_the_extended_model_has_no_invariant_zero(j: int) -> None:
    extended = sensor_model(j)
    F = extended.Bf[:, [extended.faults.index(f"{extended.outputs[j]} sensor")]]
    assert invariant_zeros(extended.A, F, extended.C).zeros.size == 0


def test_appendix_b() -> None:
    extended = sensor_model()
    np.testing.assert_array_equal(extended.A[4], [25, 0, 0, 0, -25])
    np.testing.assert_array_equal(extended.Bf[:, 0], [0, 0, 0, 0, 25])
    np.testing.assert_array_equal(extended.C, [[0, 0, 0, 0, 1], [0, 1, 0, 0, 0], [0, 0, 0, 1, 0]])
    assert not extended.Df[:, 0].any()


def test_the_printed_gain_gives_other_poles() -> None:
    found = rs.design.inverse_form_observer(sensor_model(), faults="v_horizontal sensor", K=K_PRINTED)
    wrong = np.array([-40, -51.107, -30.040, -0.0667 + 1.7116j, -0.0667 - 1.7116j])
    assert np.abs(found.poles[match_poles(wrong, found.poles)] - wrong).max() < 1e-3


def test_with_its_sign_corrected_it_is_the_announced_gain_up_to_print_precision() -> None:
    """Newton's method on the entries, from the corrected print: exact poles within half a unit of the last digit."""
    extended = sensor_model()
    design = rs.design.inverse_form_observer(extended, faults="v_horizontal sensor", poles=SENSOR_POLES)
    start = K_PRINTED.copy()
    start[0, 1] *= -1
    wanted = np.poly(1 / np.array(SENSOR_POLES, dtype=float))[1:]
    scale = np.abs(wanted)

    def missed(entries: np.ndarray) -> np.ndarray:
        K = start.copy()
        K[start != 0] = entries
        return (np.poly(design.N_BO - K @ extended.C)[1:] - wanted) / scale

    printed = start[start != 0]
    entries = printed.copy()
    for _ in range(60):
        slopes = [(missed(entries + step) - missed(entries - step)) / 2e-7 for step in 1e-7 * np.eye(len(entries))]
        entries = entries - np.linalg.lstsq(np.array(slopes).T, missed(entries), rcond=None)[0]
    assert np.abs(missed(entries)).max() < 1e-9
    assert np.abs(entries - printed).max() < 5e-5
    K = start.copy()
    K[start != 0] = entries
    poles = 1 / np.linalg.eigvals(design.N_BO - K @ extended.C)
    # a double pole that is not semisimple scatters by the root of the rounding
    assert np.abs(np.sort(poles.real) - np.sort(SENSOR_POLES)).max() < 0.5
    assert np.abs(np.poly(poles) / np.poly(SENSOR_POLES) - 1).max() < 1e-6


def test_poles_placed_by_their_inverses() -> None:
    found = rs.design.inverse_form_observer(sensor_model(), faults="v_horizontal sensor", poles=SENSOR_POLES)
    # double poles scatter by the root of the rounding: their characteristic polynomial does not
    for poles in (found.poles, 1 / np.linalg.eigvals(found.N_BF)):
        assert np.abs(np.poly(poles) / np.poly(SENSOR_POLES) - 1).max() < 1e-6
        assert np.abs(np.sort(poles.real) - np.sort(SENSOR_POLES)).max() < 2e-2


def test_one_observer_for_all_sensors_has_the_poles_of_the_plant() -> None:
    aircraft = rs.library.vtol().without_faults(ACTUATORS)
    extended = augment_sensor_filter(aircraft, aircraft.outputs, 25)
    fixed = np.linalg.eigvals(aircraft.A)
    found = rs.design.inverse_form_observer(extended, poles=[*fixed, -30, -40, -50])
    np.testing.assert_allclose(
        found.N_BO, scipy.linalg.block_diag(np.linalg.inv(aircraft.A), np.zeros((3, 3))), atol=1e-12
    )
    assert same_poles(found.poles, np.array([*fixed, -30, -40, -50]), 1e-6)


def implicit_form(
    plant: rs.Plant, found: rs.design.InverseFormObserver, times: np.ndarray, faults: np.ndarray, x0: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Integrate plant and eqs. (5), (8) as they are printed, with the exact derivative; return x, xhat and dhat."""
    A, B, F, H = plant.A, plant.B, found.observer.plant.Bd, plant.C
    rows = [plant.outputs.index(name) for name in found.first]
    H1, inverse, n = H[rows], np.linalg.inv(A), len(A)
    G = np.linalg.inv(H1 @ inverse @ F)
    u = np.ones(B.shape[1])
    # (8) with (5) put in: (I - F G H1 A^-1 - A K H) xhat' = A xhat + B u - F G (z1 + H1 A^-1 B u) - A K H x'
    left = np.linalg.inv(np.eye(n) - F @ G @ H1 @ inverse - A @ found.K @ H)

    def rates(x: np.ndarray, xh: np.ndarray, f: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        dx = A @ x + B @ u + F @ f
        dxh = left @ (A @ xh + B @ u - F @ G @ (H1 @ x + H1 @ inverse @ B @ u) - A @ found.K @ H @ dx)
        return dx, dxh

    x, xh = x0.copy(), np.zeros(n)
    out = []
    for k, f in enumerate(faults):
        dx, dxh = rates(x, xh, f)
        out.append((x, xh, -G @ (H1 @ x - H1 @ inverse @ dxh + H1 @ inverse @ B @ u)))
        if k + 1 == len(times):
            break
        h = times[k + 1] - times[k]
        s1 = (dx, dxh)
        s2 = rates(x + h / 2 * s1[0], xh + h / 2 * s1[1], f)
        s3 = rates(x + h / 2 * s2[0], xh + h / 2 * s2[1], f)
        s4 = rates(x + h * s3[0], xh + h * s3[1], f)
        x = x + h / 6 * (s1[0] + 2 * s2[0] + 2 * s3[0] + s4[0])
        xh = xh + h / 6 * (s1[1] + 2 * s2[1] + 2 * s3[1] + s4[1])
    X, XH, DH = (np.array(part) for part in zip(*out, strict=True))
    return X, XH, DH


@BOTH
def test_the_inverse_form_is_an_unknown_input_observer(corrected: bool) -> None:
    """The printed equations, integrated with the exact derivative, give the state of the observer to 1e-9."""
    aircraft = rs.library.vtol(corrected=corrected)
    found = rs.design.inverse_form_observer(aircraft, faults=ACTUATORS, poles=POLES)
    assert found.first == ("v_horizontal", "v_vertical")
    o, F = found.observer, aircraft.Bf[:, :2]
    np.testing.assert_allclose(o.F @ found.N_BF, np.eye(4), atol=1e-9)
    np.testing.assert_allclose(o.H, -np.linalg.solve(found.N_BF, found.K), atol=1e-9)
    np.testing.assert_allclose((np.eye(4) - o.H @ aircraft.C) @ F, 0, atol=1e-9)
    np.testing.assert_allclose(found.N_BF @ F, -found.K @ aircraft.C @ F, atol=1e-9)  # property 1
    assert np.sum(np.abs(np.linalg.eigvals(found.N_BO)) < 1e-9) == 2  # property 2
    same = rs.design.unknown_input_observer(aircraft.faults_as_disturbances(ACTUATORS), poles=POLES, H0=o.H)
    np.testing.assert_allclose(same.H, o.H, atol=1e-9)
    np.testing.assert_allclose(same.T, o.T, atol=1e-9)

    h = 5e-4
    times = np.arange(4001) * h
    faults = np.column_stack([np.where(times < 1, 0.0, 0.3), np.zeros(len(times))])
    x0 = np.array([0.01, 0, 0, 0])
    X, XH, DH = implicit_form(aircraft, found, times, faults, x0)
    # the observer as one system with the plant: exact for inputs held over each step; w(0) makes xhat(0) = 0
    A = np.block([[aircraft.A, np.zeros((4, 4))], [o.K @ aircraft.C, o.F]])
    B = np.vstack([np.hstack([aircraft.B, F]), np.hstack([o.G, np.zeros((4, 2))])])
    whole = rs.StateSpace(A, B, np.hstack([o.H @ aircraft.C, o.M])).discretize(h)
    start = np.concatenate([x0, -o.H @ aircraft.C @ x0])
    states = whole.simulate(np.hstack([np.ones((len(times), 2)), faults]), start)
    assert np.abs(states - XH).max() < 1e-7 * np.abs(XH).max()
    late = times > 1.8
    assert np.abs(XH - X)[late].max() < 1e-4 * np.abs(XH - X).max()
    assert np.abs(DH[late] - [0.3, 0]).max() < 1e-4


def run_actuator_fault(aircraft: rs.Plant, estimator: rs.design.FaultEstimator, h: float, end: float) -> np.ndarray:
    """Return the estimates for section 3.1, with inputs and faults that are held: sampled exactly."""
    times = np.arange(round(end / h) + 1) * h
    k = np.arange(len(times))
    f = np.zeros((len(times), 2))
    f[(k >= round(2 / h)) & (k < round(3 / h)), 0] = 0.3
    plant = aircraft.without_faults(aircraft.faults[2:]).system(("control", "fault"))
    n, m = plant.n_states, 2
    # the plant hands its inputs on, then the estimator reads [u, y]
    C = np.vstack([np.zeros((m, n)), plant.C])
    D = np.vstack([np.hstack([np.eye(m), np.zeros((m, 2))]), plant.D])
    whole = plant.replaced(C=C, D=D, outputs=None).series(estimator.system).discretize(h)
    x0 = np.zeros(whole.n_states)
    x0[0] = 0.01
    return whole.simulate(np.hstack([np.ones((len(times), 2)), f]), x0)


@BOTH
def test_v7_actuator_fault(corrected: bool) -> None:
    aircraft = rs.library.vtol(corrected=corrected)
    estimator = rs.design.fault_estimator(aircraft, faults=ACTUATORS, poles=POLES, bandwidth=50)
    h = 1e-3
    estimates = run_actuator_fault(aircraft, estimator, h, 4.0)
    assert same_poles(estimator.observer.poles, np.array(POLES), 1e-9)
    np.testing.assert_allclose(estimates[round(3 / h)], [0.3, 0], atol=1e-6)  # at 3-: the fault ends here
    np.testing.assert_allclose(estimates[round(1.5 / h) : round(2 / h) + 1], 0, atol=1e-6)
    np.testing.assert_allclose(estimates[round(3.5 / h) :], 0, atol=1e-6)
    np.testing.assert_allclose(estimates[round(1.5 / h) :, 1], 0, atol=1e-6)
    rise = estimates[round(2 / h) : round(3 / h) + 1, 0]
    lag = 0.3 * (1 - np.exp(-50 * h * np.arange(len(rise))))
    np.testing.assert_allclose(rise, lag, atol=1e-6)


def test_v7_sensor_fault_and_what_the_sensor_should_read() -> None:
    aircraft = rs.library.vtol()
    bank = rs.design.sensor_fault_estimators(aircraft, poles=[-30, -40, -40, -50])
    assert not bank.failures
    h = 1e-3
    times = np.arange(3001) * h
    u = np.ones((len(times), 2))
    healthy = aircraft.system("control").discretize(h).simulate(u, [0.01, 0, 0, 0])
    for j, (name, estimator) in enumerate(bank.items()):
        y = healthy.copy()
        pulse = ((times > 1) & (times <= 2)).astype(float)
        y[:, j] += pulse
        estimate = estimator.estimate(u, y, dt=h)
        late = times > 0.8
        assert np.abs(estimate[late, 0] - pulse[late]).max() < 1e-4, name
        assert np.abs(estimator.virtual_outputs(u, y, dt=h)[late] - healthy[late]).max() < 1e-4, name
        # the others are misled, and their output errors say so; its own stay silent
        own = estimator.consistency().run(u, y, dt=h)[late]
        assert np.abs(own).max() < 1e-4
        for other in bank:
            if other != name:
                assert np.abs(bank[other].consistency().run(u, y, dt=h)[late]).max() > 0.05
