"""Fault estimators: what is estimated is the fault, whatever else happens; and who is refused is refused rightly."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import scipy.linalg
import scipy.signal

import residua as rs
from generated import random_plant, singular_plant
from residua.design import FaultEstimator, fault_estimator
from residua.errors import DesignError, ModelError, SettingError
from residua.linear import invariant_zeros
from residua.testing import check_residual_generator

SEEDS = range(200)


@cache
def generated(seed: int) -> tuple[rs.Plant, list[str]]:
    """Return a plant and faults to estimate; state and sensor faults, alone and together, over all kinds of plants."""
    rng = np.random.default_rng(seed)
    if seed % 5 == 4:
        plant = singular_plant(rng, disturbances=int(rng.integers(0, 2)))
    else:
        plant = random_plant(
            rng, disturbances=int(rng.integers(0, 3)), sensors=seed % 2 == 0, feedthrough=bool(seed // 2 % 2)
        )
    if seed % 7 == 3:
        both = (rng.standard_normal(plant.n_states), rng.standard_normal(plant.n_outputs))
        plant = plant.with_disturbances({"both": both})
    if seed % 11 == 5:
        plant = plant.with_faults(
            {"mixed": (rng.standard_normal(plant.n_states), rng.standard_normal(plant.n_outputs))}
        )
    count = min(int(rng.integers(1, 4)), len(plant.faults))
    return plant, [str(name) for name in rng.choice(plant.faults, count, replace=False)]


@cache
def attempt(seed: int) -> FaultEstimator | str:
    """Return the estimator of a generated plant, or why there is none."""
    plant, faults = generated(seed)
    try:
        return fault_estimator(plant, faults=faults)
    except DesignError as error:
        return str(error)


def designed(seed: int) -> FaultEstimator:
    found = attempt(seed)
    if isinstance(found, str):
        pytest.skip(f"not for this plant: {found}")
    return found


def exists(plant: rs.Plant, faults: list[str]) -> bool:
    """Tell by Hautus's strong* detectability, from the raw matrices, whether faults can be estimated."""
    columns = [plant.faults.index(name) for name in faults]
    B, D = np.hstack([plant.Bd, plant.Bf[:, columns]]), np.hstack([plant.Dd, plant.Df[:, columns]])
    rank = np.linalg.matrix_rank
    both, q = rank(np.vstack([B, D])), plant.Bd.shape[1]
    if both < rank(np.vstack([plant.Bd, plant.Dd])) + len(faults) if q else both < len(faults):
        return False
    known_at_once = np.block([[D, plant.C @ B], [np.zeros_like(D), D]])
    if rank(known_at_once) < rank(D) + both:
        return False
    zeros = invariant_zeros(plant.A, B, plant.C, D)
    if zeros.normal_rank < both:
        return False
    return bool((np.abs(zeros.zeros) < 1).all() if plant.dt else (zeros.zeros.real < 0).all())


def test_every_estimator_that_exists_is_found_and_no_other() -> None:
    found = wrong = 0
    for seed in SEEDS:
        plant, faults = generated(seed)
        if plant.E is not None:
            continue
        outcome = attempt(seed)
        answer = not isinstance(outcome, str)
        assert answer or "rank" in outcome or "detectable" in outcome
        found += answer
        wrong += answer != exists(plant, faults)
    assert wrong == 0
    assert 60 < found < 150  # both answers are among them


@pytest.mark.parametrize("seed", SEEDS)
def test_the_estimate_is_the_fault_and_nothing_else_by_transfer_matrices(seed: int) -> None:
    """Independent of any state: filter times plant, at points right of all poles, where both are convergent."""
    estimator = designed(seed)
    plant, faults = generated(seed)
    if seed % 3 == 0:
        estimator = fault_estimator(plant, faults=faults, bandwidth=4.0)
    rng = np.random.default_rng(seed)
    where = 1 + np.abs(plant.system(()).poles()).max(initial=0.0)
    points = where * np.exp(1j * rng.uniform(-1, 1, 6)) * rng.uniform(1, 2, 6)
    Q = estimator.system.evaluate(points)
    P = plant.system(("control", "disturbance", "fault")).evaluate(points)
    n_u, n_d = len(plant.inputs), len(plant.disturbances)
    Qu, Qy = Q[..., :n_u], Q[..., n_u:]
    size = np.abs(Qy) @ np.abs(P)
    assert (np.abs(Qu + Qy @ P[..., :n_u]) <= 1e-8 * (np.abs(Qu) + size[..., :n_u])).all()
    assert (np.abs(Qy @ P[..., n_u : n_u + n_d]) <= 1e-8 * size[..., n_u : n_u + n_d]).all()
    columns = [n_u + n_d + plant.faults.index(name) for name in faults]
    for k, name in enumerate(faults):
        lag = estimator.lag[name]
        if not plant.dt:
            wanted = 1 / (lag * points + 1)
        else:
            a = np.exp(-4.0 * plant.dt) if seed % 3 == 0 else 0.0
            delay = round(lag / plant.dt - a / (1 - a))
            assert delay in (0, 1)
            wanted = (1 - a) / (1 - a / points) * points ** float(-delay)
        for i in range(len(faults)):
            missed = np.abs((Qy @ P[..., columns])[:, i, k] - (wanted if i == k else 0.0))
            assert (missed <= 1e-8 * (1 + size[:, i, columns[k]])).all()


@pytest.mark.parametrize("seed", SEEDS)
def test_sampled_estimates_are_exact_with_one_step_of_delay_at_most(seed: int) -> None:
    plant, faults = generated(seed)
    if plant.E is not None:
        pytest.skip("a singular plant has no samples to run over")
    if not plant.dt:
        plant = rs.Plant(plant.A / np.abs(np.linalg.eigvals(plant.A)).max(), plant.Bu, plant.C, plant.Du, dt=0.1)
        plant = plant.with_faults({"f0": np.random.default_rng(seed).standard_normal(plant.n_states)})
        faults = ["f0"]
    try:
        estimator = fault_estimator(plant, faults=faults)
    except DesignError as error:
        pytest.skip(f"not for this plant: {error}")
    rng = np.random.default_rng(seed)
    slow = np.abs(estimator.observer.poles).max()
    if slow > 0.9:
        pytest.skip("a fixed pole needs more samples than an unstable plant allows")
    steps = 10 + int(np.ceil(np.log(1e-12) / np.log(max(slow, 0.3))))
    u, d = (
        rng.standard_normal((steps + 40, len(plant.inputs))),
        rng.standard_normal((steps + 40, len(plant.disturbances))),
    )
    f = np.zeros((steps + 40, len(plant.faults)))
    columns = [plant.faults.index(name) for name in faults]
    f[:, columns] = rng.standard_normal((steps + 40, len(faults)))  # any time course, from the start
    system = plant.system(("control", "disturbance", "fault"))
    y = system.simulate(np.hstack([u, d, f]), rng.standard_normal(plant.n_states))
    estimate = estimator.estimate(u, y)
    size = np.abs(y).max() * (1 + np.abs(estimator.system.D).max())
    for k, name in enumerate(faults):
        delay = round(estimator.lag[name] / plant.dt)
        late = f[steps - delay : len(f) - delay, columns[k]]
        assert np.abs(estimate[steps:, k] - late).max() < 1e-8 * size


@pytest.mark.parametrize("seed", SEEDS)
def test_continuous_constants_are_exact_and_ramps_late_by_the_lag(seed: int) -> None:
    """Plant, estimator, constant inputs and a fault ``a + b t`` as one autonomous system, by its exponential."""
    plant, faults = generated(seed)
    if plant.E is not None or plant.dt:
        pytest.skip("for continuous plants without algebraic equations")
    estimator = designed(seed)
    growth = plant.system(()).poles().real.max()
    if growth * 30 / -estimator.system.poles().real.max() > 12:  # runs away before the slowest error has decayed
        A = plant.A - (growth + 0.1) * np.eye(plant.n_states)
        bare = rs.Plant(A, plant.Bu, plant.C, plant.Du)
        plant = bare.with_disturbances(
            {name: (plant.Bd[:, i], plant.Dd[:, i]) for i, name in enumerate(plant.disturbances)}
        ).with_faults({name: (plant.Bf[:, i], plant.Df[:, i]) for i, name in enumerate(plant.faults)})
        try:
            estimator = fault_estimator(plant, faults=faults)
        except DesignError as error:
            pytest.skip(f"not for this plant: {error}")
    time = 30 / min(-estimator.system.poles().real.max(), 1e3)
    rng = np.random.default_rng(seed)
    columns = [plant.faults.index(name) for name in faults]
    P = plant.system(("control", "disturbance", "fault"))
    n, n_u, n_d, n_v = P.n_states, len(plant.inputs), len(plant.disturbances), P.n_inputs
    hand_on = np.hstack([np.eye(n_u), np.zeros((n_u, n_v - n_u))])
    whole = P.replaced(C=np.vstack([np.zeros((n_u, n)), P.C]), D=np.vstack([hand_on, P.D]), outputs=None)
    whole = whole.series(estimator.system)
    v0, slope = rng.standard_normal(n_v), np.zeros(n_v)
    v0[n_u + n_d :] = 0.0
    v0[[n_u + n_d + c for c in columns]] = rng.standard_normal(len(faults))
    for b in (np.zeros(len(faults)), rng.standard_normal(len(faults))):
        slope[[n_u + n_d + c for c in columns]] = b
        A = scipy.linalg.block_diag(whole.A, np.zeros((2, 2)))
        A[: whole.n_states, -2:] = np.column_stack([whole.B @ v0, whole.B @ slope])
        A[-1, -2] = 1.0  # the states at the end: one, and time
        x0 = np.concatenate([rng.standard_normal(n), np.zeros(estimator.system.n_states), [1.0, 0.0]])
        x = scipy.linalg.expm(A * time) @ x0
        v = v0 + slope * time
        estimate = whole.C @ x[:-2] + whole.D @ v
        lags = np.array([estimator.lag[name] for name in faults])
        wanted = v[[n_u + n_d + c for c in columns]] - b * lags
        y = P.C @ x[:n] + P.D @ v
        size = (np.abs(y).max() + np.abs(x[:n]).max()) * (1 + np.abs(estimator.system.D).max())
        assert np.abs(estimate - wanted).max() < 1e-8 * max(size, 1.0)


def test_most_generated_plants_are_estimated_in_some_way() -> None:
    """The tests above skip plants; here is how many each really looked at."""
    kinds = {"continuous": 0, "sampled": 0, "singular": 0, "several": 0, "no derivative": 0, "both": 0}
    for seed in SEEDS:
        plant, faults = generated(seed)
        estimator = attempt(seed)
        if isinstance(estimator, str):
            continue
        lag = estimator.lag
        kinds["singular" if plant.E is not None else "sampled" if plant.dt else "continuous"] += 1
        kinds["several"] += len(faults) > 1
        direct = [not lag[name] for name in faults]
        kinds["no derivative"] += all(direct)
        kinds["both"] += any(direct) and not all(direct)
    assert min(kinds.values()) >= 10, kinds


@pytest.mark.parametrize("seed", range(30))
def test_sueurs_form_and_the_unknown_input_observer_estimate_the_same_state(seed: int) -> None:
    rng = np.random.default_rng(1000 + seed)
    n, q = int(rng.integers(3, 7)), int(rng.integers(1, 3))
    p = q + int(rng.integers(1, 3))
    dt = (0.0, 0.1)[seed % 2]
    A = rng.standard_normal((n, n))
    A *= 0.9 / np.abs(np.linalg.eigvals(A)).max()
    plant = rs.Plant(A, rng.standard_normal((n, 2)), rng.standard_normal((p, n)), rng.standard_normal((p, 2)), dt=dt)
    plant = plant.with_faults({f"f{i}": rng.standard_normal(n) for i in range(q)})
    poles = -np.linspace(1, 3, n) if not dt else np.linspace(0.2, 0.6, n)
    try:
        found = rs.design.inverse_form_observer(plant, poles=poles)
    except DesignError as error:
        assert not exists(plant, list(plant.faults)) or "poles for" in str(error)  # noqa: PT017
        pytest.skip(f"not for this plant: {error}")
    o = found.observer
    np.testing.assert_allclose(o.F @ found.N_BF, np.eye(n), atol=1e-8)
    np.testing.assert_allclose(o.T @ plant.Bf, 0, atol=1e-9 * (1 + np.abs(o.H).max()))
    np.testing.assert_allclose(np.poly(o.poles), np.poly(poles), rtol=1e-6)
    same = rs.design.unknown_input_observer(plant.faults_as_disturbances(), poles=poles, H0=o.H)
    scale = 1 + np.abs(o.H).max()
    np.testing.assert_allclose(same.H, o.H, atol=1e-8 * scale)
    run = plant if dt else plant.discretize(0.05)
    u, f = rng.standard_normal((400, 2)), rng.standard_normal((400, q))
    system = run.system(("control", "fault"))
    states = system.replaced(C=np.eye(n), D=np.zeros((n, 2 + q)), outputs=None).simulate(np.hstack([u, f]))
    y = system.simulate(np.hstack([u, f]))
    if dt:
        for one in (found.observer, same):
            np.testing.assert_allclose(one.estimate(u, y)[-50:], states[-50:], atol=1e-6 * scale * np.abs(y).max())
    else:  # transfer matrices: the state estimate of both is the state, at any s
        points = np.array([0.3 + 1j, 2 + 0.5j, 5.0])
        P = plant.system(("control", "fault")).evaluate(points)
        X = plant.system(("control", "fault")).replaced(C=np.eye(n), D=np.zeros((n, 2 + q)), outputs=None)
        X = X.evaluate(points)
        U = np.broadcast_to(np.hstack([np.eye(2), np.zeros((2, q))]), (3, 2, 2 + q))
        for one in (found.observer, same):
            Q = one.system.evaluate(points)
            missed = Q @ np.concatenate([U, P], axis=1) - X
            assert np.abs(missed).max() < 1e-8 * scale * (1 + np.abs(P).max())


def test_run_sampled_the_error_shrinks_with_the_square_of_the_step() -> None:
    aircraft = rs.library.vtol()
    names = aircraft.faults[:2]
    estimator = fault_estimator(aircraft, faults=names, poles=[-3, -4, -5, -6], bandwidth=8)
    fine, end = 1e-4, 4.0
    times = np.arange(round(end / fine) + 1) * fine
    u = np.sign(np.sin(2.0 * np.floor(times / 0.04)))[:, None] * [1.0, 0.5]  # held over every step below
    f = np.column_stack([np.sin(3 * times), np.cos(times) - 1])
    plant = aircraft.without_faults(aircraft.faults[2:]).system(("control", "fault"))
    y = plant.discretize(fine, hold=["zero"] * 2 + ["linear"] * 2).simulate(np.hstack([u, f]))
    reference = estimator.estimate(u, y, dt=fine)
    errors = []
    for h in (0.04, 0.02, 0.01, 0.005):
        every = round(h / fine)
        errors.append(np.abs(estimator.estimate(u[::every], y[::every], dt=h) - reference[::every]).max())
    ratios = np.array(errors[:-1]) / errors[1:]
    assert ((ratios > 3.3) & (ratios < 4.7)).all(), errors


def test_a_jump_of_a_measurement_costs_first_order() -> None:
    aircraft = rs.library.vtol()
    estimator = fault_estimator(aircraft, faults=["pitch sensor", "collective actuator"], margin=2, bandwidth=5)
    errors = []
    for h in (0.02, 0.01, 0.005, 0.0025):
        times = np.arange(round(3 / h) + 1) * h
        y = np.zeros((len(times), 3))
        y[:, 2] = times >= 1
        estimate = estimator.estimate(np.zeros((len(times), 2)), y, dt=h)
        wanted = np.where(times >= 1, 1 - np.exp(-5 * (times - 1)), 0.0)
        errors.append(np.abs(estimate[:, 0] - wanted).max())
    ratios = np.array(errors[:-1]) / errors[1:]
    assert ((ratios > 1.6) & (ratios < 2.4)).all(), errors


def test_smoothing_of_a_sampled_estimate_is_a_first_order_filter() -> None:
    plant = rs.library.vtol().discretize(0.01)
    names = ["collective actuator", "pitch sensor"]
    estimator = fault_estimator(plant, faults=names, margin=5, bandwidth=20)
    rng = np.random.default_rng(0)
    f = rng.standard_normal((1200, 2))
    u = rng.standard_normal((1200, 2))
    every = np.zeros((1200, 5))
    every[:, [0, 4]] = f
    y = plant.system(("control", "fault")).simulate(np.hstack([u, every]))
    a = np.exp(-0.2)
    smooth = np.asarray(scipy.signal.lfilter([1 - a], [1, -a], f, axis=0))
    smooth[1:, 0] = smooth[:-1, 0]  # the actuator's is one step late
    np.testing.assert_allclose(estimator.estimate(u, y)[1000:], smooth[1000:], atol=1e-8)
    assert estimator.lag["pitch sensor"] == pytest.approx(0.01 * a / (1 - a))
    assert estimator.lag["collective actuator"] == pytest.approx(0.01 + 0.01 * a / (1 - a))


def test_the_noise_gain_in_the_evidence_is_what_noise_does() -> None:
    plant = rs.library.vtol().discretize(0.01).with_noise(process=1e-4, measurement=[1e-4, 4e-4, 1e-4])
    rng = np.random.default_rng(1)
    for names in (["collective actuator"], ["pitch sensor"]):
        estimator = fault_estimator(plant, faults=names, margin=5, bandwidth=30)
        y = plant.system("noise").simulate(rng.standard_normal((60000, len(plant.noises))))
        estimate = estimator.estimate(np.zeros((60000, 2)), y)[1000:]
        promised = estimator.evidence.conditions[f"noise of {names[0]}, rms"]
        assert np.sqrt(np.mean(estimate**2)) == pytest.approx(promised, rel=0.05)


def test_a_wider_bandwidth_passes_more_noise_and_follows_faster() -> None:
    gains, lags = [], []
    for bandwidth in (5, 50, 500):
        found = fault_estimator(rs.library.vtol(), faults="cyclic actuator", margin=5, bandwidth=bandwidth)
        gains.append(found.evidence.conditions["peak gain, outputs to cyclic actuator"])
        lags.append(found.lag["cyclic actuator"])
    assert gains == sorted(gains)
    assert lags == [1 / 5, 1 / 50, 1 / 500]


def test_white_noise_of_a_continuous_plant_is_said_to_have_no_variance() -> None:
    plant = rs.library.vtol().with_noise(measurement=1e-4)
    evidence = fault_estimator(plant, faults="cyclic actuator").evidence
    assert evidence.conditions["noise of cyclic actuator, rms"] == np.inf
    assert any("reaches the estimate of cyclic actuator directly" in note for note in evidence.notes)


@pytest.mark.parametrize("dt", [0.0, 0.01])
def test_as_residual_generator(dt: float) -> None:
    plant = rs.library.vtol() if not dt else rs.library.vtol().discretize(dt)
    names = ("collective actuator", "pitch sensor")
    generator = fault_estimator(plant, faults=names).residual_generator()
    assert generator.estimated == names
    assert generator.method == "fault estimator"
    columns = [plant.faults.index(name) for name in names]
    np.testing.assert_array_equal(generator.structure[:, columns], np.eye(2, dtype=bool))
    for k, name in enumerate(names):
        np.testing.assert_allclose(generator.steady_directions[name], np.eye(2)[k], atol=1e-9)
    check_residual_generator(generator)


def test_sampled_as_a_generator_it_is_the_sampled_estimator() -> None:
    plant = rs.library.vtol()
    estimator = fault_estimator(plant, faults=["collective actuator", "pitch sensor"], margin=5)
    sampled = estimator.residual_generator().discretize(0.01)
    assert sampled.estimated == estimator.faults
    check_residual_generator(sampled)
    rng = np.random.default_rng(0)
    u, y = rng.standard_normal((50, 2)), rng.standard_normal((50, 3))
    np.testing.assert_array_equal(sampled.run(u, y), estimator.estimate(u, y, dt=0.01))


def test_an_integrator_with_singular_a_is_no_obstacle() -> None:
    plant = rs.Plant([[0, 1], [0, 0]], [[0], [1]], [[1, 0], [0, 1]], inputs="force").with_actuator_faults()
    with pytest.raises(DesignError, match="A is singular, rank 1 < 2"):
        rs.design.inverse_form_observer(plant)
    generator = fault_estimator(plant, bandwidth=3).residual_generator()
    s = np.array([0.5, 1j, 2 + 1j])
    np.testing.assert_allclose(generator.internal_form().evaluate(s)[:, 0, 0], 1 / (s / 3 + 1), atol=1e-10)


def test_virtual_outputs_are_what_healthy_sensors_read() -> None:
    rng = np.random.default_rng(5)
    plant = random_plant(rng, n=4, outputs=3, inputs=2, faults=0, sensors=True, feedthrough=True, dt=0.1)
    estimator = fault_estimator(plant, faults="y2 sensor")
    u, f = rng.standard_normal((300, 2)), np.zeros((300, 3))
    f[100:, 1] = np.sin(np.arange(200.0))
    system = plant.system(("control", "fault"))
    healthy, y = system.simulate(np.hstack([u, 0 * f])), system.simulate(np.hstack([u, f]))
    late = slice(150, None)
    size = np.abs(y).max()
    np.testing.assert_allclose(estimator.virtual_outputs(u, y)[late], healthy[late], atol=1e-8 * size)
    np.testing.assert_allclose(y[late] - healthy[late], f[late], atol=1e-8 * size)
    assert np.abs(estimator.consistency().run(u, y)[late]).max() < 1e-8 * size


def test_the_bank_reports_the_sensors_that_cannot_be_estimated() -> None:
    plant = rs.Plant(np.diag([1.0, -1.0]), [[1], [1]], [[1, 0], [0, 1], [0, 2]], outputs=["only", "first", "second"])
    bank = rs.design.sensor_fault_estimators(plant)
    assert list(bank) == ["first", "second"]
    assert "detectable" in bank.failures["only"]
    with pytest.raises(KeyError, match="detectable"):
        bank["only"]
    assert "only: none" in str(bank)
    with pytest.raises(DesignError, match="no fault of a sensor"):
        rs.design.sensor_fault_estimators(plant, outputs=["only"])


def test_refusals_say_why() -> None:
    aircraft = rs.library.vtol()
    with pytest.raises(DesignError, match=r"cannot be told .*rank"):
        fault_estimator(aircraft.with_faults({"copy": aircraft.Bu[:, 0]}), faults=["copy", "collective actuator"])
    with pytest.raises(DesignError, match="no observer of the state ignores"):
        fault_estimator(aircraft)
    with pytest.raises(DesignError, match="no fault"):
        fault_estimator(aircraft.without_faults())
    with pytest.raises(SettingError, match="bandwidth"):
        fault_estimator(aircraft, faults="pitch sensor", bandwidth=0)
    with pytest.raises(ModelError, match="unknown fault"):
        fault_estimator(aircraft, faults="rotor")
    with pytest.raises(DesignError, match="enters the outputs"):
        rs.design.inverse_form_observer(aircraft, faults="pitch sensor")
    good = rs.design.inverse_form_observer(aircraft, faults=aircraft.faults[:2], poles=[-20, -25, -30, -50])
    with pytest.raises(DesignError, match="not stable"):
        rs.design.inverse_form_observer(aircraft, faults=aircraft.faults[:2], K=-good.K)
    with pytest.raises(DesignError, match="N_BF is singular"):
        rs.design.inverse_form_observer(aircraft, faults=aircraft.faults[:2], K=0 * good.K)
    with pytest.raises(DesignError, match="poles or K"):
        rs.design.inverse_form_observer(aircraft, faults=aircraft.faults[:2], K=np.zeros((4, 3)), poles=[-1] * 4)


def test_a_sensor_filter_makes_sensor_faults_actuator_faults_in_sampled_time_too() -> None:
    plant = rs.library.vtol().discretize(0.02)
    extended = rs.plant.augment_sensor_filter(plant, ["pitch"], 10)
    rng = np.random.default_rng(3)
    v = rng.standard_normal((100, 2 + 5))
    raw = plant.system(("control", "fault")).simulate(v)
    filtered = rs.plant.sensor_filter(plant, ["pitch"], 10).simulate(raw)
    np.testing.assert_allclose(extended.system(("control", "fault")).simulate(v), filtered, atol=1e-10)
    with pytest.raises(ModelError, match="rate"):
        rs.plant.augment_sensor_filter(plant, ["pitch"], -1)
