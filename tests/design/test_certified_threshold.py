"""Certified thresholds: what they say, what they refuse, and that parts of a bank are certified as its members were."""

from __future__ import annotations

import numpy as np
import pytest

import residua as rs
from residua.errors import DesignError
from residua.linear import StateSpace, peak_norm
from residua.plant import Perturbation, UncertainPlant
from residua.robust.estimators.certified_threshold import _part, certified_threshold, left_out, rounding_scale
from residua.robust.sets.uncertain_loop import residual_over_set
from robust_loops import random_loop

A = np.array([[0.9, 0.05, 0], [0.013, 0.57, 0.1], [0.2, 0, 0.4]])


def three_states(**disturbances) -> rs.Plant:
    plant = rs.Plant(A, np.zeros((3, 0)), np.eye(3), dt=1.0, outputs=["a", "b", "c"])
    return plant.with_disturbances(disturbances).with_sensor_faults()


def decoupled() -> tuple[UncertainPlant, rs.design.ResidualGenerator]:
    """Return a loop, uncertain along its disturbance, and an observer that neither of them reaches."""
    plant = three_states(gust=[0.3, 0.7, 0.1])
    loop = UncertainPlant(plant, [Perturbation("A", [[0.3], [0.7], [0.1]], [[1.0, 0, 2]], -0.05, 0.05, ["p"])])
    return loop, rs.design.unknown_input_observer(plant, poles=[0.1, 0.2, 0.3]).residual_generator()


# ------------------------------------------------------------------------ rounding


def test_disturbances_that_are_decoupled_give_no_threshold():
    """It would be 1e-16, and every sample without a fault an alarm."""
    loop, observer = decoupled()
    with pytest.raises(DesignError, match=r"do not reach this residual.*NormThreshold"):
        rs.design.certified_thresholds(observer, loop)


@pytest.mark.parametrize("seed", range(6))
def test_decoupled_in_units_far_apart(seed):
    rng = np.random.default_rng(seed)
    S, y = 10.0 ** rng.uniform(-4, 4, 5), 10.0 ** rng.uniform(-3, 3, 3)
    own = rng.standard_normal((5, 5))
    own *= 0.9 / np.abs(np.linalg.eigvals(own)).max()
    plant = rs.Plant(own * S[:, None] / S, np.zeros((5, 0)), y[:, None] * rng.standard_normal((3, 5)) / S, dt=1.0)
    plant = plant.with_disturbances(S[:, None] * rng.standard_normal((5, 1))).with_sensor_faults()
    poles = [0.1, 0.2, 0.3, 0.4, 0.5]
    blind = rs.design.unknown_input_observer(plant, poles=poles).residual_generator()
    with pytest.raises(DesignError, match="do not reach"):
        rs.design.certified_thresholds(blind, UncertainPlant(plant), method="centred")
    seeing = rs.design.luenberger_observer(plant, poles=poles).residual_generator()
    (found,) = rs.design.certified_thresholds(seeing, UncertainPlant(plant), method="centred").values()
    assert found.value >= found.attained > 0


@pytest.mark.parametrize("leak", [1e-6, 1e-3])
def test_small_thresholds_that_mean_something_live(leak):
    """A disturbance that is decoupled but for a small part."""
    _, observer = decoupled()
    plant = three_states(gust=np.array([0.3, 0.7, 0.1]) + leak * np.array([1.0, -1.0, 0.5]))
    (found,) = rs.design.certified_thresholds(observer, UncertainPlant(plant, [])).values()
    assert found.attained <= found.value <= 1.02 * found.attained
    assert 0.01 * leak < found.value / rounding_scale(plant, observer.system, ["gust"]) < leak


def test_disturbances_without_effect_are_refused_and_bounded_faults_may_stand_in():
    plant = rs.Plant(np.diag([0.9, 0.5]), np.zeros((2, 0)), [[1.0, 0]], dt=1.0)
    loop = UncertainPlant(plant.with_disturbances([[0.0], [1.0]]).with_sensor_faults())
    observer = StateSpace([[0.2]], [[0.7]], [[-1.0]], [[1.0]], dt=1.0)
    with pytest.raises(DesignError, match="do not reach"):
        certified_threshold(loop, observer)
    found = certified_threshold(loop, observer, sizes={"y1 sensor": 0.5})
    assert found.value == pytest.approx(0.5 * found.leakage["y1 sensor"])


def test_disturbances_by_way_of_the_uncertainty_only():
    plant = rs.Plant(np.diag([0.9, 0.5]), np.zeros((2, 0)), [[1.0, 0]], dt=1.0).with_disturbances([[0.0], [1.0]])
    loop = UncertainPlant(plant, [Perturbation("A", [[-1.0], [0]], [[0, 1.0]], 0, 0.02, ["p"])])
    found = certified_threshold(loop, StateSpace(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[1.0]], dt=1.0))
    assert found.value >= found.attained == pytest.approx(0.4)  # 0.02 / ((1 - 0.9) (1 - 0.5))
    assert found.disturbances.worst == {"p": 0.02}


def test_a_bounded_fault_that_is_decoupled_hides_no_small_threshold():
    plant = three_states(gust=[0.3, 0.7, 0.1]).with_faults({"leak": [0.3, 0.7, 0.1]})
    observer = rs.design.unknown_input_observer(plant, poles=[0.1, 0.2, 0.3]).residual_generator()
    other = plant.without_disturbances().with_disturbances({"noise": [1e-6, 0, 0]})
    found = certified_threshold(UncertainPlant(other), observer.system, observer.state_map, sizes={"leak": 1e6})
    assert found.value > found.disturbances.bound > 1e-8
    # rounding of so large a fault is covered
    y = StateSpace(other.A, other.Bf[:, [-1]], other.C, other.Df[:, [-1]], dt=1.0).simulate(np.full((500, 1), 1e6))
    assert np.linalg.norm(observer.system.simulate(y), axis=1).max() <= 1e6 * found.leakage["leak"]


# ---------------------------------------------------------------------- parameters


def first_order(values):
    return rs.Plant([[values["pole"]]], [[]], [[1.0]], dt=1.0).with_disturbances([[0.1]]).with_sensor_faults()


def test_the_worst_member_is_told_by_its_parameters():
    loop = UncertainPlant.from_parameters(first_order, {"pole": (0.1, 0.5, 0.9)})
    observer = rs.design.luenberger_observer(loop.nominal, poles=[0.2]).residual_generator()
    found = certified_threshold(loop, observer.system, observer.state_map, faults=loop.nominal.faults)
    assert found.disturbances.worst == {"pole": 0.9}
    member = UncertainPlant(loop.member(found.disturbances.worst))
    own = peak_norm(residual_over_set(member, observer.system, observer.state_map).member([])).value
    assert own == pytest.approx(found.attained, rel=1e-3)
    assert found.faults["y1 sensor"].worst["pole"] in (0.1, 0.9)


def test_an_unstable_member_is_named_by_its_parameters():
    loop = UncertainPlant.from_parameters(first_order, {"pole": (0.1, 0.5, 1.2)})
    observer = rs.design.luenberger_observer(loop.nominal, poles=[0.2]).residual_generator()
    with pytest.raises(DesignError, match=r"pole = 1\.2"):
        rs.design.certified_thresholds(observer, loop)


# --------------------------------------------------------------------------- notes


def test_what_a_proof_leaves_out_is_told():
    curved = UncertainPlant.from_parameters(lambda v: first_order({"pole": v["lag"] ** 2}), {"lag": (0.1, 0.5, 0.8)})
    observer = rs.design.luenberger_observer(curved.nominal, poles=[0.2]).residual_generator()
    found = certified_threshold(curved, observer.system, observer.state_map)
    assert found.notes == left_out(curved) != ()
    assert "affine form" in found.notes[0]
    assert "affine form" in str(found)
    noisy = UncertainPlant(first_order({"pole": 0.5}).with_noise(process=[[1.0]]))
    assert any("white noise" in note for note in certified_threshold(noisy, observer.system).notes)
    assert not certified_threshold(UncertainPlant(first_order({"pole": 0.5})), observer.system).notes


def test_short_texts():
    loop = random_loop(3)
    observer = rs.design.luenberger_observer(loop.nominal, margin=1.0).residual_generator()
    (found,) = rs.design.certified_thresholds(observer, loop, method="centred").values()
    assert len(repr(found)) < 300
    assert f"{found.value:.5g}" in str(found)


# -------------------------------------------------------------------------- banks


def test_members_of_a_bank_are_certified_alone():
    """Without the states of other members: the same thresholds as for each filter by itself."""
    loop = random_loop(3)
    bank = rs.design.structured_bank(loop.nominal.without_disturbances(), np.eye(2, dtype=bool))
    found = rs.design.certified_thresholds(bank, loop, method="centred")
    made = bank.generator
    whole = {
        member.name: residual_over_set(loop, made.system.select(outputs=list(member.residuals)), made.state_map)
        for member in made.members
    }
    for member, (name, one) in zip(made.members, found.items(), strict=True):
        part, T = _part(made, list(member.residuals))
        assert part.n_states < made.system.n_states
        alone = residual_over_set(loop, part, T)
        assert alone.n_states < whole[name].n_states
        v = loop.vertex_values()[0] - loop.nominal_values
        assert peak_norm(alone.member(v)).value == pytest.approx(peak_norm(whole[name].member(v)).value, rel=1e-5)
        assert peak_norm(alone.member(v)).value <= one.value * (1 + 1e-9)
