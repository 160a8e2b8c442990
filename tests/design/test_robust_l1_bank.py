"""Robust l1 banks of generated loops: what they guarantee, their options, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

import residua as rs
from effort import cases
from residua.design import DifferentialEvolution, GeneticSearch
from residua.errors import DesignError
from residua.linear import StateSpace, peak_input, peak_norm
from residua.plant import Perturbation, UncertainPlant
from residua.robust.sets.uncertain_loop import residual_over_set
from robust_loops import random_loop

QUICK = DifferentialEvolution(population=30, generations=15, polish=False)


def members_of(loop: UncertainPlant, seed: int, count: int) -> np.ndarray:
    """Return parameters: every corner, and members drawn at random."""
    return np.vstack([loop.vertex_values(), loop.sample_values(seed, count)])


def largest_residuals(loop, one, values, samples=600):
    """Simulate members of the set, each with the disturbance that is worst for it, and return the largest |r|."""
    found = []
    for v in values:
        plant = loop.member(v)
        system = residual_over_set(loop, one.filter, one.state_map).member(v - loop.nominal_values)
        w = peak_input(system, peak_norm(system, rtol=1e-4), samples)
        y = StateSpace(plant.A, plant.Bd, plant.C, plant.Dd, dt=plant.dt).simulate(w)
        found.append(np.abs(one.filter.simulate(y)).max())
    return np.array(found)


def check(loop: UncertainPlant, bank: rs.design.RobustL1Bank, seed: int, count: int) -> None:
    """Compare what the bank says with simulations of members, and with frequency responses."""
    values = members_of(loop, seed, count)
    for name, one in bank.estimators.items():
        found = largest_residuals(loop, one, values)
        assert found.max() <= one.threshold
        assert found.max() <= one.certificate.attained * (1 + 1e-3)
        gains = residual_over_set(loop, one.filter, one.state_map, signals=[name])
        shifted = values - loop.nominal_values
        least = min(np.abs(gains.member(v).frequency_response([0.0])).max() for v in shifted)
        assert 0 < one.sensitivity.bound <= least * (1 + 1e-9)
        for other in one.decoupled:
            leak = residual_over_set(loop, one.filter, one.state_map, signals=[other])
            assert peak_norm(leak.member(np.zeros(len(loop.names)))).value < 1e-7 * one.sensitivity.bound
            assert max(peak_norm(leak.member(v)).attained for v in shifted) <= one.leakage[other] * (1 + 1e-9) + 1e-12


def response_changes_sign(loop: UncertainPlant, options: dict) -> bool:
    """Tell whether the steady response to some target is zero within the set, as it is where its sign changes.

    The residuals with one row that ignore the same faults are filtered versions of one another: any will do.
    """
    plant = loop.nominal
    for name in options.get("faults", plant.faults):
        ignored = [other for other in options.get("decouple", plant.faults) if other != name]
        aim = plant.without_disturbances()
        one = rs.design.decoupled_residual(aim, insensitive_to=ignored)
        system = residual_over_set(loop, one.system, one.state_map, signals=[name])
        values = members_of(loop, 0, 2000) - loop.nominal_values
        steady = [system.member(v).frequency_response([0.0])[0, :, 0].real for v in values]
        if len(steady[0]) == 1 and min(steady)[0] * max(steady)[0] < 0:
            return True
    return False


@pytest.mark.parametrize("seed", [1, 2, 5])
def test_no_member_exceeds_its_threshold(seed):
    loop = random_loop(seed)
    # one with all that the default may try for its certificate
    method = None if seed == 2 else "centred"
    bank = rs.design.robust_l1_bank(loop, search=QUICK, method=method, progress=False)
    check(loop, bank, seed, 10)
    assert np.array_equal(bank.structure, np.eye(len(bank.members), dtype=bool))


@pytest.mark.campaign
@pytest.mark.parametrize("seed", range(200))
def test_no_member_exceeds_its_threshold_on_200_loops(seed):
    loop = random_loop(seed, actuator=seed % 4 == 0)
    options = {"faults": loop.nominal.faults[:2], "decouple": loop.nominal.faults[1:2]} if seed % 4 == 0 else {}
    try:
        bank = rs.design.robust_l1_bank(loop, search=QUICK, progress=False, **options)
    except DesignError:
        bank = None
    if bank is None:
        assert response_changes_sign(loop, options)
    else:
        check(loop, bank, seed, 20)


@pytest.mark.parametrize("seed", cases([3, 4], 1))
def test_both_searches_find_the_same_cost(seed):
    """Within two per cent, before and after the local search."""
    loop = random_loop(seed)
    target = loop.nominal.faults[0]
    by = {
        name: rs.design.robust_l1_bank(loop, [target], search=name, method="centred", band=5.0, progress=False)
        for name in ("genetic", "differential-evolution")
    }
    costs = [bank.estimators[target].search for bank in by.values()]
    assert costs[0].cost == pytest.approx(costs[1].cost, rel=0.02)
    assert costs[0].unpolished == pytest.approx(costs[1].unpolished, rel=0.02)
    assert {result.method for result in costs} == {"genetic", "differential evolution"}


def test_interrupted_genetic_search_goes_on(tmp_path):
    loop = random_loop(2)
    options = {"search": GeneticSearch(population=24, generations=12, polish=False), "progress": False}
    whole = rs.design.robust_l1_bank(loop, method="centred", **options)

    class StopError(Exception):
        pass

    def stop(stage, done, total):
        if "search" in stage and done == 5:
            raise StopError

    with pytest.raises(StopError):
        rs.design.robust_l1_bank(loop, method="centred", checkpoint=tmp_path, search=options["search"], progress=stop)
    assert list(tmp_path.iterdir())
    again = rs.design.robust_l1_bank(loop, method="centred", checkpoint=tmp_path, **options)
    for name, one in whole.estimators.items():
        assert np.array_equal(one.filter.B, again.estimators[name].filter.B)
        assert one.threshold == again.estimators[name].threshold


def test_sizes_cover_what_leaks():
    """With the size of another fault declared, no course of it that keeps to its size raises an alarm."""
    loop = random_loop(5)
    target, other = loop.nominal.faults[:2]
    plain = rs.design.robust_l1_bank(loop, [target], search=QUICK, method="centred", progress=False)
    covered = rs.design.robust_l1_bank(
        loop, [target], sizes={other: 200.0}, search=QUICK, method="centred", progress=False
    )
    one = covered.estimators[target]
    assert one.certificate.sizes == {other: 200.0}
    ratio = [b.estimators[target].threshold / b.estimators[target].sensitivity.bound for b in (plain, covered)]
    assert ratio[1] > ratio[0]
    exceeds_alone = []
    for v in loop.vertex_values():
        d = v - loop.nominal_values
        own = residual_over_set(loop, one.filter, one.state_map).member(d)
        leak = residual_over_set(loop, one.filter, one.state_map, signals=[other]).member(d)
        w, f = (peak_input(s, peak_norm(s), 600) for s in (own, leak))
        plant = loop.member(v)
        k = plant.faults.index(other)
        both = StateSpace(
            plant.A,
            np.hstack([plant.Bd, plant.Bf[:, [k]]]),
            plant.C,
            np.hstack([plant.Dd, plant.Df[:, [k]]]),
            dt=plant.dt,
        )
        r = max(np.abs(one.filter.simulate(both.simulate(np.hstack([w, s * 200.0 * f])))).max() for s in (1, -1))
        assert r <= one.threshold
        exceeds_alone.append(r > one.certificate.disturbances.bound)
    assert any(exceeds_alone)  # without the size it would have been a false alarm


def test_thresholds_go_into_a_monitor_and_a_file(tmp_path):
    loop = random_loop(1)
    bank = rs.design.robust_l1_bank(loop, search=QUICK, method="centred", progress=False)
    monitor = rs.Monitor(bank)
    assert monitor.norm_test.thresholds == pytest.approx(list(bank.thresholds.values()))
    rng = np.random.default_rng(0)
    w = rng.standard_normal((3000, 2))
    w /= np.linalg.norm(w, axis=1, keepdims=True)
    name = bank.members[-1]
    f = np.zeros((3000, len(loop.nominal.faults)))
    f[1500:, loop.nominal.faults.index(name)] = 1.01 * bank.smallest_faults[name]
    plant = loop.member(loop.vertex_values()[3])
    both = StateSpace(plant.A, np.hstack([plant.Bd, plant.Bf]), plant.C, np.hstack([plant.Dd, plant.Df]), dt=plant.dt)
    y = both.simulate(np.hstack([w, f]))
    found = monitor.run(None, y)
    assert not found.parts.fired[:1500].any()
    assert found.parts.fired[-1, bank.members.index(name)]
    monitor.save(tmp_path / "bank.json")
    again = rs.Monitor.load(tmp_path / "bank.json").run(None, y)
    assert np.array_equal(again.parts.fired, found.parts.fired)
    assert np.array_equal(again.residuals, found.residuals)


def test_band_buys_a_faster_response():
    loop = random_loop(3)
    name = loop.nominal.faults[0]
    slow, fast = (
        rs.design.robust_l1_bank(loop, [name], band=band, method="centred", progress=False).estimators[name]
        for band in (0.0, 10.0)
    )

    def visible(one, omega):
        system = residual_over_set(loop, one.filter, one.state_map, signals=[name]).member(np.zeros(len(loop.names)))
        return np.abs(system.frequency_response([omega])).max() / one.threshold

    assert visible(fast, 10.0) > visible(slow, 10.0)
    assert slow.smallest_fault <= 1.01 * fast.smallest_fault
    assert fast.sensitivity.band == 10.0


def test_thresholds_of_any_filter():
    loop = random_loop(3)
    observer = rs.design.luenberger_observer(loop.nominal, margin=1.0).residual_generator()
    (found,) = rs.design.certified_thresholds(observer, loop, method="centred").values()
    for v in members_of(loop, 0, 10):
        system = residual_over_set(loop, observer.system, observer.state_map).member(v - loop.nominal_values)
        assert peak_norm(system, rtol=1e-4).attained <= found.value
    assert found.value == found.disturbances.bound
    bank = rs.design.robust_l1_bank(loop, search=QUICK, method="centred", progress=False)
    again = rs.design.certified_thresholds(bank, loop, method="centred")
    assert {name: float(t) for name, t in again.items()} == pytest.approx(bank.thresholds, rel=1e-6)
    wider = rs.design.certified_thresholds(bank, loop, sizes={loop.nominal.faults[0]: 5.0}, method="centred")
    assert float(wider[bank.members[1]]) >= bank.thresholds[bank.members[1]]
    assert float(wider[bank.members[0]]) == pytest.approx(bank.thresholds[bank.members[0]], rel=1e-6)


def test_fault_that_vanishes_is_refused():
    """A washout in the sensor: constant faults leave no trace, and a threshold for them would promise nothing."""
    plant = rs.Plant([[0.9, 0], [0, 0.5]], [[], []], [[1, 0], [0, 1]], dt=1.0)
    plant = plant.with_disturbances([[0.1], [0.1]], output=[[0.1], [0.1]])
    plant = plant.with_faults({"glitch": ([-0.1, 0], [1, 0])})  # (z - 1) / (z - 0.9) in y1
    loop = UncertainPlant(plant, deltas=[Perturbation("A", [[0], [1]], [[0, 1]], 0, 0.1, ["a"])])
    with pytest.raises(DesignError, match="glitch"):
        rs.design.robust_l1_bank(loop, search=QUICK, method="centred", progress=False)


@pytest.mark.parametrize("low", [0.0, -0.02])
def test_disturbances_that_reach_the_residual_off_nominal_only(low):
    plant = rs.Plant(np.diag([0.9, 0.5]), np.zeros((2, 0)), [[1.0, 0]], dt=1.0, outputs=["a"])
    plant = plant.with_disturbances([[0.0], [1.0]]).with_sensor_faults()
    loop = UncertainPlant(plant, deltas=[Perturbation("A", [[-1.0], [0]], [[0, 1.0]], low, 0.02, ["p"])])
    bank = rs.design.robust_l1_bank(loop, search=QUICK, method="centred", progress=False)
    check(loop, bank, 0, 10)
    # y = w 0.02 / ((z - 0.9) (z - 0.5)) at most, of which the gain is 0.4
    assert bank.smallest_faults["a sensor"] == pytest.approx(0.8, rel=0.05)


def test_without_uncertainty_the_threshold_is_the_exact_norm():
    plant = random_loop(2).nominal
    bank = rs.design.robust_l1_bank(UncertainPlant(plant), search=QUICK, method="centred", progress=False)
    for one in bank.estimators.values():
        assert one.threshold == pytest.approx(one.certificate.attained, rel=2e-4)
