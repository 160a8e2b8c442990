"""Fault estimators: what is estimated is the fault, whatever else happens; and who is refused is refused rightly."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
import scipy.linalg

import residua as rs
from generated import nth, random_plant, singular_plant
from residua.design import FaultEstimator, fault_estimator
from residua.errors import AccuracyError, DesignError
from residua.linear import invariant_zeros

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
    except AccuracyError as error:
        assert plant.E is not None  # an ordinary plant of this size is never too badly conditioned
        return str(error)


@dataclass(frozen=True)
class Case:
    """A generated plant, faults of it that can be estimated, and their estimator."""

    seed: int
    plant: rs.Plant
    faults: list[str]
    estimator: FaultEstimator


def case(seed: int, plant: rs.Plant, faults: list[str]) -> Case | None:
    try:
        return Case(seed, plant, faults, fault_estimator(plant, faults=faults))
    except DesignError:
        return None  # rightly so: see the first test


def as_generated(seed: int) -> Case | None:
    found = attempt(seed)
    return None if isinstance(found, str) else Case(seed, *generated(seed), found)


def sampled(seed: int) -> Case | None:
    """Return a case in sampled time without algebraic equations whose error decays before the plant runs away."""
    plant, _ = generated(seed)
    if plant.E is not None:
        return None
    if plant.dt:
        found = as_generated(seed)
    else:
        plant = rs.Plant(plant.A / np.abs(np.linalg.eigvals(plant.A)).max(), plant.B, plant.C, plant.D, dt=0.1)
        plant = plant.with_faults({"f0": np.random.default_rng(seed).standard_normal(plant.n_states)})
        found = case(seed, plant, ["f0"])
    return found if found is not None and np.abs(found.estimator.observer.poles).max() <= 0.9 else None


def continuous(seed: int) -> Case | None:
    """Return a case in continuous time without algebraic equations whose error decays before the plant runs away."""
    plant, faults = generated(seed)
    found = as_generated(seed) if plant.E is None and not plant.dt else None
    if found is None:
        return None
    growth = plant.system(()).poles().real.max()
    if growth * 30 / -found.estimator.system.poles().real.max() <= 12:
        return found
    slower = rs.Plant(plant.A - (growth + 0.1) * np.eye(plant.n_states), plant.B, plant.C, plant.D)
    slower = slower.with_disturbances(
        {name: (plant.Bd[:, i], plant.Dd[:, i]) for i, name in enumerate(plant.disturbances)}
    ).with_faults({name: (plant.Bf[:, i], plant.Df[:, i]) for i, name in enumerate(plant.faults)})
    return case(seed, slower, faults)


nth_case, nth_sampled, nth_continuous = nth(as_generated), nth(sampled), nth(continuous)


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
    found = wrong = inaccurate = 0
    for seed in SEEDS:
        plant, faults = generated(seed)
        if plant.E is not None:
            inaccurate += "badly" in str(attempt(seed))
            continue
        outcome = attempt(seed)
        answer = not isinstance(outcome, str)
        assert answer or "rank" in outcome or "detectable" in outcome
        found += answer
        wrong += answer != exists(plant, faults)
    assert wrong == 0
    assert inaccurate <= 1
    assert 60 < found < 150  # both answers are among them


@pytest.mark.parametrize("k", range(140))
def test_the_estimate_is_the_fault_and_nothing_else_by_transfer_matrices(k: int) -> None:
    """Independent of any state: filter times plant, at points right of all poles, where both are convergent."""
    found = nth_case(k)
    seed, plant, faults, estimator = found.seed, found.plant, found.faults, found.estimator
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
    limit = 1e-8
    if plant.E is not None:
        # The free modes of a singular plant may be seen so faintly that rounding of the filter's numbers shows: one of
        # the 200 takes a gain of 2e6 beside poles of 0.3, and changing its entries by 2**-53 lets up to 1e-5 of a
        # control through. The evidence says how much it is, and what is beyond 1e-7 is refused.
        limit = max(limit, *estimator.evidence.decoupling.values())
        assert limit <= 1e-7
    assert (np.abs(Qu + Qy @ P[..., :n_u]) <= limit * (np.abs(Qu) + size[..., :n_u])).all()
    assert (np.abs(Qy @ P[..., n_u : n_u + n_d]) <= limit * size[..., n_u : n_u + n_d]).all()
    columns = [n_u + n_d + plant.faults.index(name) for name in faults]
    for j, name in enumerate(faults):
        lag = estimator.lag[name]
        if not plant.dt:
            wanted = 1 / (lag * points + 1)
        else:
            a = np.exp(-4.0 * plant.dt) if seed % 3 == 0 else 0.0
            delay = round(lag / plant.dt - a / (1 - a))
            assert delay in (0, 1)
            wanted = (1 - a) / (1 - a / points) * points ** float(-delay)
        for i in range(len(faults)):
            missed = np.abs((Qy @ P[..., columns])[:, i, j] - (wanted if i == j else 0.0))
            assert (missed <= limit * (1 + size[:, i, columns[j]])).all()


@pytest.mark.parametrize("k", range(140))
def test_sampled_estimates_are_exact_with_one_step_of_delay_at_most(k: int) -> None:
    found = nth_sampled(k)
    plant, faults, estimator = found.plant, found.faults, found.estimator
    rng = np.random.default_rng(found.seed)
    slow = np.abs(estimator.observer.poles).max()
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
    for j, name in enumerate(faults):
        delay = round(estimator.lag[name] / plant.dt)
        late = f[steps - delay : len(f) - delay, columns[j]]
        assert np.abs(estimate[steps:, j] - late).max() < 1e-8 * size


@pytest.mark.parametrize("k", range(60))
def test_continuous_constants_are_exact_and_ramps_late_by_the_lag(k: int) -> None:
    """Plant, estimator, constant inputs and a fault ``a + b t`` as one autonomous system, by its exponential."""
    found = nth_continuous(k)
    plant, faults, estimator = found.plant, found.faults, found.estimator
    time = 30 / min(-estimator.system.poles().real.max(), 1e3)
    rng = np.random.default_rng(found.seed)
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
    """Not every plant serves the tests above; here is what kinds of them do."""
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
    found = rs.design.inverse_form_observer(plant, poles=poles)
    o = found.observer
    np.testing.assert_allclose(
        o.F @ found.N_BF, np.eye(n), atol=1e-9 * np.linalg.norm(o.F) * np.linalg.norm(found.N_BF)
    )
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


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"poles": [0.1, 0.2, 0.3, 0.4]}, "^got 4 poles for 3 states"),
        ({"poles": [0.2, 1.5]}, "^pole 1.5 is not stable"),
        ({"margin": -1.0}, "^margin must be"),
    ],
)
def test_wrong_poles_are_not_said_to_be_a_matter_of_the_plant(options: dict, message: str) -> None:
    with pytest.raises(DesignError, match=message) as refusal:
        fault_estimator(rs.library.gertler(), **options)
    assert "fewer faults" not in str(refusal.value)


def test_a_plant_without_such_an_observer_is_refused_whatever_the_poles() -> None:
    plant = rs.library.gertler().with_sensor_faults()
    with pytest.raises(DesignError, match=r"no observer of the state ignores p1, p2, .*estimate fewer faults at once"):
        fault_estimator(plant, poles=[0.2])


def test_as_many_faults_as_outputs_are_estimated_past_fixed_poles() -> None:
    """An inverse of the plant: its zero is a fixed pole, and the estimate converges though no residual is left."""
    plant = rs.Plant([[-1, 1], [1, -3]], [[1], [0]], [[1, 0]]).with_faults({"leak": [1, 0]})
    estimator = fault_estimator(plant)
    np.testing.assert_allclose(estimator.observer.evidence.fixed_poles, -3)
    time = np.arange(0, 12, 0.01)
    y = plant.system("fault").discretize(0.01).simulate(np.ones((len(time), 1)), x0=[0.3, -0.5])
    estimate = estimator.estimate(np.zeros((len(time), 1)), y, dt=0.01)
    np.testing.assert_allclose(estimate[-100:], 1, atol=1e-6)


def test_an_estimate_that_no_measurement_corrects_is_refused() -> None:
    plant = rs.Plant([[-1, 1], [1, -3]], [[1], [0]], [[1, 0], [0, 1]]).with_sensor_faults()
    with pytest.raises(DesignError, match=r"no pole of an estimate that ignores .* is free"):
        fault_estimator(plant)
    fault_estimator(plant, faults=plant.faults[:1])
