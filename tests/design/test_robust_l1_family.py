"""What the estimators of a family have in common, and the cost of many of them at once."""

from __future__ import annotations

import numpy as np
import pytest

import residua as rs
from effort import cases
from residua.errors import DesignError
from residua.linear import StateSpace, peak_norm
from residua.linear.norms import lmi
from residua.robust.estimators.estimator_family import estimator_family
from residua.robust.estimators.sampled_cost import PENALTY, Norms, Weights, sampled_cost
from residua.robust.estimators.starting_gains import error_system, least_star_gains, starting_gains
from residua.robust.sets.uncertain_loop import residual_over_set
from robust_loops import random_loop

NONE = np.zeros(0)


def others(loop: rs.UncertainPlant, target: str) -> tuple[str, ...]:
    return tuple(name for name in loop.nominal.faults if name != target)


def points(family, count: int, seed: int = 0) -> np.ndarray:
    return 0.2 * np.random.default_rng(seed).standard_normal((count, family.size))


@pytest.mark.parametrize("seed", range(12))
def test_no_nuisance_reaches_any_member_of_a_family(seed):
    loop = random_loop(seed)
    plant = loop.nominal
    for target in plant.faults:
        nuisances = others(loop, target)
        family = estimator_family(plant, target, nuisances)
        columns = [plant.faults.index(name) for name in nuisances]
        for point in points(family, 5, seed):
            one, T = family.estimator(point)
            assert family.full
            # W R2k = R1k and P R2k = 0
            assert np.abs(one.B @ plant.Df[:, columns] - T @ plant.Bf[:, columns]).max() < 1e-12
            assert np.abs(one.D @ plant.Df[:, columns]).max() < 1e-12
            leak = residual_over_set(loop, one, T, signals=nuisances).member(NONE if not loop.names else [0, 0, 0])
            own = residual_over_set(loop, one, T, signals=[target]).member([0, 0, 0])
            frequencies = np.linspace(0, np.pi / plant.dt, 20)
            assert np.abs(leak.frequency_response(frequencies)).max() < 1e-9
            assert np.abs(own.frequency_response(frequencies)).max() > 1e-3


@pytest.mark.parametrize("seed", [3, 4, 6, 8])
def test_faults_of_actuators_are_divided_out(seed):
    """No gain solves ``W R2k = R1k`` for them, for ``R2k`` is zero."""
    loop = random_loop(seed, actuator=True)
    plant = loop.nominal
    names = ("actuator",)
    for target in plant.faults[:-1]:
        family = estimator_family(plant, target, names)
        assert not family.full
        for point in points(family, 3, seed):
            one, T = family.estimator(point)
            leak = residual_over_set(loop, one, T, signals=names).member([0, 0, 0])
            assert np.abs(leak.frequency_response(np.linspace(0, 30, 20))).max() < 1e-9


def test_refused_where_the_outputs_are_used_up():
    loop = random_loop(3, actuator=True)
    with pytest.raises(DesignError, match="all used up"):
        estimator_family(loop.nominal, "actuator", others(loop, "actuator"))


@pytest.mark.parametrize("seed", range(8))
def test_cost_is_made_of_the_exact_norms(seed):
    loop = random_loop(seed)
    plant = loop.nominal
    decoupled = plant.faults[1:-1]  # the last is bounded, not decoupled: two combinations are free
    family = estimator_family(plant, plant.faults[0], decoupled)
    values = [loop.nominal_values, *loop.vertex_values()[:3], *loop.sample_values(seed, 2)]
    members = [loop.member(v) for v in values]
    weights = Weights(0.3, 0.7)
    bounded = {plant.faults[-1]: 0.5}
    cost = sampled_cost(family, members, weights, radius=0.98, band=4.0, bounded=bounded)
    stable = starting_gains(family, 0.98)[2]
    tried = points(family, 30, seed) + family.point(stable, np.zeros(family.rows))
    found = cost.norms(tried)
    disturbance, fault, radius = found.disturbance, found.fault, found.radius
    assert np.isfinite(disturbance).sum() >= 5
    for k in np.flatnonzero(np.isfinite(disturbance))[:5]:
        one, T = family.estimator(tried[k])
        assert radius[k] == pytest.approx(np.abs(one.poles()).max())
        shifted = [v - loop.nominal_values for v in values]
        own = residual_over_set(loop, one, T)
        leak = residual_over_set(loop, one, T, signals=[plant.faults[-1]], sizes={plant.faults[-1]: 0.5})
        target = residual_over_set(loop, one, T, signals=[plant.faults[0]])
        alone = [peak_norm(own.member(v)).value for v in shifted]
        sums = [peak_norm(own.member(v)).value + peak_norm(leak.member(v)).value for v in shifted]
        gains = [np.abs(target.member(v).frequency_response(np.linspace(0, 4.0, 9))).min() for v in shifted]
        assert disturbance[k] == pytest.approx(max(sums), rel=3e-3)  # tails are cut, and directions few
        assert found.alone[k] == pytest.approx(max(alone), rel=3e-3)
        assert fault[k] == pytest.approx(min(gains), rel=1e-9)
        plain = weights.cost(disturbance[k], fault[k])
        assert plain < cost(tried[k : k + 1])[0] < 1.0021 * plain
    slow = cost(tried)[~np.isfinite(disturbance)]
    assert np.all(slow >= PENALTY)


def test_cost_of_slow_loops_by_longer_steps():
    """The impulse response of a loop with a pole at 0.9999 is summed in 1500 steps instead of 90 000."""
    plant = rs.Plant([[0.9999, 0.001], [0, 0.9]], [[], []], [[1, 0], [0, 1]], dt=0.01)
    plant = plant.with_disturbances([[0.001, 0], [0, 0.1]], output=[[0.1, 0], [0, 0.1]]).with_sensor_faults()
    loop = rs.UncertainPlant(plant, deltas=[rs.plant.Perturbation("A", [[0], [1]], [[0, 1]], 0, 0.01, ["a"])])
    family = estimator_family(plant, "y1 sensor", ("y2 sensor",))
    cost = sampled_cost(family, [plant], Weights(0.5, 1.0), radius=0.99995)
    tried = np.vstack([np.zeros(2), points(family, 20) * np.logspace(-3, 0, 20)[:, None]])
    found = cost.norms(tried).disturbance
    usable = np.flatnonzero(np.isfinite(found))
    assert len(usable) >= 5
    for k in usable:
        one, T = family.estimator(tried[k])
        exact = peak_norm(residual_over_set(loop, one, T).member([0])).value
        assert found[k] == pytest.approx(exact, rel=2e-3)


def test_any_cost_is_below_that_of_what_is_of_no_use():
    """However large, and in their order; small ones are what they are."""
    loop = random_loop(3)
    family = estimator_family(loop.nominal, loop.nominal.faults[0], others(loop, loop.nominal.faults[0]))
    cost = sampled_cost(family, [loop.nominal], Weights(0.0, 1.0), radius=0.95)
    ratios = np.logspace(-3, 30, 400)
    one, radius = np.ones(400), np.full(400, 0.95)
    found = cost.ranked(Norms(ratios, ratios, one, radius))
    useless = cost.ranked(Norms(ratios, ratios, 0 * one, radius))
    assert found.max() < PENALTY <= useless.min()
    assert np.all(np.diff(found) >= 0)
    small = ratios < PENALTY / 3
    assert found[small] == pytest.approx(1.002 * ratios[small], rel=1e-12)


def test_size_of_the_residual_is_the_best_one():
    weights = Weights(0.3, 0.7)
    scale = weights.scale(2.0, 5.0)
    sizes = scale * np.array([0.99, 1.0, 1.01])
    costs = 0.3 * 2 * sizes + 0.7 / (5 * sizes) + 0.7 * 2 / 5
    assert costs.argmin() == 1
    assert costs[1] == pytest.approx(weights.cost(np.array(2.0), np.array(5.0)))


@pytest.mark.skipif(not lmi.has_solver(), reason="needs the extra lmi")
@pytest.mark.parametrize("seed", cases(range(4), 2))
def test_convex_start_is_the_least_star_norm(seed):
    """Nothing that is tried from Kalman gains on, at random, has a smaller star norm."""
    loop = random_loop(seed)
    family = estimator_family(loop.nominal, loop.nominal.faults[0], others(loop, loop.nominal.faults[0]))
    s = error_system(family)

    def star(Z):
        closed = StateSpace(s.A - Z @ s.C, s.B - Z @ s.D, s.C, s.D, dt=1.0)
        return peak_norm(closed, kind="star").value if closed.is_stable() else np.inf

    convex = min(star(Z) for Z in least_star_gains(s, np.linspace(0.05, 0.9, 8)))
    rng = np.random.default_rng(seed)
    starts = starting_gains(family, 0.95)
    assert len(starts) >= 4
    tried = [Z + size * rng.standard_normal(Z.shape) for Z in starts for size in (0, 0.01, 0.1, 1) for _ in range(10)]
    different = {Z.tobytes(): Z for Z in tried}  # a start itself is there ten times
    assert convex <= 1.03 * min(star(Z) for Z in different.values())
